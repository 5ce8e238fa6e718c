"""Errors at readings that no step of the training saw.

A method is fitted without some readings and asked for their error. The unknown zero of the left-out runs,
eq. (11), is estimated anew as the mean of what remains in each zero group, so a residual is counted from its run:

    r_i = e_i - Ê(θ_i, T_i) - mean over the group,    RMSE² = sum r_i² / sum (n_group - 1)

It holds the noise of the readings: the repeatability stated beside it is the floor that no model goes below.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import angle_difference_deg, wrap_deg
from trueangle_training.methods import Method, TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.least_squares import SAME_TEMPERATURE_C

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

SAME_PLACE_DEG = 0.5
FEWEST_PLACES = 35
"""With 23 places and 11 harmonics nothing is left over: without one of them any method but the crudest is
magnified noise there, which says nothing of how it does with all of them."""
FACES_LEFT_OUT = 6
"""Places of the turn that are left out one by one: the last one, at the seam, and others all round."""

FACES_LEFT_OUT_ALONE = 24
"""Where nothing else can be left out."""


class HeldOutKind(Enum):
    """What is left out of the training at a time."""

    TEMPERATURE = "leave-one-temperature-out"
    RUN = "leave-runs-out"
    """The k-th run of every temperature: as many fits as there are repeats, every run left out once."""
    FACE = "leave-one-face-out"
    """One place of the turn at all temperatures."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fold:
    """Readings that are left out together."""

    label: str
    left_out: Mask
    """[readings]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Residuals of one method at left-out readings."""

    kind: HeldOutKind
    residual_arcsec: Floats
    """[readings], counted from the zero re-estimated for the left-out part of each group; NaN where none is known:
    the array keeps the place of readings that the method could not be asked for."""
    uncertainty_arcsec: Floats | None
    """[readings]: the method's own k = 1 for the error there; None: it knows none."""
    degrees_of_freedom: Floats
    """[readings]: 1 - 1/n for each of n readings of a group, 0 where the residual is unknown."""
    refused: tuple[str, ...]
    """Folds that the method cannot be fitted without, and why."""

    @property
    def known(self) -> Mask:
        """Where a residual is."""
        return self.degrees_of_freedom > 0.0

    @property
    def rmse_arcsec(self) -> float | None:
        """None: no fold could be fitted."""
        freedom = float(self.degrees_of_freedom.sum())
        return float(np.sqrt(np.nansum(self.residual_arcsec**2) / freedom)) if freedom else None

    @property
    def largest_arcsec(self) -> float | None:
        """Largest absolute residual; None: no fold could be fitted."""
        return float(np.nanmax(np.abs(self.residual_arcsec))) if self.known.any() else None


def temperature_groups(readings: TrainingReadings) -> Integers:
    """Which of the campaign's temperatures each reading belongs to, numbered upwards from 0, shape [readings]."""
    run_mean_c = readings.run_mean_temperature_c()
    ordered = np.unique(run_mean_c)
    label = np.concatenate([[0], np.cumsum(np.diff(ordered) > SAME_TEMPERATURE_C)])
    return label[np.searchsorted(ordered, run_mean_c)].astype(np.int64)


def temperature_folds(readings: TrainingReadings) -> tuple[Fold, ...]:
    """One fold a temperature; none where there are fewer than three."""
    group = temperature_groups(readings)
    if group.max() < 2:
        return ()
    means = [float(readings.temperature_c[group == each].mean()) for each in range(int(group.max()) + 1)]
    return tuple(Fold(label=f"{mean_c:.1f} degC", left_out=group == each) for each, mean_c in enumerate(means))


def run_folds(readings: TrainingReadings) -> tuple[Fold, ...]:
    """Fold k holds the k-th run of every temperature that has more than one."""
    group = temperature_groups(readings)
    place = np.full(len(readings), -1)
    for each in np.unique(group):
        runs = np.unique(readings.run[group == each])
        if runs.size < 2:
            continue
        for k, run in enumerate(runs):
            place[readings.run == run] = k
    return tuple(
        Fold(label=f"run {k + 1} of each temperature", left_out=place == k) for k in range(int(place.max()) + 1)
    )


def face_folds(readings: TrainingReadings, count: int = FACES_LEFT_OUT) -> tuple[Fold, ...]:
    """`count` places of the turn left out one by one, the last one before the seam first; never the datum itself.

    None where fewer than FEWEST_PLACES were measured.
    """
    from_datum = wrap_deg(readings.angle_deg - readings.datum_deg + SAME_PLACE_DEG)
    ordered = np.unique(from_datum)
    starts = ordered[np.concatenate([[True], np.diff(ordered) > SAME_PLACE_DEG])]
    if starts.size < FEWEST_PLACES:
        return ()
    place = np.searchsorted(starts, from_datum, side="right") - 1
    chosen = np.unique(np.linspace(starts.size - 1, 1, count).astype(np.int64))[::-1]
    return tuple(
        Fold(label=f"{_circular_mean_deg(readings.angle_deg[place == each]):.1f} deg", left_out=place == each)
        for each in chosen
    )


def _circular_mean_deg(angle_deg: Floats) -> float:
    first = float(angle_deg[0])
    return wrap_deg(first + float(np.mean(angle_difference_deg(angle_deg, first))))


def subset(readings: TrainingReadings, chosen: Mask) -> TrainingReadings:
    """Some of the readings."""
    return replace(
        readings,
        angle_deg=readings.angle_deg[chosen],
        error_arcsec=readings.error_arcsec[chosen],
        temperature_c=readings.temperature_c[chosen],
        run=readings.run[chosen],
        zero_group=None if readings.zero_group is None else readings.zero_group[chosen],
    )


def hold_out(
    readings: TrainingReadings,
    method: Method,
    kind: HeldOutKind,
    folds: tuple[Fold, ...],
    *,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> HeldOut:
    """Fit once a fold; a fold that the method refuses is listed, not raised."""
    residual = np.full(len(readings), np.nan)
    freedom = np.zeros(len(readings))
    uncertainty: Floats | None = np.full(len(readings), np.nan)
    refused: list[str] = []
    for fold in folds:
        out = fold.left_out
        try:
            model = method.fit(subset(readings, ~out), seed=seed).model
        except UnsuitableReadingsError as error:
            refused.append(f"{fold.label}: {error.faults[0]}")
            progress()
            continue
        angle_deg, temperature_c = readings.angle_deg[out], readings.temperature_c[out]
        left = readings.error_arcsec[out] - model.error_arcsec(angle_deg, temperature_c)
        if kind is HeldOutKind.FACE:
            # The group's zero is known from its other faces, to the accuracy of the fit to them.
            residual[out] = left - _offset_of_others(readings, out, model.error_arcsec)
            freedom[out] = 1.0
        else:
            residual[out], freedom[out] = _centred(left, readings.offset_group[out])
        spread = model.uncertainty_arcsec(angle_deg, temperature_c)
        if spread is None or uncertainty is None:
            uncertainty = None
        else:
            uncertainty[out] = spread
        progress()
    return HeldOut(
        kind=kind,
        residual_arcsec=residual,
        uncertainty_arcsec=uncertainty,
        degrees_of_freedom=freedom,
        refused=tuple(refused),
    )


def _centred(values: Floats, groups: Integers) -> tuple[Floats, Floats]:
    """Values less their group's mean, and the degrees of freedom that each then has."""
    _, index, counts = np.unique(groups, return_inverse=True, return_counts=True)
    means = np.bincount(index, weights=values) / counts
    return values - means[index], (1.0 - 1.0 / counts)[index]


def _offset_of_others(
    readings: TrainingReadings, out: Mask, error_arcsec: Callable[[Floats, Floats], Floats]
) -> Floats:
    """The mean residual of the rest of each left-out reading's group, shape [left out]."""
    group = readings.offset_group
    left = readings.error_arcsec - error_arcsec(readings.angle_deg, readings.temperature_c)
    counts = np.bincount(group[~out], minlength=int(group.max()) + 1)
    sums = np.bincount(group[~out], weights=left[~out], minlength=int(group.max()) + 1)
    means = sums / np.maximum(counts, 1)
    return means[group[out]]


def all_folds(readings: TrainingReadings) -> Iterator[tuple[HeldOutKind, tuple[Fold, ...]]]:
    """Every kind with its folds."""
    temperatures, runs = temperature_folds(readings), run_folds(readings)
    yield HeldOutKind.TEMPERATURE, temperatures
    yield HeldOutKind.RUN, runs
    alone = not temperatures and not runs
    yield HeldOutKind.FACE, face_folds(readings, FACES_LEFT_OUT_ALONE if alone else FACES_LEFT_OUT)


def repeatability_arcsec(readings: TrainingReadings) -> float | None:
    """Standard deviation of one reading from runs that repeat places and temperature; None: nothing is repeated.

    Analysis of variance over places and runs of each temperature: free of any model of the error. Runs whose
    temperatures differ within their group, by the chamber's jitter, raise it a little.
    """
    group = temperature_groups(readings)
    place = np.rint(wrap_deg(readings.angle_deg) / SAME_PLACE_DEG).astype(np.int64) % int(360 / SAME_PLACE_DEG)
    squares, freedom = 0.0, 0
    for each in np.unique(group):
        here = group == each
        cells = np.unique(place[here], return_inverse=True)[1]
        runs = np.unique(readings.run[here], return_inverse=True)[1]
        if runs.max() == 0 or cells.size != (cells.max() + 1) * (runs.max() + 1):
            continue
        table = np.full((runs.max() + 1, cells.max() + 1), np.nan)
        table[runs, cells] = readings.error_arcsec[here]
        if np.isnan(table).any():
            continue
        left = table - table.mean(axis=0) - table.mean(axis=1, keepdims=True) + table.mean()
        squares += float(np.sum(left**2))
        freedom += (table.shape[0] - 1) * (table.shape[1] - 1)
    return float(np.sqrt(squares / freedom)) if freedom else None
