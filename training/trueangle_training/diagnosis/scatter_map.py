"""Where the scatter differs, and whether one run, or all from one run on, are unlike the others."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from trueangle_training.diagnosis.findings import Place
from trueangle_training.diagnosis.problem import STEADY_C, Problem
from trueangle_training.effects.cells import Cell

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

PERMUTATIONS = 999
FEWEST_RUNS = 6
"""6! = 720 permutations: with fewer runs none of them is rare."""
LEVEL = 0.05
WEIGHT_OF_SCATTER = 0.2
"""Part of the level of the whole map."""
LEAST_OVER_MEDIAN = 1e-3


def scatter_places(
    problem: Problem, residual: Floats, unit: Integers, *, found_any: bool, rng: np.random.Generator
) -> list[Place]:
    """Cells of the variance: log squared residual over temperature, speed, load and angle, tested over runs.

    `residual`: [readings], of the re-calibrated simulator; where structure was found the map is not significant by
    itself, because a mean that is missing looks like scatter.
    """
    size = residual**2
    log_square = np.log(size + LEAST_OVER_MEDIAN * max(float(np.median(size)), 1e-300))
    at = problem.conditions
    cells: list[tuple[Cell, float]] = []
    covariates = (
        (Cell(order="0", temperature="linear", moment="variance"), at.temperature_c, STEADY_C),
        (Cell(order="0", speed="linear", moment="variance"), _absolute(at.velocity_deg_s), 1e-9),
        (Cell(order="0", load="linear", moment="variance"), at.load_nm, 1e-9),
    )
    for cell, values, least in covariates:
        if values is not None and float(np.ptp(values)) > least:
            p_value = _over_runs(log_square, values, unit, rng)
            if p_value is not None:
                cells.append((cell, p_value))
    theta = np.radians(at.angle_deg)
    for k in (1, 2):
        waves = np.column_stack([np.cos(k * theta), np.sin(k * theta)])
        p_value = _within_runs(log_square, waves, unit, rng)
        if p_value is not None:
            cells.append((Cell(order=str(k), moment="variance"), p_value))
    ordered = sorted(cells, key=lambda each: each[1])
    places: list[Place] = []
    largest = 0.0
    for rank, (cell, p_value) in enumerate(ordered):
        largest = min(1.0, max(largest, p_value * (len(ordered) - rank) / WEIGHT_OF_SCATTER))
        significant = largest <= LEVEL and not found_any
        places.append(Place(cell=cell, share=0.0, p_value=largest, significant=significant))
    return places


def _absolute(values: Floats | None) -> Floats | None:
    return None if values is None else np.abs(values)


def _run_means(values: Floats, unit: Integers) -> Floats:
    return np.bincount(unit, weights=values) / np.bincount(unit)


def _over_runs(log_square: Floats, values: Floats, unit: Integers, rng: np.random.Generator) -> float | None:
    """p of a slope between runs (permuted) or within runs (signs of runs flipped): the smaller one, twice."""
    candidates: list[float] = []
    x, y = _run_means(values, unit), _run_means(log_square, unit)
    if x.size >= FEWEST_RUNS and float(np.ptp(x)) > 0.1 * float(np.ptp(values)):
        x, y = x - x.mean(), y - y.mean()
        observed = abs(float(x @ y))
        drawn = np.abs(rng.permuted(np.tile(y, (PERMUTATIONS, 1)), axis=1) @ x)
        candidates.append((1.0 + float(np.sum(drawn >= observed))) / (PERMUTATIONS + 1.0))
    inside = values - _run_means(values, unit)[unit]
    if float(np.std(inside)) > 0.1 * float(np.std(values)):
        p_value = _within_runs(log_square, inside[:, None], unit, rng)
        if p_value is not None:
            candidates.append(p_value)
    return min(1.0, len(candidates) * min(candidates)) if candidates else None


def _within_runs(log_square: Floats, columns: Floats, unit: Integers, rng: np.random.Generator) -> float | None:
    """p of columns [readings, any] within runs, by flipping the signs of whole runs."""
    runs = int(unit.max()) + 1
    if runs < FEWEST_RUNS + 2:
        return None
    y = log_square - _run_means(log_square, unit)[unit]
    score = np.stack([np.bincount(unit, weights=column * y) for column in columns.T], axis=1)
    signs = rng.integers(0, 2, size=(PERMUTATIONS, runs)) * 2.0 - 1.0
    observed = float(np.sum(np.sum(score, axis=0) ** 2))
    drawn = np.sum((signs @ score) ** 2, axis=1)
    return (1.0 + float(np.sum(drawn >= observed))) / (PERMUTATIONS + 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Homogeneity:
    """Whether all runs are alike; p-values are corrected for the number of runs looked at."""

    odd_run: int
    """The run whose residual is most unlike the others'."""
    odd_p_value: float
    first_run_after_step: int
    """Where the runs' shared pattern changes most, if it changes at all."""
    step_p_value: float


def run_homogeneity(problem: Problem, residual: Floats, rng: np.random.Generator) -> Homogeneity | None:
    """One odd run (by its residual's size) and a step between runs (of orders 1 to 3); None below six runs."""
    runs, unit = np.unique(problem.conditions.run, return_inverse=True)
    if runs.size < FEWEST_RUNS:
        return None
    count = np.bincount(unit)
    level = np.log(np.maximum(np.bincount(unit, weights=residual**2) / count, 1e-300))
    others = runs.size - 1
    t_value = np.empty(runs.size)
    for i in range(runs.size):
        rest = np.delete(level, i)
        # Chi-squared scatter of a run's own mean square, lest equal runs by chance make any run odd.
        spread = np.sqrt(max(float(np.var(rest, ddof=1)), 2.0 / float(np.median(count))))
        t_value[i] = (level[i] - rest.mean()) / (spread * np.sqrt(1.0 + 1.0 / others))
    odd = int(np.argmax(t_value))
    odd_p = min(1.0, runs.size * float(special.stdtr(others - 1, -t_value[odd])))
    first, step_p = _step(problem, residual, unit.astype(np.int64), rng)
    return Homogeneity(
        odd_run=int(runs[odd]), odd_p_value=odd_p, first_run_after_step=int(runs[first]), step_p_value=step_p
    )


def _step(problem: Problem, residual: Floats, unit: Integers, rng: np.random.Generator) -> tuple[int, float]:
    """First run after the largest step of the runs' own orders 1 to 3, and its p by permuting the runs."""
    theta = np.radians(problem.conditions.angle_deg)
    count = np.bincount(unit)
    own = np.stack(
        [
            np.bincount(unit, weights=wave(k * theta) * residual) / count
            for k in (1, 2, 3)
            for wave in (np.cos, np.sin)
        ],
        axis=1,
    )
    own = (own - own.mean(axis=0)) / np.maximum(own.std(axis=0), 1e-300)
    runs = own.shape[0]
    weight = np.sqrt(runs / (np.arange(1, runs) * (runs - np.arange(1, runs))))

    def largest(values: Floats) -> tuple[int, float]:
        summed = np.cumsum(values, axis=0)[:-1] * weight[:, None]
        size = np.max(np.sum(summed.reshape(runs - 1, 3, 2) ** 2, axis=2), axis=1)
        return int(np.argmax(size)) + 1, float(size.max())

    first, observed = largest(own)
    drawn = sum(largest(own[rng.permutation(runs)])[1] >= observed for _ in range(PERMUTATIONS // 3))
    return first, (1.0 + drawn) / (PERMUTATIONS // 3 + 1.0)
