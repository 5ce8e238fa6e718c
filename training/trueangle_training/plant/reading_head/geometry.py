"""Exact geometry of one reading head over a grating, and the signals that it makes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ARCSEC_PER_RAD = 180.0 * 3600.0 / np.pi


def grating_error_arcsec(
    shaft_deg: Floats,
    *,
    radius_mm: Floats | float,
    centre_mm: Complexes | complex = 0.0,
    wobble_mm: Complexes | complex = 0.0,
    ovality: Complexes | complex = 0.0,
) -> Floats:
    """Angle of the line under the head minus the shaft's angle, shape [n].

    The head stands at `radius_mm` on the real axis. The grating's centre sits at `centre_mm` in the frame of the
    shaft, the shaft's axis at `wobble_mm` in the frame of the housing. A grating tilted by g, or oval, shows its
    lines compressed across one axis by 1 - |ovality| (= cos g); half the argument of `ovality` is that axis.
    """
    shaft = np.deg2rad(shaft_deg)
    centre = centre_mm * np.exp(1j * shaft) + wobble_mm
    seen = (radius_mm - centre) * np.exp(-1j * shaft)
    axis = np.angle(ovality) / 2.0
    turned = seen * np.exp(1j * axis)
    line = axis - np.arctan2(turned.imag * (1.0 - np.abs(ovality)), turned.real)
    return wrapped_rad(line - shaft) * ARCSEC_PER_RAD


def wrapped_rad(angle_rad: NDArray[np.floating]) -> Floats:
    """Into -pi to pi."""
    return np.angle(np.exp(1j * np.asarray(angle_rad, dtype=np.float64)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalError:
    """How the sine and cosine signals differ from ideal ones, relative to their amplitude."""

    offset_cos: float = 0.0
    offset_sin: float = 0.0
    gain: float = 0.0
    """Cosine larger, sine smaller by half of this."""
    quadrature_rad: float = 0.0
    third: float = 0.0
    """Third harmonic, which interpolation turns into four errors a line."""

    def added(self, other: "SignalError") -> "SignalError":
        """Both together."""
        return SignalError(
            offset_cos=self.offset_cos + other.offset_cos,
            offset_sin=self.offset_sin + other.offset_sin,
            gain=self.gain + other.gain,
            quadrature_rad=self.quadrature_rad + other.quadrature_rad,
            third=self.third + other.third,
        )

    def scaled(self, size: float) -> "SignalError":
        """All of it by a factor."""
        return SignalError(
            offset_cos=size * self.offset_cos,
            offset_sin=size * self.offset_sin,
            gain=size * self.gain,
            quadrature_rad=size * self.quadrature_rad,
            third=size * self.third,
        )


def interpolation_error_arcsec(line_deg: Floats, *, lines_per_rev: int, signals: SignalError) -> Floats:
    """Interpolated minus true place in the line, shape [n]: arctangent of the disturbed signals."""
    phase = np.deg2rad(line_deg * lines_per_rev)
    cosine = (1 + signals.gain / 2) * np.cos(phase) + signals.third * np.cos(3 * phase) + signals.offset_cos
    sine = (1 - signals.gain / 2) * np.sin(phase + signals.quadrature_rad) + signals.offset_sin
    sine = sine - signals.third * np.sin(3 * phase) * 0.8
    found = np.arctan2(sine, cosine)
    return wrapped_rad(found - phase) / lines_per_rev * ARCSEC_PER_RAD
