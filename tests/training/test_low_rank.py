"""Shared temperature shapes by sampling, and the average of all three estimators."""

import numpy as np
import pytest
from tests.benchmarks.families import draw_campaign, draw_joint, true_grid
from tests.training.test_linear import readings_of

from trueangle_training.export import build_graph, check_agreement
from trueangle_training.methods.best import Best, fit_best
from trueangle_training.methods.fe_gabpnn import FeGabpnnSettings
from trueangle_training.methods.linear import LinearFit, fit_linear
from trueangle_training.methods.low_rank import GibbsSettings, fit_low_rank
from trueangle_training.methods.posterior import HarmonicPosterior
from trueangle_training.methods.separable import SeparableModel

NETWORK = FeGabpnnSettings(hidden_nodes=(2,), individuals=10, generations=5)
SAMPLING = GibbsSettings(sweeps=250, burn_in=120)


@pytest.fixture(scope="module")
def linear() -> LinearFit:
    return fit_linear(readings_of(draw_campaign(draw_joint("bump+wave", 1), 1)))


@pytest.fixture(scope="module")
def sampled(linear: LinearFit) -> HarmonicPosterior:
    return fit_low_rank(linear)


def test_the_mean_served_is_the_mean_of_what_was_sampled(linear: LinearFit, sampled: HarmonicPosterior) -> None:
    # The constants are the readings': at the campaign's nodes the mean is within the noise of a free fit there.
    nodes = linear.data.nodes_c
    coefficients = (sampled.basis.evaluate(nodes) @ sampled.weights_arcsec).T.reshape(11, -1)
    assert linear.data.decoupled is not None
    precision = np.diag(linear.data.decoupled.precision[0])
    free = linear.data.decoupled.information / precision
    standardised = (coefficients - free) * np.sqrt(precision)
    # 154 values with some fitted: the mean square has a standard deviation of 0.11 about somewhat less than 1.
    assert float(np.mean(standardised**2)) == pytest.approx(0.8, abs=0.4)


def test_same_seed_gives_the_same_and_another_nearly_the_same(linear: LinearFit) -> None:
    first, again, other = (fit_low_rank(linear, seed=seed, settings=SAMPLING) for seed in (1, 1, 2))
    assert (first.weights_arcsec == again.weights_arcsec).all()
    assert (first.covariance == again.covariance).all()
    assert not (first.weights_arcsec == other.weights_arcsec).all()


def test_knowing_who_carries_a_shape_leaves_the_others_still(linear: LinearFit) -> None:
    carried = np.zeros((2, 11), dtype=bool)
    carried[0, 2] = True
    posterior = fit_low_rank(linear, settings=SAMPLING, carried=carried)
    movement = np.ptp(posterior.mean_at_nodes().reshape(11, 2, -1), axis=2)
    assert movement[2].max() > 0.0
    assert movement[np.arange(11) != 2].max() < 1e-9


def test_covariances_are_positive(sampled: HarmonicPosterior) -> None:
    smallest = np.linalg.eigvalsh(sampled.covariance).min()
    assert smallest > -1e-6 * np.abs(sampled.covariance).max()


def test_the_average_trusts_the_network_where_its_evidence_is_ahead_and_not_elsewhere(linear: LinearFit) -> None:
    lost = fit_best(linear, network=NETWORK, sampling=SAMPLING)
    assert lost.network_share < 0.05
    # A step and a decay are what hidden units are made for.
    step = fit_linear(readings_of(draw_campaign(draw_joint("step+decay", 1), 1)))
    ahead = fit_best(step, network=NETWORK, sampling=SAMPLING)
    assert ahead.network_share > 0.4
    assert ahead.network_share + ahead.linear_share == pytest.approx(0.5)


def test_best_is_served_as_one_graph() -> None:
    joint = draw_joint("cusp+step", 1)
    fit = Best(network=NETWORK, sampling=SAMPLING).fit(readings_of(draw_campaign(joint, 1)))
    assert isinstance(fit.model, SeparableModel)
    angle_deg, temperature_c = np.linspace(-400.0, 400.0, 500), np.linspace(0.0, 50.0, 500)
    assert check_agreement(build_graph(fit.model).SerializeToString(), fit.model, angle_deg, temperature_c) < 1e-7
    angle_deg, temperature_c, truth = true_grid(joint)
    error = fit.model.error_arcsec(angle_deg, temperature_c) - truth
    assert float(np.sqrt(np.mean(error**2))) < 0.6


def test_a_plan_that_couples_harmonics_is_taken() -> None:
    joint = draw_joint("n3q", 3)
    readings = readings_of(draw_campaign(joint, 3, missing=0.05))
    fit = Best(network=NETWORK, sampling=GibbsSettings(sweeps=60, burn_in=30)).fit(readings)
    angle_deg, temperature_c, truth = true_grid(joint)
    error = fit.model.error_arcsec(angle_deg, temperature_c) - truth
    assert float(np.sqrt(np.mean(error**2))) < 0.6
