"""Fourier expansion of the error over the angle, eq. (1) of Jia et al. 2020 (Sensors 20, 2603)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class RankDeficientError(ValueError):
    """The angles do not determine the coefficients that were asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FourierSeries:
    """error(θ) = a_0 + sum over i = 1..order of a_i sin(i θ) + b_i cos(i θ); mind that a goes with the sine."""

    constant_arcsec: float
    """a_0."""
    sine_arcsec: tuple[float, ...]
    """a_1 .. a_order."""
    cosine_arcsec: tuple[float, ...]
    """b_1 .. b_order."""

    def __post_init__(self) -> None:
        if len(self.sine_arcsec) != len(self.cosine_arcsec):
            raise ValueError(
                f"Fourier series: expected as many sine as cosine coefficients, found {len(self.sine_arcsec)} "
                f"and {len(self.cosine_arcsec)}"
            )
        if not np.isfinite([self.constant_arcsec, *self.sine_arcsec, *self.cosine_arcsec]).all():
            raise ValueError("Fourier series: expected finite coefficients, found NaN or infinity")

    @property
    def order(self) -> int:
        """The highest harmonic, 0 for a constant."""
        return len(self.sine_arcsec)

    def evaluate(self, angle_deg: Floats) -> Floats:
        """The series in arcsec at each angle; same shape as `angle_deg`."""
        phase_rad = np.multiply.outer(angle_deg, _radians_per_degree(self.order))
        sine, cosine = np.array(self.sine_arcsec), np.array(self.cosine_arcsec)
        return self.constant_arcsec + np.sin(phase_rad) @ sine + np.cos(phase_rad) @ cosine


def _radians_per_degree(order: int) -> Floats:
    return np.asarray(np.arange(1, order + 1) * np.pi / 180.0, dtype=np.float64)


def design_matrix(angle_deg: Floats, order: int) -> Floats:
    """Matrix A of the paper's Appendix A, shape [readings, 2 order + 1]: 1, sin θ, cos θ, sin 2θ, cos 2θ, ..."""
    phase_rad = np.multiply.outer(angle_deg, _radians_per_degree(order))
    matrix = np.empty((angle_deg.size, 2 * order + 1))
    matrix[:, 0] = 1.0
    matrix[:, 1::2] = np.sin(phase_rad)
    matrix[:, 2::2] = np.cos(phase_rad)
    return matrix


def fit_fourier(angle_deg: Floats, error_arcsec: Floats, order: int) -> FourierSeries:
    """Least-squares coefficients by an orthogonal factorisation.

    Appendix A of the paper writes the normal equations; they square the condition number of the design matrix,
    so they are not used. `angle_deg` and `error_arcsec` have shape [readings]. RankDeficientError where the
    angles lie on fewer than 2 order + 1 distinct places.
    """
    if order < 0:
        raise ValueError(f"order of the Fourier series: expected 0 or more, found {order}")
    if angle_deg.ndim != 1 or angle_deg.shape != error_arcsec.shape:
        raise ValueError(
            "angle_deg and error_arcsec: expected the same length, one dimension, "
            f"found shapes {angle_deg.shape} and {error_arcsec.shape}"
        )
    matrix = design_matrix(angle_deg, order)
    coefficients, _, rank, _ = np.linalg.lstsq(matrix, error_arcsec, rcond=None)
    needed = 2 * order + 1
    if rank < needed:
        raise RankDeficientError(
            f"Fourier series of order {order}: expected at least {needed} distinct angles, found angles that "
            f"determine only {rank} coefficients; measure at more angles or ask for order "
            f"{max((int(rank) - 1) // 2, 0)}"
        )
    return FourierSeries(
        constant_arcsec=float(coefficients[0]),
        sine_arcsec=tuple(coefficients[1::2].tolist()),
        cosine_arcsec=tuple(coefficients[2::2].tolist()),
    )
