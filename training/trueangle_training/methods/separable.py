"""Models whose temperature and angle separate: Fourier coefficients that are functions of temperature.

    E(θ, T) = sum over c of C_c(T) (h_c(θ) - h_c(datum)),   h = cos θ, sin θ, cos 2θ, sin 2θ, ...
    C(T) = φ(T) W,   φ = 1, t, t², ..., tanh(a t + b), exp(-(t - u)² / 2 l²),   t = (T - centre) / scale

Nearly every method of the laboratory ends as one of these, so evaluation and export are written once. The model's
own uncertainty is the spread of such a function as well. Its coefficients are random, known by a factor of their
covariance at the nodes of a temperature grid and linear in between:

    u²(θ, T) = sum of |d(θ, T)' L|²,   d = (h(θ) - h(datum)) ⊗ ψ(T),   ψ: hat functions of nodes, constant outside

A sum of squares cannot turn negative, whatever the rounding, and is 0 at the datum.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg

Floats = NDArray[np.float64]


def harmonics(angle_deg: Floats, orders: tuple[int, ...]) -> Floats:
    """cos nθ and sin nθ side by side for each order, shape [n, 2 orders]."""
    radians_per_degree = np.asarray(orders, dtype=np.float64) * (np.pi / 180.0)
    phase_rad = np.multiply.outer(np.asarray(angle_deg, dtype=np.float64), radians_per_degree)
    result = np.empty((*phase_rad.shape[:-1], 2 * len(orders)))
    result[..., 0::2] = np.cos(phase_rad)
    result[..., 1::2] = np.sin(phase_rad)
    return result


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureBasis:
    """Functions of temperature in the order powers, tanh, bells; t = (T - centre_c) / scale_c."""

    centre_c: float
    scale_c: float
    """Above 0."""
    powers: tuple[int, ...] = (0,)
    """Exponents of t."""
    tanh_slope: tuple[float, ...] = ()
    tanh_offset: tuple[float, ...] = ()
    """tanh(slope t + offset)."""
    bell_centre: tuple[float, ...] = ()
    bell_length: tuple[float, ...] = ()
    """exp(-(t - centre)² / 2 length²), in units of t."""

    def __post_init__(self) -> None:
        if not self.scale_c > 0.0 or not all(length > 0.0 for length in self.bell_length):
            raise ValueError("temperature basis: expected a scale and lengths above 0")
        if len(self.tanh_slope) != len(self.tanh_offset) or len(self.bell_centre) != len(self.bell_length):
            raise ValueError("temperature basis: expected an offset for each slope and a length for each centre")

    @property
    def size(self) -> int:
        """How many functions there are."""
        return len(self.powers) + len(self.tanh_slope) + len(self.bell_centre)

    def evaluate(self, temperature_c: Floats) -> Floats:
        """φ at each temperature, shape [n, size]."""
        t = (np.asarray(temperature_c, dtype=np.float64) - self.centre_c) / self.scale_c
        parts = [t[:, None] ** np.array(self.powers, dtype=np.int64)]
        parts.append(np.tanh(np.multiply.outer(t, np.array(self.tanh_slope)) + np.array(self.tanh_offset)))
        from_centre = np.subtract.outer(t, np.array(self.bell_centre))
        parts.append(np.exp(-((from_centre / np.array(self.bell_length)) ** 2) / 2.0))
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoefficientSpread:
    """What the readings leave open of the coefficients, as a factor of their covariance at temperature nodes."""

    orders: tuple[int, ...]
    """Of the uncertain harmonics; may hold more than the model's own, such as those that the plan cannot see."""
    nodes_c: Floats
    """[nodes], rising, one or more; outside them the spread stays what it is at the nearest."""
    factor_arcsec: Floats
    """[2 orders, nodes, r]: sums of products over r are the covariances of coefficients at nodes."""

    def __post_init__(self) -> None:
        shape = (2 * len(self.orders), self.nodes_c.size)
        if self.factor_arcsec.shape[:2] != shape or not (np.diff(self.nodes_c) > 0.0).all():
            raise ValueError(
                f"spread: expected rising nodes and a factor {shape}, found {self.factor_arcsec.shape}"
            )

    def hats(self, temperature_c: Floats) -> Floats:
        """ψ, shape [n, nodes]: linear interpolation between the two nodes around each temperature."""
        return np.stack(
            [np.interp(temperature_c, self.nodes_c, unit) for unit in np.eye(self.nodes_c.size)], axis=1
        )

    def variance(self, harmonic_from_datum: Floats, temperature_c: Floats) -> Floats:
        """u² in arcsec² at rows of h(θ) - h(datum), shape [n]."""
        hats = self.hats(temperature_c)
        products = harmonic_from_datum[:, :, None] * hats[:, None, :]
        coefficients, nodes, rank = self.factor_arcsec.shape
        flat = products.reshape(-1, coefficients * nodes)
        return np.sum((flat @ self.factor_arcsec.reshape(-1, rank)) ** 2, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeparableModel:
    """A `FittedModel`: coefficients over temperature times harmonics of the angle."""

    orders: tuple[int, ...]
    basis: TemperatureBasis
    weights_arcsec: Floats
    """[basis.size, 2 orders]; columns cos, sin of each order in turn."""
    datum_deg: float
    """In [0, 360)."""
    temperature_used: bool = True
    spreads: tuple[CoefficientSpread, ...] = field(default=())
    """Independent parts of the uncertainty; none: the method knows no uncertainty."""

    def __post_init__(self) -> None:
        shape = (self.basis.size, 2 * len(self.orders))
        if self.weights_arcsec.shape != shape:
            raise ValueError(f"separable model: expected weights {shape}, found {self.weights_arcsec.shape}")

    def coefficients_arcsec(self, temperature_c: Floats) -> Floats:
        """C(T), shape [n, 2 orders]."""
        return self.basis.evaluate(temperature_c) @ self.weights_arcsec

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """E(θ, T) - E(datum, T) at each pair, shape [n]; exactly 0 at the datum."""
        angle_deg = wrap_deg(np.asarray(angle_deg, dtype=np.float64))
        from_datum = self._from_datum(angle_deg, self.orders)
        error = np.einsum("nc,nc->n", self.coefficients_arcsec(temperature_c), from_datum)
        return np.where(angle_deg == self.datum_deg, 0.0, error)

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        """Standard uncertainty of `error_arcsec`, shape [n]; exactly 0 at the datum."""
        if not self.spreads:
            return None
        angle_deg = wrap_deg(np.asarray(angle_deg, dtype=np.float64))
        temperature_c = np.asarray(temperature_c, dtype=np.float64)
        variance = np.zeros(angle_deg.shape)
        for spread in self.spreads:
            variance += spread.variance(self._from_datum(angle_deg, spread.orders), temperature_c)
        return np.where(angle_deg == self.datum_deg, 0.0, np.sqrt(variance))

    def _from_datum(self, angle_deg: Floats, orders: tuple[int, ...]) -> Floats:
        return harmonics(angle_deg, orders) - harmonics(np.array([self.datum_deg]), orders)
