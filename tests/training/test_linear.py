"""Harmonics with smooth temperature terms: complete campaigns, all other plans, and what is said of the unseen."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.benchmarks.families import Campaign, draw_campaign, draw_joint, oracle_rms_arcsec, true_grid

from trueangle_training.export import build_graph, check_agreement
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.coefficients import (
    reduce_general,
    reduce_to_coefficients,
    spline_interpolation,
)
from trueangle_training.methods.linear import Linear, fit_linear, fit_without_uncertainty
from trueangle_training.methods.registry import load_method
from trueangle_training.methods.separable import SeparableModel
from trueangle_training.methods.temperature_kernels import KernelMixture

Floats = NDArray[np.float64]


def readings_of(campaign: Campaign) -> TrainingReadings:
    return TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )


def some(readings: TrainingReadings, kept: NDArray[np.bool_]) -> TrainingReadings:
    return TrainingReadings(
        angle_deg=readings.angle_deg[kept],
        error_arcsec=readings.error_arcsec[kept],
        temperature_c=readings.temperature_c[kept],
        run=readings.run[kept],
    )


def served(readings: TrainingReadings) -> SeparableModel:
    linear = fit_linear(readings)
    return linear.model_of(linear.posterior)


def rms_arcsec(model: SeparableModel, truth: tuple[Floats, Floats, Floats]) -> float:
    angle_deg, temperature_c, error_arcsec = truth
    return float(np.sqrt(np.mean((model.error_arcsec(angle_deg, temperature_c) - error_arcsec) ** 2)))


def test_on_a_complete_campaign_the_transform_and_the_general_model_agree() -> None:
    joint = draw_joint("spread", 1)
    readings = readings_of(draw_campaign(joint, 1))
    even = dataclasses.replace(readings, temperature_c=np.round(readings.temperature_c / 5.0) * 5.0)
    angle_deg, temperature_c, _ = true_grid(joint)
    # With temperatures that miss the set one by 0.1 degC the general model sees a little more slope than the
    # transform, which moves readings to the set temperature; without them both solve the same problem.
    for given, allowed_arcsec in ((even, 1e-8), (readings, 0.01)):
        by_transform = fit_linear(given)
        assert by_transform.data.decoupled is not None
        general = fit_linear(given, reduce_general(given))
        assert general.data.joint is not None
        assert general.data.sigma_arcsec == pytest.approx(by_transform.data.sigma_arcsec, rel=1e-3)
        one, other = (fit.model_of(fit.posterior) for fit in (by_transform, general))
        difference = one.error_arcsec(angle_deg, temperature_c) - other.error_arcsec(angle_deg, temperature_c)
        assert np.abs(difference).max() < allowed_arcsec
        first, second = (model.uncertainty_arcsec(angle_deg, temperature_c) for model in (one, other))
        assert first is not None
        assert first == pytest.approx(second, rel=0.01)


def test_noise_is_known_from_the_repeats() -> None:
    # 308 degrees of freedom: 4 % standard deviation of sigma each, 1.3 % of the mean of ten.
    sigmas = [
        reduce_to_coefficients(readings_of(draw_campaign(draw_joint("n3q", seed), seed))).sigma_arcsec
        for seed in range(10)
    ]
    assert float(np.mean(sigmas)) == pytest.approx(0.63, rel=0.04)


def test_angles_that_differ_from_their_face_by_arcminutes_change_nothing_of_note() -> None:
    joint = draw_joint("n3q", 2)
    exact, beside = (draw_campaign(joint, 2, angle_jitter_deg=jitter_deg) for jitter_deg in (0.0, 0.05))
    assert fit_linear(readings_of(beside)).data.decoupled is not None
    # 0.05 deg times the slope of 60 arcsec is 0.05 arcsec a reading, were it not followed.
    at_exact, at_beside = (rms_arcsec(served(readings_of(c)), true_grid(joint)) for c in (exact, beside))
    assert at_beside == pytest.approx(at_exact, abs=0.01)


def test_without_noise_the_truth_is_found() -> None:
    joint = dataclasses.replace(draw_joint("n3q", 3), noise_arcsec=0.0)
    assert rms_arcsec(served(readings_of(draw_campaign(joint, 3))), true_grid(joint)) < 0.01


def test_missing_readings_cost_little() -> None:
    joint = draw_joint("n3q", 4)
    campaign = draw_campaign(joint, 4, missing=0.07)
    linear = fit_linear(readings_of(campaign))
    assert linear.data.joint is not None
    # Over twenty seeds the ratio to the oracle stayed below 1.4 for the complete plan.
    assert rms_arcsec(linear.model_of(linear.posterior), true_grid(joint)) < 1.4 * oracle_rms_arcsec(
        joint, campaign
    )


def test_shifted_repeats_see_the_orders_that_equal_faces_hide() -> None:
    plain, shifted = [], []
    for seed in range(3):
        joint = draw_joint("alias", seed)
        plain.append(rms_arcsec(served(readings_of(draw_campaign(joint, seed))), true_grid(joint)))
        linear = fit_linear(readings_of(draw_campaign(joint, seed, shifted=True)))
        assert linear.data.orders[-1] == 22
        shifted.append(rms_arcsec(linear.model_of(linear.posterior), true_grid(joint)))
    assert float(np.median(plain)) > 0.4
    assert float(np.median(shifted)) < 0.30


def test_a_dense_sweep_with_drifting_temperature_is_taken() -> None:
    joint, rng = draw_joint("n3q", 6), np.random.default_rng(6)
    run = np.repeat(np.arange(16), 60)
    angle_deg = np.tile(np.arange(60) * 6.0, 16) + rng.uniform(-0.5, 0.5, run.size)
    temperature_c = 10.0 + 30.0 * np.arange(run.size) / run.size
    error_arcsec = joint.error_arcsec(angle_deg, temperature_c) + rng.normal(0.0, 0.63, run.size) + 3.0 * run
    readings = TrainingReadings(
        angle_deg=angle_deg, error_arcsec=error_arcsec, temperature_c=temperature_c, run=run
    )
    # 960 readings on 48 coefficients: 0.63 sqrt(2 * 48 / 960) = 0.20 arcsec for the constants alone.
    assert rms_arcsec(served(readings), true_grid(joint)) < 0.4


def test_one_run_a_temperature_takes_its_noise_from_what_a_cubic_leaves() -> None:
    joint = draw_joint("n3q", 7)
    data = reduce_to_coefficients(readings_of(draw_campaign(joint, 7, repeats=1)))
    # (7 - 4) temperatures times 22 coefficients.
    assert data.sigma_freedoms == 66
    assert data.sigma_arcsec == pytest.approx(0.63, rel=0.3)


def test_what_the_plan_cannot_see_is_said_and_counted() -> None:
    joint = draw_joint("alias", 8)
    fit = Linear().fit(readings_of(draw_campaign(joint, 8)))
    assert any("above order 11" in note and "no measurement" in note for note in fit.notes)
    model = fit.model
    assert isinstance(model, SeparableModel)
    alone = dataclasses.replace(model, spreads=model.spreads[:1])
    faces_deg = np.arange(1, 23) * 360.0 / 23
    between_deg = faces_deg + 180.0 / 23
    temperature_c = np.full(22, 25.0)

    def counted(angle_deg: Floats) -> Floats:
        with_unseen = model.uncertainty_arcsec(angle_deg, temperature_c)
        without = alone.uncertainty_arcsec(angle_deg, temperature_c)
        assert with_unseen is not None
        assert without is not None
        return np.sqrt(with_unseen**2 - without**2)

    # Orders that fold onto others are right at the faces and wrong between them: 2 A sin²(F θ / 2) of their power.
    assert counted(faces_deg).max() < 1e-6
    rms_arcsec = fit.settings["unseen_orders_rms_arcsec"]
    assert isinstance(rms_arcsec, float)
    assert counted(between_deg) == pytest.approx(np.full(22, 2.0 * rms_arcsec), rel=1e-6)


def test_intervals_hold_what_they_promise() -> None:
    covered = []
    for seed in range(8):
        joint = draw_joint("spread", seed)
        model = served(readings_of(draw_campaign(joint, seed)))
        angle_deg, temperature_c, truth = (axis[::7] for axis in true_grid(joint))
        uncertainty = dataclasses.replace(model, spreads=model.spreads[:1]).uncertainty_arcsec(
            angle_deg, temperature_c
        )
        assert uncertainty is not None
        error = np.abs(model.error_arcsec(angle_deg, temperature_c) - truth)
        covered.append(float(np.mean(error <= 2.0 * uncertainty)))
    # 95 %, but the datum's error is common to all angles of a joint: single joints range from 0.8 to 1.
    assert 0.90 <= float(np.mean(covered)) <= 0.995


def test_the_exported_graph_agrees() -> None:
    model = served(readings_of(draw_campaign(draw_joint("knee", 9), 9)))
    angle_deg = np.linspace(-400.0, 800.0, 2000)
    temperature_c = np.random.default_rng(9).uniform(0.0, 50.0, 2000)
    assert check_agreement(build_graph(model).SerializeToString(), model, angle_deg, temperature_c) < 1e-8


def test_runs_may_have_any_zero() -> None:
    joint = draw_joint("n3q", 10)
    readings = readings_of(draw_campaign(joint, 10))
    offsets = np.random.default_rng(10).normal(0.0, 1000.0, 21)[readings.run]
    moved = dataclasses.replace(readings, error_arcsec=readings.error_arcsec + offsets)
    angle_deg, temperature_c, _ = true_grid(joint)
    one, other = (served(given).error_arcsec(angle_deg, temperature_c) for given in (readings, moved))
    assert np.abs(one - other).max() < 1e-8


def test_a_zero_shared_by_runs_of_all_temperatures_does_not_take_drift_for_error() -> None:
    joint = draw_joint("n3q", 11)
    readings = readings_of(draw_campaign(joint, 11))
    drift = 0.7 * (readings.temperature_c - 20.0)
    shared = dataclasses.replace(
        readings, error_arcsec=readings.error_arcsec + drift, zero_group=np.zeros_like(readings.run)
    )
    angle_deg, temperature_c, _ = true_grid(joint)
    one, other = (served(given).error_arcsec(angle_deg, temperature_c) for given in (readings, shared))
    assert np.abs(one - other).max() < 1e-8


def test_spline_interpolation_is_exact_for_straight_lines_and_at_its_nodes() -> None:
    nodes_c = np.array([10.0, 14.0, 21.0, 40.0])
    temperature_c = np.array([-5.0, 10.0, 12.0, 21.0, 33.0, 55.0])
    matrix = spline_interpolation(nodes_c, temperature_c)
    assert matrix @ (3.0 * nodes_c - 2.0) == pytest.approx(3.0 * temperature_c - 2.0, abs=1e-11)
    assert spline_interpolation(nodes_c, nodes_c) == pytest.approx(np.eye(4), abs=1e-12)


def test_what_cannot_be_trained_on_is_refused_with_what_is_missing() -> None:
    joint = draw_joint("n3q", 12)
    with pytest.raises(UnsuitableReadingsError, match="temperatures that differ by 1 degC"):
        fit_linear(readings_of(draw_campaign(joint, 12, temperatures_c=(20.0,))))
    with pytest.raises(UnsuitableReadingsError, match="repeats that show the noise"):
        fit_linear(readings_of(draw_campaign(joint, 12, temperatures_c=(10.0, 30.0), repeats=1)))
    whole = readings_of(draw_campaign(joint, 12))
    with pytest.raises(UnsuitableReadingsError, match="at least 3 distinct angles"):
        fit_linear(some(whole, whole.angle_deg < 20.0))


def test_seed_changes_nothing_and_torch_is_not_needed() -> None:
    readings = readings_of(draw_campaign(draw_joint("n3q", 13), 13))
    angle_deg, temperature_c = np.linspace(0.0, 359.0, 100), np.full(100, 31.0)
    one, other = (load_method("linear").fit(readings, seed=seed).model for seed in (0, 5))
    assert (one.error_arcsec(angle_deg, temperature_c) == other.error_arcsec(angle_deg, temperature_c)).all()
    script = (
        "import sys; from trueangle_training.methods.registry import load_method; "
        "import trueangle_training.export; [load_method(n) for n in ('linear', 'fe-gabpnn', 'best')]; "
        "sys.exit('torch' in sys.modules)"
    )
    environment = {"PYTHONPATH": ":".join(entry for entry in sys.path if entry)}
    assert subprocess.run([sys.executable, "-c", script], env=environment, check=False).returncode == 0


def test_coupled_harmonics_ask_for_the_posterior_mean_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rounds that weigh the kernels need no mean, which costs more than the weighing."""
    asked: list[int] = []
    means = KernelMixture.means

    def counted(mixture: KernelMixture) -> Floats:
        asked.append(1)
        return means(mixture)

    monkeypatch.setattr(KernelMixture, "means", counted)
    readings = readings_of(draw_campaign(draw_joint("spread", 1), 1))
    kept = np.arange(readings.error_arcsec.size) % 7 != 0
    fit_without_uncertainty(reduce_to_coefficients(some(readings, kept)), datum_deg=0.0)
    assert len(asked) == 1
