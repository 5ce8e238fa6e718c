"""Amplitude and phase of each harmonic of the measured error at each temperature, with their uncertainty.

At one temperature the errors are sum over n of c_n cos nθ + s_n sin nθ plus one free zero a run, by least squares;
A_n = |c + i s| at phase φ_n, so that the harmonic is A_n cos(nθ - φ_n). With V the covariance of (c, s),
u(A) = sqrt(g' V g), g = (cos φ, sin φ), and u(φ) = sqrt(h' V h) / A, h = (-sin φ, cos φ): GUM (JCGM 100:2008),
eq. (13).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods import distinct_angle_count
from trueangle_training.methods.separable import harmonics
from trueangle_training.report.inputs import ReportReadings
from trueangle_training.report.residuals import Residuals

Floats = NDArray[np.float64]

HIGHEST_ORDER = 11
WORST_CONDITION = 30.0
"""Of the design; beyond, the harmonics of a temperature are not told apart and are not shown."""
SIGNIFICANT = 2.0
"""Times its uncertainty an amplitude must be for its phase to mean something."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Harmonic:
    """One order at one temperature."""

    order: int
    amplitude_arcsec: float
    amplitude_uncertainty_arcsec: float
    """k = 1."""
    phase_deg: float
    """In [0, 360)."""
    phase_uncertainty_deg: float | None
    """k = 1; None: the amplitude is no more than noise, so the phase says nothing."""
    cosine_arcsec: float
    sine_arcsec: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureHarmonics:
    """All orders at one temperature."""

    temperature_c: float
    orders: tuple[Harmonic, ...]


def harmonics_by_temperature(report: ReportReadings, found: Residuals) -> tuple[TemperatureHarmonics, ...]:
    """One entry a temperature whose readings determine the harmonics, rising."""
    readings = report.readings
    entries: list[TemperatureHarmonics] = []
    for group, temperature_c in enumerate(found.temperature_c.tolist()):
        here = found.temperature_group == group
        highest = min(HIGHEST_ORDER, (distinct_angle_count(readings.angle_deg[here]) - 1) // 2)
        if highest < 1:
            continue
        zero = np.unique(readings.offset_group[here], return_inverse=True)[1]
        orders = tuple(range(1, highest + 1))
        design = np.concatenate(
            [harmonics(readings.angle_deg[here], orders), np.eye(zero.max() + 1)[zero]], axis=1
        )
        if design.shape[0] < design.shape[1] or np.linalg.cond(design) > WORST_CONDITION:
            continue
        inverse = np.linalg.inv(design.T @ design)
        solution = inverse @ design.T @ readings.error_arcsec[here]
        covariance: Floats = np.asarray(found.rms_arcsec**2 * inverse, dtype=np.float64)
        entries.append(
            TemperatureHarmonics(
                temperature_c=temperature_c,
                orders=tuple(
                    _harmonic(n, solution[2 * n - 2 : 2 * n], covariance[2 * n - 2 : 2 * n, 2 * n - 2 : 2 * n])
                    for n in orders
                ),
            )
        )
    return tuple(entries)


def _harmonic(order: int, coefficients: Floats, covariance: Floats) -> Harmonic:
    cosine, sine = float(coefficients[0]), float(coefficients[1])
    amplitude, phase_rad = float(np.hypot(cosine, sine)), float(np.arctan2(sine, cosine))
    along = np.array([np.cos(phase_rad), np.sin(phase_rad)])
    across = np.array([-np.sin(phase_rad), np.cos(phase_rad)])
    of_amplitude = float(np.sqrt(along @ covariance @ along))
    of_phase = float(np.degrees(np.sqrt(across @ covariance @ across) / amplitude)) if amplitude else None
    return Harmonic(
        order=order,
        amplitude_arcsec=amplitude,
        amplitude_uncertainty_arcsec=of_amplitude,
        phase_deg=float(np.degrees(phase_rad)) % 360.0,
        phase_uncertainty_deg=of_phase if amplitude > SIGNIFICANT * of_amplitude else None,
        cosine_arcsec=cosine,
        sine_arcsec=sine,
    )
