"""Harmonics of the true angle whose coefficients are polynomials of temperature.

    E(theta, T) = sum over terms of A (T - T0)^d cos(n theta - phi)          arcsec

theta is the true mechanical angle, T0 the joint's base temperature, n the order, d the degree in temperature.
This is |c_n| cos(n theta - arg c_n) with the complex amplitude c_n = sum of A (T - T0)^d exp(i phi).
"""

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range

MAX_ORDER = 1000
Order = Annotated[int, Range(minimum=1, maximum=MAX_ORDER)]


@dataclass(frozen=True, slots=True, kw_only=True)
class HarmonicTerm:
    """One summand: `amplitude` (T - T0)^degree cos(order theta - phase)."""

    order: int
    """1 .. MAX_ORDER; 0 would be an offset, which no zeroed campaign can show."""
    degree: int
    """Power of the temperature difference, 0 and up."""
    amplitude: float
    """arcsec / K^degree"""
    phase_deg: float

    @property
    def coefficient(self) -> complex:
        """Amplitude and phase as one complex number, arcsec / K^degree."""
        return cmath.rect(self.amplitude, math.radians(self.phase_deg))


@dataclass(frozen=True, slots=True, kw_only=True)
class HarmonicSeries:
    """A sum of terms, collected by order and degree so that it is evaluated in one pass."""

    base_temperature_c: float
    coefficients: tuple[tuple[complex, ...], ...]
    """[order - 1][degree]: conjugate complex amplitudes in arcsec / K^degree; an order may have none."""

    def error_arcsec(
        self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64] | float
    ) -> NDArray[np.float64]:
        """Error at true angles and temperatures of any broadcastable shapes."""
        from_base_k = np.asarray(temperature_c, dtype=np.float64) - self.base_temperature_c
        # The whole turns come off in degrees, where they are exact: the radian is not.
        rotation = np.exp(1j * np.radians(np.mod(angle_deg, 360.0)))
        total = np.zeros(np.broadcast_shapes(rotation.shape, from_base_k.shape), dtype=np.complex128)
        for by_degree in reversed(self.coefficients):
            amplitude = np.zeros_like(from_base_k, dtype=np.complex128)
            for coefficient in reversed(by_degree):
                amplitude = amplitude * from_base_k + coefficient
            total = (total + amplitude) * rotation
        return total.real

    def error_at_arcsec(self, angle_deg: float, temperature_c: float) -> float:
        """Error at one point: the same sum on plain numbers, a few microseconds a value."""
        from_base_k = temperature_c - self.base_temperature_c
        rotation = cmath.exp(1j * math.radians(math.fmod(angle_deg, 360.0)))
        total = 0j
        for by_degree in reversed(self.coefficients):
            amplitude = 0j
            for coefficient in reversed(by_degree):
                amplitude = amplitude * from_base_k + coefficient
            total = (total + amplitude) * rotation
        return total.real


def harmonic_series(terms: Iterable[HarmonicTerm], *, base_temperature_c: float) -> HarmonicSeries:
    """Collect the terms; terms of equal order and degree add up."""
    table: dict[int, list[complex]] = {}
    for term in terms:
        by_degree = table.setdefault(term.order, [])
        by_degree.extend([0j] * (term.degree + 1 - len(by_degree)))
        by_degree[term.degree] += term.coefficient.conjugate()
    highest = max(table, default=0)
    coefficients = tuple(tuple(table.get(order, ())) for order in range(1, highest + 1))
    return HarmonicSeries(base_temperature_c=base_temperature_c, coefficients=coefficients)
