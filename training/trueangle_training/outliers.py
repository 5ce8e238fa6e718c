"""Single readings and whole runs that contradict all others: typing errors, slipped faces, mixed units.

A smooth surface, harmonics times powers of temperature with an offset for each zero group, is fitted so that what
lies far off it loses its say (iteratively reweighted least squares). What is then farther off than any noise or
unmodelled shape could be is refused by line; what is only farther off than the noise is trained on and named.
Nobody but the user takes a reading out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import Fault
from trueangle.contract.units import angle_difference_deg, wrap_deg
from trueangle_training.evaluation.held_out import SAME_PLACE_DEG, temperature_groups
from trueangle_training.file_lines import leave_out_advice, line_ranges
from trueangle_training.methods import TrainingReadings, distinct_angle_count
from trueangle_training.methods.least_squares import distinct_temperature_count
from trueangle_training.methods.separable import harmonics

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

HIGHEST_ORDER = 11
HIGHEST_DEGREE = 3
FEWEST_READINGS_A_COEFFICIENT = 2.0
"""With fewer the surface passes through its readings, wrong ones included."""
FAR_OFF = 15.0
"""Times the robust standard deviation: a normal deviate is never there, a knee in temperature neither."""
SMALLEST_OUTLIER_ARCSEC = 5.0
"""Rotary joints have local defects of a few arcseconds; they are no typing errors."""
CONSPICUOUS = 5.5
"""Times the noise known from repeats. The surface passes through as many readings as it has coefficients and
leaves long tails to the others: at 4.5 one sound campaign in twenty had a conspicuous reading."""
CONSPICUOUS_WITHOUT_REPEATS = 7.0
"""The noise is then known from the surface alone, which takes some of it: at 5.5 one sound campaign in twenty had
a conspicuous reading, at 7 none of 150."""
FROM_NEIGHBOURS = 4.5
"""Times the noise, from the median of the nearest readings at the same temperature: what the surface cannot
follow, a bump or a step over temperature, moves all of them together and is no mistake of one."""
NEIGHBOURS = 4
"""Where no other reading is at the same place."""
SMALLEST_CONSPICUOUS_ARCSEC = 0.1
"""Readings without noise leave roundings, of which one is always many times the median."""
RUN_SHARE = 0.3
"""Of a run's readings far off: the run as a whole is wrong."""
ITERATIONS = 60
RIDGE = 1e-10
NORMAL_OVER_MAD = 1.4826
ROWS_SHOWN = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contradictions:
    """Readings that contradict the others."""

    far_off: Mask
    """[readings]"""
    residual_arcsec: Floats
    """[readings], from the robust surface."""
    limit_arcsec: float
    scale_arcsec: float
    """Robust standard deviation of one reading about the surface."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConspicuousReading:
    """A reading far from all others that may still be one."""

    index: int
    """Among the readings."""
    residual_arcsec: float
    """From the robust surface."""
    over_noise: float
    """|residual| over the robust standard deviation of one reading."""


def contradictions(readings: TrainingReadings) -> Contradictions | None:
    """None: too few readings to tell."""
    design = _design(readings)
    if len(readings) < FEWEST_READINGS_A_COEFFICIENT * design.shape[1]:
        return None
    residual = _robust_residual(design, readings.error_arcsec)
    scale = NORMAL_OVER_MAD * float(np.median(np.abs(residual)))
    # The fit has used up freedom: what it leaves is smaller than the noise.
    scale /= np.sqrt(1.0 - design.shape[1] / len(readings))
    limit = max(FAR_OFF * scale, SMALLEST_OUTLIER_ARCSEC)
    return Contradictions(
        far_off=np.abs(residual) > limit, residual_arcsec=residual, limit_arcsec=limit, scale_arcsec=float(scale)
    )


def conspicuous(readings: TrainingReadings, found: Contradictions) -> tuple[ConspicuousReading, ...]:
    """Readings beyond CONSPICUOUS times the noise that their neighbours are not, the worst first.

    `found` is of the same readings.
    """
    repeats = departures_from_repeats(readings, found.residual_arcsec)
    scale, factor = found.scale_arcsec, CONSPICUOUS_WITHOUT_REPEATS
    if repeats.size:
        scale, factor = max(scale, NORMAL_OVER_MAD * float(np.median(np.abs(repeats)))), CONSPICUOUS
    size = np.abs(found.residual_arcsec)
    far = np.flatnonzero(size > max(factor * scale, SMALLEST_CONSPICUOUS_ARCSEC))
    far = far[np.abs(_from_neighbours(readings, found.residual_arcsec, far)) > FROM_NEIGHBOURS * scale]
    return tuple(
        ConspicuousReading(
            index=index,
            residual_arcsec=float(found.residual_arcsec[index]),
            over_noise=float(size[index]) / max(scale, np.finfo(np.float64).tiny),
        )
        for index in far[np.argsort(-size[far])].tolist()
    )


def _from_neighbours(readings: TrainingReadings, values: Floats, chosen: NDArray[np.intp]) -> Floats:
    """Chosen values less the median of the nearest others at the same temperature, shape [chosen]."""
    group = temperature_groups(readings)
    departure = values[chosen].copy()
    for place, index in enumerate(chosen.tolist()):
        others = np.flatnonzero(group == group[index])
        others = others[others != index]
        if others.size == 0:
            continue
        apart_deg = np.abs(angle_difference_deg(readings.angle_deg[others], float(readings.angle_deg[index])))
        # High orders differ from place to place, so that repeats of the place itself are the better witnesses.
        repeats = int(np.count_nonzero(apart_deg <= SAME_PLACE_DEG))
        nearest = others[np.argsort(apart_deg, kind="stable")[: repeats or NEIGHBOURS]]
        departure[place] -= float(np.median(values[nearest]))
    return departure


def departures_from_repeats(readings: TrainingReadings, values: Floats) -> Floats:
    """Departures from the mean of readings at the same place and temperature, scaled to the spread of one.

    Only of the readings that are repeated: empty where nothing is.
    """
    place = np.rint(wrap_deg(readings.angle_deg) / SAME_PLACE_DEG).astype(np.int64) % round(360.0 / SAME_PLACE_DEG)
    group = temperature_groups(readings)
    cell = np.unique(np.stack([group, place]), axis=1, return_inverse=True)[1].reshape(-1)
    count = np.bincount(cell)[cell]
    departure = values - (np.bincount(cell, weights=values) / np.bincount(cell))[cell]
    repeated = count > 1
    # A mean of r readings takes 1/r of the variance of each with it.
    return departure[repeated] / np.sqrt(1.0 - 1.0 / count[repeated])


def _design(readings: TrainingReadings) -> Floats:
    order = min(HIGHEST_ORDER, (distinct_angle_count(readings.angle_deg) - 1) // 2)
    degree = min(HIGHEST_DEGREE, distinct_temperature_count(readings) - 1)
    span_c = float(np.ptp(readings.temperature_c)) or 1.0
    t = 2.0 * (readings.temperature_c - float(readings.temperature_c.min())) / span_c - 1.0
    powers = t[:, None] ** np.arange(degree + 1)
    by_angle = harmonics(wrap_deg(readings.angle_deg), tuple(range(1, order + 1)))
    products = (powers[:, :, None] * by_angle[:, None, :]).reshape(len(readings), -1)
    group = readings.offset_group
    return np.concatenate([products, np.eye(int(group.max()) + 1)[group]], axis=1)


def _robust_residual(design: Floats, error_arcsec: Floats) -> Floats:
    """Residual of the least absolute deviations, by reweighting with 1 / |residual|."""
    weight = np.ones(error_arcsec.size)
    diagonal = np.arange(design.shape[1])
    residual = error_arcsec
    for _ in range(ITERATIONS):
        weighted = design * weight[:, None]
        # Normal equations will do: harmonics and powers of -1 to 1 are nearly orthogonal, and outliers are looked
        # for, not tenths. The ridge decides where places or temperatures are too few for the surface.
        gram = design.T @ weighted
        gram[diagonal, diagonal] += RIDGE * float(np.trace(gram)) / gram.shape[0]
        solution = np.linalg.solve(gram, weighted.T @ error_arcsec)
        before, residual = residual, error_arcsec - design @ solution
        size = np.abs(residual)
        if float(np.max(np.abs(residual - before))) < 1e-3 * float(np.median(size)):
            break
        weight = 1.0 / np.maximum(size, 1e-2 * float(np.median(size)) + 1e-12)
    return residual


def contradiction_faults(
    campaign: Campaign, readings: TrainingReadings, row: NDArray[np.int64], found: Contradictions
) -> list[Fault]:
    """One fault a run that is wrong as a whole, one for all single readings; `row`: the readings' file lines."""
    faults: list[Fault] = []
    single = found.far_off.copy()
    for run in np.unique(readings.run[found.far_off]).tolist():
        here = readings.run == run
        if np.mean(found.far_off[here]) <= RUN_SHARE:
            continue
        single &= ~here
        lines = row[here]
        spread, others = np.ptp(readings.error_arcsec[here]), np.ptp(readings.error_arcsec[~here])
        faults.append(
            Fault(
                where=f"{campaign.source} lines {lines.min()} to {lines.max()}, run {run}",
                expected=f"errors within {found.limit_arcsec:.3g} arcsec of the curve of all other runs",
                found=f"up to {np.abs(found.residual_arcsec[here]).max():.4g} arcsec off it "
                f"(peak to peak {spread:.4g}, others {others:.4g})",
                advice="is the run in another unit, shifted by a face or of another joint? "
                f"{leave_out_advice(lines.tolist())}",
            )
        )
    if single.any():
        lines = row[single]
        off = ", ".join(
            f"{line} ({value:+.4g} arcsec)"
            for line, value in list(zip(lines, found.residual_arcsec[single], strict=True))[:ROWS_SHOWN]
        )
        more = f", ... {lines.size} in all" if lines.size > ROWS_SHOWN else ""
        faults.append(
            Fault(
                where=f"{campaign.source}, column error_arcsec",
                expected=f"readings within {found.limit_arcsec:.3g} arcsec of the curve of all others",
                found=f"far off it: {'lines' if lines.size > 1 else 'line'} {off}{more}",
                advice=f"is it a typing error? {leave_out_advice(lines.tolist())}",
            )
        )
    return faults


def conspicuous_warnings(
    campaign: Campaign, readings: TrainingReadings, row: NDArray[np.int64], found: Contradictions
) -> tuple[str, ...]:
    """One sentence about all conspicuous readings, the worst first; none where there is none."""
    far_off = conspicuous(readings, found)
    if not far_off:
        return ()
    lines = [int(row[each.index]) for each in far_off]
    listed = "; ".join(
        f"line {line}: {readings.error_arcsec[each.index]:.4g} is {each.residual_arcsec:+.3g} arcsec off the "
        f"curve of all others, {each.over_noise:.1f} times the robust standard deviation of a reading"
        for line, each in list(zip(lines, far_off, strict=True))[:ROWS_SHOWN]
    )
    more = f"; ... {len(lines)} in all" if len(lines) > ROWS_SHOWN else ""
    option = line_ranges(lines)
    leaves_out = "" if option is None else f"; --exclude-rows {option} leaves out what was a mistake"
    advice = f"Not left out: look into the notes of the measurement{leaves_out}"
    return (f"{campaign.source}, column error_arcsec, {listed}{more}. {advice}",)
