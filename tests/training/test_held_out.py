"""Errors at left-out readings, their intervals, and the repeatability that they are judged against."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.training.reference_joint import NOISE_ARCSEC, joint_error_arcsec, polygon_campaign

from trueangle.contract.errors import Fault
from trueangle_training.evaluation.bootstrap import paired_difference, rmse_estimate
from trueangle_training.evaluation.held_out import (
    HeldOut,
    HeldOutKind,
    face_folds,
    hold_out,
    repeatability_arcsec,
    run_folds,
    subset,
    temperature_folds,
)
from trueangle_training.methods import Fit, Progress, TrainingReadings, UnsuitableReadingsError, no_progress
from trueangle_training.methods.separable import SeparableModel, TemperatureBasis

Floats = NDArray[np.float64]


def campaign_readings(seed: int = 0) -> TrainingReadings:
    campaign = polygon_campaign(seed, above_11=False)
    return TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthBut:
    """A model that knows the joint, but for `wrong_arcsec` times cos θ."""

    wrong_arcsec: float = 0.0
    sigma_arcsec: float | None = None
    datum_deg: float = 0.0
    temperature_used: bool = True

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        truth = joint_error_arcsec(angle_deg, temperature_c, above_11=False)
        at_datum = joint_error_arcsec(np.zeros_like(angle_deg), temperature_c, above_11=False)
        return truth - at_datum + self.wrong_arcsec * (np.cos(np.radians(angle_deg)) - 1.0)

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        return None if self.sigma_arcsec is None else np.full_like(angle_deg, self.sigma_arcsec)


class Knowing:
    """A method that notes what it is trained on and gives a fixed model."""

    name = "knowing"
    summary = "for tests"

    def __init__(self, model: TruthBut, *, refuses_below_c: float | None = None) -> None:
        self.model, self.refuses_below_c = model, refuses_below_c
        self.trained_on: list[TrainingReadings] = []

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        self.trained_on.append(readings)
        if self.refuses_below_c is not None and readings.temperature_c.min() > self.refuses_below_c:
            raise UnsuitableReadingsError([Fault(where="temperature_c", expected="cold runs", found="none")])
        return Fit(model=self.model, settings={})


def test_each_temperature_is_left_out_once_and_never_trained_on() -> None:
    readings, method = campaign_readings(), Knowing(TruthBut())
    folds = temperature_folds(readings)
    held_out = hold_out(readings, method, HeldOutKind.TEMPERATURE, folds)
    assert len(folds) == 7
    assert np.array_equal(np.sum([fold.left_out for fold in folds], axis=0), np.ones(483))
    for fold, trained_on in zip(folds, method.trained_on, strict=True):
        left_c = readings.temperature_c[fold.left_out]
        assert np.abs(np.subtract.outer(left_c, trained_on.temperature_c)).min() > 4.0
    assert held_out.known.all()


def test_runs_are_left_out_whole_and_each_once() -> None:
    readings = campaign_readings()
    folds = run_folds(readings)
    assert len(folds) == 3
    for fold in folds:
        runs = np.unique(readings.run[fold.left_out])
        assert runs.size == 7
        assert not np.isin(readings.run[~fold.left_out], runs).any()
    assert np.array_equal(np.sum([fold.left_out for fold in folds], axis=0), np.ones(483))


def test_a_perfect_model_leaves_the_noise_and_nothing_of_the_runs_zeros() -> None:
    readings = campaign_readings()
    shifted = replace(readings, error_arcsec=readings.error_arcsec + 1000.0 * readings.run)
    for data in (readings, shifted):
        folds = temperature_folds(data)
        held_out = hold_out(data, Knowing(TruthBut()), HeldOutKind.TEMPERATURE, folds)
        # 462 degrees of freedom: the standard deviation of an estimated sigma is 3.3 %; four of them.
        assert held_out.rmse_arcsec == pytest.approx(NOISE_ARCSEC, rel=0.13)


def test_a_wrong_model_shows_its_error_on_top_of_the_noise() -> None:
    readings = campaign_readings()
    folds = temperature_folds(readings)
    wrong = hold_out(readings, Knowing(TruthBut(wrong_arcsec=3.0)), HeldOutKind.TEMPERATURE, folds)
    right = hold_out(readings, Knowing(TruthBut()), HeldOutKind.TEMPERATURE, folds)
    assert wrong.rmse_arcsec is not None
    assert right.rmse_arcsec is not None
    # The cosine over 23 equal faces has mean 0 and mean square 1/2: 22/23 degrees of freedom a reading.
    added = wrong.rmse_arcsec**2 - right.rmse_arcsec**2
    assert added == pytest.approx(4.5 * 23 / 22, rel=0.15)


def test_a_fold_that_cannot_be_fitted_is_listed_and_not_counted() -> None:
    readings = campaign_readings()
    held_out = hold_out(
        readings,
        Knowing(TruthBut(), refuses_below_c=12.0),
        HeldOutKind.TEMPERATURE,
        temperature_folds(readings),
    )
    assert len(held_out.refused) == 1
    assert "cold runs" in held_out.refused[0]
    assert np.count_nonzero(~held_out.known) == 69
    assert held_out.rmse_arcsec == pytest.approx(NOISE_ARCSEC, rel=0.14)


def test_places_are_left_out_only_where_others_can_stand_for_them() -> None:
    readings = campaign_readings()
    assert face_folds(readings) == ()
    turned_deg = readings.angle_deg + (readings.run % 3) * 360.0 / 69.0
    dense = replace(readings, angle_deg=turned_deg)
    folds = face_folds(dense)
    assert len(folds) == 6
    # The first one is the last place before the seam, 360 - 360/69 deg; the datum is never left out.
    assert np.allclose(dense.angle_deg[folds[0].left_out], 360.0 - 360.0 / 69.0)
    assert all((dense.angle_deg[fold.left_out] > 1.0).all() for fold in folds)


def test_left_out_places_are_counted_from_the_zero_of_the_others() -> None:
    readings = campaign_readings()
    turned_deg = readings.angle_deg + (readings.run % 3) * 360.0 / 69.0
    truth = joint_error_arcsec(turned_deg, readings.temperature_c, above_11=False)
    noise = np.random.default_rng(5).normal(0.0, NOISE_ARCSEC, truth.size)
    dense = replace(readings, angle_deg=turned_deg, error_arcsec=truth + noise + 50.0 * readings.run)
    held_out = hold_out(dense, Knowing(TruthBut()), HeldOutKind.FACE, face_folds(dense))
    # 6 places x 7 readings: the standard deviation of sigma is 11 %, four of them; zeros add 1/23 of variance.
    assert held_out.rmse_arcsec == pytest.approx(NOISE_ARCSEC, rel=0.45)


def test_repeatability_is_the_noise_and_knows_nothing_of_the_joint() -> None:
    estimates = [repeatability_arcsec(campaign_readings(seed)) for seed in range(5)]
    # 308 degrees of freedom each: 4 % standard deviation; the mean of five within four of 1.8 %.
    assert np.mean([each for each in estimates if each is not None]) == pytest.approx(NOISE_ARCSEC, rel=0.072)
    readings = campaign_readings()
    single = subset(readings, readings.run % 3 == 0)
    assert repeatability_arcsec(single) is None


def held_out_of(residual_arcsec: Floats) -> HeldOut:
    return HeldOut(
        kind=HeldOutKind.RUN,
        residual_arcsec=residual_arcsec,
        uncertainty_arcsec=None,
        degrees_of_freedom=np.where(np.isnan(residual_arcsec), 0.0, 1.0),
        refused=(),
    )


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    runs = np.repeat(np.arange(20), 10)
    hits = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        # Runs of very different quality: what a bootstrap of single readings would underestimate.
        size = rng.gamma(4.0, 0.5, 20)[runs]
        estimate = rmse_estimate(held_out_of(rng.normal(0.0, size)), runs, np.random.default_rng(0))
        assert estimate is not None
        # E size² = shape (shape + 1) scale² = 5.
        hits += estimate.low <= np.sqrt(5.0) <= estimate.high
    # A percentile bootstrap of 20 skewed units holds 95 % in about 88 %; below 45 of 60 it would be broken.
    assert hits >= 45


def test_paired_differences_see_what_the_runs_luck_hides() -> None:
    rng = np.random.default_rng(1)
    runs = np.repeat(np.arange(20), 10)
    luck = rng.gamma(2.0, 0.5, 20)[runs]
    residual = rng.normal(0.0, luck)
    better, worse = held_out_of(residual), held_out_of(1.05 * residual)
    paired = paired_difference(worse, better, runs, np.random.default_rng(0))
    alone = [rmse_estimate(each, runs, np.random.default_rng(0)) for each in (worse, better)]
    assert paired is not None
    assert paired.low > 0.0
    assert alone[0] is not None
    assert alone[1] is not None
    assert alone[0].low < alone[1].value


def test_one_run_gives_no_interval() -> None:
    residual = np.full(30, np.nan)
    residual[:10] = 1.0
    runs = np.repeat(np.arange(3), 10)
    assert rmse_estimate(held_out_of(residual), runs, np.random.default_rng(0)) is None


def test_the_wrong_term_of_this_files_yardstick_is_the_cosine_it_claims() -> None:
    basis = TemperatureBasis(centre_c=20.0, scale_c=1.0)
    cosine = SeparableModel(orders=(1,), basis=basis, weights_arcsec=np.array([[3.0, 0.0]]), datum_deg=0.0)
    angle_deg, temperature_c = np.linspace(0.0, 350.0, 36), np.full(36, 30.0)
    difference = TruthBut(wrong_arcsec=3.0).error_arcsec(angle_deg, temperature_c) - TruthBut().error_arcsec(
        angle_deg, temperature_c
    )
    np.testing.assert_allclose(difference, cosine.error_arcsec(angle_deg, temperature_c), atol=1e-12)
