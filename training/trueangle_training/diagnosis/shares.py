"""How far simulator and joint are apart, in three shares: parameters, structure, and what no model goes below.

In mean squares on held-out runs: G0 of the simulator as shipped, G1 after re-calibration, F the floor.

    parametric = (G0 - G1) / G0,   structural = (G1 - F) / G0,   floor = F / G0,   their sum is 1

The floor is the scatter of a reading about the mean of its condition over repeats, after each run's offset:
resolution and autocollimator noise are inside. Where a kind of run is never repeated (dense sweeps), it is the
scatter about a saturated fit of smooth functions of all conditions, with the degrees of freedom that this leaves.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    Fold,
    HeldOut,
    groups_of_values,
    held_out,
    less_group_mean,
    orthonormal,
    recalibration_columns,
    run_folds,
    temperature_of_runs,
)
from trueangle_training.diagnosis.run_draws import BLOCKS_OF_RUN
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

SAME_PLACE_DEG = 0.5
SAME_TEMPERATURE_C = 1.0
FEWEST_FREEDOMS = 20.0
"""A scatter from fewer is known to worse than 16 %: the saturated fit is asked instead."""
HIGHEST_ORDER = 12
DRAWS_NOTE = (
    "the simulator has effects that each run draws anew: re-calibrated, each half of a held-out run is judged "
    "with the draw of the other half"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """Variance of one reading about the mean of its condition."""

    variance_arcsec2: float
    freedom: float
    """Degrees of freedom behind it."""
    repeated: bool
    """From exact repeats throughout; False: partly or wholly from a saturated fit."""

    @property
    def relative_uncertainty(self) -> float:
        """Standard deviation of the variance over itself, for white normal noise."""
        return float(np.sqrt(2.0 / max(self.freedom, 1.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shares:
    """G0, G1 and F with the shares they make."""

    shipped_arcsec2: float
    recalibrated_arcsec2: float
    floor: Floor
    parametric_share: float
    structural_share: float
    floor_share: float
    """The three add up to 1."""
    shipped: HeldOut
    recalibrated: HeldOut
    notes: tuple[str, ...]


def shares_of(problem: Problem, *, found: Floats | None = None) -> Shares | None:
    """None: fewer than two runs, nothing can be held out. `found`: columns that are kept out of the floor.

    An effect that was found and is drawn anew in each run would otherwise count as scatter; [readings, any].
    """
    folds = run_folds(problem)
    if not folds:
        return None
    group = problem.conditions.zero_group
    floor = floor_of(problem, found=found)
    none = np.zeros((len(problem.conditions), 0))
    shipped = held_out(problem.error_arcsec - problem.nominal_arcsec, none, group, folds)
    drawn = _models_draws(problem)
    halves = _half_runs(problem, folds) if drawn else folds
    recalibrated = held_out(problem.error_arcsec, recalibration_columns(problem), group, halves)
    g0 = shipped.mean_square(floor.variance_arcsec2)
    g1 = recalibrated.mean_square(floor.variance_arcsec2)
    shares = _shares(g0, g1, floor, shipped, recalibrated)
    return replace(shares, notes=(*shares.notes, DRAWS_NOTE)) if drawn else shares


def _models_draws(problem: Problem) -> bool:
    """Whether the simulator has effects whose parameters each run draws anew."""
    return any(EFFECTS[name].nature in (Nature.RANDOM, Nature.EVENT) for name in set(problem.modelled_effects))


def _half_runs(problem: Problem, folds: tuple[Fold, ...]) -> tuple[Fold, ...]:
    """The folds cut into alternate blocks of each run: no other run tells the draw of this one."""
    second = np.zeros(len(problem.conditions), dtype=bool)
    run = problem.conditions.run
    for each in np.unique(run):
        here = np.flatnonzero(run == each)
        second[here] = np.arange(here.size) * min(BLOCKS_OF_RUN, here.size) // here.size % 2 == 1
    return tuple(
        Fold(label=f"{fold.label}, half {number}", left_out=left_out)
        for fold in folds
        for number, half in enumerate((second, ~second), start=1)
        if (left_out := fold.left_out & half).any()
    )


def _shares(g0: float, g1: float, floor: Floor, shipped: HeldOut, recalibrated: HeldOut) -> Shares:
    notes: list[str] = []
    f = floor.variance_arcsec2
    parts = np.array([g0 - g1, g1 - f, f])
    if g1 > g0:
        notes.append("re-calibration gains nothing on held-out runs: its share is set to 0")
    if f > g1:
        notes.append("re-calibration leaves no more than the floor: the structural share is set to 0")
    if not floor.repeated:
        notes.append(
            "no condition is repeated often enough in some kind of run: the floor there is the scatter about a "
            f"saturated fit ({floor.freedom:.0f} degrees of freedom in all)"
        )
    parts = np.maximum(parts, 0.0)
    total = float(parts.sum())
    parts = parts / total if total > 0.0 else np.array([0.0, 0.0, 1.0])
    return Shares(
        shipped_arcsec2=g0,
        recalibrated_arcsec2=g1,
        floor=floor,
        parametric_share=float(parts[0]),
        structural_share=float(parts[1]),
        floor_share=float(parts[2]),
        shipped=shipped,
        recalibrated=recalibrated,
        notes=tuple(notes),
    )


def floor_of(problem: Problem, *, found: Floats | None = None) -> Floor:
    """The floor, for each kind of run (against polygon or reference encoder) by itself and then averaged."""
    face = problem.conditions.face
    against_encoder = np.zeros(len(problem.conditions), dtype=bool) if face is None else face == 0
    condition = conditions_by_number(problem)
    weighted, freedom_parts, repeated = 0.0, 0.0, True
    for kind in (True, False):
        rows = against_encoder == kind
        if not rows.any():
            continue
        part = problem_part(problem, rows)
        own = None if found is None else found[rows]
        floor = _from_repeats(part, condition[rows], own)
        if floor.freedom < FEWEST_FREEDOMS:
            floor, repeated = _from_saturated_fit(part, own), False
        share = float(np.mean(rows))
        weighted += share * floor.variance_arcsec2
        freedom_parts += (share * floor.variance_arcsec2) ** 2 / max(floor.freedom, 1.0)
    # Welch and Satterthwaite's freedom of a weighted sum of variances.
    freedom = weighted**2 / freedom_parts if freedom_parts > 0.0 else 1.0
    return Floor(variance_arcsec2=weighted, freedom=freedom, repeated=repeated)


def problem_part(problem: Problem, rows: Mask) -> Problem:
    """Some readings without the hypotheses, which are large and not needed here."""
    return replace(problem, hypotheses=()).rows(rows)


def conditions_by_number(problem: Problem) -> Integers:
    """[readings]: readings of one number were taken under the same condition, as far as the columns tell."""
    at = problem.conditions
    place = np.rint(wrap_deg(at.angle_deg) / SAME_PLACE_DEG) % round(360.0 / SAME_PLACE_DEG)
    runs, temperature_c = temperature_of_runs(problem)
    columns = [place, groups_of_values(temperature_c, SAME_TEMPERATURE_C)[np.searchsorted(runs, at.run)]]
    columns += [each.astype(np.float64) for each in (at.direction, at.face, at.polygon_offset) if each is not None]
    for values in (at.velocity_deg_s, at.load_nm):
        if values is not None and float(np.ptp(values)) > 0.0:
            columns.append(groups_of_values(values, 0.05 * float(np.abs(values).max())))
    return np.unique(np.column_stack(columns), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _from_repeats(problem: Problem, condition: Integers, found: Floats | None) -> Floor:
    """Analysis of variance over conditions and offsets of runs, unbalanced; freedom 0 where nothing is repeated.

    The temperature of a repeat differs by the chamber's jitter: the re-calibratable columns take that out first.
    """
    count = np.bincount(condition)
    rows = count[condition] > 1
    if not rows.any():
        return Floor(variance_arcsec2=0.0, freedom=0.0, repeated=True)
    at = problem.conditions
    cell = np.unique(condition[rows], return_inverse=True)[1].astype(np.int64)
    run = np.unique(np.column_stack([at.run, at.zero_group])[rows], axis=0, return_inverse=True)[1].reshape(-1)
    # Offsets as columns, less their condition's mean: what the conditions cannot carry of them.
    columns = (run[:, None] == np.arange(int(run.max()) + 1)).astype(np.float64)
    if found is not None:
        columns = np.column_stack([columns, found[rows]])
    basis = orthonormal(_negligible_to_zero(less_group_mean(columns, cell)))
    values = less_group_mean(_without_recalibration(problem)[rows][:, None], cell)
    left = values - basis @ (basis.T @ values)
    freedom = float(cell.size - (cell.max() + 1) - basis.shape[1])
    if freedom < 1.0:
        return Floor(variance_arcsec2=0.0, freedom=0.0, repeated=True)
    return Floor(variance_arcsec2=float(np.sum(left**2)) / freedom, freedom=freedom, repeated=True)


def _negligible_to_zero(columns: Floats) -> Floats:
    """Columns that vanish but for rounding are set to 0, lest their direction count."""
    size = np.sqrt(np.mean(columns**2, axis=0, keepdims=True))
    return np.where(size > 1e-6 * max(float(size.max(initial=0.0)), 1e-30), columns, 0.0)


def _without_recalibration(problem: Problem) -> Floats:
    _, index = np.unique(problem.conditions.zero_group, return_inverse=True)
    index = index.astype(np.int64)
    basis = orthonormal(less_group_mean(recalibration_columns(problem), index))
    values = less_group_mean(problem.error_arcsec[:, None], index)
    return (values - basis @ (basis.T @ values))[:, 0]


def _from_saturated_fit(problem: Problem, found: Floats | None) -> Floor:
    columns = saturated_columns(problem, own_run=False)
    if found is not None:
        columns = np.column_stack([columns, found])
    _, index = np.unique(problem.conditions.zero_group, return_inverse=True)
    index = index.astype(np.int64)
    basis = orthonormal(_negligible_to_zero(less_group_mean(columns, index)))
    values = less_group_mean(problem.error_arcsec[:, None], index)
    left = values - basis @ (basis.T @ values)
    freedom = max(1.0, float(index.size - (index.max() + 1) - basis.shape[1]))
    return Floor(variance_arcsec2=float(np.sum(left**2)) / freedom, freedom=freedom, repeated=False)


def saturated_columns(problem: Problem, *, own_run: bool = True) -> Floats:
    """[readings, columns]: smooth functions of all conditions that were measured, the offsets not among them.

    `own_run` adds the first orders and the slope of each run by itself, which no other run can predict.
    """
    at = problem.conditions
    theta = np.radians(at.angle_deg)
    turn = float(np.ptp(at.angle_deg))
    places = np.unique(np.rint(wrap_deg(at.angle_deg) / SAME_PLACE_DEG)).size
    highest = int(min(HIGHEST_ORDER, max(1, (places - 1) // 2), max(1.0, turn / 30.0)))
    orders = [f(k * theta) for k in range(1, highest + 1) for f in (np.cos, np.sin)]
    first = np.column_stack([np.ones(theta.size), *orders[:4]])
    parts = [np.column_stack(orders)]
    runs, run_index = np.unique(at.run, return_inverse=True)
    slopes = [column for column in (_centred(at.temperature_c), _centred(at.load_nm)) if column is not None]
    for x in slopes:
        parts += [x[:, None] * np.column_stack([np.ones(theta.size), *orders]), (x**2)[:, None] * first]
    if (speed := _centred(at.velocity_deg_s)) is not None:
        parts += [speed[:, None] * first, np.abs(speed)[:, None] * first]
    if (direction := _centred(at.direction)) is not None:
        parts.append(direction[:, None] * np.column_stack([np.ones(theta.size), *orders[:8]]))
    # Without a clock the order of the runs is one: what wanders over the campaign is seen in both.
    if (time := _centred(run_index.astype(np.float64) if at.time_s is None else at.time_s)) is not None:
        parts.append(time[:, None] * first)
    place = within_run(problem)
    parts.append(np.column_stack([place, place**2]))
    if own_run:
        own = (run_index[:, None] == np.arange(runs.size)).astype(np.float64)
        parts += [own * column[:, None] for column in (place, *orders[:4])]
    return np.column_stack(parts)


def _centred(values: Floats | None) -> Floats | None:
    """Scaled to -1..1; None where nothing changes."""
    if values is None:
        return None
    low, high = float(values.min()), float(values.max())
    return None if high - low < 1e-9 * max(1.0, abs(high)) else (2.0 * values - low - high) / (high - low)


def within_run(problem: Problem) -> Floats:
    """[readings]: time within the run, or the place in the file where no time is known, from -1 to 1."""
    at = problem.conditions
    clock = np.arange(len(at), dtype=np.float64) if at.time_s is None else at.time_s
    _, index = np.unique(at.run, return_inverse=True)
    low = np.full(int(index.max()) + 1, np.inf)
    high = -low
    np.minimum.at(low, index, clock)
    np.maximum.at(high, index, clock)
    return (2.0 * clock - low[index] - high[index]) / np.maximum(high - low, 1e-9)[index]
