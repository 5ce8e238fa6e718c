"""The uncertainty budget of a corrected angle, after the GUM (JCGM 100:2008): u_c² = sum of u_i², U = 2 u_c.

All contributions are standard uncertainties of the angle from the datum at the same temperature, as root mean
squares over the turn and the valid temperatures, and taken as independent, eq. (10).

- Reference and temperature sensor as stated (type B); the sensor acts through |dE/dT|, a central difference.
- Model: what the file serves, less the reference and the sensor, which the training has put into it. Where a file
  serves no uncertainty, its error at held-out data or, failing that, the scatter of the readings about it stands
  here: not the same, and said to be so.
- Repeatability: scatter of one reading, type A, from repeats where there are any. It contains the rounding to
  counts and the autocollimator's noise; the rounding q / sqrt(12) counts by itself only where it is the larger
  (EA-4/02 M: 2022).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import ARCSEC_PER_TURN
from trueangle_training.evaluation.held_out import repeatability_arcsec
from trueangle_training.report.inputs import ReportInputs, ReportReadings
from trueangle_training.report.residuals import Residuals
from trueangle_training.uncertainty import SLOPE_STEP_C

Floats = NDArray[np.float64]

COVERAGE_FACTOR = 2.0
GRID_ANGLES, GRID_TEMPERATURES = 360, 31


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """One line of the budget."""

    name: str
    kind: str
    """A: from readings; B: from other knowledge."""
    uncertainty_arcsec: float | None
    """k = 1; None: not stated."""
    how: str
    counted: bool = True
    """Whether it is part of the sum: what another line contains is shown but not added again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """The budget and what it adds up to."""

    contributions: tuple[Contribution, ...]
    """Of the corrected angle, the reading's own scatter apart."""
    reading: tuple[Contribution, ...]
    """What one reading adds."""
    combined_arcsec: float
    """u_c of the corrected angle."""
    largest_arcsec: float | None
    """Largest u on the grid as served; None: the file serves none."""
    combined_reading_arcsec: float
    """u_c with one reading's scatter."""
    slope_arcsec_per_c: float
    """RMS of dE/dT."""
    model_knows: bool
    """Whether the model's part is the file's own uncertainty."""

    @property
    def expanded_arcsec(self) -> float:
        """U (k = 2) of the corrected angle, RMS over the valid ranges."""
        return COVERAGE_FACTOR * self.combined_arcsec

    @property
    def largest_expanded_arcsec(self) -> float | None:
        """U (k = 2) that holds at every valid angle and temperature; None: the file serves none."""
        return (
            None
            if self.largest_arcsec is None
            else COVERAGE_FACTOR * max(self.largest_arcsec, self.combined_arcsec)
        )

    @property
    def largest_expanded_reading_arcsec(self) -> float | None:
        """The same of one corrected reading, whose scatter is the same everywhere."""
        if self.largest_expanded_arcsec is None:
            return None
        scatter_square = self.combined_reading_arcsec**2 - self.combined_arcsec**2
        return float(np.hypot(self.largest_expanded_arcsec, COVERAGE_FACTOR * max(scatter_square, 0.0) ** 0.5))

    @property
    def expanded_reading_arcsec(self) -> float:
        """U (k = 2) of one corrected reading, RMS over the valid ranges."""
        return COVERAGE_FACTOR * self.combined_reading_arcsec


def uncertainty_budget(inputs: ReportInputs, report: ReportReadings, found: Residuals) -> Budget:
    """The budget over the model's valid ranges."""
    repeated = repeatability_arcsec(report.readings)
    angle_deg, temperature_c = valid_grid(inputs)
    served = inputs.model.uncertainty_arcsec(angle_deg, temperature_c)
    reference = inputs.metadata.reference.standard_uncertainty_arcsec
    sensor_c = None if inputs.joint is None else inputs.joint.temperature_sensor.standard_uncertainty_c or None
    slope = _slope_rms(inputs, angle_deg, temperature_c)
    sensor = None if sensor_c is None else slope * sensor_c
    if not inputs.metadata.temperature_used:
        sensor = 0.0
    total = None if served is None else float(np.sqrt(np.mean(served**2)))
    model, how = _model_part(total, reference, sensor, found, inputs.metadata.errors.held_out_rmse_arcsec)
    contributions = (
        Contribution(name="Reference angle", kind="B", uncertainty_arcsec=reference, how=_reference_text(inputs)),
        Contribution(name="Model", kind="A", uncertainty_arcsec=model, how=how),
        Contribution(
            name="Temperature sensor",
            kind="B",
            uncertainty_arcsec=sensor,
            how=_sensor_text(inputs, slope, sensor_c, in_model=total is not None),
        ),
    )
    parts = (reference, model, sensor)
    combined = float(np.sqrt(sum(part**2 for part in parts if part is not None)))
    reading = _reading_part(inputs, found.rms_arcsec if repeated is None else repeated, repeated is not None)
    with_reading = np.sqrt(
        combined**2 + sum((each.uncertainty_arcsec or 0) ** 2 for each in reading if each.counted)
    )
    return Budget(
        contributions=contributions,
        reading=reading,
        combined_arcsec=combined,
        largest_arcsec=None if served is None else float(served.max()),
        combined_reading_arcsec=float(with_reading),
        slope_arcsec_per_c=slope,
        model_knows=served is not None,
    )


def valid_grid(inputs: ReportInputs) -> tuple[Floats, Floats]:
    """Angles and temperatures over the valid ranges, flat."""
    valid_deg, valid_c = inputs.metadata.valid_angle_deg, inputs.metadata.valid_temperature_c
    step = (valid_deg.maximum - valid_deg.minimum) / GRID_ANGLES
    angles = np.asarray(valid_deg.minimum + step * (np.arange(GRID_ANGLES) + 0.5), dtype=np.float64)
    angle_deg, temperature_c = np.meshgrid(
        angles,
        np.linspace(valid_c.minimum, valid_c.maximum, GRID_TEMPERATURES),
    )
    return angle_deg.ravel(), temperature_c.ravel()


def _slope_rms(inputs: ReportInputs, angle_deg: Floats, temperature_c: Floats) -> float:
    above = inputs.model.correction_arcsec(angle_deg, temperature_c + SLOPE_STEP_C)
    below = inputs.model.correction_arcsec(angle_deg, temperature_c - SLOPE_STEP_C)
    return float(np.sqrt(np.mean((above - below) ** 2))) / (2.0 * SLOPE_STEP_C)


def _model_part(
    total: float | None,
    reference: float | None,
    sensor: float | None,
    found: Residuals,
    held_out: float | None,
) -> tuple[float, str]:
    if total is None:
        if held_out is not None and held_out > found.rms_arcsec:
            return (
                held_out,
                "this method knows no uncertainty of its own; in its place its RMS error at held-out data",
            )
        return found.rms_arcsec, (
            "this method knows no uncertainty of its own; in its place the scatter of the readings about it, "
            "which says nothing about other angles and temperatures"
        )
    rest = max(total**2 - (reference or 0.0) ** 2 - (sensor or 0.0) ** 2, 0.0)
    return float(np.sqrt(rest)), "as served, RMS over the valid ranges" + (
        ", the reference's and the sensor's part taken off" if reference or sensor else ""
    )


def _reading_part(inputs: ReportInputs, noise_arcsec: float, repeated: bool) -> tuple[Contribution, ...]:
    lines = [
        Contribution(
            name="Repeatability of one reading",
            kind="A",
            uncertainty_arcsec=noise_arcsec,
            how="from the repeats of each place and temperature"
            if repeated
            else "nothing is repeated: scatter of the readings about the model, the zero of each run taken off",
        )
    ]
    encoder = inputs.metadata.encoder
    if encoder is None:
        how = "counts a turn not stated"
        lines.append(Contribution(name="Resolution", kind="B", uncertainty_arcsec=None, how=how, counted=False))
        return tuple(lines)
    count_arcsec = ARCSEC_PER_TURN / encoder.counts_per_rev
    resolution = count_arcsec / 12**0.5
    counted = resolution > noise_arcsec
    lines.append(
        Contribution(
            name="Resolution",
            kind="B",
            uncertainty_arcsec=resolution,
            how=f"one count is {count_arcsec:.3g}″, rectangular, / √12"
            + ("" if counted else "; contained in the repeatability, not added again"),
            counted=counted,
        )
    )
    return tuple(lines)


def _reference_text(inputs: ReportInputs) -> str:
    reference = inputs.metadata.reference
    if reference.standard_uncertainty_arcsec is None:
        return "not stated: the figures below leave it out and are no uncertainty of the angle"
    certificate = f", certificate {reference.certificate_id}" if reference.certificate_id else ""
    return f"{reference.kind} as stated at the training{certificate}"


def _sensor_text(inputs: ReportInputs, slope: float, sensor_c: float | None, *, in_model: bool) -> str:
    if not inputs.metadata.temperature_used:
        return "the model ignores temperature"
    if sensor_c is None:
        known = "; where the training knew it, it is in the line above" if in_model else ""
        return f"u(T) not stated here (--joint){known}; |dE/dT| is {slope:.3f}″/K RMS"
    return f"u(T) = {sensor_c:.3g} K times |dE/dT| = {slope:.3f}″/K RMS"
