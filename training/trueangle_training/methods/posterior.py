"""What a method knows of the coefficients after the campaign, and the model that is made of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods.separable import CoefficientSpread, TemperatureBasis

Floats = NDArray[np.float64]

SPREAD_REACH_C = 6.0
"""How far beyond the campaign the uncertainty goes on growing."""
FEW_NODES = 8
NEGLIGIBLE_VARIANCE = 1e-8
"""Of the largest eigenvalue of the spread."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HarmonicPosterior:
    """Mean of the coefficients as functions of temperature, and each harmonic's covariance at nodes."""

    basis: TemperatureBasis
    weights_arcsec: Floats
    """[basis.size, 2 orders], columns cos, sin of each order in turn."""
    nodes_c: Floats
    """[k]: of the covariance, see `spread_nodes`."""
    covariance: Floats
    """[orders, 2 k, 2 k], arcsec²; cos at every node, then sin."""

    def mean_at_nodes(self) -> Floats:
        """[orders, 2 k], ordered as the covariance."""
        at_nodes = self.basis.evaluate(self.nodes_c) @ self.weights_arcsec
        return at_nodes.T.reshape(self.covariance.shape[0], -1)


def spread_nodes(nodes_c: Floats) -> Floats:
    """The campaign's nodes, the middles between them where there are few, and a place beyond either end."""
    inner = nodes_c
    if nodes_c.size <= FEW_NODES:
        inner = np.sort(np.concatenate([nodes_c, (nodes_c[1:] + nodes_c[:-1]) / 2.0]))
    return np.concatenate([[inner[0] - SPREAD_REACH_C], inner, [inner[-1] + SPREAD_REACH_C]])


def average(posteriors: Sequence[HarmonicPosterior], shares: Sequence[float]) -> HarmonicPosterior:
    """The mixture: the means' average; what they differ by counts as uncertainty. All share their nodes."""
    centre_c, scale_c = posteriors[0].basis.centre_c, posteriors[0].basis.scale_c
    mean = sum(share * one.mean_at_nodes() for one, share in zip(posteriors, shares, strict=True))
    covariance = np.zeros_like(posteriors[0].covariance)
    columns: dict[str, list[float]] = {name: [] for name in ("slope", "offset", "centre", "length")}
    powers: dict[int, Floats] = {}
    tanh_rows: list[Floats] = []
    bell_rows: list[Floats] = []
    for one, share in zip(posteriors, shares, strict=True):
        basis, weights = one.basis, share * one.weights_arcsec
        if (basis.centre_c, basis.scale_c) != (centre_c, scale_c) or not np.array_equal(
            one.nodes_c, posteriors[0].nodes_c
        ):
            raise ValueError("average: expected posteriors over one temperature scale and the same nodes")
        off = one.mean_at_nodes() - mean
        covariance += share * (one.covariance + off[:, :, None] * off[:, None, :])
        tanh_from, bells_from = len(basis.powers), len(basis.powers) + len(basis.tanh_slope)
        for row, exponent in enumerate(basis.powers):
            powers[exponent] = powers.get(exponent, 0.0) + weights[row]
        columns["slope"] += basis.tanh_slope
        columns["offset"] += basis.tanh_offset
        columns["centre"] += basis.bell_centre
        columns["length"] += basis.bell_length
        tanh_rows.append(weights[tanh_from:bells_from])
        bell_rows.append(weights[bells_from:])
    exponents = tuple(sorted(powers))
    basis = TemperatureBasis(
        centre_c=centre_c,
        scale_c=scale_c,
        powers=exponents,
        tanh_slope=tuple(columns["slope"]),
        tanh_offset=tuple(columns["offset"]),
        bell_centre=tuple(columns["centre"]),
        bell_length=tuple(columns["length"]),
    )
    rows = np.concatenate([np.stack([powers[exponent] for exponent in exponents]), *tanh_rows, *bell_rows])
    return HarmonicPosterior(
        basis=basis, weights_arcsec=rows, nodes_c=posteriors[0].nodes_c, covariance=covariance
    )


def widened(one: HarmonicPosterior, other: HarmonicPosterior, share: float) -> HarmonicPosterior:
    """The mean of `one`, uncertain as if `other` were true with probability `share`."""
    off = other.mean_at_nodes() - one.mean_at_nodes()
    as_other = other.covariance + off[:, :, None] * off[:, None, :]
    return replace(one, covariance=(1.0 - share) * one.covariance + share * as_other)


def spread_of(covariance: Floats, *, orders: tuple[int, ...], nodes_c: Floats) -> CoefficientSpread:
    """The covariance [2 orders nodes, 2 orders nodes] by the eigenvectors that matter."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    kept = values > NEGLIGIBLE_VARIANCE * max(float(values[-1]), 1e-12)
    factor = vectors[:, kept] * np.sqrt(values[kept])
    return CoefficientSpread(
        orders=orders, nodes_c=nodes_c, factor_arcsec=factor.reshape(2 * len(orders), nodes_c.size, -1)
    )


def with_links(blocks: Floats, links: Floats | None) -> Floats:
    """One covariance of all harmonics [k, k] from each one's own block [orders, 2 nodes, 2 nodes].

    `links` [orders, 2 nodes, orders, 2 nodes]: a covariance whose correlations between harmonics are taken over;
    None: there are none.
    """
    orders, size = blocks.shape[:2]
    if links is None:
        linked = np.zeros((orders, size, orders, size))
    else:
        scale = np.empty_like(blocks)
        for order in range(orders):
            root = symmetric_root(links[order, :, order])
            scale[order] = symmetric_root(blocks[order]) @ np.linalg.pinv(root, rcond=1e-6, hermitian=True)
        linked = np.einsum("aij,ajmk,mlk->aiml", scale, links, scale, optimize=True)
    linked[np.arange(orders), :, np.arange(orders), :] = blocks
    return linked.reshape(orders * size, orders * size)


def symmetric_root(covariance: Floats) -> Floats:
    """The symmetric square root; what rounding made negative counts as 0."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
