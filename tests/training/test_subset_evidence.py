"""Evidence by eliminating unit after unit, kernels by one bordered factor: against the plain linear algebra."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.benchmarks.families import draw_campaign, draw_joint
from tests.training.test_linear import readings_of

from trueangle_training.methods.coefficient_network import (
    CACHE_BYTES,
    SLAB_DEVIATIONS_ARCSEC,
    _parts,
    fitness,
    output_layers,
    output_means,
)
from trueangle_training.methods.fe_gabpnn import hidden_units
from trueangle_training.methods.linear import LinearFit, fit_linear
from trueangle_training.methods.subset_evidence import subset_log_likelihood
from trueangle_training.methods.temperature_kernels import _log_likelihood

Floats = NDArray[np.float64]

PLANS = {
    "complete": draw_campaign(draw_joint("knee", 1), 1),
    "shifted repeats": draw_campaign(draw_joint("alias", 2), 2, shifted=True),
    "missing readings": draw_campaign(draw_joint("spread", 3), 3, missing=0.07),
    "unequal faces": draw_campaign(draw_joint("n3q", 4), 4, angle_jitter_deg=3.0),
}


@pytest.fixture(scope="module", params=PLANS)
def linear(request: pytest.FixtureRequest) -> LinearFit:
    return fit_linear(readings_of(PLANS[request.param]))


def one_by_one(linear: LinearFit, genes: Floats) -> tuple[Floats, list[list[tuple[Floats, Floats]]]]:
    """log L [orders, subsets, slabs] of one network and each one's posterior, every system solved by itself."""
    likelihood, units = linear.mixture.likelihood, genes.size // 2
    design = hidden_units(linear).both(genes[None])[0]
    orders = likelihood.information.shape[0]
    precision = np.broadcast_to(likelihood.precision, (orders, *likelihood.precision.shape[1:]))
    value = np.zeros((orders, 2**units, SLAB_DEVIATIONS_ARCSEC.size))
    posteriors: list[list[tuple[Floats, Floats]]] = []
    for order in range(orders):
        inner, weight = design.T @ precision[order] @ design, design.T @ likelihood.information[order]
        posteriors.append([])
        for subset in range(2**units):
            used = np.array([(subset >> (column % units)) & 1 == 1 for column in range(2 * units)])
            for number, slab in enumerate(SLAB_DEVIATIONS_ARCSEC**2):
                total = inner[np.ix_(used, used)] + np.eye(int(used.sum())) / slab
                mean, covariance = np.zeros(2 * units), np.zeros((2 * units, 2 * units))
                mean[used] = np.linalg.solve(total, weight[used])
                covariance[np.ix_(used, used)] = np.linalg.inv(total)
                log_determinant = np.linalg.slogdet(slab * total)[1]
                value[order, subset, number] = (weight[used] @ mean[used] - log_determinant) / 2.0
                posteriors[-1].append((mean, covariance))
    return value, posteriors


@pytest.mark.parametrize("units", [1, 2, 3])
def test_elimination_gives_the_evidence_of_every_subset_and_slab(linear: LinearFit, units: int) -> None:
    genes = np.random.default_rng(units).uniform(-2.0, 2.0, (3, 2 * units))
    likelihood = linear.mixture.likelihood
    design = hidden_units(linear).both(genes)
    inner = design.swapaxes(1, 2)[:, None] @ likelihood.precision[None] @ design[:, None]
    weight = likelihood.information @ design
    by_elimination = subset_log_likelihood(inner, weight, SLAB_DEVIATIONS_ARCSEC**2)
    for member in range(3):
        expected, _ = one_by_one(linear, genes[member])
        # Values reach thousands of nats; a millionth of a nat is far below what any decision rests on.
        assert by_elimination[member] == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_two_units_alike_do_no_harm(linear: LinearFit) -> None:
    # B is singular; only the slab keeps the system solvable.
    genes = np.array([0.7, 0.7, 0.1, 0.1])
    expected, _ = one_by_one(linear, genes)
    likelihood = linear.mixture.likelihood
    design = hidden_units(linear).both(genes[None])
    inner = design.swapaxes(1, 2)[:, None] @ likelihood.precision[None] @ design[:, None]
    found = subset_log_likelihood(inner, likelihood.information @ design, SLAB_DEVIATIONS_ARCSEC**2)
    assert found[0] == pytest.approx(expected, rel=1e-8, abs=1e-5)


def test_output_weights_are_the_average_over_subsets_and_slabs(linear: LinearFit) -> None:
    genes = np.array([[0.7, -0.4, 0.2, 0.9]])
    likelihood, hidden = linear.mixture.likelihood, hidden_units(linear)
    value, posteriors = one_by_one(linear, genes[0])
    orders, subsets, slabs = value.shape
    # The chance of a unit being used, by the same five steps of expectation-maximisation.
    size = np.array([0.0, 1.0, 1.0, 2.0])
    largest = value.max(axis=(1, 2), keepdims=True)
    use, weight, total = 0.25, np.zeros_like(value), np.ones((orders, 1, 1))
    for _ in range(5):
        prior = use**size * (1.0 - use) ** (2.0 - size)
        weight = np.exp(value - largest) * prior[:, None] / slabs
        total = weight.sum(axis=(1, 2), keepdims=True)
        weight /= total
        use = (float(np.einsum("nsz,s->", weight, size)) + 0.5) / (2.0 * orders + 2.5)
    log_evidence = float(np.sum(np.log(total) + largest))
    expected = np.zeros((orders, 4))
    second = np.zeros((orders, 4, 4))
    for order in range(orders):
        for share, (mean, covariance) in zip(weight[order].ravel(), posteriors[order], strict=True):
            expected[order] += share * mean
            second[order] += share * (covariance + np.outer(mean, mean))
    layers = output_layers(likelihood, hidden, genes)
    assert subsets == 4
    assert layers.mean[0] == pytest.approx(expected, abs=1e-8)
    assert output_means(likelihood, hidden, genes)[0] == pytest.approx(expected, abs=1e-8)
    assert layers.covariance[0] == pytest.approx(
        second - expected[:, :, None] * expected[:, None, :], rel=1e-6, abs=1e-9
    )
    of_genes = np.sum(genes**2) / (2.0 * 1.5**2)
    assert layers.fitness[0] == pytest.approx(log_evidence - of_genes, abs=1e-6)


def test_members_in_parts_give_what_they_give_together(linear: LinearFit) -> None:
    likelihood, hidden = linear.mixture.likelihood, hidden_units(linear)
    genes = np.random.default_rng(5).uniform(-2.0, 2.0, (40, 8))
    variants = SLAB_DEVIATIONS_ARCSEC.size
    parts = _parts(genes, likelihood, variants)
    assert np.concatenate(parts) == pytest.approx(genes, abs=0.0)
    assert all(8 * len(likelihood.precision) * variants * 64 * len(part) <= CACHE_BYTES for part in parts)
    singly = np.concatenate([fitness(likelihood, hidden, one[None]) for one in genes])
    assert fitness(likelihood, hidden, genes) == pytest.approx(singly, rel=1e-10)


def test_every_kernel_has_the_evidence_of_its_own_system(linear: LinearFit) -> None:
    likelihood, grid = linear.mixture.likelihood, linear.mixture.grid
    found = _log_likelihood(likelihood, grid)
    orders, kernels = found.shape
    assert (orders, kernels) == (likelihood.information.shape[0], grid.linear.size)
    precision = np.broadcast_to(likelihood.precision, (orders, *likelihood.precision.shape[1:]))
    for kernel in range(kernels):
        prior = np.kron(np.eye(2), grid.contrasted[kernel])
        for order in range(0, orders, 3):
            # q' K (1 + P K)^-1 q / 2 - log|1 + P K| / 2, with no root taken and no line split off.
            whole = np.eye(prior.shape[0]) + precision[order] @ prior
            information = likelihood.information[order]
            expected = information @ prior @ np.linalg.solve(whole, information) / 2.0
            expected -= np.linalg.slogdet(whole)[1] / 2.0
            assert found[order, kernel] == pytest.approx(expected, rel=1e-6, abs=1e-5)
