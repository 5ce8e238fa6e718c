"""From the uncertainty of a model to that of a corrected angle.

    u² = u_model² + u_reference² + (dE/dT · u_T)²

All parts are standard uncertainties (k = 1) of the corrected angle relative to the datum at the same temperature,
so all vanish at the datum. The parts are taken as independent (GUM, JCGM 100:2008, eq. (10)).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.methods import FittedModel

Floats = NDArray[np.float64]

SLOPE_STEP_C = 0.5
"""dE/dT is the difference over twice this: as far as sensors err, so that a bend inside that reach counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyBudget:
    """What is added to the model's own uncertainty; both k = 1, 0 or more."""

    reference_arcsec: float = 0.0
    """Of the reference angle between the datum and any other position."""
    temperature_c: float = 0.0
    """Of the temperature sensor against that of the calibration."""

    def __post_init__(self) -> None:
        if not (0.0 <= self.reference_arcsec < np.inf and 0.0 <= self.temperature_c < np.inf):
            raise ValueError(
                "uncertainty budget: expected finite uncertainties of 0 or more, found "
                f"{self.reference_arcsec} arcsec and {self.temperature_c} degC"
            )


def slope_arcsec_per_c(model: FittedModel, angle_deg: Floats, temperature_c: Floats) -> Floats:
    """dE/dT by the central difference over 2 SLOPE_STEP_C, shape [n]."""
    above = model.error_arcsec(angle_deg, temperature_c + SLOPE_STEP_C)
    below = model.error_arcsec(angle_deg, temperature_c - SLOPE_STEP_C)
    return (above - below) / (2.0 * SLOPE_STEP_C)


def total_uncertainty_arcsec(
    model: FittedModel, budget: UncertaintyBudget, angle_deg: Floats, temperature_c: Floats
) -> Floats | None:
    """u of the corrected angle, shape [n]; None where the model knows no uncertainty."""
    of_model = model.uncertainty_arcsec(angle_deg, temperature_c)
    if of_model is None:
        return None
    by_sensor = slope_arcsec_per_c(model, angle_deg, temperature_c) * budget.temperature_c
    total = np.sqrt(of_model**2 + budget.reference_arcsec**2 + by_sensor**2)
    return np.where(wrap_deg(np.asarray(angle_deg, dtype=np.float64)) == model.datum_deg, 0.0, total)
