"""The noise of a campaign: a scale for each run and a colour for each kind of run.

Noise at frequency f of a run, in the run's cosine transform, has the variance
s_run^2 S_kind(f), S(f) = w (1 + A ((f^2 + f_c^2) / f_0^2)^(-alpha / 2)): white plus a power law (drift of the air,
of the autocollimator, of the clamping), flat below a corner. It is found on what a wide dictionary of smooth
patterns leaves, by least absolute deviations over frequencies, so that one odd frequency stays an effect.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.cleaning import orthonormal
from trueangle_training.diagnosis.spectra import RunTransform
from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_LEFT = 0.3
"""Share of a row's variance that the dictionary must leave for the row to count."""
CELL = 12
"""Rows of one frequency cell."""
EXPONENTS = (0.5, 1.0, 1.5, 2.0)
CORNERS = (0.0, 2.0, 6.0, 20.0)
"""Times the lowest frequency."""
AMPLITUDES = tuple(float(a) for a in np.geomspace(0.1, 1e4, 26))
"""At the lowest frequency, over the white level."""
WHITE_PRIOR = 2.0
"""Nats against noise that is white."""
USUAL_AMPLITUDE = 3.0
"""Beyond it colour is the less likely the stronger it is; a campaign without any drift is rarer than one with."""
SCALE_FREEDOM = 25.0
"""Degrees of freedom with which a run's own scale is drawn to that of its kind."""
ODD_RUN = 3.0
"""Times the median variance: the run's residual may be an effect, so its scale is taken at high frequencies."""
DENSE_RUN = 150
FEWEST_RUNS_AT_FREQUENCY = 8
HIDDEN = 0.7
"""Of what the shared patterns leave of a row: with less, patterns of single runs hide it."""
LEVEL_PRIOR = 6.0
"""Rows' worth of trust in the continued spectrum."""
TWO_DECADES = 4.6
"""Variance of 1 / f noise over two decades of frequency, over its power at the upper end times that frequency."""
SLOW_S = 20_000.0
"""Hours over which air and stand drift together."""
SAME_CONDITION = 0.05
"""Relative difference up to which runs have one temperature, load or speed."""
FEWEST_FREE_MEANS = 3
"""Means of runs beyond the lines through them, from which their scatter is told."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Variance of each row of the run-wise cosine transform."""

    transform: RunTransform
    variance: Floats
    """[rows], arcsec^2"""
    run_variance: Floats
    """[runs] as found in each run, not drawn to its kind, arcsec^2; NaN: nothing left to judge it by."""
    run_freedom: Floats
    """[runs]: degrees of freedom behind `run_variance`."""
    colour: Floats
    """[runs]: noise power at the run's lowest frequency over that at its highest."""
    offset_rows: Integers
    """The transformed rows that hold the means of runs which share a zero with other runs."""
    offset_root: Floats
    """[offset rows, offset rows]: takes these means to unit variance; between runs the zero itself wanders."""

    @property
    def sigma_arcsec(self) -> float:
        """Standard deviation of one reading within its run."""
        return float(np.sqrt(np.mean(self.variance[self.transform.half_cycles > 0])))

    def whiten(self, values: Floats) -> Floats:
        """[rows] or [rows, columns]: transformed, and of unit variance where it is noise."""
        transformed = self.transform(values)
        scale = 1.0 / np.sqrt(self.variance)
        white = transformed * (scale if values.ndim == 1 else scale[:, None])
        if self.offset_rows.size:
            white[self.offset_rows] = self.offset_root @ transformed[self.offset_rows]
        return white

    def whiten_stacked(self, transformed: NDArray[np.floating]) -> NDArray[np.floating]:
        """[columns, rows] that are transformed already."""
        kind = transformed.dtype
        white = transformed * (1.0 / np.sqrt(self.variance)).astype(kind)[None, :]
        if self.offset_rows.size:
            white[:, self.offset_rows] = transformed[:, self.offset_rows] @ self.offset_root.T.astype(kind)
        return white


def run_kinds(conditions: Conditions, transform: RunTransform) -> Integers:
    """[runs]: runs of one kind (reference, moving or not, dense or not) share their colour."""
    kinds: list[tuple[bool, bool, bool]] = []
    for rows in transform.rows:
        face, velocity = conditions.face, conditions.velocity_deg_s
        polygon = face is not None and float(np.mean(face[rows] > 0)) > 0.5
        moving = velocity is not None and float(np.median(np.abs(velocity[rows]))) > 1e-3
        kinds.append((polygon, moving, rows.size >= DENSE_RUN))
    names = sorted(set(kinds))
    return np.array([names.index(kind) for kind in kinds], dtype=np.int64)


def estimate_noise(
    error_arcsec: Floats,
    dictionary: Floats,
    transform: RunTransform,
    kinds: Integers,
    conditions: Conditions,
    *,
    shared: Floats | None = None,
    rounds: int = 3,
) -> NoiseModel:
    """Noise of cleaned errors, the mean of which lies in the span of `dictionary` ([rows, columns]).

    `dictionary` may be any basis of its span; `kinds`: [runs]. `shared`: the part of it without patterns of single
    runs, given where nothing is drawn anew in each run: what is seen at the frequencies of such patterns is noise.
    """
    design = transform(dictionary)
    error = transform(error_arcsec)
    variance = np.full(error.size, max(float(np.var(error)), 1e-12))
    runs = transform.run_index
    own, freedom = np.empty(0), np.empty(0)
    shape = np.ones(error.size)
    for _ in range(rounds):
        scale = 1.0 / np.sqrt(variance)
        basis = orthonormal(design * scale[:, None])
        whitened = error * scale
        residual = (whitened - basis @ (basis.T @ whitened)) / scale
        left = np.maximum(1.0 - np.einsum("ij,ij->i", basis, basis), 1e-6)
        usable = (left > LEAST_LEFT) & (transform.half_cycles > 0)
        if not usable.any():
            break
        energy = residual**2 / left
        own, freedom = _run_variances(energy / shape, left, usable, transform)
        drawn = _drawn_to_kind(own, freedom, kinds, energy / shape, usable, transform)
        shape = _shapes(energy / drawn[runs], usable, transform, kinds)
        own, freedom = _run_variances(energy / shape, left, usable, transform)
        drawn = _drawn_to_kind(own, freedom, kinds, energy / shape, usable, transform)
        variance = np.maximum(drawn[runs] * shape, 1e-18)
    if shared is not None and own.size:
        variance = _raised_where_hidden(error, transform(shared), design, variance, transform, kinds)
    if own.size == 0:
        count = len(transform.rows)
        own, freedom = np.full(count, np.nan), np.zeros(count)
    offset_rows, offset_root = _wandering_zero(error, variance, transform, conditions)
    return NoiseModel(
        transform=transform,
        variance=variance,
        offset_rows=offset_rows,
        offset_root=offset_root,
        run_variance=own,
        run_freedom=freedom,
        colour=_colour(shape, transform),
    )


def _raised_where_hidden(
    error: Floats, shared: Floats, whole: Floats, variance: Floats, transform: RunTransform, kinds: Integers
) -> Floats:
    """The variance, raised to what the shared patterns leave where patterns of single runs hide it.

    There the spectrum was continued from higher frequencies, and noise with a memory of a few readings has its
    knee just below them.
    """
    scale = 1.0 / np.sqrt(variance)
    basis = orthonormal(shared * scale[:, None])
    white = error * scale
    white = white - basis @ (basis.T @ white)
    left = np.maximum(1.0 - np.einsum("ij,ij->i", basis, basis), 1e-6)
    hidden_by = orthonormal(whole * scale[:, None])
    visible = np.maximum(1.0 - np.einsum("ij,ij->i", hidden_by, hidden_by), 0.0)
    raised = variance.copy()
    kind_of_row = kinds[transform.run_index]
    for kind in np.unique(kinds):
        for j in np.unique(transform.half_cycles[kind_of_row == kind]):
            rows = np.flatnonzero((kind_of_row == kind) & (transform.half_cycles == j) & (left > LEAST_LEFT))
            if j == 0 or rows.size < FEWEST_RUNS_AT_FREQUENCY:
                continue
            if float(np.mean(visible[rows])) > HIDDEN * float(np.mean(left[rows])):
                continue
            energy = white[rows] ** 2 / left[rows]
            energy = np.minimum(energy, 9.0 * float(np.mean(energy)))
            level = (float(np.sum(energy)) + LEVEL_PRIOR) / (rows.size + LEVEL_PRIOR)
            raised[rows] *= max(level, 1.0)
    return raised


def _run_variances(
    energy: Floats, left: Floats, usable: NDArray[np.bool_], transform: RunTransform
) -> tuple[Floats, Floats]:
    """Mean energy of each run's usable rows, the largest ones drawn in, and its degrees of freedom."""
    count = len(transform.rows)
    own, freedom = np.full(count, np.nan), np.zeros(count)
    for run, rows in enumerate(transform.rows):
        here = rows[usable[rows]]
        if here.size == 0:
            continue
        values = energy[here]
        # 9 times the mean of a chi-squared of one degree of freedom is passed once in 370 rows.
        for _ in range(2):
            values = np.minimum(values, 9.0 * float(np.mean(values)))
        own[run] = float(np.average(values, weights=left[here]))
        freedom[run] = float(np.sum(left[here]))
    return own, freedom


def _drawn_to_kind(
    own: Floats,
    freedom: Floats,
    kinds: Integers,
    energy: Floats,
    usable: NDArray[np.bool_],
    transform: RunTransform,
) -> Floats:
    """[runs]: each run's variance drawn to the median of its kind; an odd run's by its high frequencies."""
    drawn = own.copy()
    overall = float(np.nanmedian(own))
    for kind in np.unique(kinds):
        members = np.flatnonzero(kinds == kind)
        known = members[np.isfinite(own[members])]
        centre = float(np.median(own[known])) if known.size else overall
        for run in members:
            value = own[run] if np.isfinite(own[run]) else centre
            if known.size >= 3 and value > ODD_RUN * centre:
                rows = transform.rows[run]
                fast = rows[usable[rows] & (transform.half_cycles[rows] > rows.size / 2)]
                fine = float(np.mean(energy[fast])) if fast.size >= 4 else centre
                # The median of a chi-squared of one degree of freedom is 0.455 times its mean.
                fine = min(fine, float(np.median(energy[rows[usable[rows]]])) / 0.455)
                value = min(value, max(centre, 1.3 * fine))
            weight = freedom[run] if np.isfinite(own[run]) else 0.0
            drawn[run] = (weight * value + SCALE_FREEDOM * centre) / (weight + SCALE_FREEDOM)
    return np.maximum(drawn, 1e-18)


def _shapes(energy: Floats, usable: NDArray[np.bool_], transform: RunTransform, kinds: Integers) -> Floats:
    """[rows]: S of each row, with mean 1 over a run's rows beyond the mean."""
    shape = np.ones(energy.size)
    runs = transform.run_index
    for kind in np.unique(kinds):
        of_kind = kinds[runs] == kind
        rows = np.flatnonzero(of_kind & usable)
        if rows.size < 3 * CELL:
            continue
        frequency, level, freedom = _cells(transform.frequency_hz[rows], energy[rows])
        lowest = float(frequency[0])
        every = np.flatnonzero(of_kind)
        asked = transform.frequency_hz[every]
        # The run's mean lies half a step below its slowest cosine.
        steps = 1.0 / np.maximum([2.0 * rows.size for rows in transform.rows], 1.0)
        own_step = np.array([transform.frequency_hz[r].max() / max(r.size - 1, 1) for r in transform.rows])
        asked = np.where(asked > 0, asked, 0.5 * np.where(own_step > 0, own_step, steps)[runs[every]])
        shape[every] = _averaged_spectrum(frequency, level, freedom, asked, lowest)
    for rows in transform.rows:
        beyond = rows[transform.half_cycles[rows] > 0]
        if beyond.size:
            shape[rows] /= float(np.mean(shape[beyond]))
    return shape


def _cells(frequency: Floats, energy: Floats) -> tuple[Floats, Floats, Floats]:
    """Frequency, level and freedom of cells that grow with frequency.

    The level of a cell is the median over dozens of rows, so that a few orders with an effect do not raise it.
    """
    order = np.argsort(frequency, kind="stable")
    frequency, energy = frequency[order], energy[order]
    centre: list[float] = []
    level: list[float] = []
    freedom: list[float] = []
    start = 0
    while start < order.size:
        size = max(CELL, start // 8 // CELL * CELL)
        stop = start + size if order.size - (start + size) >= CELL else order.size
        blocks = [
            float(np.mean(np.minimum(part, 9.0 * np.mean(part))))
            for part in np.array_split(energy[start:stop], max(1, (stop - start) // CELL))
        ]
        centre.append(float(np.exp(np.mean(np.log(np.maximum(frequency[start:stop], 1e-12))))))
        # The median of a chi-squared of 12 degrees of freedom is 0.945 times its mean (Wilson and Hilferty 1931).
        level.append(blocks[0] if len(blocks) == 1 else float(np.median(blocks)) / 0.945)
        freedom.append(float(stop - start) / (1.0 if len(blocks) == 1 else 1.5))
        start = stop
    return np.array(centre), np.maximum(np.array(level), 1e-12), np.array(freedom)


def _averaged_spectrum(frequency: Floats, level: Floats, freedom: Floats, asked: Floats, lowest: float) -> Floats:
    """S at the frequencies asked for, averaged over all laws by how well they describe the cells."""
    spread = 1.2 * np.sqrt(2.0 / freedom)
    # Laplace rather than Gauss: single cells with an effect in them must not bend the law.
    weight = np.sqrt(2.0) / spread
    laws = [(0.0, 0.0, 1.0)] + [(a, c, e) for e in EXPONENTS for c in CORNERS for a in AMPLITUDES]
    amplitude, corner, exponent = (np.array(each) for each in zip(*laws, strict=True))
    shapes = _law(frequency[None, :], lowest, amplitude, corner, exponent)
    difference = np.log(level)[None, :] - np.log(shapes)
    # The white level that suits each law best.
    base = _weighted_median(difference, weight)
    score = -np.sum(weight * np.abs(difference - base[:, None]), axis=1)
    score[1:] -= np.log(1.0 + amplitude[1:] / USUAL_AMPLITUDE)
    score[1:] -= np.log(np.mean(1.0 / (1.0 + amplitude[1:] / USUAL_AMPLITUDE)) * (len(laws) - 1))
    score[0] -= WHITE_PRIOR
    score -= score.max()
    share = np.exp(score)
    share /= share.sum()
    used = share > 1e-4
    # Below the lowest cell nothing was seen: there the law may rise no faster than 1 / f.
    inside = np.maximum(asked, lowest)
    values = np.exp(base[used])[:, None] * _law(
        inside[None, :], lowest, amplitude[used], corner[used], exponent[used]
    )
    white = np.exp(base[used])[:, None]
    below = np.where(asked < lowest, lowest / np.maximum(asked, 1e-12), 1.0)[None, :]
    rising = corner[used, None] == 0
    values = np.where(rising, white + (values - white) * below, values)
    return np.sum((share[used] / share[used].sum())[:, None] * values, axis=0)


def _law(frequency: Floats, lowest: float, amplitude: Floats, corner: Floats, exponent: Floats) -> Floats:
    ratio = np.sqrt((frequency / lowest) ** 2 + corner[:, None] ** 2) / np.sqrt(1.0 + corner[:, None] ** 2)
    return 1.0 + amplitude[:, None] * ratio ** (-exponent[:, None])


def _weighted_median(values: Floats, weight: Floats) -> Floats:
    """[laws] of [laws, cells]."""
    order = np.argsort(values, axis=1)
    cumulated = np.cumsum(weight[order], axis=1)
    place = np.argmax(cumulated >= 0.5 * cumulated[:, -1:], axis=1)
    rows = np.arange(values.shape[0])
    return values[rows, order[rows, place]]


def _wandering_zero(
    error: Floats, variance: Floats, transform: RunTransform, conditions: Conditions
) -> tuple[Integers, Floats]:
    """Rows of the means of runs that share a zero, and the inverse root of their covariance.

    The zero wanders by v between such runs, half of it at each run, half of it slowly (an exponential correlation
    over hours). v is the larger of what 1 / f noise seen within the runs gives over two more decades, and of what
    the means themselves scatter by about a line in each condition, direction and signed speed among them.
    """
    group = np.array([conditions.zero_group[rows[0]] for rows in transform.rows])
    groups, size = np.unique(group, return_counts=True)
    found: list[Integers] = []
    blocks: list[Floats] = []
    for shared in groups[size >= 2]:
        runs = np.flatnonzero(group == shared)
        first = np.array([transform.rows[run][0] for run in runs], dtype=np.int64)
        count = np.array([transform.rows[run].size for run in runs], dtype=np.float64)
        means = error[first] / np.sqrt(count)
        inside = [transform.rows[run] for run in runs]
        excess = [max(float(variance[r[1]] - variance[r[-1]]), 0.0) / r.size for r in inside if r.size > 2]
        within = TWO_DECADES * float(np.median(excess)) if excess else 0.0
        wander = max(within, _scatter_of_means(means, inside, conditions))
        at_s = np.array(
            [
                np.mean(conditions.time_s[r]) if conditions.time_s is not None else i * 3600.0
                for i, r in enumerate(inside)
            ]
        )
        slow = np.exp(-np.abs(at_s[:, None] - at_s[None, :]) / SLOW_S)
        covariance = wander * (0.5 * np.eye(runs.size) + 0.5 * slow) * np.sqrt(np.outer(count, count))
        covariance += np.diag(variance[first])
        found.append(first)
        blocks.append(np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64))
    if not found:
        return np.empty(0, dtype=np.int64), np.empty((0, 0))
    rows = np.concatenate(found)
    root = np.zeros((rows.size, rows.size))
    at = 0
    for block in blocks:
        root[at : at + block.shape[0], at : at + block.shape[0]] = block
        at += block.shape[0]
    return rows, root


def _scatter_of_means(means: Floats, inside: list[Integers], conditions: Conditions) -> float:
    """Robust variance of the runs' means about what the conditions make of them; 0 with too few runs."""
    design = _conditions_of_means(inside, conditions)
    freedom = means.size - design.shape[1]
    if freedom < FEWEST_FREE_MEANS:
        return 0.0
    left = means - design @ np.linalg.lstsq(design, means, rcond=None)[0]
    return float(np.median(left**2)) / 0.455 * means.size / freedom


def _conditions_of_means(inside: list[Integers], conditions: Conditions) -> Floats:
    """[runs, columns]: lines in temperature, load, speed, velocity and direction, where the runs differ in them.

    A mean that follows a condition is an effect (latency, hysteresis), not a zero that wanders. Velocity and
    direction come last: they are left out where they would leave too few runs to see any wander by.
    """
    velocity, direction = conditions.velocity_deg_s, conditions.direction
    sizes = [
        None if each is None else np.abs(each) for each in (conditions.temperature_c, conditions.load_nm, velocity)
    ]
    design = np.ones((len(inside), 1))
    for place, values in enumerate([*sizes, velocity, direction]):
        if values is None:
            continue
        by_run = np.array([float(np.mean(values[rows])) for rows in inside])
        largest = max(float(np.max(np.abs(by_run))), 1e-9)
        column = by_run - float(np.mean(by_run))
        if float(np.ptp(by_run)) <= SAME_CONDITION * largest:
            continue
        if place >= len(sizes):
            own = column - design @ np.linalg.lstsq(design, column, rcond=None)[0]
            if np.linalg.norm(own) <= SAME_CONDITION * np.linalg.norm(column):
                continue
            if len(inside) - design.shape[1] <= FEWEST_FREE_MEANS:
                break
        design = np.column_stack([design, column])
    return design


def _colour(shape: Floats, transform: RunTransform) -> Floats:
    ratio = np.ones(len(transform.rows))
    for run, rows in enumerate(transform.rows):
        if rows.size > 2:
            ratio[run] = float(shape[rows[1]] / shape[rows[-1]])
    return ratio
