"""Model files: the good one serves, every broken one is refused by name.

The files in tests/data/models are written by tests/data/make_models.py, which needs the training extra; here the
daemon reads them without it.
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trueangle.contract.errors import ContractError
from trueangle.edges.onnx_model import MAX_MODEL_BYTES, load_model

DATA = Path(__file__).parents[1] / "data" / "models"


def refused(path: Path, pinned_sha256: str | None = None) -> str:
    with pytest.raises(ContractError) as caught:
        load_model(path, pinned_sha256=pinned_sha256)
    return str(caught.value)


def test_a_good_model_corrects_and_is_zero_at_its_datum() -> None:
    model = load_model(DATA / "good.onnx")
    datum = np.full(4, model.metadata.datum_deg)
    answer = model.correct(datum, np.array([10.0, 20.0, 30.0, 40.0]))
    assert answer.correction_arcsec.tolist() == [0.0, 0.0, 0.0, 0.0]
    assert abs(model.correct(np.array([123.0]), np.array([25.0])).correction_arcsec[0]) > 1.0


def test_whole_turns_do_not_change_the_correction() -> None:
    model = load_model(DATA / "good.onnx")
    angle_deg = np.linspace(0, 359.9, 50)
    temperature_c = np.full(50, 23.0)
    once = model.correct(angle_deg, temperature_c).correction_arcsec
    for turns in (-3, 1, 7):
        again = model.correct(angle_deg + 360.0 * turns, temperature_c).correction_arcsec
        assert np.abs(again - once).max() < 1e-9


def test_no_samples_give_no_corrections() -> None:
    assert load_model(DATA / "good.onnx").correct(np.empty(0), np.empty(0)).correction_arcsec.shape == (0,)


def test_the_pinned_file_is_accepted_and_any_other_refused() -> None:
    sha256 = hashlib.sha256((DATA / "good.onnx").read_bytes()).hexdigest()
    assert load_model(DATA / "good.onnx", pinned_sha256=sha256).sha256 == sha256
    assert "expected the pinned SHA-256" in refused(DATA / "good.onnx", "0" * 64)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("probe-disagrees.onnx", "expected probes that come out as they were written, found probe 8"),
        # One sign bit of one weight: the file is well-formed, only the probes can tell.
        ("flipped-weight.onnx", "expected probes that come out as they were written, found probe"),
        ("wrong-inputs.onnx", "expected the inputs angle_deg, temperature_c, found theta, temperature_c"),
        ("float32.onnx", "expected tensor(double) of shape [n], found tensor(float)"),
        ("no-metadata.onnx", "expected metadata under the key trueangle, found none"),
        ("newer-metadata.onnx", "schema_version: expected a whole number, exactly 1, found 2"),
        ("external-data.onnx", "expected all weights inside the file, found a reference to external data"),
    ],
)
def test_a_model_that_breaks_the_contract_is_refused_by_name(name: str, found: str) -> None:
    text = refused(DATA / name)
    assert name in text
    assert found in text


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    whole = (DATA / "good.onnx").read_bytes()
    for name, data in (
        ("cut.onnx", whole[: len(whole) // 2]),
        ("garbage.onnx", bytes(range(256)) * 40),
        ("text.onnx", b"hello"),
    ):
        (tmp_path / name).write_bytes(data)
        assert "an ONNX model that ONNX Runtime can load" in refused(tmp_path / name) or "metadata" in refused(
            tmp_path / name
        )
    (tmp_path / "empty.onnx").write_bytes(b"")
    assert "found an empty file" in refused(tmp_path / "empty.onnx")
    assert "expected a readable model file" in refused(tmp_path / "nowhere.onnx")


def test_a_range_changed_afterwards_is_refused_although_graph_and_probes_agree(tmp_path: Path) -> None:
    data = (DATA / "good.onnx").read_bytes()
    at = data.index(b'"maximum": 40.')
    (tmp_path / "wider.onnx").write_bytes(data[: at + 11] + b"6" + data[at + 12 :])
    assert "expected the file's own SHA-256 under trueangle_sha256, found another" in refused(
        tmp_path / "wider.onnx"
    )


def test_no_damaged_byte_is_accepted(tmp_path: Path) -> None:
    """Bits flipped all over the file: refused with a message, whatever the runtime makes of it."""
    data = (DATA / "good.onnx").read_bytes()
    for at in range(0, len(data), max(1, len(data) // 150)):
        damaged = bytearray(data)
        damaged[at] ^= 1 << (at % 8)
        (tmp_path / "bit.onnx").write_bytes(bytes(damaged))
        assert "bit.onnx" in refused(tmp_path / "bit.onnx")


def test_a_run_that_fails_gives_nan_and_no_exception() -> None:
    model = load_model(DATA / "good.onnx")
    answer = model.correct(np.zeros(3), np.zeros(2))
    assert np.isnan(answer.correction_arcsec).all()


class Runtime:
    """A session whose run writes no answer, or fails."""

    def __init__(self, error: Exception | None) -> None:
        self.error = error

    def run_with_iobinding(self, _: object) -> None:
        if self.error is not None:
            raise self.error


@pytest.mark.parametrize("error", [None, RuntimeError("planted")])
def test_the_answer_of_the_sample_before_is_never_given_again(error: Exception | None) -> None:
    model = load_model(DATA / "good.onnx")
    assert model.correct_sample(135.6, 25.0).correction_arcsec != 0.0
    model._one._session = Runtime(error)
    assert np.isnan(model.correct_sample(135.6, 25.0).correction_arcsec)


def test_a_file_too_large_to_be_a_model_is_not_even_read(tmp_path: Path) -> None:
    with (tmp_path / "huge.onnx").open("wb") as file:
        file.truncate(MAX_MODEL_BYTES + 1)
    assert f"expected at most {MAX_MODEL_BYTES} bytes, found a larger file" in refused(tmp_path / "huge.onnx")


def test_the_runtime_s_telemetry_is_off_before_it_is_imported() -> None:
    code = (
        "import os, sys, pathlib; import trueangle.edges.onnx_model as m; assert 'onnxruntime' not in sys.modules;"
        f"m.load_model(pathlib.Path({str(DATA / 'good.onnx')!r})); print(os.environ['ORT_DISABLE_TELEMETRY'])"
    )
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.strip() == "1"


@pytest.mark.parametrize("name", ["a\0b.onnx", "a\ud800b.onnx"])
def test_a_name_that_no_file_can_have_is_a_fault_like_any_other(name: str) -> None:
    with pytest.raises(ContractError, match="expected a readable model file"):
        load_model(Path(name))
