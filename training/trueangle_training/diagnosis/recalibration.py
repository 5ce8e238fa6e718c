"""Re-calibration on some runs, judged on others: only what it leaves there may be called structural.

The parameters of the modelled effects are fitted to training runs with one free offset for each zero group. On a
held-out run a zero group that the training runs do not share has its offset estimated anew, which costs a degree
of freedom; a shared one keeps its offset. What the finite number of training readings adds to the square,
sigma^2 tr(X_out (X_in' X_in)^-1 X_out'), is known beforehand and taken off again: it is no gap.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.problem import STEADY_C, Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

FOLDS = 5
SAME_SPEED = 0.05
"""Relative difference below which two speeds are one."""
RELATIVE_RANK = 1e-9
"""Singular values below this part of the largest one belong to columns that the readings cannot tell apart."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fold:
    """Readings that are left out together."""

    label: str
    left_out: Mask
    """[readings]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """What is left at readings whose runs no fit saw; arrays of shape [readings]."""

    residual_arcsec: Floats
    """0 where no fold left the reading out."""
    freedom: Floats
    """Degrees of freedom of each reading: 1 - 1/n in a group of n whose offset was estimated from them."""
    inflation: Floats
    """Expected square that the training's own uncertainty adds, in units of the noise variance."""

    @property
    def known(self) -> Mask:
        """Where a residual is."""
        return self.freedom > 0.0

    def mean_square(self, noise_variance: float, rows: Mask | None = None) -> float:
        """Mean square per degree of freedom, less the training's own uncertainty, arcsec^2; never below 0."""
        kept = self.known if rows is None else rows & self.known
        freedom = float(self.freedom[kept].sum())
        if freedom <= 0.0:
            return 0.0
        squares = float(np.sum(self.residual_arcsec[kept] ** 2))
        return max(0.0, (squares - noise_variance * float(self.inflation[kept].sum())) / freedom)


def temperature_of_runs(problem: Problem) -> tuple[Integers, Floats]:
    """Run numbers in ascending order and each run's mean temperature; 0 degC where none was measured."""
    runs, index = np.unique(problem.conditions.run, return_inverse=True)
    temperature = problem.conditions.temperature_c
    if temperature is None:
        return runs, np.zeros(runs.size)
    return runs, np.bincount(index, weights=temperature) / np.bincount(index)


def groups_of_values(values: Floats, tolerance: float) -> Integers:
    """Number from 0 of the cluster each value belongs to: neighbours closer than `tolerance` are together."""
    ordered = np.unique(values)
    label = np.concatenate([[0], np.cumsum(np.diff(ordered) > tolerance)])
    return label[np.searchsorted(ordered, values)].astype(np.int64)


def run_folds(problem: Problem, count: int = FOLDS) -> tuple[Fold, ...]:
    """Whole runs dealt to `count` folds by temperature, so that each fold holds all; none below two runs."""
    runs, temperature_c = temperature_of_runs(problem)
    if runs.size < 2:
        return ()
    order = np.argsort(temperature_c, kind="stable")
    fold = np.empty(runs.size, dtype=np.int64)
    fold[order] = np.arange(runs.size) % min(count, runs.size)
    of_reading = fold[np.searchsorted(runs, problem.conditions.run)]
    return tuple(Fold(label=f"runs {k + 1}", left_out=of_reading == k) for k in range(int(fold.max()) + 1))


def temperature_folds(problem: Problem) -> tuple[Fold, ...]:
    """One fold a temperature, by the runs' means; none below three temperatures."""
    runs, temperature_c = temperature_of_runs(problem)
    group = groups_of_values(temperature_c, 2.0 * STEADY_C)
    if group.max() < 2:
        return ()
    of_reading = group[np.searchsorted(runs, problem.conditions.run)]
    return tuple(
        Fold(label=f"{temperature_c[group == k].mean():.1f} degC", left_out=of_reading == k)
        for k in range(int(group.max()) + 1)
    )


def speed_folds(problem: Problem) -> tuple[Fold, ...]:
    """One fold for each absolute speed; none below two speeds."""
    velocity = problem.conditions.velocity_deg_s
    if velocity is None:
        return ()
    speed = np.abs(velocity)
    label = groups_of_values(speed, max(SAME_SPEED * float(speed.max()), 1e-6))
    if not 1 <= label.max() <= 20:
        return ()
    return tuple(
        Fold(label=f"{speed[label == k].mean():.3g} deg/s", left_out=label == k)
        for k in range(int(label.max()) + 1)
    )


def recalibration_columns(problem: Problem) -> Floats:
    """[readings, columns]: all that is re-calibrated besides the offsets."""
    return np.column_stack([problem.drift, problem.modelled])


def held_out(error_arcsec: Floats, columns: Floats, group: Integers, folds: tuple[Fold, ...]) -> HeldOut:
    """Fit `columns` and the offsets of `group` without each fold and ask for the error there.

    error_arcsec, group: [readings]; columns: [readings, any]. Directions that the training readings cannot see get
    coefficient 0.
    """
    residual, freedom, inflation = (np.zeros(error_arcsec.size) for _ in range(3))
    for fold in folds:
        out = fold.left_out
        values, allowed, added = one_fold(error_arcsec, columns, group, out)
        residual[out], freedom[out], inflation[out] = values, allowed, added
    return HeldOut(residual_arcsec=residual, freedom=freedom, inflation=inflation)


def calibrated(values: Floats, columns: Floats, group: Integers, inside: Mask) -> Floats:
    """Coefficients [columns] of least squares on the readings inside, the offsets of `group` free."""
    labels, index = np.unique(group, return_inverse=True)
    both, _, _ = _less_group_mean(np.column_stack([values, columns]), index, inside, labels.size)
    return np.asarray(np.linalg.lstsq(both[inside, 1:], both[inside, 0], rcond=1e-8)[0], dtype=np.float64)


def one_fold(error: Floats, columns: Floats, group: Integers, out: Mask) -> tuple[Floats, Floats, Floats]:
    """Residual, freedom and inflation, as of `HeldOut`, of the readings of one fold alone; `out`: [readings]."""
    labels, index = np.unique(group, return_inverse=True)
    inside = ~out
    both = np.column_stack([error, columns])
    centred, mean, count = _less_group_mean(both, index, inside, labels.size)
    gram = centred[inside, 1:].T @ centred[inside, 1:]
    spread, vectors = np.linalg.eigh(gram)
    seen = spread > RELATIVE_RANK * max(float(spread.max(initial=0.0)), 1e-30)
    root = vectors[:, seen] / np.sqrt(spread[seen])
    solution = root @ (root.T @ (centred[inside, 1:].T @ centred[inside, 0]))
    known = count[index] > 0
    own, _, own_count = _less_group_mean(both, index, out & ~known, labels.size)
    shown = np.where(known[:, None], both - mean[index], own)
    values = shown[:, 0] - shown[:, 1:] @ solution
    n = np.maximum(own_count[index], 1)
    freedom = np.where(known, 1.0, 1.0 - 1.0 / n)
    offset_part = np.where(known, 1.0 / np.maximum(count[index], 1), 0.0)
    inflation = np.sum((shown[:, 1:] @ root) ** 2, axis=1) + offset_part
    return values[out], freedom[out], inflation[out]


def _less_group_mean(values: Floats, index: Integers, rows: Mask, groups: int) -> tuple[Floats, Floats, Integers]:
    """Values less the mean of their group over `rows`, these means [groups, columns] and the numbers of rows."""
    count = np.bincount(index[rows], minlength=groups)
    sums = np.stack(
        [np.bincount(index[rows], weights=column[rows], minlength=groups) for column in values.T], axis=1
    )
    mean = sums / np.maximum(count, 1)[:, None]
    return values - mean[index], mean, count


def orthonormal(columns: Floats) -> Floats:
    """[readings, rank]: an orthonormal basis of the columns' span."""
    if columns.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    scale = np.sqrt(np.sum(columns**2, axis=0))
    scaled = columns[:, scale > 0] / scale[scale > 0]
    if scaled.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    spread, vectors = np.linalg.eigh(scaled.T @ scaled)
    seen = spread > RELATIVE_RANK * float(spread.max())
    basis = scaled @ (vectors[:, seen] / np.sqrt(spread[seen]))
    # The Gram matrix has squared the condition number: a second pass restores the lost digits.
    return np.asarray(np.linalg.qr(basis)[0], dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projector:
    """Takes the re-calibratable span, offsets included, out of columns."""

    basis: Floats
    """[readings, rank]: orthonormal, the offsets of the groups not included."""
    index: Integers
    """[readings]: number of the zero group, from 0."""

    def outside(self, columns: Floats) -> Floats:
        """The part of `columns` ([readings] or [readings, any]) outside the span."""
        flat = columns[:, None] if columns.ndim == 1 else columns
        left = less_group_mean(flat, self.index)
        left = left - self.basis @ (self.basis.T @ left)
        return left[:, 0] if columns.ndim == 1 else left

    @property
    def rank(self) -> int:
        """Dimensions that are taken out."""
        return self.basis.shape[1] + int(self.index.max(initial=-1)) + 1


def less_group_mean(columns: Floats, index: Integers) -> Floats:
    """Columns [readings, any] less their means over the groups 0, 1, ... of `index` [readings]."""
    groups = int(index.max(initial=-1)) + 1
    count = np.bincount(index, minlength=groups)
    order = np.argsort(index, kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    mean = np.add.reduceat(columns[order], starts, axis=0) / count[:, None]
    return columns - mean[index]


def recalibration_span(problem: Problem, extra: Floats | None = None) -> Projector:
    """The projector of all that is re-calibrated, and of `extra` columns [readings, any]."""
    _, index = np.unique(problem.conditions.zero_group, return_inverse=True)
    index = index.astype(np.int64)
    columns = recalibration_columns(problem)
    if extra is not None:
        columns = np.column_stack([columns, extra])
    return Projector(basis=orthonormal(less_group_mean(columns, index)), index=index)
