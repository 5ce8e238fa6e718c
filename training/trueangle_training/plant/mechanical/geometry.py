"""What the head reads when centre, axis and shape of the grating are off: series in small numbers."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ARCSEC_PER_RAD = 180.0 * 3600.0 / np.pi


def head_error_arcsec(
    shaft_deg: Floats,
    *,
    centre_arcsec: Complexes | complex = 0.0,
    axis_arcsec: Complexes | complex = 0.0,
    oval_arcsec: Complexes | complex = 0.0,
) -> Floats:
    """Place read less the shaft's angle, shape [n].

    With u = (centre e^(i shaft) + axis) / radius the head is seen from the grating's centre turned by
    -arg(1 - u) = Im(u + u^2/2 + u^3/3 + ...). An oval track, or one tilted by g, turns it by Im(w - w^2/2 + ...),
    w = m e^(2 i shaft), |m| = tan^2(g / 2). All displacements are given over the radius in arcsec.
    """
    turn = np.exp(1j * np.deg2rad(shaft_deg))
    u = (np.asarray(centre_arcsec) * turn + np.asarray(axis_arcsec)) / ARCSEC_PER_RAD
    w = np.asarray(oval_arcsec) * turn**2 / ARCSEC_PER_RAD
    series = u + u**2 / 2.0 + u**3 / 3.0 + w - w**2 / 2.0
    return np.asarray(series.imag * ARCSEC_PER_RAD, dtype=np.float64)
