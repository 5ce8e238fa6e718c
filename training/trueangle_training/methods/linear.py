"""Harmonics with smooth temperature terms, weighed by evidence: deterministic, milliseconds, with its uncertainty.

Each Fourier coefficient is a constant plus a Gaussian process in temperature, the kernel's amplitudes and length
averaged over a grid by their evidence (`temperature_kernels`). Complete regular campaigns are transformed and
every harmonic stands alone; in all others the same priors tell the harmonics of a general linear model apart, each
with the others integrated out (`coefficients`). The constants have a flat prior below order 12; from there on the
campaign itself says how large they may be (`high_orders`), for every method that rests on this fit.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.coefficients import (
    CoefficientLikelihood,
    CoefficientReadings,
    JointLikelihood,
    reduce_to_coefficients,
)
from trueangle_training.methods.high_orders import steady_power, steady_prior_variance
from trueangle_training.methods.posterior import HarmonicPosterior, spread_nodes, spread_of, with_links
from trueangle_training.methods.separable import SeparableModel, TemperatureBasis
from trueangle_training.methods.stages import Stages, staged
from trueangle_training.methods.temperature_kernels import (
    LENGTHS_C,
    SCALE_C,
    KernelGrid,
    KernelMixture,
    covariance_root,
    weigh_kernels,
)
from trueangle_training.methods.unseen_orders import UnseenOrders, unseen_orders

Floats = NDArray[np.float64]

COUPLING_ROUNDS = 4
"""At most so many rounds of marginal likelihood and kernel weights where harmonics are coupled."""
SETTLED_WEIGHT = 0.01
"""Rounds end when no harmonic's weights move by more in sum: the error then moves by thousandths of an arcsec."""
LEAST_DEVIATION_ARCSEC = 0.01
"""Of every contrast where harmonics are coupled: keeps the prior's root invertible, far below any noise."""
NEGLIGIBLE_WEIGHT = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearFit:
    """The fitted mixture, from which other methods take noise, likelihood and correlations."""

    readings: TrainingReadings
    data: CoefficientReadings
    likelihood: CoefficientLikelihood
    """Each harmonic's own; where harmonics are coupled, with the others integrated out."""
    mixture: KernelMixture
    posterior: HarmonicPosterior
    links: Floats | None
    """[orders, 2 nodes, orders, 2 nodes]: covariance between harmonics; None: the plan leaves none."""
    unseen: UnseenOrders | None

    def model_of(self, posterior: HarmonicPosterior) -> SeparableModel:
        """The served model of this or another method's posterior on the same campaign."""
        covariance = with_links(posterior.covariance, self.links)
        spread = spread_of(covariance, orders=self.data.orders, nodes_c=posterior.nodes_c)
        return SeparableModel(
            orders=self.data.orders,
            basis=posterior.basis,
            weights_arcsec=posterior.weights_arcsec,
            datum_deg=self.readings.datum_deg,
            spreads=(spread,) if self.unseen is None else (spread, self.unseen.spread),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """The `Method`."""

    name: str = "linear"
    summary: str = "harmonics with smooth temperature terms, weighted by evidence"
    stages: Stages | None = None
    """None: every training begins at the beginning."""

    def sharing(self, stages: Stages) -> "Linear":
        """The same with stages shared with other methods."""
        return replace(self, stages=stages)

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Deterministic: the seed changes nothing."""
        progress(0, 1)
        linear = staged_linear(self.stages, readings)
        progress(1, 1)
        return Fit(
            model=linear.model_of(linear.posterior), notes=plan_notes(linear), settings=plan_settings(linear)
        )


def staged_linear(stages: Stages | None, readings: TrainingReadings) -> LinearFit:
    """`fit_linear`, or what a method that shares these stages has made of the same readings."""
    return staged(stages, "linear", readings, None, lambda: fit_linear(readings))


def make(base_temperature_c: float) -> Linear:
    """The method; no temperature is its base."""
    del base_temperature_c
    return Linear()


def plan_notes(linear: LinearFit) -> tuple[str, ...]:
    """What must be said of any method that rests on this reduction."""
    data = linear.data
    noise = f"noise of one reading {data.sigma_arcsec:.3f} arcsec, from {data.sigma_freedoms} degrees of freedom"
    return (noise,) if linear.unseen is None else (noise, linear.unseen.note)


def plan_settings(linear: LinearFit) -> dict[str, object]:
    """How the campaign was reduced, for the model file."""
    data = linear.data
    return {
        "highest_order": data.orders[-1],
        "plan": "complete and regular" if data.decoupled is not None else "general",
        "temperature_nodes_c": [round(float(node), 4) for node in data.nodes_c],
        "sigma_arcsec": data.sigma_arcsec,
        "unseen_orders_rms_arcsec": 0.0 if linear.unseen is None else linear.unseen.rms_arcsec,
    }


def fit_linear(readings: TrainingReadings, data: CoefficientReadings | None = None) -> LinearFit:
    """Fit the mixture; `data` where the readings have been reduced already."""
    weighed = _weighed_twice(reduce_to_coefficients(readings) if data is None else data)
    data, mixture = weighed.data, weighed.mixture
    nodes_c = spread_nodes(data.nodes_c)
    links = None if data.joint is None else _links(data.joint, mixture, nodes_c)
    _, basis, weights = _mean_model(mixture)
    covariance = _harmonic_covariances(mixture, nodes_c)
    unseen = unseen_orders(readings, orders=data.orders, power_arcsec2=weighed.power_arcsec2)
    return LinearFit(
        readings=readings,
        data=data,
        likelihood=weighed.likelihood,
        mixture=mixture,
        posterior=HarmonicPosterior(basis=basis, weights_arcsec=weights, nodes_c=nodes_c, covariance=covariance),
        links=links,
        unseen=unseen,
    )


def fit_without_uncertainty(data: CoefficientReadings, *, datum_deg: float) -> SeparableModel:
    """The model of `fit_linear` without its spread, which costs as much again."""
    _, basis, weights = _mean_model(_weighed_twice(data).mixture)
    return SeparableModel(orders=data.orders, basis=basis, weights_arcsec=weights, datum_deg=datum_deg, spreads=())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Weighed:
    """Kernels weighed with the prior that the campaign itself gives the constants of high orders."""

    data: CoefficientReadings
    likelihood: CoefficientLikelihood
    mixture: KernelMixture
    power_arcsec2: Floats
    """[orders]: squared amplitudes of the steady harmonics."""


def _weighed_twice(data: CoefficientReadings) -> _Weighed:
    grid = KernelGrid.over(data.nodes_c)
    likelihood, mixture = _weighed(data, grid, None)
    steady_arcsec, steady_variance = _steady(likelihood, mixture)
    prior_variance = steady_prior_variance(data.orders, steady_arcsec, steady_variance)
    if np.isfinite(prior_variance).any():
        data = data.with_steady_prior(prior_variance)
        likelihood, mixture = _weighed(data, grid, mixture)
    power = steady_power(steady_arcsec, steady_variance, prior_variance)
    return _Weighed(data=data, likelihood=likelihood, mixture=mixture, power_arcsec2=power)


def _weighed(
    data: CoefficientReadings, grid: KernelGrid, first: KernelMixture | None
) -> tuple[CoefficientLikelihood, KernelMixture]:
    """Each harmonic's likelihood and kernels; `first` is where coupled harmonics begin, None: anywhere."""
    if data.joint is not None:
        return _fit_coupled(data.joint, grid, first)
    assert data.decoupled is not None  # noqa: S101 - one of the two is there
    return data.decoupled, weigh_kernels(data.decoupled, grid)


def _steady(likelihood: CoefficientLikelihood, mixture: KernelMixture) -> tuple[Floats, Floats]:
    """Each order's constants [orders, 2] at the nodes' mean and their mean variance [orders].

    Under one Gaussian whose prior covariance is the mixture's; as in `JointLikelihood.posterior`, order by order.
    """
    factor = _coupled_factor(mixture.prior_covariance(), mixture.grid)
    prior = np.ones(factor.shape[1])
    prior[:2] = 0.0
    across = factor.swapaxes(1, 2)
    covariance: Floats = np.linalg.inv(across @ likelihood.precision @ factor + np.diag(prior)).astype(np.float64)
    mean = covariance @ (across @ likelihood.information[:, :, None])
    return mean[:, :2, 0], np.einsum("ncc->n", covariance[:, :2, :2]) / 2.0


def _fit_coupled(
    joint: JointLikelihood, grid: KernelGrid, first: KernelMixture | None
) -> tuple[CoefficientLikelihood, KernelMixture]:
    """Alternate between each harmonic's marginal likelihood and the kernels' weights."""
    if first is None:
        broad = np.where(grid.choice[:, 1] == 0, 0.0, 1.0)
        broad_covariance = np.tensordot(broad / broad.sum(), grid.contrasted, axes=1)
        covariance = np.repeat(broad_covariance[None], len(joint.information), 0)
    else:
        covariance = first.prior_covariance()
    likelihood = joint.marginal(_coupled_factor(covariance, grid))
    mixture = weigh_kernels(likelihood, grid)
    for _ in range(COUPLING_ROUNDS - 1):
        before = mixture.weight
        likelihood = joint.marginal(_coupled_factor(mixture.prior_covariance(), grid))
        mixture = weigh_kernels(likelihood, grid)
        if np.abs(mixture.weight - before).sum(axis=1).max() < SETTLED_WEIGHT:
            break
    return likelihood, mixture


def _coupled_factor(covariance: Floats, grid: KernelGrid) -> Floats:
    """`JointLikelihood.marginal`'s factor from prior covariances of contrasts [orders, m - 1, m - 1]."""
    nodes = grid.nodes_c.size
    factor = np.zeros((covariance.shape[0], 2 * nodes, 2 * nodes))
    root = grid.contrast @ _floored_root(covariance)
    factor[:, :nodes, 0] = factor[:, nodes:, 1] = 1.0
    factor[:, :nodes, 2 : nodes + 1] = factor[:, nodes:, nodes + 1 :] = root
    return factor


def _floored_root(covariance: Floats) -> Floats:
    return covariance_root(covariance + LEAST_DEVIATION_ARCSEC**2 * np.eye(covariance.shape[-1]))


def _mean_model(mixture: KernelMixture) -> tuple[Floats, TemperatureBasis, Floats]:
    """Constants [orders, 2] at the nodes' mean, and the posterior mean as basis and weights.

    f(T) is a sum of kernels to the nodes with weights Q (q - P z), q and P the likelihood's, z the posterior mean.
    """
    grid, likelihood, means = mixture.grid, mixture.likelihood, mixture.means()
    orders, nodes = mixture.weight.shape[0], grid.nodes_c.size
    dual = likelihood.information[:, None] - np.einsum("nij,ngj->ngi", _each(likelihood.precision, orders), means)
    at_nodes = dual.reshape(orders, -1, 2, nodes - 1) @ grid.contrast.T
    middle_c = float(grid.nodes_c.mean())
    t = (grid.nodes_c - middle_c) / SCALE_C
    slope = np.einsum("ng,g,ngcj,j->nc", mixture.weight, grid.linear, at_nodes, t)
    bells = [
        np.einsum("ng,g,ngcj->ncj", mixture.weight, np.where(grid.length == index, grid.bell, 0.0), at_nodes)
        for index in range(len(LENGTHS_C))
    ]
    basis = TemperatureBasis(
        centre_c=middle_c,
        scale_c=SCALE_C,
        powers=(0, 1),
        bell_centre=tuple(np.tile(t, len(LENGTHS_C)).tolist()),
        bell_length=tuple(np.repeat(np.array(LENGTHS_C) / SCALE_C, nodes).tolist()),
    )
    contrasts = np.einsum("ng,ngi->ni", mixture.weight, means)
    falls = np.einsum("nci,ni->nc", _each(likelihood.constant_slope, orders), contrasts)
    constant = likelihood.constant - falls
    by_function = np.stack([constant, slope, *(bell[:, :, j] for bell in bells for j in range(nodes))])
    by_function[0] -= np.einsum("k,knc->nc", basis.evaluate(grid.nodes_c).mean(axis=0)[1:], by_function[1:])
    return constant, basis, by_function.reshape(basis.size, 2 * orders)


def _each(matrices: Floats, orders: int) -> Floats:
    """One matrix an order, where one may stand for all."""
    return np.broadcast_to(matrices, (orders, *matrices.shape[1:]))


def _harmonic_covariances(mixture: KernelMixture, nodes_c: Floats) -> Floats:
    """Posterior covariance of each harmonic's values at `nodes_c`, [orders, 2 nodes, 2 nodes], cos before sin.

    Under one kernel they are K - F S F', F = (covariance with the contrasts, ones), S the readings' share of it.
    """
    orders = mixture.weight.shape[0]
    likelihood, means, twice = mixture.likelihood, mixture.means(), np.eye(2)
    precision = _each(likelihood.precision, orders)
    slope, constant = _each(likelihood.constant_slope, orders), _each(likelihood.constant_covariance, orders)
    ones = np.kron(twice, np.ones((nodes_c.size, 1)))
    total = np.zeros((orders, 2 * nodes_c.size, 2 * nodes_c.size))
    mean = np.zeros((orders, 2 * nodes_c.size))
    kept = np.flatnonzero(mixture.weight.max(axis=0) > NEGLIGIBLE_WEIGHT)
    weights = mixture.weight[:, kept] / mixture.weight[:, kept].sum(axis=1, keepdims=True)
    posteriors = _each(mixture.covariances(kept), orders)
    across, own = mixture.grid.from_node_mean(nodes_c, np.eye(mixture.weight.shape[1])[kept])
    for number, kernel in enumerate(kept):
        posterior = posteriors[:, number]
        known = precision @ posterior
        moves = slope - slope @ known.swapaxes(1, 2)
        of_constant = constant + slope @ posterior @ slope.swapaxes(1, 2)
        upper = np.concatenate([precision - known @ precision, moves.swapaxes(1, 2)], axis=2)
        share = np.concatenate([upper, np.concatenate([moves, -of_constant], axis=2)], axis=1)
        reach = np.concatenate([np.kron(twice, across[number]), ones], axis=1)
        covariance = np.kron(twice, own[number]) - reach @ share @ reach.T
        dual = likelihood.information - np.einsum("nij,nj->ni", precision, means[:, kernel])
        level = likelihood.constant - np.einsum("nci,ni->nc", slope, means[:, kernel])
        at = np.concatenate([dual, level], axis=1) @ reach.T
        weight = weights[:, number]
        total += weight[:, None, None] * (covariance + at[:, :, None] * at[:, None, :])
        mean += weight[:, None] * at
    return total - mean[:, :, None] * mean[:, None, :]


def _links(joint: JointLikelihood, mixture: KernelMixture, nodes_c: Floats) -> Floats:
    """Posterior covariance of all values at `nodes_c` under one Gaussian whose priors are the mixture's."""
    prior = mixture.prior_covariance()
    factor = _coupled_factor(prior, mixture.grid)
    orders, size = joint.information.shape
    posterior, _ = joint.posterior(factor)
    ones = np.ones((nodes_c.size, 1))
    maps = np.zeros((orders, 2 * nodes_c.size, size))
    left = np.zeros((orders, 2 * nodes_c.size, 2 * nodes_c.size))
    across, own = mixture.grid.from_node_mean(nodes_c, mixture.weight)
    for order in range(orders):
        on_root = across[order] @ np.linalg.inv(_floored_root(prior[order])).T
        maps[order] = np.concatenate([np.kron(np.eye(2), ones), np.kron(np.eye(2), on_root)], axis=1)
        left[order] = np.kron(np.eye(2), own[order] - on_root @ on_root.T)
    covariance = np.einsum("aik,akml,mjl->aimj", maps, posterior, maps, optimize=True)
    covariance[np.arange(orders), :, np.arange(orders), :] += left
    return covariance
