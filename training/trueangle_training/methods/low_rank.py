"""A few temperature shapes shared by all harmonics, sampled: robust where no formula fits the shape.

    z_n = sum over modes k of u_nk g_k + noise,   u_nk = 0 or N(0, s_k² I),   g_k ~ N(0, R_k)

z_n are the contrasts of harmonic n's coefficients over temperature, g_k free but smooth shapes, R_k one of a few
kernels. What a warm housing does to eccentricity it does to tilt as well: harmonics that share a shape pay for it
once. Gibbs sampling with several chains; the result is the average over their sweeps.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods.linear import LinearFit
from trueangle_training.methods.posterior import HarmonicPosterior, spread_nodes
from trueangle_training.methods.separable import TemperatureBasis
from trueangle_training.methods.temperature_kernels import ContrastLikelihood, covariance_root

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

SCALE_C = 10.0
LENGTHS_C = (8.0, 12.0, 20.0)
BELL_SHARES = (0.02, 0.1, 0.5, 3.0)
"""Of a bell-shaped part beside the straight line."""
DEVIATIONS_ARCSEC = np.geomspace(0.02, 10.0, 14)
USED_PRIOR = (1.0, 3.0)
"""Beta prior of the share of harmonics that carry a mode."""
HOT_SWEEPS = 100
HEAT = 200.0
"""The first sweeps see the readings with up to this many times their variance, so that chains find their modes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GibbsSettings:
    """How long to sample."""

    modes: int = 2
    chains: int = 2
    sweeps: int = 500
    burn_in: int = 200


DEFAULT_SAMPLING = GibbsSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Kernels:
    """The shapes' priors at the nodes (in contrasts) and at the spread's nodes."""

    inverse: Floats
    """[kernels, m - 1, m - 1]"""
    log_determinant: Floats
    """[kernels]: of the covariance."""
    reach: Floats
    """[kernels, spread nodes, m - 1]: a shape's mean there, given its contrasts."""
    left: Floats
    """[kernels, spread nodes, spread nodes]: its covariance there, given its contrasts."""
    to_basis: Floats
    """[kernels, functions, m - 1]: weights of line and bells, given its contrasts."""


def _kernels(nodes_c: Floats, contrast: Floats, spread_c: Floats) -> _Kernels:
    middle_c, size = float(nodes_c.mean()), nodes_c.size - 1

    def line(one_c: Floats, other_c: Floats) -> Floats:
        return np.outer(one_c - middle_c, other_c - middle_c) / SCALE_C**2

    parts: dict[str, list[Floats]] = {"inverse": [], "reach": [], "left": [], "to_basis": []}
    determinants: list[float] = []
    for (index, length_c), share in product(enumerate(LENGTHS_C), BELL_SHARES):

        def bell(one_c: Floats, other_c: Floats, length_c: float = length_c) -> Floats:
            return np.exp(-(np.subtract.outer(one_c, other_c) ** 2) / (2.0 * length_c**2))

        line_scale = size / float(np.trace(contrast.T @ line(nodes_c, nodes_c) @ contrast))
        bell_scale = share * size / float(np.trace(contrast.T @ bell(nodes_c, nodes_c) @ contrast))

        def kernel(
            one_c: Floats, other_c: Floats, scales: tuple[float, float] = (line_scale, bell_scale), bell=bell
        ) -> Floats:
            return scales[0] * line(one_c, other_c) + scales[1] * bell(one_c, other_c)

        at_nodes = kernel(nodes_c, nodes_c)
        # A hundred-millionth of the variance keeps long bells over close nodes invertible.
        covariance = contrast.T @ at_nodes @ contrast + 1e-8 * size * np.eye(size)
        inverse: Floats = np.linalg.inv(covariance).astype(np.float64)
        across = kernel(spread_c, nodes_c)
        mean = across.mean(axis=1)
        own = kernel(spread_c, spread_c) - mean[:, None] - mean[None, :] + at_nodes.mean()
        reach = (across - at_nodes.mean(axis=0)) @ contrast @ inverse
        functions = np.zeros((1 + len(LENGTHS_C) * nodes_c.size, size))
        dual = contrast @ inverse
        functions[0] = line_scale * ((nodes_c - middle_c) / SCALE_C) @ dual
        functions[1 + index * nodes_c.size : 1 + (index + 1) * nodes_c.size] = bell_scale * dual
        parts["inverse"].append(inverse)
        parts["reach"].append(reach)
        parts["left"].append(own - reach @ covariance @ reach.T)
        parts["to_basis"].append(functions)
        determinants.append(float(np.linalg.slogdet(covariance)[1]))
    return _Kernels(
        log_determinant=np.array(determinants), **{name: np.stack(part) for name, part in parts.items()}
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sweeps:
    """What was kept: axis 0 runs over sweeps and chains."""

    loading: Floats
    """[kept, modes, orders, 2]: u"""
    shape: Floats
    """[kept, modes, m - 1]: g"""
    kernel: Integers
    """[kept, modes]"""


def fit_low_rank(
    linear: LinearFit, *, seed: int = 0, settings: GibbsSettings = DEFAULT_SAMPLING, carried: Mask | None = None
) -> HarmonicPosterior:
    """Sample the shared shapes of a campaign that `linear` has reduced.

    `carried` [modes, orders]: which harmonics carry which mode, where that is known; benchmarks take it from the
    simulated truth to see what the readings allow at best.
    """
    spread_c = spread_nodes(linear.data.nodes_c)
    kernels = _kernels(linear.data.nodes_c, linear.mixture.grid.contrast, spread_c)
    rng = np.random.default_rng([seed, 2])
    sweeps = _sample(linear.mixture.likelihood, kernels, settings, rng, carried)
    return _posterior(linear, kernels, sweeps, spread_c)


def _sample(
    likelihood: ContrastLikelihood,
    kernels: _Kernels,
    settings: GibbsSettings,
    rng: np.random.Generator,
    carried: Mask | None,
) -> _Sweeps:
    """All chains side by side; arrays begin with [chains]."""
    orders, size = likelihood.information.shape
    chains, modes, half = settings.chains, settings.modes, size // 2
    roots = covariance_root(np.linalg.inv(kernels.inverse).astype(np.float64))
    kernel = rng.integers(kernels.log_determinant.size, size=(chains, modes))
    shape = (roots[kernel] @ rng.standard_normal((chains, modes, half, 1)))[..., 0]
    loading = np.zeros((chains, modes, orders, 2))
    deviation = np.full((chains, modes), 0.5)
    used_share = np.full((chains, modes), 0.25)
    kept: list[tuple[Floats, Floats, Integers]] = []
    for sweep in range(settings.sweeps):
        heat = 1.0 + HEAT * max(0.0, 1.0 - sweep / HOT_SWEEPS) ** 4
        precision, information = likelihood.precision / heat, likelihood.information / heat
        for mode in rng.permutation(modes):
            others = [other for other in range(modes) if other != mode]
            outputs = np.einsum("cknx,cki->cnxi", loading[:, others], shape[:, others]).reshape(
                chains, orders, size
            )
            left = information - (precision @ outputs[..., None])[..., 0]
            known = None if carried is None else carried[mode]
            loading[:, mode] = _draw_loading(
                precision, left, shape[:, mode], deviation[:, mode], used_share[:, mode], known, rng
            )
            used = np.any(loading[:, mode] != 0.0, axis=2).sum(axis=1)
            deviation[:, mode] = _draw_deviation(loading[:, mode], used, rng)
            used_share[:, mode] = rng.beta(USED_PRIOR[0] + used, USED_PRIOR[1] + orders - used)
            shape[:, mode] = _draw_shape(precision, left, loading[:, mode], kernels.inverse[kernel[:, mode]], rng)
            kernel[:, mode] = _draw_kernel(shape[:, mode], kernels, rng)
        if sweep >= settings.burn_in:
            kept.append((loading.copy(), shape.copy(), kernel.copy()))
    loadings, shapes, chosen = (np.concatenate(part) for part in zip(*kept, strict=True))
    return _Sweeps(loading=loadings, shape=shapes, kernel=chosen)


def _draw_loading(
    precision: Floats,
    left: Floats,
    shape: Floats,
    deviation: Floats,
    used_share: Floats,
    known: Mask | None,
    rng: np.random.Generator,
) -> Floats:
    """u of one mode, [chains, orders, 2]: included by its odds with u integrated out, then drawn."""
    chains, half = shape.shape
    orders = left.shape[1]
    squares = (shape[:, :, None] * shape[:, None, :]).reshape(chains, -1)
    inner = (squares @ _by_component(precision, half).T).reshape(chains, -1, 4)
    slab = deviation[:, None] ** -2
    first, across, second = inner[..., 0] + slab, inner[..., 1], inner[..., 3] + slab
    determinant = first * second - across**2
    weight = (left.reshape(chains, orders, 2, half) @ shape[:, None, :, None])[..., 0]
    cosine, sine = weight[..., 0], weight[..., 1]
    mean = np.stack([second * cosine - across * sine, first * sine - across * cosine], axis=2)
    mean /= determinant[..., None]
    log_odds = np.log(used_share / (1.0 - used_share))[:, None]
    worth = np.sum(weight * mean, axis=2) - np.log(determinant * deviation[:, None] ** 4)
    log_odds = log_odds + worth / 2.0
    included = rng.uniform(size=(chains, orders)) < 1.0 / (1.0 + np.exp(-np.clip(log_odds, -500.0, 500.0)))
    if known is not None:
        included = np.broadcast_to(known, included.shape)
    # The Cholesky factor of a two by two covariance, the inverse of (first, across; across, second).
    one, other = np.moveaxis(rng.standard_normal((chains, orders, 2)), 2, 0)
    root = np.sqrt(second / determinant)
    noise = np.stack([root * one, -across / (determinant * root) * one + other / np.sqrt(second)], axis=2)
    return np.where(included[..., None], mean + noise, 0.0)


def _by_component(precision: Floats, half: int) -> Floats:
    """Blocks (cos cos), (cos sin), (sin cos), (sin sin) of every order as rows, [orders or 1 times 4, half²]."""
    return precision.reshape(-1, 2, half, 2, half).swapaxes(2, 3).reshape(-1, half * half)


def _draw_deviation(loading: Floats, used: Integers, rng: np.random.Generator) -> Floats:
    """s of one mode on its grid, [chains]."""
    square = np.sum(loading**2, axis=(1, 2))
    log_density = -2.0 * used[:, None] * np.log(DEVIATIONS_ARCSEC) - square[:, None] / (2.0 * DEVIATIONS_ARCSEC**2)
    return DEVIATIONS_ARCSEC[_draw_index(log_density, rng)]


def _draw_shape(
    precision: Floats, left: Floats, loading: Floats, inverse: Floats, rng: np.random.Generator
) -> Floats:
    """g of one mode, [chains, m - 1]."""
    orders, size = left.shape[1:]
    half = size // 2
    products = loading[..., :, None] * loading[..., None, :]
    if precision.shape[0] == 1:
        products = products.sum(axis=1)
    chains = loading.shape[0]
    of_readings = products.reshape(chains, -1) @ _by_component(precision, half)
    total = inverse + of_readings.reshape(chains, half, half)
    information = (loading.reshape(chains, 1, -1) @ left.reshape(chains, orders * 2, half))[:, 0]
    factor = np.linalg.cholesky(total)
    noise = rng.standard_normal((*information.shape, 1))
    mean = np.linalg.solve(total, information[..., None])
    return (mean + np.linalg.solve(factor.swapaxes(1, 2), noise))[..., 0]


def _draw_kernel(shape: Floats, kernels: _Kernels, rng: np.random.Generator) -> Integers:
    chains, half = shape.shape
    products = (shape[:, :, None] * shape[:, None, :]).reshape(chains, -1)
    square = products @ kernels.inverse.reshape(-1, half * half).T
    return _draw_index(-(square + kernels.log_determinant) / 2.0, rng)


def _draw_index(log_density: Floats, rng: np.random.Generator) -> Integers:
    """One index a row with probability proportional to exp(log_density)."""
    share = np.cumsum(np.exp(log_density - log_density.max(axis=1, keepdims=True)), axis=1)
    return np.sum(share < rng.uniform(size=(share.shape[0], 1)) * share[:, -1:], axis=1)


def _posterior(linear: LinearFit, kernels: _Kernels, sweeps: _Sweeps, spread_c: Floats) -> HarmonicPosterior:
    """Average over the sweeps; the spread adds what each shape leaves open between the nodes."""
    likelihood, nodes_c = linear.mixture.likelihood, linear.data.nodes_c
    orders, count = len(linear.data.orders), sweeps.loading.shape[0]
    ones = np.ones((spread_c.size, 1))
    contrasts = np.einsum("sknx,ski->snxi", sweeps.loading, sweeps.shape).reshape(count, orders, -1)
    fall = np.einsum(
        "nci,sni->snc", np.broadcast_to(likelihood.constant_slope, (orders, 2, contrasts.shape[2])), contrasts
    )
    at_spread = np.einsum("skti,ski->skt", kernels.reach[sweeps.kernel], sweeps.shape)
    paths = np.einsum("sknx,skt->snxt", sweeps.loading, at_spread) - fall[..., None]
    paths = paths.reshape(count, orders, -1)
    mean = paths.mean(axis=0)
    off = (paths - mean).transpose(1, 2, 0)
    covariance = off @ off.swapaxes(1, 2) / count
    both = np.kron(np.eye(2), ones)
    covariance += both @ likelihood.constant_covariance @ both.T
    function_weights = np.zeros((kernels.to_basis.shape[1], orders, 2))
    for kernel in range(kernels.inverse.shape[0]):
        here = sweeps.kernel == kernel
        loading = sweeps.loading[here]
        squares = np.einsum("rnx,rny->nxy", loading, loading) / count
        left = np.einsum("nxy,tu->nxtyu", squares, kernels.left[kernel])
        covariance += left.reshape(covariance.shape)
        moments = np.einsum("rnx,ri->nxi", loading, sweeps.shape[here]) / count
        function_weights += np.einsum("fi,nxi->fnx", kernels.to_basis[kernel], moments)
    middle_c = float(nodes_c.mean())
    t = (nodes_c - middle_c) / SCALE_C
    basis = TemperatureBasis(
        centre_c=middle_c,
        scale_c=SCALE_C,
        powers=(0, 1),
        bell_centre=tuple(np.tile(t, len(LENGTHS_C)).tolist()),
        bell_length=tuple(np.repeat(np.array(LENGTHS_C) / SCALE_C, t.size).tolist()),
    )
    constant = likelihood.constant - fall.mean(axis=0)
    at_nodes = basis.evaluate(nodes_c)[:, 1:].mean(axis=0)
    constant = constant - np.einsum("f,fnx->nx", at_nodes, function_weights)
    weights = np.concatenate([constant[None], function_weights]).reshape(basis.size, -1)
    return HarmonicPosterior(basis=basis, weights_arcsec=weights, nodes_c=spread_c, covariance=covariance)
