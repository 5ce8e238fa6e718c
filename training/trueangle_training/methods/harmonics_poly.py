"""Harmonics times a polynomial of temperature with one free offset a run: the honest baseline without a network.

The idea of the 2019 method of the paper's authors (reference 16), with all the harmonics that the angles determine
and a low degree, so that a temperature which was not measured is interpolated instead of oscillated through.
"""

from dataclasses import dataclass

from trueangle_training.methods import Fit, Progress, TrainingReadings, distinct_angle_count, no_progress
from trueangle_training.methods.least_squares import (
    Constant,
    distinct_temperature_count,
    fit_harmonics_times_powers,
)

HIGHEST_ORDER = 11


@dataclass(frozen=True, slots=True, kw_only=True)
class HarmonicsPoly:
    """The `Method`."""

    degree: int = 2
    """Lowered to one less than the number of temperatures where these are few; the note says so."""
    name: str = "harmonics-poly"
    summary: str = "harmonics times a polynomial of temperature"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Least squares; deterministic, the seed changes nothing."""
        order = min(HIGHEST_ORDER, (distinct_angle_count(readings.angle_deg) - 1) // 2)
        temperatures = distinct_temperature_count(readings)
        degree = min(self.degree, temperatures - 1)
        fitted = fit_harmonics_times_powers(readings, order=order, degree=degree, constant=Constant.OFFSETS)
        notes = (
            (f"degree {degree} instead of {self.degree} in temperature: only {temperatures} temperatures",)
            if degree < self.degree
            else ()
        )
        return Fit(model=fitted.model, notes=notes, settings={"order": order, "degree": degree})


def make(base_temperature_c: float) -> HarmonicsPoly:
    """The default settings; no base temperature is needed."""
    return HarmonicsPoly()
