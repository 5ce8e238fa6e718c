"""The noise of one reading where a plan repeats little, and what `plan` says of plans that give none."""

import argparse
import datetime
import io
from pathlib import Path

import numpy as np
import pytest
from tests.training.reference_joint import joint_error_arcsec

from trueangle.contract.errors import ContractError
from trueangle_training import plan_command
from trueangle_training.command import Surroundings
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.coefficients import reduce_to_coefficients
from trueangle_training.methods.registry import load_method

SIGMA_ARCSEC = 0.6
JOINT = Path(plan_command.__file__).parent / "examples" / "joint.yaml"


def polygon_readings(
    temperatures_c: tuple[float, ...], shifts: tuple[float, ...], *, seed: int, faces: int = 23
) -> TrainingReadings:
    """One run for each temperature and shift of the polygon, each zeroed at its first face."""
    rng = np.random.default_rng(seed)
    angle, error, temperature, run = [], [], [], []
    for at_c in temperatures_c:
        for shift in shifts:
            angle_deg = (np.arange(faces, dtype=np.float64) + shift) * (360.0 / faces)
            temperature_c = np.full(faces, at_c)
            error_arcsec = joint_error_arcsec(angle_deg, temperature_c, above_11=False)
            error_arcsec = error_arcsec + rng.normal(0.0, SIGMA_ARCSEC, faces)
            angle.append(angle_deg)
            error.append(error_arcsec - error_arcsec[0])
            temperature.append(temperature_c)
            run.append(np.full(faces, len(run)))
    return TrainingReadings(
        angle_deg=np.concatenate(angle),
        error_arcsec=np.concatenate(error),
        temperature_c=np.concatenate(temperature),
        run=np.concatenate(run),
    )


@pytest.mark.parametrize(
    ("temperatures_c", "shifts"),
    [
        # Two shifted repeats: 22 orders with a value at each temperature take all that the readings know.
        ((10.0, 20.0, 30.0, 40.0), (0.0, 0.5)),
        ((10.0, 20.0, 30.0), (0.0, 0.5)),
        ((20.0, 40.0), (0.0, 0.5)),
        # One repeat of equal faces.
        ((10.0, 20.0, 30.0, 40.0), (0.0,)),
        ((10.0, 25.0, 40.0), (0.0,)),
    ],
)
def test_the_noise_of_a_lean_plan_is_found(temperatures_c: tuple[float, ...], shifts: tuple[float, ...]) -> None:
    found = [reduce_to_coefficients(polygon_readings(temperatures_c, shifts, seed=seed)) for seed in range(12)]
    assert min(each.sigma_freedoms for each in found) >= 30
    # Mean over 12 seeds of 30 or more freedoms: known to 1 / sqrt(2 * 30 * 12) = 4 %; three times that below.
    # Above: at three temperatures the lean shapes leave a little of the bend to the noise.
    ratio = float(np.sqrt(np.mean([each.sigma_arcsec**2 for each in found]))) / SIGMA_ARCSEC
    assert 0.88 < ratio < 1.3


def test_a_lean_plan_is_fitted_and_its_uncertainty_covers_the_true_error() -> None:
    angle_deg, at_c = (
        each.ravel() for each in np.meshgrid(np.arange(0.5, 360.0, 2.0), np.arange(10.0, 41.0, 5.0))
    )
    truth = joint_error_arcsec(angle_deg, at_c, above_11=False)
    truth = truth - joint_error_arcsec(np.zeros_like(angle_deg), at_c, above_11=False)
    covered = []
    for seed in range(4):
        readings = polygon_readings((10.0, 20.0, 30.0, 40.0), (0.0, 0.5), seed=seed)
        model = load_method("linear").fit(readings).model
        uncertainty = model.uncertainty_arcsec(angle_deg, at_c)
        assert uncertainty is not None
        covered.append(np.mean(np.abs(model.error_arcsec(angle_deg, at_c) - truth) <= 2.0 * uncertainty))
    # 95 % for normal errors; the errors of one campaign move together, so that four say it to some percent only.
    assert np.mean(covered) > 0.9


def test_readings_without_any_redundancy_are_refused_with_advice_that_helps() -> None:
    with pytest.raises(
        UnsuitableReadingsError, match="another repeat of each temperature, or another temperature"
    ):
        reduce_to_coefficients(polygon_readings((20.0, 40.0), (0.0,), seed=0))
    # Following the advice once is enough, either way.
    for temperatures_c, shifts in (((20.0, 40.0), (0.0, 0.0)), ((20.0, 30.0, 40.0), (0.0,))):
        reduce_to_coefficients(polygon_readings(temperatures_c, shifts, seed=0))


def planned(arguments: list[str], out: Path) -> tuple[str, str]:
    parser = argparse.ArgumentParser()
    plan_command.register(parser.add_subparsers())
    parsed = parser.parse_args(["plan", *arguments, "-o", str(out)])
    told, warned = io.StringIO(), io.StringIO()
    parsed.run(parsed, Surroundings(today=datetime.date(2025, 3, 1), out=told, err=warned))
    return told.getvalue(), warned.getvalue()


def test_the_default_plan_of_two_repeats_can_be_trained_on(tmp_path: Path) -> None:
    told, warned = planned(
        ["--faces", "23", "--temperatures", "10,20,30,40", "--repeats", "2", "--joint", str(JOINT)],
        tmp_path / "plan.yaml",
    )
    assert "not to be had" not in told
    assert "trueangle train refuses" not in told + warned


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--faces", "23", "--temperatures", "20,40", "--repeats", "1"], "show the noise"),
        (["--faces", "23", "--temperatures", "20"], "two or more temperatures"),
        (["--faces", "4", "--temperatures", "10,20,30", "--shift", "none"], "5 distinct angles"),
    ],
)
def test_a_plan_that_cannot_be_trained_on_is_called_so(arguments: list[str], reason: str, tmp_path: Path) -> None:
    _, warned = planned(arguments, tmp_path / "plan.yaml")
    assert warned.startswith("trueangle: warning: trueangle train refuses a campaign of this plan: ")
    assert reason in warned


def test_sheet_and_plan_are_different_files(tmp_path: Path) -> None:
    out = tmp_path / "plan.csv"
    with pytest.raises(ContractError, match="another file than --output"):
        planned(["--faces", "23", "--temperatures", "10,20", "--sheet", str(out)], out)
    assert not out.exists()
