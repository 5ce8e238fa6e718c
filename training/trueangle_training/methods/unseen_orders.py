"""What harmonics that the plan cannot see may do between its angles.

At F equal faces order n reads like order F - n, and no method can tell them apart. A harmonic above the highest
one fitted is therefore fitted as a lower one at the faces and missing in between. The readings cannot say how
large it is; the size is an extrapolation: amplitudes fall on as order^-1.5 from those that were seen. Where places
are many the model ends before they do, and what is above its last order is left out alike. Where many orders from
12 up were seen, these alone are extrapolated: they are the nearest, and may lie far below the others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.methods import TrainingReadings, distinct_angle_count
from trueangle_training.methods.coefficients import HIGHEST_ORDER, centred
from trueangle_training.methods.high_orders import LOWEST_HIGH_ORDER
from trueangle_training.methods.separable import CoefficientSpread, harmonics

Floats = NDArray[np.float64]

LOWEST_SMOOTH_ORDER = 4
"""Eccentricity, tilt and bearing make orders 1 to 3; what is above them falls off by itself."""
ENOUGH_HIGH_ORDERS = 8
"""Fewer from order 12 up say too little of those beyond."""
FALL_EXPONENT = 1.5
NEGLIGIBLE_ARCSEC = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnseenOrders:
    """The assumed harmonics above the fitted ones, and how they spread."""

    rms_arcsec: float
    """Root of the sum of the assumed mean squares, on the faces and between them alike."""
    spread: CoefficientSpread
    note: str


def unseen_orders(
    readings: TrainingReadings, *, orders: tuple[int, ...], power_arcsec2: Floats
) -> UnseenOrders | None:
    """None where the fitted harmonics leave nothing to extrapolate.

    `power_arcsec2` [orders]: estimates of the squared amplitudes of the steady harmonics.
    """
    highest = orders[-1]
    order = np.array(orders, dtype=np.float64)
    many = np.count_nonzero(order >= LOWEST_HIGH_ORDER) >= ENOUGH_HIGH_ORDERS
    smooth = order >= (LOWEST_HIGH_ORDER if many else min(LOWEST_SMOOTH_ORDER, highest))
    strength = float(np.mean(order[smooth] ** (2 * FALL_EXPONENT) * power_arcsec2[smooth]))
    unseen = tuple(range(highest + 1, 2 * highest + 3))
    mean_square = strength / 2.0 / np.array(unseen, dtype=np.float64) ** (2 * FALL_EXPONENT)
    if strength <= 0.0 or mean_square.sum() < NEGLIGIBLE_ARCSEC**2:
        return None
    group = readings.offset_group
    angle_deg = wrap_deg(readings.angle_deg)
    seen_design = centred(harmonics(angle_deg, orders), group)
    response = np.linalg.lstsq(seen_design, centred(harmonics(angle_deg, unseen), group), rcond=None)[0]
    deviation = np.repeat(np.sqrt(mean_square), 2)
    factor: Floats = np.concatenate([response, -np.eye(2 * len(unseen))]).astype(np.float64) * deviation
    rms_arcsec = float(np.sqrt(mean_square.sum()))
    seen = f"{int(order[smooth][0])} to {highest}"
    why, remedy = _why_unseen(readings, highest)
    note = (
        f"harmonics above order {highest} {why}; the uncertainty counts {rms_arcsec:.2f} arcsec RMS of them, "
        f"assuming that amplitudes fall as order^-{FALL_EXPONENT:g} from orders {seen} on; it is no "
        f"measurement{remedy}"
    )
    spread = CoefficientSpread(
        orders=(*orders, *unseen),
        nodes_c=np.array([float(readings.temperature_c.mean())]),
        factor_arcsec=factor[:, None, :],
    )
    return UnseenOrders(rms_arcsec=rms_arcsec, spread=spread, note=note)


def _why_unseen(readings: TrainingReadings, highest: int) -> tuple[str, str]:
    """Whether the places or the model itself end at this order, and what would show more."""
    places = distinct_angle_count(readings.angle_deg)
    if (places - 1) // 2 <= highest:
        return "cannot be told apart by these angles", _remedy(readings, places)
    if highest >= HIGHEST_ORDER:
        return f"are left out of the model, which ends there; these {places} places would show them", ""
    return "cannot be told from lower ones and the zeros of the runs by these angles", _remedy(readings, places)


def _remedy(readings: TrainingReadings, places: int) -> str:
    group = readings.offset_group
    largest = int(np.argmax(np.bincount(group)))
    if places > distinct_angle_count(readings.angle_deg[group == largest]):
        return ", and only more faces would show them"
    return ", and repeats shifted by a third of the face pitch would show them"
