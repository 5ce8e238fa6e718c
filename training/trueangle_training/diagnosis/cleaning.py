"""Single wild readings found and drawn in before anything is judged by run.

A wide dictionary of smooth patterns is taken off first, so that an effect is not mistaken for an outlier; what
comes again at the same place of the grating, and a run that is odd as a whole, are structure and stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.problem import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

NORMAL_OVER_MAD = 1.4826
SUSPECT = 3.5
"""Times the robust standard deviation of a reading about its four neighbours in time: drawn in."""
OUTLIER = 6.0
"""Replaced by its neighbours."""
PEELED = 8.0
"""Taken out one a run before the others are judged: it would drag its neighbours through the run's slope."""
PEELINGS = 6
SHARE_AT_PLACE = 1 / 3
SHARE_OF_RUN = 0.2
PLACES = 360
"""A place is a degree of the grating."""
LARGEST_SHARE_OF_READINGS = 0.4
"""Columns of the dictionary over readings."""
SMOOTHEST_OWN_PATTERN = 12
"""Readings of a run from which order 1 and a slope of its own are taken off."""
LEAST_LEFT = 0.2
LONGEST_BURST = 8
"""Readings."""
LONGEST_AT_END = 6
"""Readings at the beginning or end of a run that are a burst and no step."""
BURST_GAIN = 10.0
"""Half the energy of a burst in units of the variance: nats that taking it out wins."""
RUNS_WITH_BURST = 0.12
"""Share of the runs, at least one run: with more of them it is no accident but structure."""
ORDINARY_REST = 4.0
"""Variance of a run without its burst over the median of all runs: beyond it the run is odd as a whole."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dictionary:
    """Orthonormal bases of smooth patterns."""

    shared: Floats
    """[readings, rank]: patterns of the whole campaign."""
    whole: Floats
    """[readings, rank]: these, and order 1 and a slope of each run's own."""
    left: Floats
    """[readings]: share of a single wild reading that `whole` leaves in place, at least `LEAST_LEFT`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cleaned:
    """Errors without wild readings."""

    error_arcsec: Floats
    """[readings]"""
    replaced: Mask
    """[readings]: replaced by the neighbours."""
    drawn_in: Mask
    """[readings]: brought nearer to the neighbours."""


def wide_dictionary(problem: Problem) -> Dictionary:
    """All smooth patterns an effect may leave, the likeliest first, at most 40 % as many as there are readings."""
    conditions = problem.conditions
    axes = axes_of(conditions)
    waves = [axes.cosine_sine(k) for k in range(12)]
    parts: list[Floats] = [problem.nuisance(), *waves[1:]]
    x = axes.temperature
    if x is not None:
        parts += [x[:, None] * waves[k] for k in range(9)] + [(x**2)[:, None] * waves[k] for k in range(3)]
    if axes.direction is not None:
        parts += [axes.direction[:, None] * waves[k] for k in range(5)]
    for factor in (axes.campaign, axes.within_run, axes.load):
        if factor is not None:
            parts += [factor[:, None], (factor**2)[:, None], factor[:, None] * waves[1]]
    for factor in (axes.velocity, axes.speed):
        if factor is not None:
            parts.append(factor[:, None])
    parts += [axes.cosine_sine(conditions.lines_per_rev), axes.cosine_sine(2 * conditions.lines_per_rev)]
    if conditions.face is not None and conditions.faces is not None:
        parts.append((conditions.face[:, None] == np.arange(1, conditions.faces + 1)).astype(np.float64))
    most = max(problem.offsets().shape[1], int(LARGEST_SHARE_OF_READINGS * len(problem)))
    shared = np.concatenate(parts, axis=1)[:, :most]
    own: list[Floats] = []
    sizes = np.bincount(axes.run_index)
    for run in np.flatnonzero(sizes >= SMOOTHEST_OWN_PATTERN):
        here = (axes.run_index == run).astype(np.float64)[:, None]
        own.append(here * np.column_stack([waves[1], axes.within_run]))
    whole = np.concatenate([shared, *own], axis=1)[:, :most]
    basis = orthonormal(whole)
    left = np.maximum(1.0 - np.einsum("ij,ij->i", basis, basis), LEAST_LEFT)
    return Dictionary(shared=orthonormal(shared), whole=basis, left=left)


def orthonormal(columns: Floats, *, tolerance: float = 1e-6) -> Floats:
    """[rows, rank]: orthonormal basis of the columns' span; columns that add next to nothing are left out."""
    length = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    kept = columns[:, length > 0] / length[length > 0]
    if kept.shape[1] == 0:
        return kept
    # By the Gram matrix: a thousand times faster than a decomposition of the columns, and its loss of half the
    # digits only decides about columns that are the sum of others to one part in a thousand.
    values, vectors = np.linalg.eigh(kept.T @ kept)
    used = values > tolerance * values[-1]
    basis = kept @ (vectors[:, used] / np.sqrt(values[used]))
    return np.asarray(basis)


def clean(
    problem: Problem, dictionary: Dictionary, *, scale_group: Integers, mean_arcsec: Floats | None = None
) -> Cleaned:
    """Clean the errors about `mean_arcsec`; `scale_group`: [readings], those of equal scatter."""
    mean = np.zeros(len(problem)) if mean_arcsec is None else mean_arcsec
    neighbours = _neighbours(problem)
    place = np.floor(np.mod(problem.conditions.angle_deg, 360.0)).astype(np.int64) % PLACES
    run = axes_of(problem.conditions).run_index
    error = problem.error_arcsec - mean
    replaced = np.zeros(error.size, dtype=bool)
    drawn_in = np.zeros(error.size, dtype=bool)
    for _ in range(PEELINGS):
        away, scale = _away(error, dictionary, neighbours, scale_group, run)
        wild = np.abs(away) > PEELED * scale
        wild &= ~_common(wild, place, SHARE_OF_RUN, fewest=3)
        worst = _worst_of_run(np.abs(away) / scale, wild, run)
        if worst.size == 0:
            break
        error[worst] -= away[worst]
        replaced[worst] = True
    residual = error - dictionary.shared @ (dictionary.shared.T @ error)
    for burst in _bursts(residual, problem, scale_group):
        # The height that least squares gives a column of its own, not the part that the dictionary leaves of it.
        taken_up = float(np.sum(dictionary.shared[burst.rows].sum(axis=0) ** 2))
        height = float(np.sum(residual[burst.rows])) / max(
            burst.rows.size - taken_up, LEAST_LEFT * burst.rows.size
        )
        error[burst.rows] -= height
        replaced[burst.rows] = True
    for _ in range(2):
        away, scale = _away(error, dictionary, neighbours, scale_group, run)
        size = np.abs(away) / scale
        suspect = size > SUSPECT
        suspect &= ~_common(suspect, place, SHARE_AT_PLACE, fewest=3) & ~_common(
            suspect, run, SHARE_OF_RUN, fewest=8
        )
        far = suspect & (size > OUTLIER)
        near = suspect & ~far
        error[far] -= away[far]
        error[near] -= np.sign(away[near]) * 2.0 * scale[near]
        replaced |= far
        drawn_in |= near
    return Cleaned(error_arcsec=error + mean, replaced=replaced, drawn_in=drawn_in & ~replaced)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Burst:
    """Neighbouring readings of one run that are off together."""

    rows: Integers
    height: float
    run: int
    ordinary: bool
    """The rest of the run is like other runs."""


def _bursts(residual: Floats, problem: Problem, scale_group: Integers) -> list[_Burst]:
    """Bursts in few runs; in many, or in runs that are odd beside them, they are structure and left alone."""
    found: list[_Burst] = []
    runs = _runs_in_time(problem)
    variance = np.empty(residual.size)
    for each in np.unique(scale_group):
        here = scale_group == each
        spread = [
            float(np.mean((residual[r] - residual[r].mean()) ** 2)) for r in runs if scale_group[r[0]] == each
        ]
        robust = NORMAL_OVER_MAD * float(np.median(np.abs(residual[here] - np.median(residual[here]))))
        variance[here] = max(min(float(np.median(spread)), 1.5 * robust**2), 1e-18)
    for number, rows in enumerate(runs):
        values = residual[rows] - np.mean(residual[rows])
        for _ in range(2):
            burst = _burst_of_run(values, rows, number, float(variance[rows[0]]))
            if burst is None:
                break
            found.append(burst)
            values[np.isin(rows, burst.rows)] -= burst.height
            values -= np.mean(values)
    odd = {burst.run for burst in found if not burst.ordinary}
    # With the offsets free a burst that begins or ends its run is a step, and so are two that go on in each other.
    odd |= {burst.run for burst in found if _is_step(burst, runs)}
    odd |= {
        one.run
        for one, other in pairwise(sorted(found, key=lambda burst: (burst.run, _place(burst, runs)[0])))
        if one.run == other.run
        and _place(one, runs)[1] + 1 == _place(other, runs)[0]
        and one.height * other.height > 0
    }
    found = [burst for burst in found if burst.run not in odd]
    few = max(1, round(RUNS_WITH_BURST * len(runs)))
    return found if len({burst.run for burst in found} | odd) <= few else []


def _place(burst: _Burst, runs: Sequence[Integers]) -> tuple[int, int]:
    """First and last reading of a burst, counted in its run."""
    places = np.flatnonzero(np.isin(runs[burst.run], burst.rows))
    return int(places[0]), int(places[-1])


def _is_step(burst: _Burst, runs: Sequence[Integers]) -> bool:
    """A reading that noise has pushed back may stand between a step and its end of the run."""
    first, last = _place(burst, runs)
    return burst.rows.size > LONGEST_AT_END and (first <= 1 or last >= runs[burst.run].size - 2)


def _burst_of_run(values: Floats, rows: Integers, number: int, variance: float) -> _Burst | None:
    n = rows.size
    best, where = 0.0, (0, 0)
    for length in range(2, min(LONGEST_BURST, n // 3) + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        total = windows.sum(axis=1)
        # Without its largest reading, so that one wild reading is no burst.
        largest = np.take_along_axis(windows, np.argmax(np.abs(windows), axis=1)[:, None], axis=1)[:, 0]
        without, mean = (total - largest) / (length - 1), total / length
        height = np.where(without * mean > 0, np.minimum(np.abs(without), np.abs(mean)), 0.0)
        gain = height**2 * length * n / (n - length)
        place = int(np.argmax(gain))
        if gain[place] > best:
            best, where = float(gain[place]), (place, length)
    if best < 2.0 * BURST_GAIN * variance:
        return None
    inside = np.zeros(n, dtype=bool)
    inside[where[0] : where[0] + where[1]] = True
    rest = values[~inside]
    return _Burst(
        rows=rows[inside],
        height=float(np.mean(values[inside]) - np.median(rest)),
        run=number,
        ordinary=(NORMAL_OVER_MAD * float(np.median(np.abs(rest - np.median(rest))))) ** 2
        <= ORDINARY_REST * variance,
    )


def _runs_in_time(problem: Problem) -> list[Integers]:
    """Rows of each run in the order of time."""
    run, time_s = problem.conditions.run, problem.conditions.time_s
    found: list[Integers] = []
    for each in np.unique(run):
        rows = np.flatnonzero(run == each)
        found.append(rows if time_s is None else rows[np.argsort(time_s[rows], kind="stable")])
    return found


def _away(
    error: Floats, dictionary: Dictionary, neighbours: Integers, scale_group: Integers, run: Integers
) -> tuple[Floats, Floats]:
    """How far each reading is from the median of its neighbours, and the scatter it has there, both [readings].

    What the dictionary took up of a single wild reading is given back to it (leave-one-out residual); readings at
    the ends of a run, where a slope holds on to them, would hide otherwise.
    """
    residual = error - dictionary.whole @ (dictionary.whole.T @ error)
    away = residual / dictionary.left - np.median(residual[neighbours], axis=1)
    spread = 1.0 / np.sqrt(dictionary.left)
    return away, _scale(away / spread, scale_group, run) * spread


def _neighbours(problem: Problem) -> Integers:
    """[readings, 4]: the nearest four in time of the same run (of a run of fewer, some twice)."""
    found = np.empty((len(problem), 4), dtype=np.int64)
    for rows in _runs_in_time(problem):
        n = rows.size
        if n < 5:
            found[rows] = rows[np.resize(np.arange(n), 4)]
            continue
        low = np.clip(np.arange(n) - 2, 0, n - 5)
        window = low[:, None] + np.arange(5)
        others = window[window != np.arange(n)[:, None]].reshape(n, 4)
        found[rows] = rows[others]
    return found


def _scale(away: Floats, scale_group: Integers, run: Integers) -> Floats:
    """[readings]: robust standard deviation of the reading's group, or of its run where that is larger."""
    scale = np.empty(away.size)
    for each in np.unique(scale_group):
        here = scale_group == each
        scale[here] = NORMAL_OVER_MAD * np.median(np.abs(away[here]))
    for each in np.unique(run):
        here = run == each
        if int(here.sum()) >= 10:
            scale[here] = np.maximum(scale[here], NORMAL_OVER_MAD * np.median(np.abs(away[here])))
    return np.maximum(scale, 1e-12)


def _common(flagged: Mask, group: Integers, share: float, *, fewest: int) -> Mask:
    """[readings]: in a group where the flagged are no exception."""
    count = np.bincount(group)
    found = np.bincount(group, weights=flagged)
    common = (count >= fewest) & (found >= np.maximum(2.0, share * count))
    return common[group]


def _worst_of_run(size: Floats, wild: Mask, run: Integers) -> Integers:
    candidates = np.flatnonzero(wild)
    order = candidates[np.argsort(-size[candidates], kind="stable")]
    _, first = np.unique(run[order], return_index=True)
    return order[first]
