"""Steady harmonics from order 12 up are shrunk by what the campaign says of them, and nothing else is touched."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.benchmarks.families import Campaign, FamilyJoint, draw_campaign, draw_joint, true_grid

from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.coefficients import reduce_to_coefficients
from trueangle_training.methods.high_orders import steady_power, steady_prior_variance
from trueangle_training.methods.linear import LinearFit, fit_linear
from trueangle_training.methods.separable import harmonics

Floats = NDArray[np.float64]

ORDERS = tuple(range(1, 23))
HIGH = np.arange(12, 23)
VARIANCE = 0.00176
"""Of one coefficient of 483 readings with 0.65 arcsec: 2 σ² / 483."""
EXAMPLE_ARCSEC = np.array([0.25, 0.21, 0.18, 0.15, 0.13, 0.11, 0.09, 0.08, 0.07, 0.0, 0.0])
SPARSE_ARCSEC = np.where(np.isin(HIGH, (14, 19)), 0.3, 0.0)


def readings_of(campaign: Campaign) -> TrainingReadings:
    return TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )


def shrunk(estimate_arcsec: Floats, variance: float = VARIANCE) -> tuple[Floats, Floats]:
    """Prior variances and posterior means of all orders from their estimates [22, 2]."""
    own = np.full(len(ORDERS), variance)
    prior = steady_prior_variance(ORDERS, estimate_arcsec, own)
    return prior, estimate_arcsec / (1.0 + own / prior)[:, None]


def parts_left(amplitude_arcsec: Floats) -> float:
    """Squared error after shrinking over that before, orders 12 to 22, over 200 draws."""
    rng = np.random.default_rng(5)
    before = after = 0.0
    for _ in range(200):
        phase = rng.uniform(0.0, 2.0 * np.pi, HIGH.size)
        truth = np.zeros((len(ORDERS), 2))
        truth[11:] = amplitude_arcsec[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)
        estimate = truth + rng.normal(0.0, VARIANCE**0.5, truth.shape)
        _, mean = shrunk(estimate)
        before += float(np.sum((estimate - truth)[11:] ** 2))
        after += float(np.sum((mean - truth)[11:] ** 2))
    return after / before


@pytest.mark.parametrize(
    ("amplitude_arcsec", "at_most"),
    # Knowing each amplitude, (A² / 2) / (A² / 2 + v) would leave 0.65, 0.18, 0.00 and 0.92 of the squared error.
    [(EXAMPLE_ARCSEC, 0.80), (SPARSE_ARCSEC, 0.30), (np.zeros(11), 0.08), (np.full(11, 0.2), 1.0)],
    ids=["falling", "two of eleven", "none", "all alike"],
)
def test_shrinking_pays_whatever_the_orders_are_like(amplitude_arcsec: Floats, at_most: float) -> None:
    assert parts_left(amplitude_arcsec) < at_most


def test_lower_orders_and_large_ones_are_left_as_they_are() -> None:
    estimate = np.full((len(ORDERS), 2), 0.02)
    prior, mean = shrunk(estimate)
    assert np.isinf(prior[:11]).all()
    assert (mean[:11] == estimate[:11]).all()
    assert (np.abs(mean[11:]) < 0.3 * 0.02).all()
    # 100 standard deviations: what is taken off is far below one.
    large = np.full((len(ORDERS), 2), 100.0 * VARIANCE**0.5)
    assert np.abs(shrunk(large)[1] - large).max() < 0.02 * VARIANCE**0.5


def test_the_prior_depends_on_signal_over_noise_alone_where_the_grid_reaches() -> None:
    # The grid is in arcsec: moved by a factor of three its points lie elsewhere, and its ends as well.
    rng = np.random.default_rng(1)
    estimate = rng.normal(0.0, 2.0 * VARIANCE**0.5, (len(ORDERS), 2))
    one, other = shrunk(estimate)[0], shrunk(3.0 * estimate, 9.0 * VARIANCE)[0]
    assert other[11:] == pytest.approx(9.0 * one[11:], rel=0.2)


def test_the_expected_power_is_unbiased_without_and_positive_with_a_prior() -> None:
    rng = np.random.default_rng(2)
    estimate = rng.normal(0.0, VARIANCE**0.5, (20000, 2))
    variance, prior = np.full(20000, VARIANCE), np.full(20000, np.inf)
    # The standard error of the mean of |y|² is 2 v / sqrt(20000).
    assert abs(np.mean(steady_power(estimate, variance, prior))) < 4.0 * 2.0 * VARIANCE / 20000**0.5
    prior[:] = VARIANCE
    # κ = 1/2: v / 2 of the estimate and v of the posterior.
    assert np.mean(steady_power(estimate, variance, prior)) == pytest.approx(1.5 * VARIANCE, rel=0.05)


def test_a_prior_counts_once_in_the_reduced_readings() -> None:
    """The posterior of one steady order is that of ridge regression on the readings themselves."""
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(6), 23)
    angle_deg = (np.tile(np.arange(23), 6) + np.repeat([0.0, 1 / 3, 2 / 3] * 2, 23)) * 360.0 / 23
    error_arcsec = rng.normal(0.0, 1.0, run.size)
    temperature_c = np.repeat([20.0, 30.0], 69)
    readings = TrainingReadings(
        angle_deg=angle_deg, error_arcsec=error_arcsec, temperature_c=temperature_c, run=run
    )
    data = reduce_to_coefficients(readings)
    prior = np.where(np.arange(1, 23) == 15, 0.01, np.inf)
    after = data.with_steady_prior(prior).joint
    assert after is not None
    index = 14
    # Both nodes alike: x = (c, c, s, s).
    same = np.kron(np.eye(2), np.ones((2, 1)))
    precision = same.T @ after.precision[index, :, index] @ same
    found = np.linalg.solve(precision, same.T @ after.information[index])
    column = harmonics(angle_deg, (15,))
    weight = 1.0 / data.sigma_arcsec**2
    direct = np.linalg.solve(weight * column.T @ column + np.eye(2) / 0.01, weight * column.T @ error_arcsec)
    # Over equal faces order 15 has no mean in a run, so offsets change nothing.
    assert found == pytest.approx(direct, rel=1e-9)


def test_plans_that_see_no_order_above_eleven_keep_their_readings() -> None:
    joint = draw_joint("spread", 1)
    readings = readings_of(draw_campaign(joint, 1))
    data = reduce_to_coefficients(readings)
    assert fit_linear(readings, data).data is data


def square_error_of_high_orders(joint: FamilyJoint, linear: LinearFit) -> float:
    """Sum of squares over orders 12 to 22 of the served steady coefficients' errors."""
    truth = np.zeros((22, 2))
    truth[: len(joint.steady_arcsec)] = joint.steady_arcsec
    served = linear.model_of(linear.posterior).coefficients_arcsec(linear.data.nodes_c).mean(axis=0)
    return float(np.sum((served.reshape(22, 2) - truth)[11:] ** 2))


def test_shifted_repeats_serve_high_orders_better_than_their_noise_and_promise_what_they_hold() -> None:
    found, of_noise = 0.0, 0.0
    covered: list[float] = []
    for seed in range(6):
        joint = draw_joint("alias", seed)
        linear = fit_linear(readings_of(draw_campaign(joint, seed, shifted=True)))
        found += square_error_of_high_orders(joint, linear)
        of_noise += 22 * 2.0 * joint.noise_arcsec**2 / 483
        model = linear.model_of(linear.posterior)
        angle_deg, temperature_c, truth = (axis[::7] for axis in true_grid(joint))
        uncertainty = model.uncertainty_arcsec(angle_deg, temperature_c)
        assert uncertainty is not None
        error = np.abs(model.error_arcsec(angle_deg, temperature_c) - truth)
        covered.append(float(np.mean(error <= 2.0 * uncertainty)))
    # 0.70 over 25 joints; the 132 squares here scatter by an eighth.
    assert found < 0.95 * of_noise
    # 95 % and a little more: orders above 22 are counted, and these joints have none.
    assert 0.90 <= float(np.mean(covered)) <= 0.995
