"""Units and the one way to subtract angles.

Signs, once and for all: `error = raw - reference`, `correction = -error`, `corrected = raw + correction`.
"""

from typing import overload

import numpy as np
from numpy.typing import NDArray

DEG_PER_TURN = 360.0
ARCSEC_PER_DEG = 3600.0
ARCSEC_PER_TURN = 1_296_000.0
MILLIARCSEC_PER_TURN = 1_296_000_000


@overload
def wrap_deg(angle_deg: float) -> float: ...
@overload
def wrap_deg(angle_deg: NDArray[np.float64]) -> NDArray[np.float64]: ...
def wrap_deg(angle_deg: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
    """The angle reduced to [0, 360): never 360 itself, also for tiny negative angles that round up to it."""
    if isinstance(angle_deg, np.ndarray):
        wrapped = np.mod(angle_deg, DEG_PER_TURN)
        return np.where(wrapped >= DEG_PER_TURN, 0.0, wrapped)
    reduced = angle_deg % DEG_PER_TURN
    return 0.0 if reduced >= DEG_PER_TURN else reduced


@overload
def angle_difference_deg(angle_deg: float, from_deg: float) -> float: ...
@overload
def angle_difference_deg(
    angle_deg: NDArray[np.float64], from_deg: NDArray[np.float64] | float
) -> NDArray[np.float64]: ...
def angle_difference_deg(
    angle_deg: float | NDArray[np.float64], from_deg: float | NDArray[np.float64]
) -> float | NDArray[np.float64]:
    """`angle_deg - from_deg` by the shorter way round, in [-180, 180)."""
    turned = angle_deg - from_deg + DEG_PER_TURN / 2
    return wrap_deg(turned) - DEG_PER_TURN / 2  # pyright: ignore[reportArgumentType, reportCallIssue]
