"""The measuring chain: from the shaft's true angle to the row of the campaign file."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.reading_head.contribution import Contribution, Setting
from trueangle_training.plant.reading_head.geometry import grating_error_arcsec, interpolation_error_arcsec
from trueangle_training.plant.reading_head.heat import Sensor
from trueangle_training.plant.world import Measured, zeroed

Floats = NDArray[np.float64]

EXPANSION_PER_K = 1.1e-5
"""Steel and glass alike: the grating's radius grows with temperature."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Indication:
    """What encoder and reference say of each reading, shape [n]."""

    indicated_deg: Floats
    """Of the encoder, not yet rounded to counts."""
    reference_deg: Floats


def indicate(setting: Setting, part: Contribution) -> Indication:
    """One pass through the chain without noise."""
    schedule = setting.schedule
    ripple = 1.0 + 0.01 * np.sin(np.deg2rad(6 * schedule.angle_deg))
    moved = schedule.velocity_deg_s * ripple * part.latency_s
    shaft = schedule.angle_deg - moved + np.asarray(part.twist_arcsec) / 3600.0
    radius = setting.radius_mm * (1.0 + EXPANSION_PER_K * (setting.climate.temperature_c - 20.0))
    centre_mm = np.asarray(part.centre_mm, dtype=np.complex128)
    geometry = grating_error_arcsec(
        shaft,
        radius_mm=radius,
        centre_mm=centre_mm,
        wobble_mm=part.wobble_mm,
        ovality=part.ovality,
    )
    line_deg = shaft + (geometry + np.asarray(part.head_arcsec)) / 3600.0
    shifted = np.zeros_like(line_deg)
    for shift in part.line_shifts:
        shifted = shifted + shift(line_deg)
    line_deg = line_deg + shifted / 3600.0
    signal = interpolation_error_arcsec(line_deg, lines_per_rev=setting.lines_per_rev, signals=part.signals)
    return Indication(
        indicated_deg=line_deg + signal / 3600.0 - np.asarray(part.lost_counts) * setting.count_arcsec / 3600.0,
        reference_deg=schedule.angle_deg + np.asarray(part.reference_arcsec) / 3600.0,
    )


def error_arcsec(indication: Indication) -> Floats:
    """Indicated minus reference, shape [n]."""
    return (indication.indicated_deg - indication.reference_deg) * 3600.0


def measure(
    setting: Setting,
    part: Contribution,
    *,
    sensor: Sensor,
    noise_arcsec: Floats,
    extra_noise: Floats,
    reference_step_arcsec: float,
) -> Measured:
    """Encoder rounded to counts, reference with noise and rounded, errors zeroed in each group at its first row.

    `extra_noise`: unit draws that the defects' own scatter multiplies, shape [n].
    """
    schedule = setting.schedule
    indication = indicate(setting, part)
    lattice_deg = setting.count_arcsec * part.coarse / 3600.0
    angle_deg = np.round(indication.indicated_deg / lattice_deg) * lattice_deg
    scattered = noise_arcsec + np.asarray(part.scatter_arcsec) * extra_noise
    nominal_deg = schedule.angle_deg
    said = (indication.reference_deg - nominal_deg) * 3600.0 - scattered
    said = np.round(said / reference_step_arcsec) * reference_step_arcsec
    error = (angle_deg - nominal_deg) * 3600.0 - said
    return Measured(
        angle_deg=angle_deg,
        error_arcsec=zeroed(error, schedule.zero_group),
        temperature_c=sensor.readings_c(setting.climate),
    )
