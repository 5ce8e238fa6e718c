"""Answers of `trueangle diagnose` must not mislead: what was set aside, what is left, what may be overwritten."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.training.test_diagnose_command import JOINT, campaign_rows, diagnosed, refused, report_of, write_rows

from trueangle_training import cli

Output = pytest.CaptureFixture[str]

KNOWN = """\
schema_version: 1
name: known
encoder: {lines_per_rev: 16384, counts_per_rev: 3276800}
reference: {kind: polygon, faces: 23, autocollimator_arcsec: 0.125}
noise: {repeatability_arcsec: 0.6}
effects:
  eccentricity: {amplitude_arcsec: 40, phase_deg: 30}
  grating_tilt: {amplitude_arcsec: 6, phase_deg: -50}
  graduation_error: {orders: [3, 11], harmonics: [{order: 3, amplitude_arcsec: 2, phase_deg: 10}]}
  thermal_eccentricity: {amplitude_arcsec_per_k: 0.3, phase_deg: 80}
"""
PLAN = """\
schema_version: 1
faces: 23
temperatures_c: [10, 15, 20, 25, 30, 35, 40]
repeats: 3
directions: [1]
soak_h: 4
temperature_jitter_c: 0.1
"""
SWEEPS = """\
schema_version: 1
faces: 23
temperatures_c: [10, 25, 40]
repeats: 2
directions: [1]
soak_h: 3
temperature_jitter_c: 0.1
segments:
  - {kind: sweep, temperatures_c: [15, 35], repeats: 2, directions: [1, -1], speeds_deg_s: [10, 40], turns: 2,
     degrees_per_reading: 12.3}
"""


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT)
    return path


def simulated(folder: Path, effect: str, *, plan: str = PLAN, seed: int = 5) -> Path:
    """A campaign of the known joint with an effect more, and beside it the file of the known joint."""
    (folder / "known.yaml").write_text(KNOWN)
    (folder / "true.yaml").write_text(KNOWN + effect)
    (folder / "plan.yaml").write_text(plan)
    out = folder / "campaign.csv"
    files = ["--joint", str(folder / "true.yaml"), "--plan", str(folder / "plan.yaml"), "-o", str(out)]
    assert cli.main(["simulate", *files, "--seed", str(seed)]) == 0
    return out


def diagnosis(campaign: Path, joint: Path, name: str, *, update: Path | None = None) -> dict[str, Any]:
    out = campaign.with_name(name)
    options = [] if update is None else ["--update", str(update)]
    assert (
        cli.main(["diagnose", str(campaign), "--joint", str(joint), "--out", str(out), "--no-html", *options]) == 0
    )
    return report_of(out)


@pytest.mark.parametrize(
    ("effect", "name"),
    [
        (
            "  subdivision_error: {harmonics: [{per_line: 2, amplitude_arcsec: 1.5, phase_deg: 20}]}\n",
            "subdivision_error",
        ),
        ("  run_to_run_eccentricity: {amplitude_arcsec: 2}\n", "run_to_run_eccentricity"),
        ("  noise_growth: {arcsec_per_k: 0.1, from_temperature_c: 10}\n", "noise_growth"),
    ],
)
def test_with_the_updated_joint_the_same_campaign_is_noise(effect: str, name: str, tmp_path: Path) -> None:
    campaign = simulated(tmp_path, effect)
    updated = tmp_path / "updated.yaml"
    first = diagnosis(campaign, tmp_path / "known.yaml", "first", update=updated)
    assert name in [cause["effect"] for cause in first["causes"]]
    assert sum(place["share"] for place in first["where"]) == pytest.approx(1.0, abs=0.02)
    second = diagnosis(campaign, updated, "second")
    assert second["verdict"] == "none"
    # No more than the uncertainty of the curves inside a line, whose phase the noise of each reading moves.
    assert second["gap"]["structural_share"] < 0.15
    again = ["--joint", str(updated), "--plan", str(tmp_path / "plan.yaml"), "-o", str(tmp_path / "again.csv")]
    again += ["--seed", "9"]
    assert cli.main(["simulate", *again]) == 0


def test_an_effect_that_got_more_orders_is_told_as_extended(joint: Path, capsys: Output) -> None:
    rows = campaign_rows(shift=1 / 3, extra=lambda angle, temperature_c, direction: 1.5 * np.cos(14 * angle))
    measured = write_rows(joint.with_name("measured.csv"), rows)
    updated = joint.with_name("updated.yaml")
    report = diagnosis(measured, joint, "out", update=updated)
    assert [cause["effect"] for cause in report["causes"]] == ["graduation_error"]
    assert "with graduation_error extended" in capsys.readouterr().out
    assert 14 in [
        each["order"] for each in yaml.safe_load(updated.read_text())["effects"]["graduation_error"]["harmonics"]
    ]


def test_shifts_of_whole_runs_under_one_zero_are_laid_to_their_condition(tmp_path: Path) -> None:
    """Latency of 20 us at up to 40 deg/s is 2.9 arcsec, the same in each run of one speed and direction."""
    campaign = simulated(tmp_path, "  read_latency: {latency_s: 2.0e-5}\n", plan=SWEEPS)
    report = diagnosis(campaign, tmp_path / "known.yaml", "out")
    assert report["gap"]["structural_share"] > 0.8
    assert report["verdict"] == "named"
    assert [cause["effect"] for cause in report["causes"]] == ["read_latency"]
    assert report["gap"]["closure"] is not None, "a gap of this size is significant"


def test_a_zero_that_wanders_from_run_to_run_is_no_latency(tmp_path: Path) -> None:
    """Sweeps in both directions at two speeds, one zero for all, which moves by .7 arcsec between the runs."""
    campaign = simulated(tmp_path, "", plan=SWEEPS)
    header, *lines = (line for line in campaign.read_text().splitlines() if not line.startswith("#"))
    columns = header.split(",")
    run, error, face = (columns.index(name) for name in ("run", "error_arcsec", "face"))
    rng = np.random.default_rng(11)
    moved_by: dict[str, float] = {}
    rows = [line.split(",") for line in lines]
    for row in rows:
        moved_by.setdefault(row[run], float(rng.normal(0.0, 0.7)))
        if row[face] == "0":
            row[error] = repr(float(row[error]) + moved_by[row[run]])
    campaign.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")
    assert diagnosis(campaign, tmp_path / "known.yaml", "out")["verdict"] == "none"


def test_readings_that_were_set_aside_are_told_by_line(joint: Path, capsys: Output) -> None:
    rows = campaign_rows(seed=3)
    for number in (100, 101, 102, 103, 104, 250):
        rows[number]["error_arcsec"] = repr(float(rows[number]["error_arcsec"]) + 6.0)
    report = diagnosed(rows, joint)
    (note,) = [each for each in report["notes"] if "taken for disturbances" in each]  # pyright: ignore[reportGeneralTypeIssues]
    # The header is line 1.
    assert "102-106" in note
    assert "252" in note
    assert "counts lost" in note
    assert "taken for disturbances" in capsys.readouterr().out


def test_too_few_runs_say_what_can_be_said_all_the_same(joint: Path, capsys: Output) -> None:
    report = diagnosed(campaign_rows(temperatures_c=(20.0,), repeats=1), joint)
    (note,) = [each for each in report["notes"] if "what can be said" in each]  # pyright: ignore[reportGeneralTypeIssues]
    # 23 readings, one offset, orders 1 to 11 with two parameters each: nothing is left.
    assert "moved to fit every reading" in note
    assert "With 23 readings in 1 run" in capsys.readouterr().out


def test_a_faulty_file_asks_to_be_mended_not_for_a_measurement(joint: Path) -> None:
    rows = [{**row, "error_arcsec": "1.5"} for row in campaign_rows()]
    assert "Mend the file" in str(diagnosed(rows, joint)["next_measurement"])


@pytest.mark.parametrize("name", ["report.json", "design.json", "report.html"])
def test_an_update_never_overwrites_the_report(name: str, joint: Path, capsys: Output) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(repeats=1))
    out = joint.with_name("out")
    arguments = [str(measured), "--joint", str(joint), "--out", str(out), "--update", str(out / name)]
    assert "another file than the report's own files" in refused(arguments, capsys)
    assert not (out / name).exists()


def test_the_joint_itself_may_be_updated_in_place_and_again(joint: Path) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(repeats=2, seed=9))
    for _ in range(2):
        assert diagnosis(measured, joint, "out", update=joint)["verdict"] == "none"
    text = joint.read_text()
    assert text.startswith("# the elbow")
    assert list(yaml.safe_load(text)["effects"]) == [
        "eccentricity",
        "grating_tilt",
        "graduation_error",
        "thermal_eccentricity",
    ]


def test_directions_that_never_share_a_zero_are_told(joint: Path) -> None:
    """Up and down in runs of their own, each with its own zero: constant hysteresis is in the offsets."""
    rows = campaign_rows(directions=(1, -1), repeats=2, seed=12)
    apart = [{**row, "run": str(2 * int(row["run"]) + (row["direction"] == "1"))} for row in rows]
    notes = " ".join(str(note) for note in diagnosed(apart, joint)["notes"])  # pyright: ignore[reportGeneralTypeIssues]
    assert "measure both directions under one zero" in notes
    together = " ".join(str(note) for note in diagnosed(rows, joint)["notes"])  # pyright: ignore[reportGeneralTypeIssues]
    assert "measure both directions under one zero" not in together


def test_a_long_simulation_says_that_it_works_and_a_short_one_is_silent(tmp_path: Path, capsys: Output) -> None:
    simulated(tmp_path, "")
    assert capsys.readouterr().err == ""
    long_plan = PLAN + (
        "segments:\n  - {kind: sweep, temperatures_c: [20], repeats: 1, speeds_deg_s: [10], turns: 100,\n"
        "     degrees_per_reading: 0.7}\n"
    )
    simulated(tmp_path, "", plan=long_plan)
    # 483 stops and a reading every 0.7 deg of 36,000.
    assert "simulating 519" in capsys.readouterr().err


def test_an_update_with_one_of_a_class_says_that_it_stands_for_the_others(joint: Path, capsys: Output) -> None:
    """A simulator without effects: eccentricity and a pattern over the faces are one thing at 23 fixed stops."""
    joint.write_text(JOINT.split("effects:")[0] + "effects: []\n")
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(seed=2))
    report = diagnosis(measured, joint, "out", update=joint.with_name("updated.yaml"))
    (cause,) = [each for each in report["causes"] if len(each["class"]) > 1]
    assert f"{cause['effect']} is written for one of {', '.join(cause['class'])}" in capsys.readouterr().out


def test_an_error_of_the_interpolation_lies_at_the_lines_not_at_orders_that_look_like_them(tmp_path: Path) -> None:
    found = simulated(
        tmp_path,
        "  subdivision_error:\n"
        "    harmonics:\n"
        "    - {per_line: 1, amplitude_arcsec: 1.2, phase_deg: 20}\n"
        "    - {per_line: 2, amplitude_arcsec: 1.2, phase_deg: 70}\n",
    )
    report = diagnosis(found, tmp_path / "known.yaml", "out")
    assert [cause["effect"] for cause in report["causes"]] == ["subdivision_error"]
    assert report["where"][0]["cell"]["order"] in ("N", "2N")
    assert report["where"][0]["share"] > 0.9
