"""Smooth functions of temperature as a small grid of Gaussian-process kernels, and their weighing by evidence.

A coefficient is a constant b, known only from the readings, plus a Gaussian process

    k(T, T') = s₁² t t' + s₂² κ_l exp(-(T - T')² / 2 l²),   t = T / 10 degC from the middle,

with κ_l such that both parts have the same trace over the campaign's temperatures. The evidence of every kernel of
the grid is exact, and the shares of the grid's values are common to all harmonics: where few harmonics move with
temperature, the others are held still (expectation-maximisation with Dirichlet pseudo-counts).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods.coefficients import CoefficientLikelihood

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SCALE_C = 10.0
AMPLITUDES_ARCSEC = (0.0, *np.geomspace(0.05, 8.0, 8).tolist())
"""Of either part; 0: the part is absent."""
LENGTHS_C = (8.0, 15.0, 30.0)
ABSENT_PSEUDO_COUNT = 2.0
PRESENT_PSEUDO_COUNT = 1.0 / 8.0
"""Of each amplitude above 0: a harmonic without temperature terms is the rule."""
LENGTH_PSEUDO_COUNT = 1.0 / 3.0
EVIDENCE_STEPS = 30
NEGLIGIBLE_WEIGHT = 1e-6
"""Kernels that have less for every harmonic get none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelGrid:
    """All kernels at the temperature nodes of one campaign."""

    nodes_c: Floats
    contrast: Floats
    """[m, m - 1], orthonormal columns that sum to 0."""
    linear: Floats
    """[kernels]: s₁² of each."""
    bell: Floats
    """[kernels]: s₂² κ of each."""
    length: Integers
    """[kernels]: which of LENGTHS_C."""
    choice: Integers
    """[kernels, 3]: indices of s₁, s₂ and l, for the shares."""
    contrasted: Floats
    """[kernels, m - 1, m - 1]: every kernel at the nodes, in contrasts."""
    root: Floats
    """[kernels, m - 1, m - 1]: L with L L' = contrasted."""

    @staticmethod
    def over(nodes_c: Floats) -> "KernelGrid":
        """The grid for these nodes; kernels without a bell occur once, not once a length."""
        count = nodes_c.size
        contrast = np.linalg.qr(np.column_stack([np.ones(count), np.eye(count)[:, : count - 1]]))[0][:, 1:]
        t = (nodes_c - nodes_c.mean()) / SCALE_C
        straight = contrast.T @ np.outer(t, t) @ contrast
        bells = np.stack([contrast.T @ _bell(nodes_c, nodes_c, length_c) @ contrast for length_c in LENGTHS_C])
        scales = np.trace(straight) / np.trace(bells, axis1=1, axis2=2)
        amplitudes, lengths = range(len(AMPLITUDES_ARCSEC)), range(len(LENGTHS_C))
        choice = [(i, j, k) for i, j, k in product(amplitudes, amplitudes, lengths) if j > 0 or k == 0]
        amplitude = np.array(AMPLITUDES_ARCSEC)
        chosen = np.array(choice)
        linear = amplitude[chosen[:, 0]] ** 2
        bell = amplitude[chosen[:, 1]] ** 2 * scales[chosen[:, 2]]
        contrasted = linear[:, None, None] * straight + bell[:, None, None] * bells[chosen[:, 2]]
        return KernelGrid(
            nodes_c=nodes_c,
            contrast=contrast,
            linear=linear,
            bell=bell,
            length=chosen[:, 2],
            choice=chosen,
            contrasted=contrasted,
            root=covariance_root(contrasted),
        )

    def from_node_mean(self, one_c: Floats, weights: Floats) -> tuple[Floats, Floats]:
        """Covariances of f(T) - mean f(nodes) under sums of kernels, `weights` [sums, kernels].

        With the contrasts [sums, one, m - 1], and with itself [sums, one, one].
        """
        part_of: Floats = np.column_stack(
            [self.linear, *(np.where(self.length == index, self.bell, 0.0) for index in range(len(LENGTHS_C)))]
        )
        at_nodes = self._parts(self.nodes_c, self.nodes_c)
        across, own = self._parts(one_c, self.nodes_c), self._parts(one_c, one_c)
        mean = across.mean(axis=2)
        own = own - mean[:, :, None] - mean[:, None, :] + at_nodes.mean(axis=(1, 2))[:, None, None]
        reach = (across - at_nodes.mean(axis=1)[:, None, :]) @ self.contrast
        shares = weights @ part_of
        return np.einsum("sp,pij->sij", shares, reach), np.einsum("sp,pij->sij", shares, own)

    def _parts(self, one_c: Floats, other_c: Floats) -> Floats:
        """The straight line and the bell of each length, [1 + lengths, one, other]."""
        middle_c = self.nodes_c.mean()
        straight = np.outer(one_c - middle_c, other_c - middle_c) / SCALE_C**2
        return np.stack([straight, *(_bell(one_c, other_c, length_c) for length_c in LENGTHS_C)])


def _bell(one_c: Floats, other_c: Floats, length_c: float) -> Floats:
    return np.exp(-(np.subtract.outer(one_c, other_c) ** 2) / (2.0 * length_c**2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContrastLikelihood:
    """A likelihood with the constant of each coefficient integrated out (flat prior)."""

    precision: Floats
    """[orders or 1, 2 (m - 1), 2 (m - 1)] in contrasts z of the nodes' values, cos before sin."""
    information: Floats
    """[orders, 2 (m - 1)]."""
    constant_covariance: Floats
    """[orders or 1, 2, 2]: of the constants (cos, sin) given the contrasts."""
    constant: Floats
    """[orders, 2]: their mean where all contrasts are 0."""
    constant_slope: Floats
    """[orders or 1, 2, 2 (m - 1)]: by how much it falls for each contrast."""

    @staticmethod
    def of(likelihood: CoefficientLikelihood, contrast: Floats) -> "ContrastLikelihood":
        """Complete the square in the constants."""
        ones = np.kron(np.eye(2), np.ones((contrast.shape[0], 1)))
        both = np.kron(np.eye(2), contrast)
        by_constant = likelihood.precision @ ones
        covariance: Floats = np.linalg.inv(ones.T @ by_constant).astype(np.float64)
        slope = covariance @ (by_constant.swapaxes(1, 2) @ both)
        constant = (covariance @ (likelihood.information @ ones)[:, :, None])[:, :, 0]
        precision = both.T @ likelihood.precision @ both - (both.T @ by_constant) @ slope
        information = likelihood.information @ both - ((both.T @ by_constant) @ constant[:, :, None])[:, :, 0]
        return ContrastLikelihood(
            precision=precision,
            information=information,
            constant_covariance=covariance,
            constant=constant,
            constant_slope=slope,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelMixture:
    """Every kernel's weight for every harmonic; from them the contrasts' posterior under each."""

    grid: KernelGrid
    likelihood: ContrastLikelihood
    weight: Floats
    """[orders, kernels], rows sum to 1."""
    log_evidence: float
    """Of the whole campaign with the shares as found, up to a constant of the campaign."""

    def prior_covariance(self) -> Floats:
        """The mixture's prior covariance of one component's contrasts, [orders, m - 1, m - 1]."""
        return np.tensordot(self.weight, self.grid.contrasted, axes=1)

    def means(self) -> Floats:
        """The contrasts' posterior mean, [orders, kernels, 2 (m - 1)]; 0 for kernels without weight.

        Not kept with the weights: coupled harmonics weigh the kernels many times and ask for the mean once.
        """
        counted = self.weight.max(axis=0) > 0.0
        roots = _for_both(self.grid.root[counted])
        projected = np.einsum("gik,ni->ngk", roots, self.likelihood.information)
        solved = np.linalg.solve(_inner(self.likelihood, roots), projected[..., None])[..., 0]
        mean = np.zeros((*self.weight.shape, self.likelihood.information.shape[1]))
        mean[:, counted] = np.einsum("gik,ngk->ngi", roots, solved)
        return mean

    def covariances(self, kernels: Integers) -> Floats:
        """The contrasts' posterior covariance under some kernels, [orders or 1, kernels, 2 (m - 1), 2 (m - 1)]."""
        roots = _for_both(self.grid.root[kernels])
        return roots @ np.linalg.inv(_inner(self.likelihood, roots)) @ roots.swapaxes(1, 2)


def weigh_kernels(likelihood: CoefficientLikelihood, grid: KernelGrid) -> KernelMixture:
    """All kernels, weighed by exact evidence and by shares common to the harmonics."""
    contrasts = ContrastLikelihood.of(likelihood, grid.contrast)
    weight, log_evidence = _shares(_log_likelihood(contrasts, grid), grid.choice)
    counted = weight.max(axis=0) > NEGLIGIBLE_WEIGHT
    weight = np.where(counted, weight, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    return KernelMixture(grid=grid, likelihood=contrasts, weight=weight, log_evidence=log_evidence)


def _inner(likelihood: ContrastLikelihood, roots: Floats) -> Floats:
    """1 + R'PR of each kernel, [orders or 1, kernels, 2 (m - 1), 2 (m - 1)]."""
    return np.eye(roots.shape[1]) + roots.swapaxes(1, 2) @ likelihood.precision[:, None] @ roots


def _log_likelihood(likelihood: ContrastLikelihood, grid: KernelGrid) -> Floats:
    """w'M⁻¹w / 2 - log|M| / 2 of M = 1 + R'PR and w = R'q of every kernel R R', [orders, kernels].

    One Cholesky decomposition of M bordered by the vectors w gives both: the border of the factor is L⁻¹w. Only
    kernels without a straight line are decomposed. A line is one more vector u for either component: with V = R'Pu
    beside w in the border, s = u'Pu - V'M⁻¹V and d = u'q - V'M⁻¹w are what the bells leave of it, and an amplitude
    s₁ adds d'(s₁⁻² + s)⁻¹d / 2 - log|1 + s₁² s| / 2.
    """
    lines = np.array(AMPLITUDES_ARCSEC) ** 2
    roots = _for_both(grid.root[: grid.linear.size // lines.size])
    line = np.kron(np.eye(2), (grid.contrast.T @ (grid.nodes_c / SCALE_C))[:, None])
    inner = _inner(likelihood, roots)
    blocks, kernels, size, _ = inner.shape
    # Where one precision stands for all orders, all their vectors stand in one border.
    information = likelihood.information.reshape(blocks, -1, size)
    count = information.shape[1]
    of_line = line.T @ likelihood.precision
    vectors = np.concatenate([information, of_line], axis=1)[:, None] @ roots
    bordered = np.zeros((blocks, kernels, size + count + 2, size + count + 2))
    bordered[:, :, :size, :size] = inner
    bordered[:, :, size:, :size] = vectors
    # M is 1 or more, so the corner stays positive; what it is does not reach the border.
    corner = np.sum(vectors**2, axis=(2, 3)) + 1.0
    bordered[:, :, range(size, size + count + 2), range(size, size + count + 2)] = corner[..., None]
    factor = np.linalg.cholesky(bordered)
    diagonal = np.diagonal(factor[:, :, :size, :size], axis1=2, axis2=3)
    border, of_border = factor[:, :, size : size + count, :size], factor[:, :, size + count :, :size]
    gain = np.sum(border**2, axis=3) / 2.0 - np.sum(np.log(diagonal), axis=2)[..., None]
    left, turn = np.linalg.eigh((of_line @ line)[:, None] - of_border @ of_border.swapaxes(2, 3))
    moved = ((information @ line)[:, None] - border @ of_border.swapaxes(2, 3)) @ turn
    grown = 1.0 + lines[:, None, None, None] * np.maximum(left, 0.0)
    by_line = np.sum(lines[:, None, None, None, None] * moved**2 / grown[:, :, :, None], axis=4) / 2.0
    value = gain + by_line - np.sum(np.log(grown), axis=3)[..., None] / 2.0
    return value.transpose(1, 3, 0, 2).reshape(blocks * count, -1)


def _for_both(one: Floats) -> Floats:
    """[kernels, i, j] as a block for cos and the same for sin, [kernels, 2 i, 2 j]."""
    kernels, rows, columns = one.shape
    result = np.zeros((kernels, 2 * rows, 2 * columns))
    result[:, :rows, :columns] = result[:, rows:, columns:] = one
    return result


def covariance_root(covariance: Floats) -> Floats:
    """L with L L' = covariance, also where it is singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def _shares(log_likelihood: Floats, choice: Integers) -> tuple[Floats, float]:
    """Each kernel's weight [orders, kernels] and the log evidence summed over the harmonics."""
    counts = [np.full(len(AMPLITUDES_ARCSEC), PRESENT_PSEUDO_COUNT) for _ in range(2)]
    counts[0][0] = counts[1][0] = ABSENT_PSEUDO_COUNT
    counts.append(np.full(len(LENGTHS_C), LENGTH_PSEUDO_COUNT))
    with_length = choice[:, 1] > 0
    shares = [count / count.sum() for count in counts]
    weight, log_evidence = np.empty_like(log_likelihood), 0.0
    for _ in range(EVIDENCE_STEPS):
        log_prior = np.log(shares[0][choice[:, 0]]) + np.log(shares[1][choice[:, 1]])
        log_prior += np.where(with_length, np.log(shares[2][choice[:, 2]]), 0.0)
        joint = log_likelihood + log_prior
        largest = joint.max(axis=1, keepdims=True)
        weight = np.exp(joint - largest)
        total = weight.sum(axis=1, keepdims=True)
        weight /= total
        log_evidence = float(np.sum(largest + np.log(total)))
        by_kernel = weight.sum(axis=0)
        for part, count in enumerate(counts):
            used = by_kernel if part < 2 else by_kernel * with_length
            seen = count + np.bincount(choice[:, part], weights=used, minlength=count.size)
            shares[part] = seen / seen.sum()
    return weight, log_evidence
