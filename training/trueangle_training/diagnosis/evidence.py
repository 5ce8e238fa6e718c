"""How much better each shape explains the errors than noise does: integrated Bayes factors of Gaussian blocks.

A block is a hypothesis with its main columns M and its wiggle columns W. After whitening and after all that is
re-calibrated has been projected out, it is scaled so that its visible RMS is that of the noise; its coefficients
then have the prior N(0, tau^2), those of the wiggle N(0, (tau epsilon)^2). With B = [M, W epsilon],
A = B'B = U diag(l) U', b = B'e and g = U'b the log Bayes factor against noise alone is

    sum_i [ -1/2 log(1 + tau^2 l_i) + 1/2 tau^2 g_i^2 / (1 + tau^2 l_i) ],

averaged over a grid of tau. What is accepted already stays as a Gaussian term: A and b are conditional on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.cleaning import orthonormal
from trueangle_training.diagnosis.noise import NoiseModel
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

TAUS = np.array([0.07, 0.14, 0.28, 0.56, 1.1, 2.2, 4.5, 9.0, 18.0])
"""Visible RMS over the noise of one reading."""
LEAST_VISIBLE = 0.01
"""Share of a shape's energy that must be left after re-calibration; below it the plan cannot see the shape."""
LARGEST_WIGGLE = 6.0
"""Mean square of the wiggle's over that of the main coefficients: beyond it the wiggle would be the effect."""
LARGEST_BEND = 0.5
"""Expected energy of the wiggle over that of the main columns."""
COLOUR_DOUBT = 0.35
"""Standard deviation of the logarithm of the noise power at low frequencies: 20 runs know it no better."""
SINGLE_PRECISION_BEYOND = 4_000_000
"""Elements of the columns."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accepted:
    """A block that is part of the explanation, with its prior size."""

    block: int
    tau: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scores:
    """Log evidence of every block, given what is accepted; -inf where a block is barred."""

    log_evidence: Floats
    """[blocks], averaged over tau."""
    tau: Floats
    """[blocks], the likeliest."""
    over_colour: Floats
    """[blocks], nats: of patterns drawn in each run, how much better than noise of another colour; others: inf."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Posterior of all accepted blocks together."""

    columns: Integers
    """Of `Evidence.columns`, those of the accepted blocks in their order."""
    coefficients: Floats
    """[columns], in the scaled units of the blocks."""
    covariance: Floats
    energy_left: Floats
    """Energy of the whitened residual, a scalar array."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """All visible blocks of a problem, whitened and scaled, and their products, kept for every question."""

    columns: NDArray[np.floating]
    """[all columns, rows]: whitened, not projected; scaled, wiggles by epsilon too."""
    nuisance: NDArray[np.floating]
    """[rank, rows]: orthonormal."""
    inside: NDArray[np.floating]
    """[rank, all columns]: products of nuisance and columns."""
    error: Floats
    """[rows]: whitened, projected."""
    score: Floats
    """[all columns]: products of columns and error."""
    hypothesis: Integers
    """[blocks]: index of the hypothesis in the problem."""
    start: Integers
    """[blocks]: first column."""
    mains: Integers
    """[blocks]: number of main columns."""
    width: Integers
    """[blocks]: number of all columns."""
    scale: Floats
    """[all columns]: a coefficient of the scaled column times this is one of the hypothesis's."""
    visible: Floats
    """[blocks]: share of the energy of the main columns that re-calibration leaves."""
    drawn: NDArray[np.bool_]
    """[blocks]: drawn anew in each run, and so alike to noise that was taken for too small there."""
    reach: Floats
    """[blocks]: of what happens in some runs, share of the readings that these runs have; else 1."""
    groups: tuple[tuple[Integers, Integers], ...]
    """Blocks of one width, and their columns [blocks, width]."""
    grams: tuple[Floats, ...]
    """[blocks, width, width] of each group."""
    products: dict[int, Floats] = field(default_factory=dict[int, Floats])
    """Of a block that was accepted once: [its columns, all columns] of products after projection."""
    scored: dict[tuple[Accepted, ...], Scores] = field(default_factory=dict["tuple[Accepted, ...]", Scores])
    """Beside what was accepted: asked again when a member is weighed, pruned or compared with its rivals."""

    def column_range(self, block: int) -> Integers:
        """Columns of one block."""
        return np.arange(self.start[block], self.start[block] + self.width[block])

    def product(self, block: int) -> Floats:
        """[columns of the block, all columns]."""
        if block not in self.products:
            own = self.column_range(block)
            crude = self.columns[own] @ self.columns.T - self.inside[:, own].T @ self.inside
            self.products[block] = crude.astype(np.float64)
        return self.products[block]


def evidence_of(
    problem: Problem, noise: NoiseModel, error_arcsec: Floats, transformed: NDArray[np.floating]
) -> Evidence:
    """Whiten, project and scale.

    `error_arcsec` are the cleaned errors, `transformed` is [all columns, rows]: `stacked_columns` in the run-wise
    cosine transform.
    """
    rows = len(problem)
    kind = transformed.dtype
    nuisance = orthonormal(noise.whiten(problem.nuisance()))
    error = noise.whiten(error_arcsec)
    error = error - nuisance @ (nuisance.T @ error)
    columns = noise.whiten_stacked(transformed)
    basis = np.ascontiguousarray(nuisance.T.astype(kind))
    inside = basis @ columns.T
    mains = np.array([each.main.shape[1] for each in problem.hypotheses], dtype=np.int64)
    width = np.array([each.main.shape[1] + each.wiggle.shape[1] for each in problem.hypotheses], dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(width)[:-1]]).astype(np.int64) if width.size else width
    whole = np.einsum("ij,ij->i", columns, columns, dtype=np.float64)
    left = np.maximum(whole - np.einsum("ij,ij->j", inside, inside, dtype=np.float64), 0.0)
    scale = np.ones(columns.shape[0])
    visible = np.zeros(mains.size)
    for block, each in enumerate(problem.hypotheses):
        first, last = start[block], start[block] + mains[block]
        seen, all_of_it = float(left[first:last].sum()), float(whole[first:last].sum())
        if all_of_it <= 0 or seen <= 0:
            continue
        visible[block] = seen / all_of_it
        size = np.sqrt(rows / seen)
        scale[first:last] = size
        end = start[block] + width[block]
        scale[last:end] = size * each.wiggle_size
        # In units of its own a wiggle may be of any size; bent by more than itself the shape is another one.
        bent = float(left[last:end].sum()) * (size * each.wiggle_size) ** 2
        if bent > LARGEST_BEND * rows:
            scale[last:end] *= np.sqrt(LARGEST_BEND * rows / bent)
    kept = np.flatnonzero(visible >= LEAST_VISIBLE)
    columns *= scale.astype(kind)[:, None]
    inside *= scale.astype(kind)[None, :]
    score = (columns @ error.astype(kind)).astype(np.float64)
    groups: list[tuple[Integers, Integers]] = []
    grams: list[Floats] = []
    for each in np.unique(width[kept]):
        blocks = np.flatnonzero(width[kept] == each)
        index = start[kept][blocks][:, None] + np.arange(each)
        groups.append((blocks, index))
        grams.append(_grams(columns, inside, index))
    return Evidence(
        columns=columns,
        nuisance=basis,
        inside=inside,
        error=error,
        score=score,
        hypothesis=kept,
        start=start[kept],
        mains=mains[kept],
        width=width[kept],
        scale=scale,
        visible=visible[kept],
        drawn=np.array([problem.hypotheses[i].nature is Nature.RANDOM for i in kept], dtype=bool),
        reach=np.array(
            [
                # The transform and the whitening of a run fill it, and leave the other runs at 0.
                float(np.mean(columns[start[i] : start[i] + mains[i]].any(axis=0)))
                if problem.hypotheses[i].nature is Nature.EVENT
                else 1.0
                for i in kept
            ]
        ),
        groups=tuple(groups),
        grams=tuple(grams),
    )


def stacked_columns(problem: Problem) -> NDArray[np.floating]:
    """[all columns, rows]: main then wiggle columns of every hypothesis; many of them in single precision."""
    rows = len(problem)
    total = sum(each.main.shape[1] + each.wiggle.shape[1] for each in problem.hypotheses)
    stacked = np.empty((total, rows), dtype=np.float32 if rows * total > SINGLE_PRECISION_BEYOND else np.float64)
    at = 0
    for each in problem.hypotheses:
        for part in (each.main, each.wiggle):
            stacked[at : at + part.shape[1]] = part.T
            at += part.shape[1]
    return stacked


def _grams(columns: NDArray[np.floating], inside: NDArray[np.floating], index: Integers) -> Floats:
    """[blocks, width, width] after projection, a few blocks at a time."""
    blocks, width = index.shape
    out = np.empty((blocks, width, width))
    step = max(1, 2_000_000 // (columns.shape[1] * width))
    for first in range(0, blocks, step):
        part = index[first : first + step]
        b = columns[part]
        c = inside.T[part]
        out[first : first + step] = b @ b.transpose(0, 2, 1) - c @ c.transpose(0, 2, 1)
    return out


def scores(evidence: Evidence, accepted: Sequence[Accepted]) -> Scores:
    """Log evidence of each block beside the accepted ones."""
    if tuple(accepted) not in evidence.scored:
        evidence.scored[tuple(accepted)] = _scores(evidence, accepted)
    return evidence.scored[tuple(accepted)]


def _scores(evidence: Evidence, accepted: Sequence[Accepted]) -> Scores:
    count = evidence.hypothesis.size
    log_evidence = np.full(count, -np.inf)
    likeliest = np.full(count, TAUS[0])
    over_colour = np.full(count, np.inf)
    solved, crossed, kernel = _conditional(evidence, accepted)
    for (blocks, index), gram in zip(evidence.groups, evidence.grams, strict=True):
        a, b = gram, evidence.score[index]
        if crossed is not None and solved is not None and kernel is not None:
            c = crossed[:, index].transpose(1, 0, 2)
            k = kernel[:, index].transpose(1, 0, 2)
            a = gram - c.transpose(0, 2, 1) @ k
            b = b - np.einsum("hkc,k->hc", c, solved)
        value, tau, over = _log_bayes_factors(a, b, evidence.mains[blocks])
        log_evidence[blocks] = value
        likeliest[blocks] = tau
        over_colour[blocks] = np.where(evidence.drawn[blocks], over, np.inf)
    return Scores(log_evidence=log_evidence, tau=likeliest, over_colour=over_colour)


def _conditional(
    evidence: Evidence, accepted: Sequence[Accepted]
) -> tuple[Floats | None, Floats | None, Floats | None]:
    """Solved score of the accepted columns, their products with all columns, and these solved."""
    if not accepted:
        return None, None, None
    own = np.concatenate([evidence.column_range(each.block) for each in accepted])
    crossed = np.concatenate([evidence.product(each.block) for each in accepted])
    precision = crossed[:, own] + np.diag(_prior_precision(evidence, accepted))
    both = np.linalg.solve(precision, np.column_stack([evidence.score[own], crossed]))
    return np.asarray(both[:, 0], dtype=np.float64), crossed, np.asarray(both[:, 1:], dtype=np.float64)


def _prior_precision(evidence: Evidence, accepted: Sequence[Accepted]) -> Floats:
    return np.concatenate([np.full(evidence.width[each.block], each.tau**-2) for each in accepted])


def _log_bayes_factors(gram: Floats, score: Floats, mains: Integers) -> tuple[Floats, Floats, Floats]:
    """Averaged over tau; the likeliest tau; the average over that of noise of another colour. Shapes [blocks].

    A pattern drawn anew in each run raises the noise power of its columns by 1 + tau^2 l and nothing else, and so
    does a colour that was estimated too small: the last value weighs the two against each other.
    """
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    g = np.einsum("hij,hi->hj", vectors, score)
    tau2 = (TAUS**2)[:, None, None]
    shrunk = 1.0 + tau2 * values
    log_bf = np.sum(-0.5 * np.log(shrunk) + 0.5 * tau2 * g**2 / shrunk, axis=2)
    main = np.arange(gram.shape[1])[None, :] < mains[:, None]
    if not main.all():
        coefficient = (vectors @ (tau2 * g / shrunk).transpose(1, 2, 0)).transpose(2, 0, 1) ** 2
        main_square = np.sum(coefficient * main, axis=2) / mains
        wiggles = np.maximum(gram.shape[1] - mains, 1)
        wiggle_square = np.sum(coefficient * ~main, axis=2) / wiggles
        log_bf = np.where(wiggle_square > LARGEST_WIGGLE * main_square, -np.inf, log_bf)
    best = np.argmax(log_bf, axis=0)
    top = log_bf[best, np.arange(best.size)]
    safe = np.where(np.isfinite(top), top, 0.0)
    averaged = safe + np.log(np.mean(np.exp(log_bf - safe), axis=0) + 1e-300)
    power = np.log1p(tau2[:, :, 0] * np.mean(values, axis=1)[None, :])
    doubt = -0.5 * (power / COLOUR_DOUBT) ** 2
    doubt -= doubt.max(axis=0)
    doubt -= np.log(np.sum(np.exp(doubt), axis=0))
    colour = safe + np.log(np.sum(np.exp(log_bf - safe + doubt), axis=0) + 1e-300)
    return np.where(np.isfinite(top), averaged, -np.inf), TAUS[best], averaged - np.maximum(colour, 0.0)


def joint_log_evidence(evidence: Evidence, accepted: Sequence[Accepted]) -> float:
    """Log Bayes factor of all accepted blocks together against noise alone, each with its own prior size."""
    if not accepted:
        return 0.0
    own = np.concatenate([evidence.column_range(each.block) for each in accepted])
    gram = np.concatenate([evidence.product(each.block) for each in accepted])[:, own]
    prior = _prior_precision(evidence, accepted)
    precision = gram + np.diag(prior)
    score = evidence.score[own]
    volume = float(np.linalg.slogdet(precision)[1] - np.sum(np.log(prior)))
    return 0.5 * (float(score @ np.linalg.solve(precision, score)) - volume)


def fit(evidence: Evidence, accepted: Sequence[Accepted]) -> Fit:
    """Posterior of the accepted blocks' coefficients."""
    energy = float(evidence.error @ evidence.error)
    if not accepted:
        return Fit(
            columns=np.empty(0, dtype=np.int64),
            coefficients=np.empty(0),
            covariance=np.empty((0, 0)),
            energy_left=np.array(energy),
        )
    own = np.concatenate([evidence.column_range(each.block) for each in accepted])
    gram = np.concatenate([evidence.product(each.block) for each in accepted])[:, own]
    covariance = np.asarray(np.linalg.inv(gram + np.diag(_prior_precision(evidence, accepted))), dtype=np.float64)
    coefficients = covariance @ evidence.score[own]
    left = energy - 2.0 * float(coefficients @ evidence.score[own]) + float(coefficients @ gram @ coefficients)
    return Fit(columns=own, coefficients=coefficients, covariance=covariance, energy_left=np.array(max(left, 0.0)))
