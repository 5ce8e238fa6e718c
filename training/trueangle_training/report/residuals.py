"""What the model leaves of the readings, each run's own zero taken off, and how the runs differ.

A residual is r_i = left_i - mean of its zero group, and its mean square is divided by n - groups: the zero of a
run is not known better than its readings. Nothing here is the error of the corrected angle, which needs the
reference's and the model's own uncertainty: see `budget`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.methods import TrainingReadings
from trueangle_training.outliers import CONSPICUOUS, conspicuous, contradictions, departures_from_repeats
from trueangle_training.report.inputs import ReportReadings

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_TEMPERATURE_C = 1.0
NORMAL_OVER_MAD = 1.4826
DRIFT_CHANCE = 0.001
"""Of a run of a sound campaign to be called drifted, shared among all its runs."""
COVERAGE_FACTOR = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Residuals in arcsec, each array of shape [readings] unless said otherwise."""

    centred_arcsec: Floats
    group_mean_arcsec: Floats
    """[zero groups]: what the zero of each is off by."""
    rms_arcsec: float
    """With n - groups degrees of freedom."""
    noise_arcsec: float
    """Of one reading, whatever the model: from repeats of the same place and temperature by their median absolute
    deviation; from the residuals where nothing is repeated."""
    noise_from_repeats: bool
    temperature_group: Integers
    """Number of each reading's temperature, rising."""
    temperature_c: Floats
    """[temperatures]: their means."""

    @property
    def largest_arcsec(self) -> float:
        """Largest absolute residual."""
        return float(np.abs(self.centred_arcsec).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """A reading far from all others."""

    row: int
    angle_deg: float
    temperature_c: float
    residual_arcsec: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftedRun:
    """A run whose shape differs from the other repeats at its temperature by more than noise."""

    run: int
    temperature_c: float
    amplitude_arcsec: float
    """Of the first harmonic in which it differs from the mean of all repeats at its temperature."""


def temperature_groups(readings: TrainingReadings) -> tuple[Integers, Floats]:
    """Runs whose means follow each other within 1 degC are of one temperature; numbers [readings] and means."""
    mean_c = readings.run_mean_temperature_c()
    levels = np.unique(mean_c)
    starts = np.concatenate([[False], np.diff(levels) > SAME_TEMPERATURE_C])
    group = np.cumsum(starts)[np.searchsorted(levels, mean_c)].astype(np.int64)
    means = np.bincount(group, weights=readings.temperature_c) / np.bincount(group)
    return group, means


def residuals(report: ReportReadings) -> Residuals:
    """Residuals of all readings."""
    readings, left = report.readings, report.left_arcsec
    zero = readings.offset_group
    means = np.bincount(zero, weights=left) / np.bincount(zero)
    centred = left - means[zero]
    freedom = max(len(readings) - means.size, 1)
    group, means_c = temperature_groups(readings)
    departure = departures_from_repeats(readings, centred)
    shown = centred if departure.size == 0 else departure
    return Residuals(
        centred_arcsec=centred,
        group_mean_arcsec=means,
        rms_arcsec=float(np.sqrt(np.sum(centred**2) / freedom)),
        noise_arcsec=NORMAL_OVER_MAD * float(np.median(np.abs(shown))),
        noise_from_repeats=departure.size > 0,
        temperature_group=group,
        temperature_c=means_c,
    )


def outliers(report: ReportReadings, found: Residuals) -> tuple[Outlier, ...]:
    """Readings far from all others, the worst first: those that the training names.

    Held against a robust surface through all readings, so that neither a model that follows an outlier nor one
    that fits badly hides it; against the model where there are too few readings for one.
    """
    readings = report.readings
    surface = contradictions(readings)
    if surface is None:
        size = np.abs(found.centred_arcsec)
        far = np.flatnonzero((size > CONSPICUOUS * found.noise_arcsec) & (found.noise_arcsec > 0.0))
        named = [(index, float(found.centred_arcsec[index])) for index in far[np.argsort(-size[far])].tolist()]
    else:
        named = [(each.index, each.residual_arcsec) for each in conspicuous(readings, surface)]
    return tuple(
        Outlier(
            row=int(report.row[index]),
            angle_deg=float(readings.angle_deg[index]),
            temperature_c=float(readings.temperature_c[index]),
            residual_arcsec=residual_arcsec,
        )
        for index, residual_arcsec in named
    )


def drifted_runs(report: ReportReadings, found: Residuals) -> tuple[DriftedRun, ...]:
    """Runs whose first harmonic departs from that of the other repeats.

    Over n readings cos and sin have the variance 2 s² / n each, less the run's own share in the mean of r repeats;
    (c² + s²) over that variance is then chi-squared with two degrees of freedom, whose tail is exp(-x / 2).
    """
    readings, residual = report.readings, found.centred_arcsec
    runs = np.unique(readings.run)
    coefficients, count = np.zeros((runs.size, 2)), np.zeros(runs.size)
    temperature = np.zeros(runs.size, dtype=np.int64)
    for place, run in enumerate(runs):
        here = readings.run == run
        phase_rad = np.radians(readings.angle_deg[here])
        design = np.column_stack([np.ones(phase_rad.size), np.cos(phase_rad), np.sin(phase_rad)])
        coefficients[place] = np.linalg.lstsq(design, residual[here], rcond=None)[0][1:]
        temperature[place], count[place] = found.temperature_group[here][0], phase_rad.size
    drifted: list[DriftedRun] = []
    for place, run in enumerate(runs.tolist()):
        repeats = np.flatnonzero(temperature == temperature[place])
        if repeats.size < 2 or found.noise_arcsec == 0.0:
            continue
        departure = coefficients[place] - coefficients[repeats].mean(axis=0)
        variance = 2.0 * found.noise_arcsec**2 / count[place] * (1.0 - 1.0 / repeats.size)
        chance = float(np.exp(-np.sum(departure**2) / variance / 2.0))
        if chance < DRIFT_CHANCE / runs.size:
            drifted.append(
                DriftedRun(
                    run=run,
                    temperature_c=float(found.temperature_c[temperature[place]]),
                    amplitude_arcsec=float(np.hypot(*departure)),
                )
            )
    return tuple(drifted)


def coverage(report: ReportReadings, found: Residuals, noise_arcsec: float) -> float | None:
    """Share of residuals within twice the served uncertainty and the noise together; None: none is served."""
    if report.uncertainty_arcsec is None:
        return None
    total = np.sqrt(report.uncertainty_arcsec**2 + noise_arcsec**2)
    return float(np.mean(np.abs(found.centred_arcsec) <= COVERAGE_FACTOR * total))
