"""`trueangle diagnose` from files to files: what it finds, what it refuses, and that the answer can be used."""

import csv
import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from trueangle_training import cli
from trueangle_training.diagnosis.findings_json import DESIGN_SCHEMA, REPORT_SCHEMA, schema
from trueangle_training.documents import load_joint

FACES = 23
COUNTS = 3276800
NOISE_ARCSEC = 0.6
JOINT = """\
# the elbow
schema_version: 1
name: elbow
encoder: {lines_per_rev: 16384, counts_per_rev: 3276800}
reference: {kind: polygon, faces: 23}
effects: [eccentricity, grating_tilt, graduation_error, thermal_eccentricity]
noise: {repeatability_arcsec: 0.6}   # of the bench
"""
HARDWARE = Path(__file__).resolve().parents[3] / "shared" / "data" / "as5047d"

Output = pytest.CaptureFixture[str]
Row = dict[str, str]


def campaign_rows(
    *,
    seed: int = 1,
    temperatures_c: tuple[float, ...] = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0),
    repeats: int = 3,
    directions: tuple[int, ...] = (1,),
    shift: float = 0.0,
    extra: Callable[[np.ndarray, float, int], np.ndarray] = lambda angle_rad, temperature_c, direction: (
        0.0 * angle_rad
    ),
) -> list[Row]:
    """Readings of a joint with the modelled effects and one more, both directions of a repeat under one zero."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    run, time_s = 0, 0.0
    for set_c in temperatures_c:
        time_s += 14_400.0
        for repeat in range(repeats):
            run += 1
            zero_arcsec = None
            for direction in directions:
                stops = np.arange(FACES) if direction > 0 else np.arange(FACES)[::-1]
                true_deg = (stops + shift * repeat) * 360.0 / FACES
                angle = np.radians(true_deg)
                temperature_c = set_c + rng.uniform(-0.1, 0.1)
                error = 40.0 * np.cos(angle - 1.0) + 6.0 * np.cos(2 * angle + 0.3) + 1.5 * np.cos(3 * angle)
                error = error + 0.3 * (temperature_c - 20.0) * np.cos(angle - 0.4)
                error = error + extra(angle, temperature_c, direction) + rng.normal(0.0, NOISE_ARCSEC, FACES)
                angle_deg = np.round((true_deg + error / 3600.0) * COUNTS / 360.0) * 360.0 / COUNTS
                zero_arcsec = error[0] if zero_arcsec is None else zero_arcsec
                for i in range(FACES):
                    rows.append(
                        {
                            "angle_deg": repr(float(angle_deg[i])),
                            "error_arcsec": repr(float(error[i] - zero_arcsec)),
                            "temperature_c": repr(float(temperature_c)),
                            "run": str(run),
                            "time_s": repr(time_s),
                            "direction": str(direction),
                            "velocity_deg_s": "0",
                            "face": str(int(stops[i]) + 1),
                        }
                    )
                    time_s += 15.0
    return rows


def write_rows(path: Path, rows: list[Row], columns: tuple[str, ...] | None = None) -> Path:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns or tuple(rows[0]), extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path.write_text(text.getvalue())
    return path


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT)
    return path


def report_of(folder: Path) -> dict[str, object]:
    """The checked report; design.json beside it is checked too."""
    document = json.loads((folder / "report.json").read_text())
    jsonschema.validate(document, schema(REPORT_SCHEMA))
    jsonschema.validate(json.loads((folder / "design.json").read_text()), schema(DESIGN_SCHEMA))
    return document


def diagnosed(rows: list[Row], joint: Path, columns: tuple[str, ...] | None = None) -> dict[str, object]:
    measured = write_rows(joint.with_name("measured.csv"), rows, columns)
    out = joint.with_name("out")
    assert cli.main(["diagnose", str(measured), "--joint", str(joint), "--out", str(out), "--no-html"]) == 0
    return report_of(out)


def hysteresis(angle_rad: np.ndarray, temperature_c: float, direction: int) -> np.ndarray:
    return direction * (1.2 + 0.4 * np.cos(angle_rad - 0.5))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A joint with hysteresis, diagnosed with page and update: the folder of all files."""
    folder = tmp_path_factory.mktemp("found")
    (folder / "joint.yaml").write_text(JOINT)
    write_rows(folder / "measured.csv", campaign_rows(directions=(1, -1), extra=hysteresis, repeats=2))
    arguments = ["--joint", str(folder / "joint.yaml"), "--out", str(folder / "out")]
    arguments += ["--update", str(folder / "updated.yaml")]
    assert cli.main(["diagnose", str(folder / "measured.csv"), *arguments]) == 0
    return folder


def test_a_withheld_effect_is_named_located_and_closes_the_gap(found: Path) -> None:
    report = report_of(found / "out")
    assert report["verdict"] == "named"
    cause = report["causes"][0]  # pyright: ignore[reportIndexIssue]
    assert cause["effect"] == "hysteresis"
    assert cause["closes"] > 0.9
    assert report["where"][0]["cell"]["direction"] == "odd"  # pyright: ignore[reportIndexIssue]
    gap = report["gap"]
    # 1.2 and 0.4 / sqrt 2 arcsec beside 0.6 of noise: sqrt(1.44 + 0.08 + 0.36) = 1.37 before, 0.6 after.
    assert gap["rmse_recalibrated_arcsec"] == pytest.approx(1.37, abs=0.15)  # pyright: ignore[reportIndexIssue]
    assert gap["rmse_explained_arcsec"] == pytest.approx(0.6, abs=0.1)  # pyright: ignore[reportIndexIssue]
    assert gap["closure"] > 0.9  # pyright: ignore[reportIndexIssue]
    task = report["end_task"]
    assert task["compensable"] is False  # pyright: ignore[reportIndexIssue]
    assert task["missing_input"] == "direction"  # pyright: ignore[reportIndexIssue]


def test_page_and_plots_stand_beside_the_numbers(found: Path) -> None:
    names = {path.name for path in (found / "out").iterdir()}
    assert names == {"report.json", "design.json", "report.html", "plots"}
    page = (found / "out" / "report.html").read_text()
    assert "The simulator lacks hysteresis" in page
    assert {"where.svg", "residuals.svg", "waterfall.svg"} <= {p.name for p in (found / "out" / "plots").iterdir()}


def test_the_updated_joint_keeps_what_the_user_wrote_and_says_what_was_added(found: Path) -> None:
    text = (found / "updated.yaml").read_text()
    for line in ("# the elbow", "noise: {repeatability_arcsec: 0.6}   # of the bench", "name: elbow"):
        assert line in text
    assert "# found" in text
    assert "measured.csv" in text
    updated = load_joint(found / "updated.yaml")
    assert "hysteresis" in updated.effects
    eccentricity = updated.effects["eccentricity"].plain()
    assert eccentricity["amplitude_arcsec"] == pytest.approx(40.0, abs=0.2)
    # A cos(angle - phase) with the phase of one radian.
    assert eccentricity["phase_deg"] == pytest.approx(np.degrees(1.0), abs=0.5)


def test_diagnosed_again_with_the_updated_joint_nothing_is_missing(found: Path, tmp_path: Path) -> None:
    arguments = ["--joint", str(found / "updated.yaml"), "--out", str(tmp_path / "again"), "--no-html"]
    assert cli.main(["diagnose", str(found / "measured.csv"), *arguments]) == 0
    report = report_of(tmp_path / "again")
    assert report["verdict"] == "none"
    # The shipped simulator is now as good as the floor allows.
    assert report["gap"]["rmse_shipped_arcsec"] == pytest.approx(0.6, abs=0.1)  # pyright: ignore[reportIndexIssue]


def test_simulate_and_train_use_the_updated_joint_at_once(found: Path, tmp_path: Path, capsys: Output) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        "{schema_version: 1, faces: 23, temperatures_c: [10, 25, 40], repeats: 2, directions: [1, -1]}\n"
    )
    simulated, model = tmp_path / "simulated.csv", tmp_path / "elbow.onnx"
    updated = str(found / "updated.yaml")
    assert (
        cli.main(["simulate", "--joint", updated, "--plan", str(plan), "--seed", "1", "-o", str(simulated)]) == 0
    )
    train = ["train", "--from-simulator", updated, "--plan", str(plan), "-o", str(model), "--method", "linear"]
    assert cli.main(train) == 0
    assert model.exists()
    assert "trained in simulation, not on a measurement" in capsys.readouterr().out


def test_the_same_files_give_the_same_report(found: Path, tmp_path: Path) -> None:
    arguments = ["--joint", str(found / "joint.yaml"), "--out", str(tmp_path / "again"), "--no-html"]
    assert cli.main(["diagnose", str(found / "measured.csv"), *arguments]) == 0
    assert (tmp_path / "again" / "report.json").read_bytes() == (found / "out" / "report.json").read_bytes()


def test_noise_alone_is_no_effect(joint: Path) -> None:
    report = diagnosed(campaign_rows(seed=11), joint)
    assert report["verdict"] == "none"
    assert report["causes"] == []
    assert report["gap"]["closure"] is None  # pyright: ignore[reportIndexIssue]


@pytest.mark.parametrize("effects", ["[]", "[run_to_run_eccentricity]"])
def test_a_simulator_that_models_no_curve_is_diagnosed_all_the_same(effects: str, joint: Path) -> None:
    joint.write_text(yaml.safe_dump({**yaml.safe_load(JOINT), "effects": yaml.safe_load(effects)}))
    report = diagnosed(campaign_rows(seed=1), joint)
    assert report["verdict"] in ("named", "unknown")


def test_an_effect_that_the_plan_hides_is_listed_and_not_looked_for(joint: Path) -> None:
    report = diagnosed(campaign_rows(seed=3, extra=hysteresis), joint)
    assert report["verdict"] == "none"
    assert "hysteresis" in report["invisible"]  # pyright: ignore[reportOperatorIssue]
    assert "load_deflection" in report["not_testable"]  # pyright: ignore[reportOperatorIssue]


def test_one_run_is_insufficient_and_the_number_needed_is_said(joint: Path, capsys: Output) -> None:
    report = diagnosed(campaign_rows(temperatures_c=(20.0,), repeats=1), joint)
    assert report["verdict"] == "insufficient"
    assert "at least 7 more runs" in str(report["next_measurement"])
    assert "at least 7 more runs" in capsys.readouterr().out


def test_one_temperature_says_that_heat_is_not_visible(joint: Path) -> None:
    report = diagnosed(campaign_rows(temperatures_c=(20.0,), repeats=6, seed=5), joint)
    assert report["verdict"] == "none"
    hidden = {*report["invisible"], *report["not_testable"]}  # pyright: ignore[reportGeneralTypeIssues]
    assert "thermal_nonlinearity" in hidden or "thermal_lag" in hidden


def test_without_temperatures_everything_is_of_the_angle_only_and_says_so(joint: Path) -> None:
    rows = campaign_rows(temperatures_c=(20.0,), repeats=8, seed=6)
    report = diagnosed(rows, joint, columns=("angle_deg", "error_arcsec", "run"))
    assert any("angle only" in note for note in report["notes"])  # pyright: ignore[reportGeneralTypeIssues]
    assert "thermal_eccentricity" in report["not_testable"]  # pyright: ignore[reportOperatorIssue]


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("errors_all_equal", lambda row: {**row, "error_arcsec": "1.5"}),
        ("direction_swapped", lambda row: {**row, "direction": "-1"}),
        ("other_joint", lambda row: {**row, "face": str(int(row["face"]) + 1)}),
    ],
)
def test_a_fault_of_the_file_is_named_as_such_and_no_physics_is_told(
    kind: str, change: Callable[[Row], Row], joint: Path
) -> None:
    report = diagnosed([change(row) for row in campaign_rows()], joint)
    assert report["verdict"] == "data_fault"
    assert kind in [fault["kind"] for fault in report["data_faults"]]  # pyright: ignore[reportGeneralTypeIssues]
    assert report["causes"] == []


def test_all_readings_equal_is_a_fault_of_the_file(joint: Path) -> None:
    report = diagnosed([campaign_rows()[5]] * 60, joint)
    assert report["verdict"] == "data_fault"


def test_a_file_of_another_joint_is_said_to_be_one_and_not_unknown_with_confidence(joint: Path) -> None:
    # The campaign's eccentricity is 40 arcsec at 57 deg, its tilt 6 at -17; this joint's lie elsewhere.
    joint.write_text(
        JOINT.split("effects:")[0]
        + "effects:\n"
        + "  eccentricity: {amplitude_arcsec: 70, phase_deg: 200}\n"
        + "  grating_tilt: {amplitude_arcsec: 12, phase_deg: 120}\n"
        + "  graduation_error: {orders: [3, 3], harmonics: [{order: 3, amplitude_arcsec: 3, phase_deg: 150}]}\n"
        + "  thermal_eccentricity: {amplitude_arcsec_per_k: 0.4, phase_deg: 180}\n"
    )
    report = diagnosed(campaign_rows(seed=4), joint)
    assert report["verdict"] == "data_fault"
    assert [fault["kind"] for fault in report["data_faults"]] == ["other_joint"]  # pyright: ignore[reportGeneralTypeIssues]


@pytest.mark.parametrize("readings", [1, 2, 5])
def test_a_handful_of_readings_ends_in_a_report(readings: int, joint: Path) -> None:
    report = diagnosed(campaign_rows()[:readings], joint)
    assert report["verdict"] in ("insufficient", "data_fault")


RECORDING = ("time_s", "angle_deg", "error_arcsec", "temperature_c", "direction", "velocity_deg_s", "quality")


def test_a_recording_of_the_daemon_is_accepted(joint: Path) -> None:
    """Reference angles only where the PLC supplied them, no face, no run, a column of the daemon's own."""
    rows = campaign_rows(directions=(1, -1), extra=hysteresis, repeats=2, seed=8)
    for number, row in enumerate(rows):
        row["quality"] = "0"
        if number % 10 == 3:
            row["error_arcsec"] = ""
    report = diagnosed(rows, joint, columns=RECORDING)
    notes = " ".join(report["notes"])  # pyright: ignore[reportArgumentType, reportCallIssue]
    assert "column quality is unknown" in notes
    assert "readings without angle or error were left out" in notes
    assert report["verdict"] in ("none", "named", "unknown")
    # Turning back begins a new run and, without a column zero_group, a new zero: it hides the constant part.
    assert report["subject"]["runs"] == 28  # pyright: ignore[reportIndexIssue]


@pytest.mark.skipif(not HARDWARE.is_dir(), reason="the tables of real encoders are not beside the repository")
@pytest.mark.parametrize("table", ["table05.csv", "table07.csv"])
def test_real_encoders_get_a_sensible_answer_with_what_is_not_visible(table: str, tmp_path: Path) -> None:
    joint = tmp_path / "as5047d.yaml"
    joint.write_text(
        "{schema_version: 1, encoder: {lines_per_rev: 1, counts_per_rev: 16384}, reference: {kind: encoder}, "
        "effects: [eccentricity, grating_tilt]}\n"
    )
    out = tmp_path / "out"
    assert cli.main(["diagnose", str(HARDWARE / table), "--joint", str(joint), "--out", str(out)]) == 0
    report = report_of(out)
    assert report["verdict"] in ("none", "named", "unknown")
    assert "thermal_eccentricity" in report["not_testable"]  # pyright: ignore[reportOperatorIssue]
    assert "run_to_run_eccentricity" in report["not_testable"]  # pyright: ignore[reportOperatorIssue]


def test_a_batch_has_a_folder_each_and_a_broken_file_does_not_end_it(joint: Path, capsys: Output) -> None:
    folder = joint.parent
    (folder / "b").mkdir()
    good = write_rows(folder / "good.csv", campaign_rows(seed=11))
    same_name = write_rows(folder / "b" / "good.csv", campaign_rows(seed=12, temperatures_c=(20.0,), repeats=1))
    broken = folder / "broken.csv"
    broken.write_text("angle_deg\n1\n")
    files = [str(good), str(broken), str(same_name)]
    before = dict(os.environ)
    assert cli.main(["diagnose", *files, "--joint", str(joint), "--out", str(folder / "out"), "--no-html"]) == 2
    assert dict(os.environ) == before
    captured = capsys.readouterr()
    assert "broken.csv" in captured.err
    assert "error_arcsec" in captured.err
    assert f"{good}: verdict" in captured.out
    assert report_of(folder / "out" / "good")["verdict"] == "none"
    assert report_of(folder / "out" / "good-2")["verdict"] == "insufficient"
    assert not (folder / "out" / "broken" / "report.json").exists()


def refused(arguments: list[str], capsys: Output) -> str:
    assert cli.main(["diagnose", *arguments]) == 2
    return capsys.readouterr().err


def test_contradictions_of_the_joint_are_told_before_anything_is_written(joint: Path, capsys: Output) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(repeats=1))
    joint.write_text(
        JOINT.replace("counts_per_rev: 3276800", "counts_per_rev: 16000").replace("eccentricity,", "gremlins,")
    )
    out = joint.with_name("out")
    err = refused([str(measured), "--joint", str(joint), "--out", str(out)], capsys)
    assert "counts_per_rev" in err
    assert not out.exists()


def test_settings_of_an_effect_that_contradict_each_other_are_refused(joint: Path, capsys: Output) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(repeats=1))
    joint.write_text(
        JOINT.replace(
            "[eccentricity, grating_tilt, graduation_error, thermal_eccentricity]",
            "\n  eccentricity: {amplitude_arcsec: 3}",
        )
    )
    err = refused([str(measured), "--joint", str(joint), "--out", str(joint.with_name("out"))], capsys)
    assert "phase_deg" in err
    assert not (joint.with_name("out") / "report.json").exists()


def test_a_file_that_cannot_be_read_is_no_verdict(joint: Path, capsys: Output) -> None:
    out = ["--joint", str(joint), "--out", str(joint.with_name("out"))]
    assert "No such file" in refused([str(joint.with_name("none.csv")), *out], capsys)
    empty = joint.with_name("empty.csv")
    empty.write_text("angle_deg,error_arcsec\n")
    assert "at least one reading" in refused([str(empty), *out], capsys)


def test_an_older_answer_does_not_stand_beside_a_new_design(found: Path, tmp_path: Path, joint: Path) -> None:
    out = tmp_path / "out"
    (out / "plots").mkdir(parents=True)
    for name in ("report.html", "plots/where.svg"):
        (out / name).write_text("of another file")
    diagnosed(campaign_rows(temperatures_c=(20.0,), repeats=1), joint)
    assert not (out / "report.html").exists()
    assert not (out / "plots" / "where.svg").exists()


def test_an_update_needs_one_campaign_and_never_overwrites_it(joint: Path, capsys: Output) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(repeats=1))
    out = ["--joint", str(joint), "--out", str(joint.with_name("out"))]
    update = ["--update", str(joint.with_name("new.yaml"))]
    assert "--update: expected one campaign" in refused([str(measured), str(measured), *out, *update], capsys)
    before = measured.read_bytes()
    assert "another file than the campaign" in refused([str(measured), *out, "--update", str(measured)], capsys)
    assert measured.read_bytes() == before


def test_rows_can_be_left_out(joint: Path) -> None:
    measured = write_rows(joint.with_name("measured.csv"), campaign_rows(seed=11))
    out = joint.with_name("out")
    arguments = ["--joint", str(joint), "--out", str(out), "--no-html", "--exclude-rows", "5,7-8"]
    assert cli.main(["diagnose", str(measured), *arguments]) == 0
    assert report_of(out)["subject"]["readings"] == 480  # pyright: ignore[reportIndexIssue]


def test_a_campaign_of_sixty_thousand_readings_is_condensed_and_diagnosed(joint: Path) -> None:
    joint.write_text(JOINT.replace("{kind: polygon, faces: 23}", "{kind: encoder}"))
    rng = np.random.default_rng(2)
    lines = ["angle_deg,error_arcsec,run,time_s,direction"]
    for run in range(10):
        direction = 1 if run % 2 else -1
        angle_deg = np.linspace(0.0, 720.0, 6_000) * direction
        angle = np.radians(angle_deg)
        error = 40.0 * np.cos(angle) + 5.0 * np.cos(2 * angle) + rng.normal(0.0, 0.6, angle.size)
        time_s = 40_000.0 * run + np.arange(angle.size)
        lines += [
            f"{a:.6f},{e:.4f},{run},{t:.0f},{direction}"
            for a, e, t in zip(angle_deg.tolist(), error.tolist(), time_s.tolist(), strict=True)
        ]
    measured = joint.with_name("long.csv")
    measured.write_text("\n".join(lines) + "\n")
    out = joint.with_name("out")
    assert cli.main(["diagnose", str(measured), "--joint", str(joint), "--out", str(out), "--no-html"]) == 0
    report = report_of(out)
    assert report["subject"]["readings"] == 60_000  # pyright: ignore[reportIndexIssue]
    assert any("averag" in note for note in report["notes"])  # pyright: ignore[reportGeneralTypeIssues]
    assert yaml.safe_load(joint.read_text())["effects"]
