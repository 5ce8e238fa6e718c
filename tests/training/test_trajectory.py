"""Live joints: each sample belongs to its number alone."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trueangle_training.examples
from trueangle.contract.errors import ContractError
from trueangle_training.documents import load_joint
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint
from trueangle_training.simulator.trajectory import LiveJoint, Trajectory, standard_normal

EXAMPLES = Path(trueangle_training.examples.__file__).parent


@pytest.fixture(scope="module")
def joint() -> SimulatedJoint:
    return simulated_joint(load_joint(EXAMPLES / "joint.yaml"))


def live(joint: SimulatedJoint, *, seed: int = 3, speed_deg_s: float = 30.0) -> LiveJoint:
    trajectory = Trajectory(start_deg=350.0, speed_deg_s=speed_deg_s, start_c=15.0, end_c=35.0, ramp_s=60.0)
    return LiveJoint(simulated=joint, trajectory=trajectory, sample_period_s=0.01, seed=seed)


def test_angle_grows_with_time_and_keeps_its_turns() -> None:
    trajectory = Trajectory(start_deg=10.0, speed_deg_s=-30.0, start_c=20.0, end_c=20.0, ramp_s=1.0)
    assert trajectory.true_deg(0.0) == 10.0
    assert trajectory.true_deg(24.0) == -710.0


@pytest.mark.parametrize(
    ("time_s", "expected_c"), [(0, 15), (30, 25), (60, 35), (90, 25), (120, 15), (150, 25), (12000, 15)]
)
def test_temperature_goes_to_and_fro(time_s: float, expected_c: float) -> None:
    trajectory = Trajectory(start_deg=0.0, speed_deg_s=0.0, start_c=15.0, end_c=35.0, ramp_s=60.0)
    assert trajectory.temperature_c(time_s) == pytest.approx(expected_c, abs=1e-9)


@given(
    st.floats(0, 1e7),
    st.floats(-40, 80),
    st.floats(-40, 80),
    st.floats(0.1, 1e4),
)
def test_temperature_stays_between_its_two_ends(
    time_s: float, start_c: float, end_c: float, ramp_s: float
) -> None:
    trajectory = Trajectory(start_deg=0.0, speed_deg_s=0.0, start_c=start_c, end_c=end_c, ramp_s=ramp_s)
    # One unit in the last place of the larger end: the weighted mean of two numbers may round beyond them.
    room = math.ulp(max(abs(start_c), abs(end_c)))
    assert min(start_c, end_c) - room <= trajectory.temperature_c(time_s) <= max(start_c, end_c) + room


@pytest.mark.parametrize("ramp_s", [0.0, -1.0, math.nan])
def test_a_ramp_without_duration_is_refused(ramp_s: float) -> None:
    with pytest.raises(ContractError, match="above 0 s"):
        Trajectory(start_deg=0.0, speed_deg_s=0.0, start_c=0.0, end_c=1.0, ramp_s=ramp_s)


def test_samples_do_not_depend_on_the_order_in_which_they_are_asked(joint: SimulatedJoint) -> None:
    forwards = [live(joint).sample(i) for i in range(50)]
    other = live(joint)
    backwards = [other.sample(i) for i in reversed(range(50))]
    assert forwards == backwards[::-1]


def test_seeds_give_different_noise(joint: SimulatedJoint) -> None:
    first = [live(joint, seed=1).sample(i) for i in range(50)]
    second = [live(joint, seed=2).sample(i) for i in range(50)]
    assert first != second


@pytest.mark.parametrize("speed_deg_s", [30.0, -30.0])
def test_counts_show_the_true_angle_plus_the_error_within_noise(joint: SimulatedJoint, speed_deg_s: float) -> None:
    moving = live(joint, speed_deg_s=speed_deg_s)
    counts_per_rev = joint.joint.encoder.counts_per_rev
    residual_arcsec: list[float] = []
    for sequence in range(0, 4000, 2):
        truth = moving.truth(sequence)
        counts = moving.sample(sequence).counts
        assert 0 <= counts < counts_per_rev
        expected_arcsec = truth.true_deg * 3600 + moving.error_arcsec(sequence)
        shown_arcsec = counts * 1_296_000 / counts_per_rev
        residual_arcsec.append((shown_arcsec - expected_arcsec + 648_000) % 1_296_000 - 648_000)
    # Noise 0.63" and rounding to 0.3955" counts: sd sqrt(0.63^2 + 0.3955^2 / 12) = 0.640; n = 2000:
    # standard error 0.014 of the mean, 0.010 of the sd; four of them allowed.
    assert np.mean(residual_arcsec) == pytest.approx(0.0, abs=0.057)
    assert np.std(residual_arcsec) == pytest.approx(0.640, abs=0.041)


def test_temperature_is_sent_in_steps_of_the_sensor(joint: SimulatedJoint) -> None:
    moving = live(joint)
    for sequence in range(0, 6000, 37):
        truth_c = moving.truth(sequence).temperature_c
        sent = moving.sample(sequence).temperature_centi_c
        # Half of the sensor's 0.0625 degC step and half of 0.01 degC.
        assert abs(sent / 100 - truth_c) <= 0.03125 + 0.005 + 1e-9
        assert abs(sent / 100 / 0.0625 - round(sent / 100 / 0.0625)) <= 0.005 / 0.0625 + 1e-9


def test_scalar_and_array_forms_of_the_joint_agree(joint: SimulatedJoint) -> None:
    moving = live(joint)
    truths = [moving.truth(i) for i in range(100)]
    in_arrays = joint.error_arcsec(
        np.array([t.true_deg for t in truths]), np.array([t.temperature_c for t in truths])
    )
    np.testing.assert_allclose([moving.error_arcsec(i) for i in range(100)], in_arrays, atol=1e-9)


def test_draws_are_standard_normal_and_independent() -> None:
    draws = np.array([standard_normal(7, i) for i in range(20_000)])
    other = np.array([standard_normal(8, i) for i in range(20_000)])
    # Standard errors for n = 20000: mean 0.0071, sd 0.005, fourth moment 0.069, correlations 0.0071.
    assert abs(draws.mean()) < 0.03
    assert abs(draws.std() - 1.0) < 0.02
    assert abs((draws**4).mean() - 3.0) < 0.28
    assert abs(np.corrcoef(draws[1:], draws[:-1])[0, 1]) < 0.03
    assert abs(np.corrcoef(draws, other)[0, 1]) < 0.03
