"""A small network from temperature to all Fourier coefficients, judged by evidence and trained by LM.

    c_n(T) = b_n + sum over h of u_nh tanh(a_h t + c_h),   t = (T - middle) / scale,   u_nh = (cos, sin)

The constants b_n are integrated out (flat prior). A hidden layer (a, c) is worth its evidence with the output
weights u integrated out: each harmonic uses a subset S of the hidden units and one slab u ~ N(0, s I), both
averaged over,

    log L(n, S, s) = w'(B + 1/s)⁻¹w / 2 - log|1 + s B| / 2,   B = G'PG, w = G'q,

with P, q the harmonic's likelihood in contrasts and G the units' contrasts. The chance of a unit being used is
common to all harmonics. Everything runs over a population of networks at once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods.subset_evidence import subset_log_likelihood
from trueangle_training.methods.temperature_kernels import ContrastLikelihood

Floats = NDArray[np.float64]

GENE_DEVIATION = 1.5
"""Prior standard deviation of slopes a and offsets c."""
WEIGHT_DEVIATION_ARCSEC = 2.0
"""Of the output weights while Levenberg-Marquardt trains; the averages afterwards use the slabs."""
SLAB_DEVIATIONS_ARCSEC = np.geomspace(0.05, 10.0, 8)
FIRST_USE = 0.25
USE_STEPS = 4
LM_STEPS = 30
FIRST_DAMPING = 1.0
TAKEN_FACTOR = 0.2
DROPPED_FACTOR = 5.0
CACHE_BYTES = 2**20
"""Arrays of one step; larger ones are fetched from the system anew each time, which costs more than the sums."""
SMALLEST_RMS = 1e-6
"""A unit that saturates over the whole campaign is a constant; it must not be blown up to unit size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HiddenUnits:
    """Hidden layers of a population, in contrasts of the campaign's temperatures."""

    contrast: Floats
    """[m, m - 1]"""
    t: Floats
    """[m]: the nodes' scaled temperatures."""

    def activation(self, genes: Floats, t: Floats) -> Floats:
        """tanh(a t + c), [members, t, units]; `genes` [members, 2 units], slopes before offsets."""
        slope, offset = np.split(genes, 2, axis=1)
        return np.tanh(slope[:, None, :] * t[None, :, None] + offset[:, None, :])

    def contrasts(self, genes: Floats) -> Floats:
        """[members, m - 1, units]"""
        return self.contrast.T @ self.activation(genes, self.t)

    def rms(self, genes: Floats) -> Floats:
        """Root mean square of each unit about its mean over the nodes, [members, units]."""
        norm = np.sqrt(np.sum(self.contrasts(genes) ** 2, axis=1) / self.t.size)
        return np.maximum(norm, SMALLEST_RMS)

    def both(self, genes: Floats) -> Floats:
        """Contrasts for cos and sin, units scaled to unit RMS: [members, 2 (m - 1), 2 units]."""
        scaled = self.contrasts(genes) / self.rms(genes)[:, None, :]
        return for_both(scaled)


def for_both(one: Floats) -> Floats:
    """[..., i, j] as a block for cos and the same for sin, [..., 2 i, 2 j]."""
    rows, columns = one.shape[-2:]
    result = np.zeros((*one.shape[:-2], 2 * rows, 2 * columns))
    result[..., :rows, :columns] = result[..., rows:, columns:] = one
    return result


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputLayers:
    """Output weights of a population, averaged over subsets and slabs; units scaled to unit RMS."""

    fitness: Floats
    """[members]: log evidence plus log prior of the genes."""
    mean: Floats
    """[members, orders, 2 units]: cos of every unit, then sin."""
    covariance: Floats
    """[members, orders, 2 units, 2 units]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Subsets:
    """Every subset of the hidden units, diagonalised."""

    vectors: Floats
    """[members, orders or 1, subsets, 2 units, 2 units]"""
    values: Floats
    """[members, orders or 1, subsets, 2 units]: of B; 0 where a unit is not used."""
    projected: Floats
    """[members, orders, subsets, 2 units]: V'w"""
    log_likelihood: Floats
    """[members, orders, subsets, slabs]"""


def _inner(likelihood: ContrastLikelihood, design: Floats) -> tuple[Floats, Floats]:
    """B [members, orders or 1, 2 units, 2 units] and w [members, orders, 2 units]."""
    inner = design.swapaxes(1, 2)[:, None] @ likelihood.precision[None] @ design[:, None]
    return inner, likelihood.information @ design


def _subsets(likelihood: ContrastLikelihood, design: Floats) -> _Subsets:
    units = design.shape[2] // 2
    chosen = np.array([[(number >> unit) & 1 for unit in range(units)] for number in range(2**units)], dtype=float)
    mask = np.concatenate([chosen, chosen], axis=1)
    inner, weight = _inner(likelihood, design)
    masked = inner[:, :, None] * (mask[:, :, None] * mask[:, None, :])
    values, vectors = np.linalg.eigh(masked)
    values = np.maximum(values, 0.0)
    # Units outside the subset have eigenvalue 0 of their own; they must not lend their slab to the covariance.
    vectors = vectors * mask[:, :, None]
    weight = weight[:, :, None] * mask
    projected = (weight[..., None, :] @ vectors)[..., 0, :]
    slab = SLAB_DEVIATIONS_ARCSEC**2
    grown = 1.0 + values[..., None] * slab
    square = (projected[..., None, :] ** 2 @ (slab / grown))[..., 0, :]
    log_likelihood = square - np.sum(np.log(grown), axis=-2)
    return _Subsets(
        vectors=vectors,
        values=values,
        projected=projected,
        log_likelihood=log_likelihood / 2.0,
    )


def _weigh_subsets(log_likelihood: Floats, units: int) -> tuple[Floats, Floats]:
    """Log evidence [members] and the weight of each subset and slab, shaped like `log_likelihood`."""
    size = np.array([number.bit_count() for number in range(2**units)], dtype=np.float64)
    members, orders = log_likelihood.shape[:2]
    slabs = SLAB_DEVIATIONS_ARCSEC.size
    use = np.full((members, 1), FIRST_USE)
    # Slabs are equally likely, so the sum over them can be taken once.
    largest = log_likelihood.max(axis=(2, 3), keepdims=True)
    relative = np.exp(log_likelihood - largest)
    by_subset = relative.sum(axis=3) / slabs
    evidence, prior = np.empty((members, orders)), np.empty((members, 1, size.size))
    for _ in range(USE_STEPS + 1):
        prior = (use**size * (1.0 - use) ** (units - size))[:, None, :]
        weight = prior * by_subset
        evidence = weight.sum(axis=2)
        used = np.einsum("pns,s->p", weight / evidence[:, :, None], size)[:, None]
        use = (used + 0.5) / (orders * units + 2.5)
    log_evidence = np.sum(np.log(evidence) + largest[:, :, 0, 0], axis=1)
    weights = prior[..., None] * relative / slabs / evidence[:, :, None, None]
    return log_evidence, weights


def fitness(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats) -> Floats:
    """What each hidden layer is worth, in nats, [members]."""

    def worth(some: Floats) -> Floats:
        inner, weight = _inner(likelihood, hidden.both(some))
        subsets = subset_log_likelihood(inner, weight, SLAB_DEVIATIONS_ARCSEC**2)
        return _weigh_subsets(subsets, some.shape[1] // 2)[0]

    parts = _parts(genes, likelihood, SLAB_DEVIATIONS_ARCSEC.size)
    return np.concatenate([worth(part) for part in parts]) + _log_prior(genes)


def output_means(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats) -> Floats:
    """The output weights of each hidden layer, averaged over subsets and slabs, [members, orders, 2 units]."""
    units = genes.shape[1] // 2

    def means(some: Floats) -> Floats:
        subsets = _subsets(likelihood, hidden.both(some))
        return _mean(subsets, _averaged_gain(subsets, _weigh_subsets(subsets.log_likelihood, units)[1]))

    return np.concatenate([means(part) for part in _parts(genes, likelihood, 2**units)])


def output_layers(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats) -> OutputLayers:
    """`output_means` with the covariance of the weights and the fitness."""
    parts = _parts(genes, likelihood, 2 ** (genes.shape[1] // 2))
    log_evidence, mean, covariance = (
        np.concatenate(part) for part in zip(*(_layers(likelihood, hidden, part) for part in parts), strict=True)
    )
    return OutputLayers(fitness=log_evidence + _log_prior(genes), mean=mean, covariance=covariance)


def _log_prior(genes: Floats) -> Floats:
    return -np.sum(genes**2, axis=1) / (2.0 * GENE_DEVIATION**2)


def _parts(genes: Floats, likelihood: ContrastLikelihood, variants: int) -> list[Floats]:
    """Members in parts whose matrices [members, orders, variants, 2 units, 2 units] stay in the cache."""
    of_member = 8 * likelihood.precision.shape[0] * variants * genes.shape[1] ** 2
    count = max(1, CACHE_BYTES // of_member)
    return [genes[start : start + count] for start in range(0, genes.shape[0], count)]


def _layers(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats) -> tuple[Floats, Floats, Floats]:
    """Log evidence, mean and covariance."""
    subsets = _subsets(likelihood, hidden.both(genes))
    log_evidence, weights = _weigh_subsets(subsets.log_likelihood, genes.shape[1] // 2)
    averaged = _averaged_gain(subsets, weights)
    mean = _mean(subsets, averaged)
    gain = _gain(subsets)
    products = (gain * weights[:, :, :, None]) @ gain.swapaxes(-1, -2)
    projected = subsets.projected
    second = products * projected[..., :, None] * projected[..., None, :]
    diagonal = np.arange(projected.shape[-1])
    second[..., diagonal, diagonal] += averaged
    covariance = np.sum(subsets.vectors @ second @ subsets.vectors.swapaxes(-1, -2), axis=2)
    return log_evidence, mean, covariance - mean[..., :, None] * mean[..., None, :]


def _gain(subsets: _Subsets) -> Floats:
    """Variance of each direction under each slab, [members, orders or 1, subsets, 2 units, slabs]."""
    slab = SLAB_DEVIATIONS_ARCSEC**2
    return slab / (1.0 + subsets.values[..., None] * slab)


def _averaged_gain(subsets: _Subsets, weights: Floats) -> Floats:
    """[members, orders, subsets, 2 units]"""
    return (_gain(subsets) @ weights[..., None])[..., 0]


def _mean(subsets: _Subsets, averaged: Floats) -> Floats:
    return np.sum((subsets.vectors @ (averaged * subsets.projected)[..., None])[..., 0], axis=2)


def train(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats, weights: Floats) -> Floats:
    """Levenberg-Marquardt over all weights of each network; the trained genes [members, 2 units].

    Minimises sum over n of f_n'P f_n / 2 - q_n'f_n, f_n = G u_n, plus the priors' |(a, c)|² / 2 · 1.5² and
    |u|² / 2 · 2². `weights` [members, orders, 2 units] belong to units that are not scaled. The output weights of
    different harmonics meet only in the genes, so each step solves them away (Schur complement).
    """
    damping = np.full(genes.shape[0], FIRST_DAMPING)
    loss = _loss(likelihood, hidden, genes, weights)
    for _ in range(LM_STEPS):
        gene_step, weight_step = _step(likelihood, hidden, genes, weights, damping)
        trial_genes, trial_weights = genes + gene_step, weights + weight_step
        trial = _loss(likelihood, hidden, trial_genes, trial_weights)
        # A comparison with NaN is False: a step that overflowed is dropped.
        taken = trial < loss
        genes = np.where(taken[:, None], trial_genes, genes)
        weights = np.where(taken[:, None, None], trial_weights, weights)
        loss = np.where(taken, trial, loss)
        damping = np.clip(damping * np.where(taken, TAKEN_FACTOR, DROPPED_FACTOR), 1e-12, 1e12)
    return genes


def _loss(likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats, weights: Floats) -> Floats:
    outputs = weights @ for_both(hidden.contrasts(genes)).swapaxes(1, 2)
    bent = (likelihood.precision[None] @ outputs[..., None])[..., 0]
    data = np.sum(outputs * (bent / 2.0 - likelihood.information), axis=(1, 2))
    priors = np.sum(genes**2, axis=1) / GENE_DEVIATION**2
    return data + (priors + np.sum(weights**2, axis=(1, 2)) / WEIGHT_DEVIATION_ARCSEC**2) / 2.0


def _step(
    likelihood: ContrastLikelihood, hidden: HiddenUnits, genes: Floats, weights: Floats, damping: Floats
) -> tuple[Floats, Floats]:
    """Genes' and weights' steps of the damped Gauss-Newton system, in closed form."""
    members, orders, size = weights.shape
    units = size // 2
    bend = 1.0 - hidden.activation(genes, hidden.t) ** 2
    by_gene = hidden.contrast.T @ np.concatenate([bend * hidden.t[None, :, None], bend], axis=2)
    design = for_both(hidden.contrasts(genes))
    amplitude = np.tile(weights.reshape(members, orders, 2, units), 2)
    jacobian = (amplitude[:, :, :, None, :] * by_gene[:, None, None]).reshape(members, orders, -1, 2 * units)
    outputs = weights @ design.swapaxes(1, 2)
    slope = likelihood.information - (likelihood.precision[None] @ outputs[..., None])[..., 0]
    bent_jacobian = likelihood.precision[None] @ jacobian
    bent_design = likelihood.precision[None] @ design[:, None]
    own = design.swapaxes(1, 2)[:, None] @ bent_design
    own = own + (damping[:, None, None, None] + WEIGHT_DEVIATION_ARCSEC**-2) * np.eye(size)
    cross = design.swapaxes(1, 2)[:, None] @ bent_jacobian
    genes_block = _summed_product(jacobian, bent_jacobian)
    genes_block += (damping[:, None, None] + GENE_DEVIATION**-2) * np.eye(2 * units)
    gene_slope = _summed_product(jacobian, slope[..., None])[..., 0] - genes / GENE_DEVIATION**2
    weight_slope = slope @ design - weights / WEIGHT_DEVIATION_ARCSEC**2
    right = np.concatenate([cross, weight_slope[..., None]], axis=3)
    solved = np.linalg.solve(np.broadcast_to(own, (members, orders, size, size)), right)
    reduced = genes_block - _summed_product(cross, solved[..., :-1])
    reduced_slope = gene_slope - _summed_product(cross, solved[..., -1:])[..., 0]
    gene_step: Floats = np.linalg.solve(reduced, reduced_slope[..., None])[..., 0].astype(np.float64)
    weight_step = solved[..., -1] - np.einsum("pnik,pk->pni", solved[..., :-1], gene_step)
    return gene_step, weight_step


def _summed_product(one: NDArray[np.floating], other: NDArray[np.floating]) -> Floats:
    """Sum over orders of A'B, [members, k, l] from [members, orders, i, k] and [members, orders, i, l]."""
    members = one.shape[0]
    flat = one.reshape(members, -1, one.shape[-1])
    product: Floats = flat.swapaxes(1, 2) @ other.reshape(members, -1, other.shape[-1])
    return product
