"""A JOINT.yaml that lists another number of faces than its polygon has is refused wherever it is read."""

from pathlib import Path

import pytest
from tests.training.test_diagnose_command import campaign_rows, write_rows

from trueangle_training import cli

JOINT = """\
schema_version: 1
encoder: {{lines_per_rev: 16384, counts_per_rev: 3276800}}
reference: {{kind: polygon, faces: 23}}
effects:
  eccentricity: {{amplitude_arcsec: 20, phase_deg: 10}}
  reference_artefact:
    faces_arcsec: [{faces}]
"""
PLAN = "{schema_version: 1, faces: 23, temperatures_c: [20], repeats: 1, directions: [1], soak_h: 4}\n"
COMMANDS = {
    "simulate": "simulate --joint joint.yaml --plan plan.yaml --seed 1 -o made.csv",
    "train": "train measured.csv --joint joint.yaml -o made.onnx",
    "train in simulation": "train --from-simulator joint.yaml -o made.onnx",
    "diagnose": "diagnose measured.csv --joint joint.yaml --out made",
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("listed", "found"), [(22, "22 deviations"), (24, "24 deviations"), (1, "1 deviation")])
def test_another_number_of_faces_is_refused_with_its_place(
    command: str,
    listed: int,
    found: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rows(tmp_path / "measured.csv", campaign_rows(repeats=1))
    (tmp_path / "plan.yaml").write_text(PLAN)
    (tmp_path / "joint.yaml").write_text(JOINT.format(faces=", ".join(["0.1"] * listed)))
    assert cli.main(COMMANDS[command].split()) == 2
    err = capsys.readouterr().err
    assert "joint.yaml line 7, effects.reference_artefact.faces_arcsec" in err
    assert f"expected 23 deviations, one for each face of the reference, found {found}" in err
    assert not list(tmp_path.glob("made*"))
