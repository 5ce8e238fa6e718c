"""The Fourier series of the error at the base temperature, and whether the readings determine it."""

import numpy as np

from trueangle.contract.errors import Fault
from trueangle.contract.units import wrap_deg
from trueangle_training.fourier import Floats, FourierSeries, design_matrix, fit_fourier
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError, distinct_angle_count

HIGHEST_ORDER = 11
SAME_TEMPERATURE_C = 1.0
"""Runs whose mean lies this close to the base temperature are runs at it; what spans less is one temperature."""
FEWEST_READINGS = 10
WORST_CONDITION = 10.0
"""Of the design matrix: 1.4 for equal faces, 4.7 with one of 23 missing, 48 with two neighbours missing, where the
series magnifies the noise of the readings thirtyfold inside the gap."""


def fit_base_series(readings: TrainingReadings, *, base_temperature_c: float, order: int | None) -> FourierSeries:
    """Eq. (1) through the readings of all runs whose mean temperature is the base temperature.

    `order` None: min(11, (distinct angles - 1) // 2), as many harmonics as the angles allow. Where each face was
    read equally often, least squares over the readings is that over the faces' means. UnsuitableReadingsError
    lists what is missing: readings, angles, runs at the base temperature, or any other temperature.
    """
    angle_deg = wrap_deg(readings.angle_deg)
    run_mean_c = readings.run_mean_temperature_c()
    at_base = np.abs(run_mean_c - base_temperature_c) <= SAME_TEMPERATURE_C
    faults = _extent_faults(readings, run_mean_c)
    if at_base.any():
        faults += base_angle_faults(angle_deg[at_base], order, base_temperature_c)
    else:
        faults.append(_no_base_fault(run_mean_c, base_temperature_c))
    if faults:
        raise UnsuitableReadingsError(faults)
    angle_deg = angle_deg[at_base]
    return fit_fourier(angle_deg, readings.error_arcsec[at_base], _order(angle_deg, order))


def _order(angle_deg: Floats, order: int | None) -> int:
    return min(HIGHEST_ORDER, (distinct_angle_count(angle_deg) - 1) // 2) if order is None else order


def _extent_faults(readings: TrainingReadings, run_mean_c: Floats) -> list[Fault]:
    """Too few readings, or no variation of temperature."""
    faults: list[Fault] = []
    if len(readings) < FEWEST_READINGS:
        expected = f"at least {FEWEST_READINGS}, of which some are kept apart for validation"
        faults.append(Fault(where="readings", expected=expected, found=str(len(readings))))
    lowest_c, highest_c = float(run_mean_c.min()), float(run_mean_c.max())
    if highest_c - lowest_c < SAME_TEMPERATURE_C:
        faults.append(
            Fault(
                where="temperature_c",
                expected=f"runs at temperatures that differ by {SAME_TEMPERATURE_C:g} degC or more",
                found=f"run means from {lowest_c:.2f} to {highest_c:.2f} degC",
                advice="measure at more temperatures, or use a method without temperature",
            )
        )
    return faults


def _no_base_fault(run_mean_c: Floats, base_temperature_c: float) -> Fault:
    present = ", ".join(f"{temperature_c:g}" for temperature_c in np.unique(np.round(run_mean_c)))
    return Fault(
        where="base_temperature_c",
        expected=f"runs whose mean lies within {SAME_TEMPERATURE_C:g} degC of {base_temperature_c:g} degC",
        found=f"runs at about {present} degC",
        advice="choose one of these as base_temperature_c",
    )


def base_angle_faults(angle_deg: Floats, order: int | None, base_temperature_c: float) -> list[Fault]:
    """Angles [readings at the base temperature], in [0, 360), that do not determine the series."""
    at_base = f"at the base temperature {base_temperature_c:g} degC"
    places = distinct_angle_count(angle_deg)
    if places < 3:
        expected = f"at least 3 distinct angles {at_base}, for harmonic 1"
        advice = "measure complete turns over a polygon"
        return [Fault(where="angle_deg", expected=expected, found=str(places), advice=advice)]
    harmonics = _order(angle_deg, order)
    condition = float(np.linalg.cond(design_matrix(angle_deg, harmonics)))
    if condition <= WORST_CONDITION:
        return []
    return [
        Fault(
            where="angle_deg",
            expected=f"angles all around the circle {at_base} that determine harmonics up to {harmonics}",
            found=f"{places} angles with gaps: condition {condition:.3g}, allowed {WORST_CONDITION:g}",
            advice="measure in the gaps, choose another base temperature, or ask for a lower order",
        )
    ]
