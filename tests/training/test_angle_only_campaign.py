"""Campaigns without temperature: the harmonics come back, the second input is ignored, real data run."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.errors import ContractError
from trueangle.contract.metadata import Interval
from trueangle_training.angle_only_campaign import AngleHarmonics, angle_only_set
from trueangle_training.export import build_graph, check_agreement

NOISE_ARCSEC = 0.5
AS5047D = Path(os.environ.get("TRUEANGLE_AS5047D", Path(__file__).parents[3] / "shared" / "data" / "as5047d"))


def true_error_arcsec(angle_deg: np.ndarray) -> np.ndarray:
    """Orders 1, 2 and 7, from the datum at 0 deg."""
    rad = np.radians(angle_deg)
    return 40 * np.cos(rad - 1) + 6 * np.sin(2 * rad) + 3 * np.cos(7 * rad) - (40 * np.cos(1) + 3)


def angle_only_campaign(seed: int) -> Campaign:
    """Three runs over 36 places, each with a zero of its own."""
    rng = np.random.default_rng(seed)
    angle_deg = np.tile(np.linspace(0.0, 350.0, 36), 3)
    error_arcsec = true_error_arcsec(angle_deg) + rng.normal(0, NOISE_ARCSEC, angle_deg.size)
    error_arcsec += np.repeat(rng.normal(0, 20, 3), 36)
    run = np.repeat([1, 2, 3], 36)
    return Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        run=run,
        zero_group=run,
        row=np.arange(2, 110),
        source="angles.csv",
        sha256="0" * 64,
    )


def test_harmonics_come_back_and_their_uncertainty_holds() -> None:
    grid_deg = np.arange(0.0, 360.0, 1.0)
    anywhere_c = np.full_like(grid_deg, -40.0)
    ratios = []
    for seed in range(40):
        data = angle_only_set(angle_only_campaign(seed))
        model = AngleHarmonics().fit(data.readings).model
        off = model.error_arcsec(grid_deg, anywhere_c) - true_error_arcsec(grid_deg)
        # Fourteen harmonic coefficients or a few more from 108 readings: 0.5" sqrt(2 * 17 / 108) = 0.28" and the
        # datum's own share beside it.
        assert np.sqrt(np.mean(off**2)) < 1.0
        spread = model.uncertainty_arcsec(grid_deg, anywhere_c)
        assert spread is not None
        away = spread > 0
        ratios.append(np.mean((off[away] / spread[away]) ** 2))
    # Mean square of error over uncertainty: 1 where the uncertainty is right; 40 campaigns know it to about 10 %.
    assert 0.6 < np.mean(ratios) < 1.5


def test_temperature_changes_nothing_and_the_graph_agrees() -> None:
    data = angle_only_set(angle_only_campaign(1))
    fit = AngleHarmonics().fit(data.readings)
    assert not fit.model.temperature_used
    assert data.valid_temperature_c == Interval(minimum=-60.0, maximum=150.0)
    angle_deg, at_c = np.linspace(-400.0, 800.0, 500), np.linspace(-100.0, 200.0, 500)
    np.testing.assert_array_equal(
        fit.model.error_arcsec(angle_deg, at_c), fit.model.error_arcsec(angle_deg, np.zeros(500))
    )
    assert check_agreement(build_graph(fit.model).SerializeToString(), fit.model, angle_deg, at_c) < 1e-6
    assert any("does not follow it" in note for note in fit.notes)


def test_unsound_readings_are_refused_all_the_same() -> None:
    campaign = angle_only_campaign(1)
    in_degrees = replace(campaign, error_arcsec=campaign.error_arcsec / 3600)
    with pytest.raises(ContractError, match="are they in degrees"):
        angle_only_set(in_degrees)
    far_off = campaign.error_arcsec.copy()
    far_off[50] = 18 * 3600
    with pytest.raises(ContractError, match="line 52"):
        angle_only_set(replace(campaign, error_arcsec=far_off))
    with pytest.raises(ContractError, match="at least 5 distinct angles"):
        angle_only_set(replace(campaign, angle_deg=np.tile([0.0, 90.0, 180.0, 270.0], 27)))


@pytest.mark.skipif(not AS5047D.is_dir(), reason="the AS5047D tables are not here")
@pytest.mark.parametrize("name", ["table05", "table06", "table07", "table08"])
def test_real_magnetic_encoders_run(name: str) -> None:
    path = AS5047D / f"{name}.csv"
    campaign = read_campaign(path.read_bytes(), source=path.name)
    assert campaign.temperature_c is None
    data = angle_only_set(campaign)
    fit = AngleHarmonics().fit(data.readings)
    left = data.readings.error_arcsec - fit.model.error_arcsec(
        data.readings.angle_deg, data.readings.temperature_c
    )
    raw, rest = np.std(data.readings.error_arcsec), np.std(left)
    # The reference of these tables, the motor's full step, is good to about 324"; a curve is there to be found.
    assert rest < raw / 2
