"""What any method must beat: no correction, harmonics that ignore temperature, harmonics times a polynomial of it.

The last is the idea of the 2019 method of the paper's authors (reference 16). A figure without these beside it
says nothing: most of a joint's error goes with the first two harmonics alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import angle_difference_deg
from trueangle_training.angle_only_campaign import AngleHarmonics
from trueangle_training.dataset import centred_rms
from trueangle_training.evaluation.held_out import SAME_PLACE_DEG, HeldOutKind, hold_out, temperature_folds
from trueangle_training.methods import (
    Fit,
    Method,
    Progress,
    TrainingReadings,
    UnsuitableReadingsError,
    no_progress,
)
from trueangle_training.methods.angle_only import AngleOnly
from trueangle_training.methods.harmonics_poly import HarmonicsPoly

Floats = NDArray[np.float64]

NONE = "none"
EVERY_TEMPERATURE = "angle-only-all"
MOST_FOLDS = 12
"""More temperatures, such as those of a sweep, are not left out one by one for a line of comparison."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoModel:
    """A `FittedModel` that knows of no error."""

    datum_deg: float

    @property
    def temperature_used(self) -> bool:
        """Nothing is used."""
        return False

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """Zeros, shape [n]."""
        return np.zeros(np.shape(angle_deg))

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> None:
        """None: nothing is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoCorrection:
    """The `Method` of those who do nothing: its residuals are the raw errors."""

    name: str = NONE
    summary: str = "no correction"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Nothing is fitted."""
        return Fit(model=NoModel(datum_deg=readings.datum_deg), settings={})


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineScore:
    """What one baseline leaves, in arcsec, runs centred, noise of the readings included."""

    name: str
    left_out_rmse_arcsec: float | None
    """Over temperatures in turn left out; None: there are too few, or it cannot be fitted without some."""
    in_sample_rmse_arcsec: float


def baseline_methods(readings: TrainingReadings, *, base_temperature_c: float) -> tuple[Method, ...]:
    """No correction, harmonics, harmonics times a polynomial; only those that the readings suit.

    The harmonics are those of the base temperature, as in the paper. Where no run is there, or runs are zeroed at
    different places, they are those of all temperatures together under a name of their own.
    """
    base: Method = AngleOnly(base_temperature_c=base_temperature_c)
    every: Method = AngleHarmonics(name=EVERY_TEMPERATURE)
    harmonics = base if _zeroed_at_one_place(readings) and _suits(base, readings) else every
    candidates = (harmonics, HarmonicsPoly())
    return (NoCorrection(), *(method for method in candidates if _suits(method, readings)))


def baseline_scores(
    readings: TrainingReadings, methods: tuple[Method, ...], *, seed: int
) -> tuple[BaselineScore, ...]:
    """Each fitted to all readings and without each temperature."""
    folds = temperature_folds(readings)
    folds = folds if len(folds) <= MOST_FOLDS else ()
    scores: list[BaselineScore] = []
    for method in methods:
        model = method.fit(readings, seed=seed).model
        left = readings.error_arcsec - model.error_arcsec(readings.angle_deg, readings.temperature_c)
        held_out = hold_out(readings, method, HeldOutKind.TEMPERATURE, folds, seed=seed)
        scores.append(
            BaselineScore(
                name=method.name,
                left_out_rmse_arcsec=held_out.rmse_arcsec,
                in_sample_rmse_arcsec=centred_rms(left, readings),
            )
        )
    return tuple(scores)


def _suits(method: Method, readings: TrainingReadings) -> bool:
    try:
        method.fit(readings)
    except UnsuitableReadingsError:
        return False
    return True


def _zeroed_at_one_place(readings: TrainingReadings) -> bool:
    """Whether every zero group begins at the same stop, so that their errors may be compared as they are."""
    labels = readings.run if readings.zero_group is None else readings.zero_group
    starts_deg = readings.angle_deg[np.unique(labels, return_index=True)[1]]
    return bool((np.abs(angle_difference_deg(starts_deg, float(starts_deg[0]))) <= SAME_PLACE_DEG).all())
