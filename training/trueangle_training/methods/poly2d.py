"""The two-dimensional polynomial of degree 5 in angle and temperature, eq. (12) of Jia et al. 2020."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import Fault
from trueangle.contract.units import DEG_PER_TURN, wrap_deg
from trueangle_training.methods import (
    Fit,
    Progress,
    TrainingReadings,
    UnsuitableReadingsError,
    distinct_angle_count,
    no_progress,
)
from trueangle_training.methods.least_squares import distinct_temperature_count

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Poly2dModel:
    """p(x, t) - p(x_datum, t) with x = θ / 180 - 1 and t = (T - centre) / scale, both about -1 to 1.

    A polynomial does not close over the turn: from just below 360 deg to 0 the error jumps.
    """

    coefficients_arcsec: Floats
    """[degree + 1, degree + 1]: of x^i t^j; 0 where i + j exceeds the degree."""
    centre_c: float
    scale_c: float
    datum_deg: float

    @property
    def temperature_used(self) -> bool:
        """Always."""
        return True

    def value_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """p itself, its constant included, shape [n]; `angle_deg` in [0, 360)."""
        x = angle_deg / (DEG_PER_TURN / 2) - 1.0
        t = (temperature_c - self.centre_c) / self.scale_c
        powers = np.arange(self.coefficients_arcsec.shape[0])
        return np.einsum("ni,ij,nj->n", x[:, None] ** powers, self.coefficients_arcsec, t[:, None] ** powers)

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """E(θ, T) - E(datum, T) at each pair, shape [n]; exactly 0 at the datum."""
        angle_deg = wrap_deg(np.asarray(angle_deg, dtype=np.float64))
        at_datum = self.value_arcsec(np.full_like(angle_deg, self.datum_deg), temperature_c)
        error = self.value_arcsec(angle_deg, temperature_c) - at_datum
        return np.where(angle_deg == self.datum_deg, 0.0, error)

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> None:
        """None: the method gives no uncertainty."""


def fit_poly2d(readings: TrainingReadings, *, degree: int) -> Poly2dModel:
    """Least squares of eq. (12); UnsuitableReadingsError where angles or temperatures are too few."""
    needed = degree + 1
    counts = {
        "angle_deg": distinct_angle_count(readings.angle_deg),
        "temperature_c": distinct_temperature_count(readings),
    }
    faults = [
        Fault(where=name, expected=f"at least {needed} distinct values for degree {degree}", found=str(found))
        for name, found in counts.items()
        if found < needed
    ]
    if faults:
        raise UnsuitableReadingsError(faults)
    lowest_c, highest_c = float(readings.temperature_c.min()), float(readings.temperature_c.max())
    centre_c, scale_c = (lowest_c + highest_c) / 2, (highest_c - lowest_c) / 2
    x = wrap_deg(readings.angle_deg) / (DEG_PER_TURN / 2) - 1.0
    t = (readings.temperature_c - centre_c) / scale_c
    exponents = [(i, j) for i in range(needed) for j in range(needed - i)]
    design = np.stack([x**i * t**j for i, j in exponents], axis=1)
    solution = np.linalg.lstsq(design, readings.error_arcsec, rcond=None)[0]
    coefficients = np.zeros((needed, needed))
    for (i, j), value in zip(exponents, solution, strict=True):
        coefficients[i, j] = value
    return Poly2dModel(
        coefficients_arcsec=coefficients, centre_c=centre_c, scale_c=scale_c, datum_deg=readings.datum_deg
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Poly2d:
    """The `Method` of the paper's section 4.3.1."""

    degree: int = 5
    name: str = "poly2d"
    summary: str = "two-dimensional polynomial of degree 5, eq. (12)"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Least squares; deterministic, the seed changes nothing."""
        return Fit(model=fit_poly2d(readings, degree=self.degree), settings={"degree": self.degree})


def make(base_temperature_c: float) -> Poly2d:
    """The paper's settings; no base temperature is needed."""
    return Poly2d()
