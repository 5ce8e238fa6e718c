"""How far the gap shrinks: closure on held-out readings, with the selection inside the fold.

    closure = (G1 - G2) / (G1 - F) = 1 - loss / structure

G1 - F known by subtracting a floor is wrong by 25 % where the effect is half the noise, so loss and structure are
taken from the posterior (`closure_estimate`). The interval draws the coefficients from their posterior and the
runs with replacement. G2 is then G1 - closure (G1 - F); the plain difference of held-out squares stands beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.attribution import Attribution, Member
from trueangle_training.diagnosis.black_box import black_box, chance_effects
from trueangle_training.diagnosis.closure_estimate import Draws, Estimate, Parts, parts_of
from trueangle_training.diagnosis.findings import Step
from trueangle_training.diagnosis.fold_attribution import DRAWN, MANY_READINGS, competition
from trueangle_training.diagnosis.fold_runs import FoldRun, fold_run
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    Fold,
    HeldOut,
    Projector,
    orthonormal,
    recalibration_span,
    run_folds,
    speed_folds,
    temperature_folds,
)
from trueangle_training.diagnosis.shares import Shares

Floats = NDArray[np.float64]

LEVEL = 95.0
CHANCE_DRAWS = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutClosure:
    """Closure on one kind of fold, by the posterior and by plain held-out squares."""

    closure: float
    by_squares: float | None
    """(sum of squares before - after) / structure; noisy at small effects."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closure:
    """What the named effects close; all None or empty where no structure is significant."""

    closure: float | None = None
    interval: tuple[float, float] | None = None
    explained_arcsec2: float | None = None
    """G2"""
    ceiling: float | None = None
    random_control: float | None = None
    closes: Mapping[str, float] | None = None
    """Effect to what is lost when it alone is left out, over the structure."""
    closes_interval: Mapping[str, tuple[float, float]] | None = None
    waterfall: tuple[Step, ...] = ()
    over_temperatures: HeldOutClosure | None = None
    over_speeds: HeldOutClosure | None = None
    worse_orders: tuple[str, ...] = ()
    """Orders whose held-out energy grew significantly; "" when none did."""
    found_in_fold: tuple[Mapping[str, Floats], ...] = ()
    """For each run fold: effect to [readings], the mean curve that an attribution found without the fold."""
    notes: tuple[str, ...] = ()


def closure_of(
    problem: Problem,
    attribution: Attribution,
    *,
    named: Sequence[str],
    shares: Shares | None,
    rng: np.random.Generator,
    other_folds: bool = True,
) -> Closure:
    """`problem.error_arcsec` cleaned; `named`: effects that count, of the verdict's causes.

    Without members the gap is not significant and nothing is said; with members of which none is named, nothing is
    closed. `other_folds`: also leave out temperatures and speeds.
    """
    if shares is None or not attribution.members:
        return Closure()
    named_members = tuple(member for member in attribution.members if member.effect in named)
    floor = shares.floor.variance_arcsec2
    span = recalibration_span(problem)
    parts = parts_of(problem, attribution, named_members, span, shares)
    folds = run_folds(problem)
    names = frozenset(name for name in (member.effect for member in named_members) if name is not None)
    if not names:
        ceiling = _ceiling(problem, folds, shares.recalibrated, parts.structure, closure=0.0)
        return Closure(
            closure=0.0,
            interval=(0.0, 0.0),
            explained_arcsec2=shares.recalibrated_arcsec2,
            ceiling=ceiling,
            notes=("structure is significant but nothing is named: no part of the gap is closed",),
        )
    rivals = competition(problem, attribution)
    run = fold_run(rivals, folds, floor)
    estimate = Estimate.of(problem, parts, run, span)
    closure = estimate.closure()
    chance = chance_effects(
        problem,
        folds,
        count=len(names),
        without=names,
        draws=CHANCE_DRAWS if len(problem) < MANY_READINGS else CHANCE_DRAWS // 2,
        rng=rng,
    )
    squares_before = float(np.sum(run.before.residual_arcsec**2))
    over_temperatures = over_speeds = None
    if other_folds:
        over_temperatures, over_speeds = (
            _other(problem, fold_run(rivals, other, floor), parts, span) if other else None
            for other in (_few(temperature_folds(problem)), _few(speed_folds(problem)))
        )
    draws = estimate.draws(rng)
    closes, closes_interval = _closes(parts, estimate, draws)
    gap = max(0.0, shares.recalibrated_arcsec2 - floor)
    return Closure(
        closure=closure,
        interval=_interval(draws.closure),
        explained_arcsec2=shares.recalibrated_arcsec2 - closure * gap,
        ceiling=_ceiling(problem, folds, run.after, parts.structure, closure=closure),
        random_control=(squares_before - chance) / parts.structure,
        closes=closes,
        closes_interval=closes_interval,
        waterfall=_waterfall(parts, estimate, draws),
        over_temperatures=over_temperatures,
        over_speeds=over_speeds,
        worse_orders=_worse_orders(problem, run, floor),
        found_in_fold=run.found_in_fold,
        notes=_notes(run, parts, named_members, problem),
    )


def _few(folds: tuple[Fold, ...]) -> tuple[Fold, ...]:
    """At most three folds: leaving out an end extrapolates, a middle one interpolates; more say the same again."""
    return folds if len(folds) <= 3 else (folds[0], folds[len(folds) // 2], folds[-1])


def _interval(values: Floats) -> tuple[float, float]:
    low, high = np.percentile(values, [(100.0 - LEVEL) / 2.0, (100.0 + LEVEL) / 2.0])
    return float(low), float(high)


def _by_effect(parts: Parts) -> dict[str, list[int]]:
    """Members of each effect, the one with most energy first."""
    found: dict[str, list[int]] = {}
    energy = {}
    for i, (member, columns) in enumerate(zip(parts.members, parts.columns, strict=True)):
        name = str(member.effect)
        found.setdefault(name, []).append(i)
        curve = columns @ member.coefficients
        energy[name] = energy.get(name, 0.0) + float(curve @ curve)
    return {name: found[name] for name in sorted(found, key=lambda name: -energy[name])}


def _closes(
    parts: Parts, estimate: Estimate, draws: Draws
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """What is lost when one effect alone is left out and the others make up for it as well as they can."""
    closure = estimate.closure()
    effects = _by_effect(parts)
    lost: dict[str, float] = {}
    for name, own in effects.items():
        curve = sum((parts.columns[i] @ parts.members[i].coefficients for i in own), np.zeros(parts.curve.size))
        others = [parts.columns[i] for other, places in effects.items() if other != name for i in places]
        if others:
            basis = orthonormal(np.concatenate(others, axis=1))
            curve = curve - basis @ (basis.T @ curve)
        lost[name] = float(curve @ curve) / parts.structure
    total = sum(lost.values())
    # What the folds lose is lost to all effects alike; effects that overlap close less apart than together.
    scale = min(1.0, closure / total) if total > 0.0 else 0.0
    low, high = _interval(draws.closure)
    closes = {name: value * scale for name, value in lost.items()}
    intervals = {
        name: (value * low / max(closure, 1e-9), min(1.0, value * high / max(closure, 1e-9)))
        for name, value in closes.items()
    }
    return closes, intervals


def _waterfall(parts: Parts, estimate: Estimate, draws: Draws) -> tuple[Step, ...]:
    """Closure with the first effect, the first two, and so on; the last step is the closure itself."""
    closure = estimate.closure()
    summed = np.zeros(parts.curve.size)
    steps: list[Step] = []
    low, high = _interval(draws.closure)
    whole = max(float(parts.curve @ parts.curve), 1e-300)
    for name, own in _by_effect(parts).items():
        summed = summed + sum(parts.columns[i] @ parts.members[i].coefficients for i in own)
        left = parts.curve - summed
        part = float(np.clip(1.0 - float(left @ left) / whole, 0.0, 1.0))
        steps.append(Step(effect=name, closure=closure * part, interval=(low * part, high * part)))
    return tuple(steps)


def _ceiling(
    problem: Problem, folds: tuple[Fold, ...], named: HeldOut, structure: float, *, closure: float
) -> float:
    """Closure of a black box, told by the difference to the named effects on the same held-out readings."""
    box = black_box(problem, folds)
    difference = float(np.sum(named.residual_arcsec**2) - np.sum(box.residual_arcsec**2))
    # What the black box cannot do better the named effects show to be possible.
    return float(np.clip(max(closure, closure + difference / structure), 0.0, 1.0))


def _other(problem: Problem, run: FoldRun, parts: Parts, span: Projector) -> HeldOutClosure:
    """The same on other folds."""
    squares = float(np.sum(run.before.residual_arcsec**2) - np.sum(run.after.residual_arcsec**2))
    estimate = Estimate.of(problem, parts, run, span)
    asked = float(np.mean(run.before.known))
    return HeldOutClosure(closure=estimate.closure(), by_squares=squares / (asked * parts.structure))


def _worse_orders(problem: Problem, run: FoldRun, noise: float) -> tuple[str, ...]:
    """Orders 1 to 11 whose energy on held-out readings has grown beyond what noise may do."""
    theta = np.radians(problem.conditions.angle_deg)
    worse: list[str] = []
    for k in range(1, 12):
        columns = np.column_stack([np.cos(k * theta), np.sin(k * theta)]) / np.sqrt(theta.size / 2.0)
        before, after = (
            float(np.sum((columns.T @ held.residual_arcsec) ** 2)) for held in (run.before, run.after)
        )
        # 13.8 is passed by a chi-squared of 2 degrees of freedom once in 1000.
        if after - before > 13.8 * noise and after > 2.0 * before:
            worse.append(str(k))
    return tuple(worse)


def _notes(run: FoldRun, parts: Parts, named: tuple[Member, ...], problem: Problem) -> tuple[str, ...]:
    squares = float(np.sum(run.before.residual_arcsec**2) - np.sum(run.after.residual_arcsec**2)) / parts.structure
    notes = [f"closure is the posterior estimate; plain held-out squares, with their noise, give {squares:.3f}"]
    if any(problem.hypotheses[member.hypothesis_index].nature in DRAWN for member in named):
        notes.append(
            "an effect that is drawn anew in each run cannot be predicted for a new run: its closure is that of "
            "half a run told from the other half"
        )
    return tuple(notes)
