"""`trueangle train --method NAME`: every method makes a file that is served, and says what it was judged by."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

import trueangle_training.examples
from trueangle.contract.metadata import METADATA_KEY, ModelMetadata, metadata_from_json, probe_disagreement
from trueangle_training import cli
from trueangle_training.documents import load_joint
from trueangle_training.methods.registry import METHODS
from trueangle_training.simulator.joint import simulated_joint
from trueangle_training.train_options import excluded_rows

Floats = NDArray[np.float64]
EXAMPLES = Path(trueangle_training.examples.__file__).parent
JOINT, PLAN = str(EXAMPLES / "joint.yaml"), str(EXAMPLES / "plan.yaml")
DATES = ["--calibrated", "2025-03-01"]

Output = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def campaign_csv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "calibration.csv"
    assert cli.main(["simulate", "--joint", JOINT, "--plan", PLAN, "--seed", "2", "-o", str(path)]) == 0
    return path


def train(campaign_csv: Path, out: Path, *options: str) -> ModelMetadata:
    arguments = ["train", str(campaign_csv), "-o", str(out), "--joint", JOINT, *DATES, *options]
    assert cli.main(arguments) == 0
    entries = {entry.key: entry.value for entry in onnx.load(out).metadata_props}
    return metadata_from_json(entries[METADATA_KEY], source=str(out))


def served(path: Path, angle_deg: Floats, temperature_c: Floats) -> dict[str, Floats]:
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    values = session.run(names, {"angle_deg": angle_deg, "temperature_c": temperature_c})
    return {name: np.asarray(value) for name, value in zip(names, values, strict=True)}


@pytest.mark.parametrize("name", [name for name in METHODS if name != "fe-gabpnn-paper"])
def test_every_method_makes_a_file_whose_probes_replay(name: str, campaign_csv: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.onnx"
    metadata = train(campaign_csv, out, "--method", name, "--held-out", "none")
    assert metadata.method == name
    assert metadata.temperature_used is (name != "angle-only")
    probes = metadata.probes
    values = served(out, np.array(probes.angle_deg), np.array(probes.temperature_c))
    assert ("uncertainty_arcsec" in values) == (probes.uncertainty_arcsec is not None)
    shown = probe_disagreement(
        probes,
        correction_arcsec=values["correction_arcsec"].tolist(),
        uncertainty_arcsec=values["uncertainty_arcsec"].tolist() if "uncertainty_arcsec" in values else None,
        tolerance_arcsec=metadata.probe_tolerance_arcsec,
    )
    assert shown is None


def test_the_left_out_temperature_stands_in_file_and_report(
    campaign_csv: Path, tmp_path: Path, capsys: Output
) -> None:
    metadata = train(campaign_csv, tmp_path / "m.onnx", "--method", "linear")
    assert metadata.errors.held_out_kind == "leave-one-temperature-out"
    assert metadata.errors.held_out_rmse_arcsec is not None
    assert metadata.errors.in_sample_rmse_arcsec is not None
    # Noise of 0.65; no model of the left-out temperature is below that of the readings it was trained on.
    assert metadata.errors.in_sample_rmse_arcsec < metadata.errors.held_out_rmse_arcsec < 0.9
    captured = capsys.readouterr()
    assert "left-out temp." in captured.out
    assert "the floor of every figure of readings" in captured.out
    assert captured.err == "training linear on 483 readings\nleaving out each of 7 temperatures\n"


def test_uncertainty_holds_reference_and_sensor_and_vanishes_at_the_datum(
    campaign_csv: Path, tmp_path: Path
) -> None:
    poor = tmp_path / "poor.yaml"
    text = Path(JOINT).read_text()
    poor.write_text(
        text.replace("autocollimator_arcsec: 0.125", "autocollimator_arcsec: 3.0").replace(
            "standard_uncertainty_c: 0.25", "standard_uncertainty_c: 2.0"
        )
    )
    bare = tmp_path / "bare.yaml"
    bare.write_text(
        text.replace("autocollimator_arcsec: 0.125", "autocollimator_arcsec: 0.0").replace(
            "standard_uncertainty_c: 0.25", "standard_uncertainty_c: 0.0"
        )
    )
    angle_deg, temperature_c = np.array([0.0, 90.0, 200.0]), np.array([30.0, 30.0, 30.0])
    total = {}
    for joint in (poor, bare):
        out = tmp_path / f"{joint.stem}.onnx"
        options = ["train", str(campaign_csv), "-o", str(out), "--joint", str(joint), "--method", "linear"]
        assert cli.main([*options, "--held-out", "none"]) == 0
        total[joint.stem] = served(out, angle_deg, temperature_c)["uncertainty_arcsec"]
    assert total["poor"][0] == total["bare"][0] == 0.0
    truth = simulated_joint(load_joint(Path(JOINT)))
    above, below = (truth.error_from_datum_arcsec(angle_deg, temperature_c + step, 0.0) for step in (0.5, -0.5))
    expected = np.sqrt(total["bare"] ** 2 + 3.0**2 + (2.0 * (above - below)) ** 2)
    # The model's slope for the joint's own: 0.4 arcsec a degree, known to a few hundredths.
    np.testing.assert_allclose(total["poor"][1:], expected[1:], rtol=0.05)


def test_auto_tells_what_it_saw_and_keeps_the_best(tmp_path: Path, capsys: Output) -> None:
    plan, csv = tmp_path / "plan.yaml", tmp_path / "short.csv"
    # Three temperatures instead of seven: three trainings of each candidate.
    text = Path(PLAN).read_text()
    plan.write_text(text.replace("[10, 15, 20, 25, 30, 35, 40]  ", "[10, 25, 40]  "))
    assert cli.main(["simulate", "--joint", JOINT, "--plan", str(plan), "--seed", "2", "-o", str(csv)]) == 0
    capsys.readouterr()
    metadata = train(csv, tmp_path / "m.onnx", "--method", "auto")
    assert metadata.calibration.readings == 207
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert "s a training" in lines[0]
    assert lines[1].split()[0] == metadata.method
    assert "chosen" in lines[1]
    assert metadata.errors.held_out_kind == "leave-one-temperature-out"


def test_a_typing_error_ends_with_2_until_the_user_leaves_it_out(
    campaign_csv: Path, tmp_path: Path, capsys: Output
) -> None:
    lines = campaign_csv.read_text().splitlines()
    cells = lines[99].split(",")
    cells[1] = repr(float(cells[1]) + 18.0 * 3600.0)
    lines[99] = ",".join(cells)
    bad, out = tmp_path / "bad.csv", tmp_path / "m.onnx"
    bad.write_text("\n".join(lines) + "\n")
    options = ["--joint", JOINT, *DATES, "--method", "harmonics-poly"]
    assert cli.main(["train", str(bad), "-o", str(out), *options]) == 2
    err = capsys.readouterr().err
    assert "line 100" in err
    assert "--exclude-rows 100" in err
    assert not out.exists()
    metadata = train(bad, out, "--method", "harmonics-poly", "--exclude-rows", "100")
    assert metadata.calibration.readings == 482
    assert any("left out by the user (line 100)" in note for note in metadata.notes)


def test_shifted_repeats_are_for_methods_that_estimate_the_runs_zeros(tmp_path: Path, capsys: Output) -> None:
    plan, csv, out = tmp_path / "plan.yaml", tmp_path / "shifted.csv", tmp_path / "m.onnx"
    plan.write_text(Path(PLAN).read_text().replace("shift_faces: 0 ", "shift_faces: 0.3333333333333333 "))
    assert cli.main(["simulate", "--joint", JOINT, "--plan", str(plan), "--seed", "1", "-o", str(csv)]) == 0
    arguments = ["train", str(csv), "-o", str(out), "--joint", JOINT, "--held-out", "none"]
    assert cli.main([*arguments, "--method", "fepf"]) == 2
    assert "choose --method linear" in capsys.readouterr().err
    assert cli.main([*arguments, "--method", "linear"]) == 0
    truth = simulated_joint(load_joint(Path(JOINT)))
    angle_deg, temperature_c = (
        axis.ravel() for axis in np.meshgrid(np.arange(0.0, 360.0, 1.0), np.arange(10.0, 40.1, 3.0))
    )
    left = truth.error_from_datum_arcsec(angle_deg, temperature_c, 0.0)
    left = left + served(out, angle_deg, temperature_c)["correction_arcsec"]
    # Without the error at the datum, one draw of noise common to all angles. The plain plan cannot see orders
    # 12 to 20 and leaves 0.46 arcsec; 69 angles bring it to 0.22, standard deviation 0.02 over campaigns.
    assert np.std(left) < 0.30


def test_options_of_the_papers_networks_belong_to_them(campaign_csv: Path, tmp_path: Path, capsys: Output) -> None:
    arguments = ["train", str(campaign_csv), "-o", str(tmp_path / "m.onnx"), "--joint", JOINT]
    assert cli.main([*arguments, "--method", "linear", "--hidden-nodes", "5"]) == 2
    err = capsys.readouterr().err
    assert "no options of the paper's networks with --method linear, found --hidden-nodes" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["linear", "harmonics-poly", "fepf", "poly2d", "angle-only"])
def test_methods_without_a_network_do_not_wait_for_torch(name: str, campaign_csv: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.onnx"
    arguments = ["train", str(campaign_csv), "-o", str(out), "--joint", JOINT, "--method", name]
    program = (
        "import sys; from trueangle_training import cli\n"
        f"code = cli.main({arguments!r})\n"
        "sys.exit(code or ('torch' in sys.modules) * 9)"
    )
    path = os.pathsep.join(entry for entry in sys.path if entry)
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        check=False,
        env={"PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
        timeout=120,
    )
    assert done.returncode == 0


def test_rows_are_given_singly_and_as_ranges() -> None:
    assert excluded_rows("17,40-42") == {17, 40, 41, 42}
    with pytest.raises(ValueError, match="invalid literal"):
        excluded_rows("seventeen")
