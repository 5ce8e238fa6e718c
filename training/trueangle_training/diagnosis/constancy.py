"""Do the re-calibrated parameters stay the same over temperature, direction, speed and runs?

A pooled fit whose parameters move with a condition is a structural gap laundered into parameters. The unit is the
run: each run gives its own amplitude of every pattern that is re-calibrated, and a linear model over runs is
compared with one that lets the amplitude move with the condition,

    F = (RSS0 - RSS1) / df  /  (RSS1 / (columns x (runs - rank1))),

which is exact for normal scatter between runs, whatever its size and whatever the noise within a run looks like.
Whether the amplitude is drawn anew in each run is judged against the amplitudes of neighbouring orders, whose
median tells the noise's colour. All p-values are Holm's.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from trueangle_training.diagnosis.findings import Drifting
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    groups_of_values,
    recalibration_span,
    temperature_of_runs,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEVEL = 0.05
FEWEST_RUNS = 6
FEWEST_FREEDOMS = 3
SAME_TEMPERATURE_C = 1.0
REFERENCE_ORDERS = (3, 4, 5, 6, 7, 8)
ORDERS_OF_RUNS = (1, 2)
UNKNOWN_TEMPERATURE_K = 0.1
"""A sensor beside the head is this far from the grating after hours of soak, for all runs at one temperature."""
LEAST_OF_LARGEST = 0.2
COLOUR_SPREAD = 0.55
"""Relative uncertainty of the level that neighbouring orders give for orders 1 and 2 under a law c/k."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstancyTest:
    """One parameter against one condition."""

    effect: str
    over: str
    """temperature, direction, speed or run"""
    p_value: float
    """Family-wise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RunPattern:
    """Own amplitudes of one pattern in each run."""

    effect: str
    amplitude: Floats
    """[runs, columns]"""
    profile: tuple[Floats, ...]
    """Of each column [runs, profiles]: how re-calibration lets it go over the runs: constant, growing with T.

    Cosine and sine have their own: a missing reading changes the size of one and not of the other.
    """
    run: Integers
    """Index of the runs that show the pattern."""


def constancy_tests(problem: Problem) -> tuple[ConstancyTest, ...]:
    """All tests that the plan allows, smallest p first; none below six runs or without a parameter."""
    runs, temperature_c = temperature_of_runs(problem)
    if runs.size < FEWEST_RUNS or problem.modelled.shape[1] == 0:
        return ()
    unit = np.searchsorted(runs, problem.conditions.run).astype(np.int64)
    conditions = _run_conditions(problem, unit, temperature_c)
    raw: list[tuple[str, str, float]] = []
    for pattern in _patterns(problem, unit):
        for over, model in conditions.items():
            unknown_k = _unknown_temperature_k(problem) if over == "temperature" else 0.0
            p_value = _f_test(pattern, model, temperature_c, unknown_k)
            if p_value is not None:
                raw.append((pattern.effect, over, p_value))
    raw += _between_runs(problem, unit)
    raw.sort(key=lambda each: each[2])
    tests: list[ConstancyTest] = []
    largest = 0.0
    for rank, (effect, over, p_value) in enumerate(raw):
        largest = min(1.0, max(largest, p_value * (len(raw) - rank)))
        tests.append(ConstancyTest(effect=effect, over=over, p_value=largest))
    return tuple(tests)


def drifting(problem: Problem) -> tuple[Drifting, ...]:
    """The parameters that do not stay the same, each condition named once for an effect.

    What moves with a condition differs between runs as well: `run` is named only where no condition is.
    """
    found: dict[tuple[str, str], float] = {}
    for test in constancy_tests(problem):
        if test.p_value <= LEVEL:
            found.setdefault((test.effect, test.over), test.p_value)
    conditional = {effect for effect, over in found if over != "run"}
    found = {key: p_value for key, p_value in found.items() if key[1] != "run" or key[0] not in conditional}
    return tuple(Drifting(effect=effect, over=over, p_value=p_value) for (effect, over), p_value in found.items())


def _run_conditions(problem: Problem, unit: Integers, temperature_c: Floats) -> dict[str, Floats]:
    """Columns over runs [runs, any] of each condition that differs between runs."""
    at = problem.conditions
    conditions: dict[str, Floats] = {}
    group = groups_of_values(temperature_c, SAME_TEMPERATURE_C)
    if group.max() >= 1:
        conditions["temperature"] = (group[:, None] == np.arange(int(group.max()) + 1)).astype(np.float64)
    means = {
        "direction": at.direction,
        "speed": None if at.velocity_deg_s is None else np.abs(at.velocity_deg_s),
    }
    for name, values in means.items():
        if values is None:
            continue
        mean = np.bincount(unit, weights=values) / np.bincount(unit)
        if float(np.ptp(mean)) > 0.1 * max(float(np.abs(values).max()), 1e-9):
            conditions[name] = ((mean - mean.mean()) / float(np.ptp(mean)))[:, None]
    return conditions


def _patterns(problem: Problem, unit: Integers) -> Iterator[_RunPattern]:
    """The distinct patterns that re-calibration moves, within runs: eccentricity and its growth with T are one."""
    shapes = _shapes(problem.modelled, problem.conditions.angle_deg, unit)
    span = recalibration_span(problem)
    residual = span.outside(problem.error_arcsec)
    design = np.column_stack([problem.offsets(), problem.drift, problem.modelled])
    coefficients = np.linalg.lstsq(design, problem.error_arcsec - residual, rcond=1e-9)[0][
        -problem.modelled.shape[1] :
    ]
    done: set[int] = set()
    for effect in dict.fromkeys(problem.modelled_effects):
        own = [j for j, name in enumerate(problem.modelled_effects) if name == effect]
        # Columns come as cosine and sine of one order: one amplitude.
        for pair in (own[start : start + 2] for start in range(0, len(own), 2)):
            if done & set(pair):
                continue
            alike = [[j for j in range(shapes.shape[1]) if _same(shapes[:, j], shapes[:, i])] for i in pair]
            done |= {j for each in alike for j in each}
            # The re-calibrated part of the pattern is put back, so that each run shows all of its amplitude.
            put_back = sorted({j for each in alike for j in each})
            values = residual + problem.modelled[:, put_back] @ coefficients[put_back]
            run, amplitude = _own_amplitudes(values, shapes[:, pair], unit)
            if run.size >= FEWEST_RUNS:
                profile = tuple(
                    _along(problem, own_alike, shapes[:, column], unit)
                    for column, own_alike in zip(pair, alike, strict=True)
                )
                yield _RunPattern(effect=effect, run=run, amplitude=amplitude, profile=profile)


def _along(problem: Problem, columns: list[int], shape: Floats, unit: Integers) -> Floats:
    """[runs, columns]: how much of a shape each modelled column holds in each run."""
    length = np.maximum(np.bincount(unit, weights=shape**2), 1e-300)
    held = [np.bincount(unit, weights=problem.modelled[:, j] * shape) / length for j in columns]
    return np.stack(held, axis=1)


def _shapes(columns: Floats, angle_deg: Floats, unit: Integers) -> Floats:
    """The columns with size 1 and the same sign in every run; 0 in runs that hardly show them."""
    count = np.bincount(unit)
    size = np.stack([np.sqrt(np.bincount(unit, weights=column**2) / count) for column in columns.T], axis=1)
    # Near the base temperature a growth with it is next to nothing and has no shape.
    size = np.where(size > LEAST_OF_LARGEST * size.max(axis=0, keepdims=True), size, 0.0)
    shape = np.where(size[unit] > 0.0, columns / np.maximum(size[unit], 1e-300), 0.0)
    # Runs may have other angles in another order: their signs are compared by the first harmonics.
    theta = np.radians(angle_deg)
    waves = [np.ones(theta.size), *(f(k * theta) for k in range(1, 12) for f in (np.cos, np.sin))]
    for j in range(columns.shape[1]):
        spectrum = np.stack([np.bincount(unit, weights=wave * shape[:, j]) / count for wave in waves], axis=1)
        # A growth with temperature changes its sign at the base temperature.
        against = spectrum @ spectrum[int(np.argmax(size[:, j]))] < 0.0
        shape[against[unit], j] *= -1.0
    return shape


def _same(one: Floats, other: Floats) -> bool:
    both = (one != 0.0) & (other != 0.0)
    length = float(np.sqrt(np.sum(one[both] ** 2) * np.sum(other[both] ** 2)))
    return length > 0.0 and abs(float(one[both] @ other[both])) > 0.98 * length


def _own_amplitudes(values: Floats, pattern: Floats, unit: Integers) -> tuple[Integers, Floats]:
    """Least squares of each run by itself with its offset; runs that do not show the pattern are left out."""
    runs: list[int] = []
    found: list[NDArray[np.floating]] = []
    for run in range(int(unit.max()) + 1):
        rows = unit == run
        columns = np.column_stack([np.ones(int(rows.sum())), pattern[rows]])
        if rows.sum() < columns.shape[1] + 3:
            continue
        if np.linalg.matrix_rank(columns, tol=0.05 * np.sqrt(rows.sum())) < columns.shape[1]:
            continue
        runs.append(run)
        found.append(np.linalg.lstsq(columns, values[rows], rcond=None)[0][1:])
    return np.array(runs, dtype=np.int64), np.array(found, dtype=np.float64)


def _unknown_temperature_k(problem: Problem) -> float:
    """Standard uncertainty of the grating's temperature that all runs at one temperature share."""
    sensor = problem.joint.temperature_sensor
    stated = sensor.resolution_c**2 / 12.0 + sensor.standard_uncertainty_c**2
    return float(np.sqrt(stated + UNKNOWN_TEMPERATURE_K**2))


def _f_test(pattern: _RunPattern, model: Floats, temperature_c: Floats, unknown_k: float) -> float | None:
    """p of the condition beyond what re-calibration allows; None where nothing is left to tell.

    An amplitude that grows with temperature moves by its slope times what the sensor does not know, `unknown_k`.
    """
    runs = pattern.run
    freedom, left, rss0, rss1, of_sensor = 0, 0, 0.0, 0.0, 0.0
    growth = np.column_stack([np.ones(runs.size), temperature_c[runs] - temperature_c.mean()])
    for profile, amplitude in zip(pattern.profile, pattern.amplitude.T, strict=True):
        simple = profile[runs]
        full = np.column_stack([simple, simple[:, :1] * model[runs]])
        rank0, rank1 = int(np.linalg.matrix_rank(simple)), int(np.linalg.matrix_rank(full))
        freedom, left = freedom + rank1 - rank0, left + runs.size - rank1
        rss0, rss1 = rss0 + _rss(simple, amplitude), rss1 + _rss(full, amplitude)
        slope = float(np.linalg.lstsq(growth, amplitude, rcond=None)[0][1])
        of_sensor += runs.size / model.shape[1] * (slope * unknown_k) ** 2 / len(pattern.profile)
    if freedom <= 0 or left < FEWEST_FREEDOMS * len(pattern.profile) or rss1 <= 0.0:
        return None
    return float(special.fdtrc(freedom, left, (rss0 - rss1) / freedom / (rss1 / left + of_sensor)))


def _rss(design: Floats, values: Floats) -> float:
    return float(np.sum((values - design @ np.linalg.lstsq(design, values, rcond=None)[0]) ** 2))


def _between_runs(problem: Problem, unit: Integers) -> list[tuple[str, str, float]]:
    """Orders 1 and 2, where modelled, against the energy that neighbouring orders have in single runs."""
    names = {1: "eccentricity", 2: "grating_tilt"}
    modelled = [k for k in ORDERS_OF_RUNS if names[k] in problem.modelled_effects]
    places = np.unique(np.rint(np.mod(problem.conditions.angle_deg, 360.0) * 2.0)).size
    reference = [k for k in REFERENCE_ORDERS if k <= (places - 1) // 2 - 1]
    if not modelled or len(reference) < 3:
        return []
    residual = recalibration_span(problem).outside(problem.error_arcsec)
    runs = int(unit.max()) + 1
    energy = {k: _order_energy(problem, residual, unit, k) for k in (*modelled, *reference)}
    # S_k = s (1 + c / k): c from the median over orders, so that one odd order is no colour.
    white = float(np.median([energy[k] for k in reference if k >= 5] or [energy[k] for k in reference]))
    colour = max(0.0, float(np.median([k * (energy[k] / white - 1.0) for k in reference])))
    freedom = 2 * (runs - 2)
    found: list[tuple[str, str, float]] = []
    for k in modelled:
        ratio = energy[k] / (white * (1.0 + colour / k)) * runs / (runs - 2)
        # The level's own uncertainty, as degrees of freedom of a denominator.
        of_level = 2.0 / COLOUR_SPREAD**2
        found.append((names[k], "run", float(special.fdtrc(freedom, of_level, ratio))))
    return found


def _order_energy(problem: Problem, residual: Floats, unit: Integers, order: int) -> float:
    theta = order * np.radians(problem.conditions.angle_deg)
    count = np.bincount(unit)
    cosine, sine = (np.bincount(unit, weights=wave(theta) * residual) / count for wave in (np.cos, np.sin))
    return float(np.mean((cosine**2 + sine**2) * count))
