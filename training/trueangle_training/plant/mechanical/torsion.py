"""Shaft and coupling in a row under a torque."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

NEWTON_STEPS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """Twists are over that of the soft coupling under a torque of 1."""

    softness: float
    """Of the coupling at no torque."""
    hardening: float
    """torque = (angle + hardening angle^3) / softness."""
    shaft_softness: float


def twist(torque: Floats, coupling: Coupling) -> Floats:
    """Angle between the ends, shape [n]: the coupling's cubic equation by Newton's method, the shaft added."""
    angle = torque * coupling.softness
    for _ in range(NEWTON_STEPS):
        over = angle + coupling.hardening * angle**3 - torque * coupling.softness
        angle = angle - over / (1.0 + 3.0 * coupling.hardening * angle**2)
    return angle + coupling.shaft_softness * torque
