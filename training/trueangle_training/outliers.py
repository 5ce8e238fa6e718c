"""Single readings and whole runs that contradict all others: typing errors, slipped faces, mixed units.

A smooth surface, harmonics times powers of temperature with an offset for each zero group, is fitted so that what
lies far off it loses its say (iteratively reweighted least squares). What is then farther off than any noise or
unmodelled shape could be is named; nobody but the user takes it out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import Fault
from trueangle.contract.units import wrap_deg
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
    return Contradictions(far_off=np.abs(residual) > limit, residual_arcsec=residual, limit_arcsec=limit)


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


def contradiction_faults(campaign: Campaign, readings: TrainingReadings, row: NDArray[np.int64]) -> list[Fault]:
    """One fault a run that is wrong as a whole, one for all single readings; `row`: the readings' file lines."""
    found = contradictions(readings)
    if found is None or not found.far_off.any():
        return []
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
                advice="is the run in another unit, shifted by a face or of another joint? Mend it, or leave it "
                f"out with --exclude-rows {lines.min()}-{lines.max()}",
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
                found=f"far off it: lines {off}{more}",
                advice="is it a typing error? Mend it, or leave it out with --exclude-rows "
                + ",".join(str(line) for line in lines[:ROWS_SHOWN]),
            )
        )
    return faults
