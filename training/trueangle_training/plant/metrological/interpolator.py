"""From two signals to a place within the line: ratio of the smaller to the larger, looked up in a table."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TABLE_STEPS = 2048


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """What is wrong with the two signals, relative to their amplitude; small numbers."""

    offset_cos: float = 0.0
    offset_sin: float = 0.0
    ellipse_cos: float = 0.0
    """Unequal gains: the figure of both signals is stretched along the axes."""
    ellipse_sin: float = 0.0
    """Phase not 90 degrees: it is stretched along the diagonals."""
    square: float = 0.0
    """Harmonic 5 and 3 of a light that is not quite sinusoidal: a figure with four corners."""

    def plus(self, other: "Signals") -> "Signals":
        """Both at once."""
        return Signals(
            offset_cos=self.offset_cos + other.offset_cos,
            offset_sin=self.offset_sin + other.offset_sin,
            ellipse_cos=self.ellipse_cos + other.ellipse_cos,
            ellipse_sin=self.ellipse_sin + other.ellipse_sin,
            square=self.square + other.square,
        )

    def times(self, factor: float) -> "Signals":
        """All of it larger."""
        return Signals(
            offset_cos=factor * self.offset_cos,
            offset_sin=factor * self.offset_sin,
            ellipse_cos=factor * self.ellipse_cos,
            ellipse_sin=factor * self.ellipse_sin,
            square=factor * self.square,
        )


def interpolation_error_rad(phase_rad: Floats, signals: Signals) -> Floats:
    """Phase found less true phase, shape [n].

    To first order offset_sin cos p - offset_cos sin p + ellipse_sin cos 2p - ellipse_cos sin 2p + square sin 4p.
    """
    turning = np.exp(1j * phase_rad)
    stretch = complex(signals.ellipse_cos, signals.ellipse_sin)
    figure = turning + complex(signals.offset_cos, signals.offset_sin) + stretch * np.conj(turning)
    figure = figure + 0.5 * signals.square * (turning**5 - np.conj(turning) ** 3)
    return _wrapped(looked_up_rad(figure) - phase_rad)


def looked_up_rad(figure: NDArray[np.complex128]) -> Floats:
    """Argument by octants: the table holds the arctangent of ratios 0 to 1, linear in between."""
    across, up = np.abs(figure.real), np.abs(figure.imag)
    ratios = np.linspace(0.0, 1.0, TABLE_STEPS + 1)
    first = np.interp(np.minimum(across, up) / np.maximum(across, up), ratios, np.arctan(ratios))
    quadrant = np.where(up > across, np.pi / 2.0 - first, first)
    half = np.where(figure.real < 0, np.pi - quadrant, quadrant)
    return np.where(figure.imag < 0, -half, half)


def _wrapped(angle_rad: Floats) -> Floats:
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi
