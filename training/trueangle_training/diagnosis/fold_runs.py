"""Selections that did not see a fold, and what is left on it before and after what they found."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.fold_attribution import Competition, FoundShape, found_without
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    Fold,
    HeldOut,
    calibrated,
    one_fold,
    recalibration_columns,
)
from trueangle_training.diagnosis.run_draws import predicted_draws

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoldRun:
    """What attributions found that did not see the fold they are asked for."""

    mean_curve: Floats
    """[readings], each from the fold that left it out: effects with one curve for all runs."""
    drawn_curve: Floats
    """[readings]: effects drawn in each run, half a run from its other half."""
    before: HeldOut
    after: HeldOut
    found_in_fold: tuple[Mapping[str, Floats], ...]
    """For each fold: effect to [readings], its mean curve."""


def fold_run(rivals: Competition, folds: tuple[Fold, ...], noise_arcsec2: float) -> FoldRun:
    """Selections without each fold. Any library effect counts that a fold names: a class-mate does as well."""
    problem = rivals.problem
    size = len(problem)
    mean_curve, drawn_curve = np.zeros(size), np.zeros(size)
    before, after = (
        HeldOut(residual_arcsec=np.zeros(size), freedom=np.zeros(size), inflation=np.zeros(size)) for _ in range(2)
    )
    group = problem.conditions.zero_group
    columns = recalibration_columns(problem)
    found_in_fold: list[Mapping[str, Floats]] = []
    for fold in folds:
        out = fold.left_out
        shapes = found_without(rivals, out)
        by_effect: dict[str, Floats] = {}
        for each in shapes:
            if not each.drawn:
                curve = problem.curve(each.hypothesis_index, each.coefficients)
                by_effect[each.effect] = by_effect.get(each.effect, 0.0) + curve
        found = sum(by_effect.values(), np.zeros(size))
        draws = _draws_in_fold(problem, shapes, found, columns, out, noise_arcsec2)
        mean_curve[out], drawn_curve[out] = found[out], draws[out]
        found_in_fold.append(by_effect)
        for held, values in ((before, problem.error_arcsec), (after, problem.error_arcsec - found - draws)):
            held.residual_arcsec[out], held.freedom[out], held.inflation[out] = one_fold(
                values, columns, group, out
            )
    return FoldRun(
        mean_curve=mean_curve,
        drawn_curve=drawn_curve,
        before=before,
        after=after,
        found_in_fold=tuple(found_in_fold),
    )


def _draws_in_fold(
    problem: Problem,
    shapes: Sequence[FoundShape],
    found: Floats,
    columns: Floats,
    out: Mask,
    noise_arcsec2: float,
) -> Floats:
    """[readings]: effects drawn in each run, told within the held-out runs; as fitted in all others."""
    draws = np.zeros(len(problem))
    drawn: dict[str, list[FoundShape]] = {}
    for each in shapes:
        if each.drawn:
            drawn.setdefault(each.effect, []).append(each)
            draws += problem.curve(each.hypothesis_index, each.coefficients)
    if not drawn:
        return draws
    left = problem.error_arcsec - found
    left = left - columns @ calibrated(left - draws, columns, problem.conditions.zero_group, ~out)
    draws[out] = 0.0
    for effect, own in drawn.items():
        draws += predicted_draws(
            problem,
            left,
            effect,
            out,
            draw_arcsec2=_size_of_draw(problem, own, ~out),
            noise_arcsec2=noise_arcsec2,
        )
    return draws


def _size_of_draw(problem: Problem, shapes: Sequence[FoundShape], inside: Mask) -> float:
    """Mean square of an effect's curve over the readings of the training runs that have it, arcsec^2."""
    curve = np.sum([problem.curve(each.hypothesis_index, each.coefficients)[inside] for each in shapes], axis=0)
    index = np.unique(problem.conditions.run[inside], return_inverse=True)[1]
    count = np.bincount(index)
    mean = np.bincount(index, weights=curve) / count
    square = np.bincount(index, weights=(curve - mean[index]) ** 2) / count
    return float(np.mean(square[square > 1e-3 * float(square.max(initial=0.0))])) if square.any() else 1e-12
