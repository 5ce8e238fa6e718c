"""Two controls beside the closure: what any smooth function could close, and what effects drawn by chance do."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    Fold,
    HeldOut,
    held_out,
    less_group_mean,
    one_fold,
    recalibration_columns,
)
from trueangle_training.diagnosis.shares import saturated_columns
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RIDGES = tuple(10.0 ** (0.5 * k) for k in range(-6, 9))
"""Noise variance over the variance of a coefficient of a column with mean square 1."""
LEAST_SIZE = 1e-9
BELLS = 7
BELL_ORDERS = 8


def black_box(problem: Problem, folds: tuple[Fold, ...]) -> HeldOut:
    """Held-out residual of a ridge regression on smooth functions of all conditions, beside the modelled effects.

    The ridge is chosen on the training runs by generalised cross-validation (Golub, Heath and Wahba 1979).
    """
    free = recalibration_columns(problem)
    bent = np.column_stack([saturated_columns(problem, own_run=False), _free_over_temperature(problem)])
    group = problem.conditions.zero_group
    residual, freedom, inflation = (np.zeros(len(problem.conditions)) for _ in range(3))
    for fold in folds:
        inside = ~fold.left_out
        predicted = _ridge(problem.error_arcsec, free, bent, group, inside)
        values, allowed, _ = one_fold(problem.error_arcsec - predicted, free[:, :0], group, fold.left_out)
        residual[fold.left_out], freedom[fold.left_out] = values, allowed
    return HeldOut(residual_arcsec=residual, freedom=freedom, inflation=inflation)


def _free_over_temperature(problem: Problem) -> Floats:
    """[readings, columns]: the first orders with any course over temperature, as bells at its quantiles."""
    at = problem.conditions
    temperature = at.temperature_c
    if temperature is None or float(np.ptp(temperature)) < 1.0:
        return np.zeros((len(at), 0))
    middles = np.unique(np.round(np.quantile(temperature, np.linspace(0.0, 1.0, BELLS)), 1))
    width = max(float(np.ptp(temperature)) / BELLS, 1.0)
    bells = np.exp(-0.5 * ((temperature[:, None] - middles) / width) ** 2)
    theta = np.radians(at.angle_deg)
    waves = [np.ones(theta.size), *(f(k * theta) for k in range(1, BELL_ORDERS + 1) for f in (np.cos, np.sin))]
    return (bells[:, :, None] * np.column_stack(waves)[:, None, :]).reshape(theta.size, -1)


def _ridge(error: Floats, free: Floats, bent: Floats, group: Integers, inside: NDArray[np.bool_]) -> Floats:
    """[readings]: prediction, offsets left out, of a fit to the readings inside."""
    index = np.unique(group[inside], return_inverse=True)[1].astype(np.int64)
    table = less_group_mean(np.column_stack([error, free, bent])[inside], index)
    y, known, penalised = table[:, 0], table[:, 1 : 1 + free.shape[1]], table[:, 1 + free.shape[1] :]
    size = np.sqrt(np.mean(penalised**2, axis=0))
    kept = size > LEAST_SIZE
    penalised = penalised[:, kept] / size[kept]
    of_free, *_ = np.linalg.lstsq(known, np.column_stack([y, penalised]), rcond=1e-9)
    target = y - known @ of_free[:, 0]
    design = penalised - known @ of_free[:, 1:]
    spread, vectors = np.linalg.eigh(design.T @ design)
    spread = np.maximum(spread, 0.0)
    score = vectors.T @ (design.T @ target)
    rows = y.size - int(index.max()) - 1 - free.shape[1]
    best, coefficients = np.inf, np.zeros(design.shape[1])
    for ridge in RIDGES:
        shrunk = score / (spread + ridge)
        left = float(target @ target - 2.0 * shrunk @ score + shrunk @ (spread * shrunk))
        used = float(np.sum(spread / (spread + ridge)))
        criterion = left / max(rows - used, 1.0) ** 2
        if criterion < best:
            best, coefficients = criterion, vectors @ shrunk
    of_known = of_free[:, 0] - of_free[:, 1:] @ coefficients
    return free @ of_known + (bent[:, kept] / size[kept]) @ coefficients


def chance_effects(
    problem: Problem,
    folds: tuple[Fold, ...],
    *,
    count: int,
    without: frozenset[str],
    draws: int,
    rng: np.random.Generator,
) -> float:
    """Median over draws of the held-out sum of squares after `count` shapes of the library drawn by chance.

    A shape that lives in a few runs and is fitted without them may be off a hundredfold there, and with it a mean.
    """
    shapes = [
        each
        for each in problem.hypotheses
        if each.effect is not None
        and each.effect not in without
        and each.nature is Nature.MEAN
        and each.main.shape[1] <= 4
    ]
    by_effect = sorted({each.effect for each in shapes if each.effect is not None})
    free = recalibration_columns(problem)
    group = problem.conditions.zero_group
    sums: list[float] = []
    for _ in range(draws):
        chosen = rng.choice(len(by_effect), size=min(count, len(by_effect)), replace=False) if by_effect else []
        columns = [free]
        for effect in (by_effect[i] for i in chosen):
            own = [each for each in shapes if each.effect == effect]
            columns.append(own[int(rng.integers(len(own)))].main)
        left = held_out(problem.error_arcsec, np.column_stack(columns), group, folds)
        sums.append(float(np.sum(left.residual_arcsec**2)))
    return float(np.median(sums)) if sums else 0.0
