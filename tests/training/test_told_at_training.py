"""What train, compare and report tell of a campaign, and which files they refuse to write."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.fakes.report_inputs import made_campaign, made_inputs

from trueangle.contract.calibration import Campaign, campaign_to_csv
from trueangle_training import cli
from trueangle_training.evaluation.datum_drift import shows_datum_drift
from trueangle_training.methods import TrainingReadings
from trueangle_training.report.writing import report_page

Output = pytest.CaptureFixture[str]
LINEAR = ["--method", "linear", "--held-out", "none"]


def written(campaign: Campaign, path: Path) -> Path:
    path.write_text(campaign_to_csv(campaign))
    return path


def one_zero(campaign: Campaign) -> Campaign:
    return replace(campaign, zero_group=np.ones_like(campaign.run))


def shifted(campaign: Campaign) -> Campaign:
    """Each of three repeats a third of the pitch further on; the error follows the angle."""
    third_deg = (campaign.run - 1) % 3 * (360.0 / 23 / 3)
    angle_deg = campaign.angle_deg + third_deg
    error_arcsec = campaign.error_arcsec + 50.0 * (
        np.cos(np.radians(angle_deg)) - np.cos(np.radians(campaign.angle_deg))
    )
    return replace(campaign, angle_deg=angle_deg, error_arcsec=error_arcsec)


def test_model_and_report_of_one_name_are_refused_before_training(tmp_path: Path, capsys: Output) -> None:
    campaign, same = written(made_campaign(), tmp_path / "c.csv"), tmp_path / "same.x"
    assert cli.main(["train", str(campaign), *LINEAR, "-o", str(same), "--report", str(same)]) == 2
    assert "--report: expected another file than --output" in capsys.readouterr().err
    before = campaign.read_bytes()
    assert cli.main(["train", str(campaign), *LINEAR, "-o", str(same), "--report", str(campaign)]) == 2
    assert campaign.read_bytes() == before
    assert not same.exists()


def test_compare_and_report_never_overwrite_what_they_read(tmp_path: Path, capsys: Output) -> None:
    campaign = written(made_campaign(), tmp_path / "c.csv")
    before = campaign.read_bytes()
    assert cli.main(["compare", str(campaign), "-o", str(campaign)]) == 2
    assert cli.main(["report", str(tmp_path / "m.onnx"), str(campaign), "-o", str(campaign)]) == 2
    assert capsys.readouterr().err.count("another file than C") == 2
    assert campaign.read_bytes() == before


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no file system that refuses new files")
def test_a_report_that_cannot_be_written_leaves_the_old_model(tmp_path: Path, capsys: Output) -> None:
    campaign, model = written(made_campaign(), tmp_path / "c.csv"), tmp_path / "m.onnx"
    model.write_bytes(b"released")
    assert cli.main(["train", str(campaign), *LINEAR, "-o", str(model), "--report", "/proc/x.html"]) == 2
    assert "/proc/x.html" in capsys.readouterr().err
    assert model.read_bytes() == b"released"


def test_train_says_what_the_zeros_show_of_the_datum(tmp_path: Path, capsys: Output) -> None:
    for campaign, said, unsaid in (
        (made_campaign(), "not visible", "datum's drift"),
        (one_zero(made_campaign()), "datum's drift", "not visible"),
    ):
        path = written(campaign, tmp_path / "c.csv")
        assert cli.main(["train", str(path), *LINEAR, "-o", str(tmp_path / "m.onnx")]) == 0
        out = capsys.readouterr().out
        assert said in out
        assert unsaid not in out


def test_a_zero_kept_within_one_temperature_shows_no_drift_with_temperature() -> None:
    campaign = made_campaign()
    assert campaign.temperature_c is not None
    readings = TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
        zero_group=np.unique(campaign.temperature_c, return_inverse=True)[1],
    )
    assert not shows_datum_drift(readings)
    assert shows_datum_drift(replace(readings, zero_group=np.ones_like(campaign.run)))
    assert not shows_datum_drift(replace(readings, zero_group=None))


def test_compare_takes_the_noise_of_shifted_repeats_from_the_fit_and_says_so(
    tmp_path: Path, capsys: Output
) -> None:
    out = tmp_path / "compare.json"
    path = written(shifted(made_campaign()), tmp_path / "c.csv")
    assert cli.main(["compare", str(path), "--methods", "linear", "-o", str(out)]) == 0
    told, compared = capsys.readouterr().out, json.loads(out.read_text())
    assert "from what the fit of linear leaves" in told
    assert "zeroed one by one" in told
    assert compared["repeatability_arcsec"] is None
    assert compared["noise_from"] == "fit"
    # 0.5 arcsec were drawn; some hundred freedoms know it to 7 %.
    assert compared["noise_arcsec"] == pytest.approx(0.5, rel=0.25)
    coverage = compared["methods"][0]["held_out"]["leave-one-temperature-out"]["coverage_2u"]
    assert 0.9 < coverage <= 1.0


def test_compare_says_that_one_zero_shows_the_datums_drift(tmp_path: Path, capsys: Output) -> None:
    path, out = written(one_zero(made_campaign()), tmp_path / "c.csv"), tmp_path / "compare.json"
    assert cli.main(["compare", str(path), "--methods", "angle-only", "-o", str(out)]) == 0
    assert "show how the datum itself drifts" in capsys.readouterr().out
    assert "zeroed one by one" not in out.read_text()


def test_missing_places_are_warned_of_on_the_terminal_and_in_the_report(tmp_path: Path, capsys: Output) -> None:
    campaign = made_campaign()
    assert campaign.temperature_c is not None
    keep = ~((campaign.temperature_c == 30.0) & (campaign.angle_deg > 100.0))
    columns = {
        name: getattr(campaign, name)[keep]
        for name in ("angle_deg", "error_arcsec", "run", "zero_group", "row", "temperature_c")
    }
    short = replace(campaign, **columns)
    path, report = written(short, tmp_path / "c.csv"), tmp_path / "r.html"
    arguments = ["train", str(path), *LINEAR, "-o", str(tmp_path / "m.onnx"), "--report", str(report)]
    assert cli.main(arguments) == 0
    captured = capsys.readouterr()
    assert "at 30.0 degC 16 places of other temperatures not read (109.6 to 344.3 deg)" in captured.err
    assert "10 .. 25 degC" in captured.out
    assert "Places of the turn missing at some temperatures" in report.read_text()
    assert "Places of the turn missing" not in report_page(made_inputs())


def test_the_report_warns_of_a_left_out_error_far_above_the_noise() -> None:
    inputs = made_inputs()
    assert "Far off at left-out temperatures" not in report_page(inputs)
    errors = replace(inputs.metadata.errors, held_out_rmse_arcsec=4.0)
    text = report_page(replace(inputs, metadata=replace(inputs.metadata, errors=errors)))
    assert "Far off at left-out temperatures" in text
