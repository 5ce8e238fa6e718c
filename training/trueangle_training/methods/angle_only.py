"""Harmonics of the angle at the base temperature: what a calibration without temperatures would serve."""

from dataclasses import dataclass

import numpy as np

from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.base_series import fit_base_series
from trueangle_training.methods.separable import SeparableModel, TemperatureBasis

DEFAULT_BASE_TEMPERATURE_C = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleOnly:
    """The `Method`: eq. (1) of Jia et al. 2020 and nothing else."""

    base_temperature_c: float = DEFAULT_BASE_TEMPERATURE_C
    name: str = "angle-only"
    summary: str = "harmonics at the base temperature, temperature ignored"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Least squares over the runs at the base temperature; deterministic, the seed changes nothing."""
        series = fit_base_series(readings, base_temperature_c=self.base_temperature_c, order=None)
        weights = np.column_stack([series.cosine_arcsec, series.sine_arcsec]).reshape(1, -1)
        model = SeparableModel(
            orders=tuple(range(1, series.order + 1)),
            basis=TemperatureBasis(centre_c=self.base_temperature_c, scale_c=1.0),
            weights_arcsec=weights,
            datum_deg=readings.datum_deg,
            temperature_used=False,
        )
        settings = {"base_temperature_c": self.base_temperature_c, "order": series.order}
        return Fit(model=model, notes=("temperature is ignored",), settings=settings)


def make(base_temperature_c: float) -> AngleOnly:
    """The method at the campaign's base temperature."""
    return AngleOnly(base_temperature_c=base_temperature_c)
