"""The estimate of closure from the posterior: loss and structure, and draws of both for the interval.

    closure = 1 - loss / structure
    structure = |f|^2 + tr V + rest
    loss = |f_fold - f|^2 + tr V + rest

f is the found curve outside the re-calibrated span, V its posterior covariance, f_fold the curve that a selection
found which had not seen the fold, and rest what other members explain or no member does beyond the noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.attribution import Attribution, Member
from trueangle_training.diagnosis.fold_attribution import DRAWN
from trueangle_training.diagnosis.fold_runs import FoldRun
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import Projector
from trueangle_training.diagnosis.shares import Shares

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

DRAWS = 400
UNSEEN_REST = 2.0
"""Expected structure, in noise variances of one reading, that is too small to be found by evidence."""
SHAPE_ERROR = 0.015
"""Mean part of the structure that a right name's shape misses; on the development plant 0.001 to 0.1."""
REST_DEVIATIONS = 2.0
KNOWN_NOISE = 0.2
"""Relative uncertainty of the noise model's own level: heavy tails and bursts shift it by 10 to 20 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The named members as columns outside the re-calibrated span."""

    members: tuple[Member, ...]
    columns: tuple[Floats, ...]
    """Of each member: [readings, coefficients]."""
    curve: Floats
    """[readings]: their sum."""
    rest: float
    """Energy of other members, and what is left beyond noise and chance, arcsec^2."""
    rest_deviation: float
    noise: float

    @property
    def covariance(self) -> Floats:
        """[coefficients, coefficients] of all members, block by block."""
        sizes = [member.coefficients.size for member in self.members]
        full = np.zeros((sum(sizes), sum(sizes)))
        at = 0
        for member, size in zip(self.members, sizes, strict=True):
            full[at : at + size, at : at + size] = member.covariance
            at += size
        return full

    @property
    def spread(self) -> float:
        """tr V: expected square of the curve's error."""
        return float(sum(np.sum((c @ m.covariance) * c) for c, m in zip(self.columns, self.members, strict=True)))

    @property
    def structure(self) -> float:
        """Energy of all structure, arcsec^2 summed over the readings."""
        return float(self.curve @ self.curve) + self.spread + self.rest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Posterior and bootstrap draws, shape [draws]."""

    closure: Floats
    weight: Floats
    """[draws, readings' runs]: how often each run was drawn."""
    error: Floats
    """[draws, coefficients]"""
    rest: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """Loss and structure by runs."""

    parts: Parts
    moved: Floats
    """[readings]: what the mean curve moved when the fold was left out, outside the span."""
    drawn_energy: Floats
    """[readings]: square of the drawn part of the found curve."""
    drawn_gain: Floats
    """[readings]: what the drawn part gains when half a run is told from the other half."""
    run: Integers
    asked: float
    """Part of the readings that some fold left out."""

    @staticmethod
    def of(problem: Problem, parts: Parts, folded: FoldRun, span: Projector) -> "Estimate":
        is_drawn = [problem.hypotheses[m.hypothesis_index].nature in DRAWN for m in parts.members]
        zero = np.zeros(len(problem))
        mean, drawn = (
            sum(
                (
                    columns @ member.coefficients
                    for columns, member, each in zip(parts.columns, parts.members, is_drawn, strict=True)
                    if each is wanted
                ),
                zero,
            )
            for wanted in (False, True)
        )
        known = folded.before.known
        moved = np.where(known, span.outside(np.where(known, folded.mean_curve, mean)) - mean, 0.0)
        told = span.outside(folded.drawn_curve)
        # 2 f.y - f^2 is the gain in squares; the found curve, which has less noise, stands for y.
        gain = 2.0 * told * drawn - told**2 if any(is_drawn) else zero
        return Estimate(
            parts=parts,
            moved=moved,
            drawn_energy=drawn**2,
            drawn_gain=gain,
            run=np.unique(problem.conditions.run, return_inverse=True)[1].astype(np.int64),
            asked=float(np.mean(known)),
        )

    def closure(self) -> float:
        """The estimate."""
        parts = self.parts
        lost = float(self.moved @ self.moved) / self.asked + parts.spread + parts.rest
        lost += float(np.sum(self.drawn_energy) - np.sum(self.drawn_gain))
        return float(np.clip(1.0 - lost / parts.structure, 0.0, 1.0))

    def draws(self, rng: np.random.Generator) -> Draws:
        """Coefficients from their posterior, runs with replacement."""
        parts = self.parts
        runs = int(self.run.max()) + 1
        weight = rng.multinomial(runs, np.full(runs, 1.0 / runs), size=DRAWS).astype(np.float64)
        covariance = parts.covariance
        spread, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(spread, 0.0))
        error = rng.normal(size=(DRAWS, covariance.shape[0])) @ root.T
        columns = np.concatenate(parts.columns, axis=1)
        gram, cross = columns.T @ columns, columns.T @ parts.curve
        off = np.einsum("bi,ij,bj->b", error, gram, error)
        energy = float(parts.curve @ parts.curve) + 2.0 * error @ cross + off
        # Every other draw takes the shape for exact and all runs for seen: then coefficients alone are uncertain.
        doubt = rng.integers(0, 2, size=DRAWS)
        unseen = parts.noise * UNSEEN_REST + SHAPE_ERROR * parts.structure
        rest = parts.rest + doubt * unseen * rng.exponential(size=DRAWS)
        rest = np.maximum(0.0, rest + parts.rest_deviation * rng.normal(size=DRAWS))
        by_run = np.bincount(self.run, weights=self.moved**2 + self.drawn_energy - self.drawn_gain)
        # What moves without a fold is partly due to the smaller training set alone, and nobody knows how far.
        part = rng.integers(0, 2, size=DRAWS) * rng.uniform(size=DRAWS)
        lost = part * (weight @ by_run) + off + rest
        structure = np.maximum(energy, 0.0) + rest
        closure = np.clip(1.0 - lost / np.maximum(structure, 1e-300), 0.0, 1.0)
        return Draws(closure=closure, weight=weight, error=error, rest=rest)


def parts_of(
    problem: Problem, attribution: Attribution, named: tuple[Member, ...], span: Projector, shares: Shares
) -> Parts:
    noise = shares.floor.variance_arcsec2
    columns = {id(member): span.outside(_columns(problem, member)) for member in attribution.members}
    curves = {id(member): columns[id(member)] @ member.coefficients for member in attribution.members}
    counted = {id(member) for member in named}
    others = sum((curve for key, curve in curves.items() if key not in counted), np.zeros(len(problem)))
    # Whitened, because slow noise is no structure, however large its square.
    freedom = max(1.0, float(len(problem) - span.rank))
    deviation = float(np.sqrt(2.0 / freedom + KNOWN_NOISE**2))
    excess = attribution.residual_energy - 1.0
    unexplained = freedom * noise * excess if excess > REST_DEVIATIONS * deviation else 0.0
    return Parts(
        members=named,
        columns=tuple(columns[id(member)] for member in named),
        curve=sum((curves[id(member)] for member in named), np.zeros(len(problem))),
        rest=float(others @ others) + unexplained,
        rest_deviation=freedom * noise * deviation if unexplained > 0.0 else 0.0,
        noise=noise,
    )


def _columns(problem: Problem, member: Member) -> Floats:
    shape = problem.hypotheses[member.hypothesis_index]
    return np.column_stack([shape.main, shape.wiggle])
