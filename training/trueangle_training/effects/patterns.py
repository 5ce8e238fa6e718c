"""Columns of angular orders, alone or driven by a condition, and the amplitudes and phases that they stand for.

A cos(n θ - φ) = A cos φ · cos nθ + A sin φ · sin nθ; of order 0 there is only the first part.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis

Floats = NDArray[np.float64]

HIGHEST_SEARCHED_ORDER = 40
_PLACE_DEG = 0.1
_NAME = re.compile(r"order_(\d+)_(?:(cos|sin)_)?(.*)")


def angle_rad(angle_deg: Floats, order: float = 1.0) -> Floats:
    """The phase of an order in radians; of whole orders the turns come off in degrees, where they are exact."""
    if float(order).is_integer():
        return np.radians(np.mod(np.mod(angle_deg, DEG_PER_TURN) * order, DEG_PER_TURN))
    return np.radians(np.mod(angle_deg * order, DEG_PER_TURN))


def order_columns(angle_deg: Floats, orders: Iterable[int], driver: Floats | None = None) -> Floats:
    """cos and sin of each order (of order 0 a column of ones), times `driver` [readings] where one is given."""
    columns: list[Floats] = []
    for order in orders:
        if order == 0:
            columns.append(np.ones_like(angle_deg))
        else:
            phase_rad = angle_rad(angle_deg, order)
            columns += [np.cos(phase_rad), np.sin(phase_rad)]
    if not columns:
        return no_columns(angle_deg.size)
    stacked = np.column_stack(columns)
    return stacked if driver is None else stacked * driver[:, None]


def no_columns(readings: int) -> Floats:
    """Shape [readings, 0]."""
    return np.empty((readings, 0))


def beside(*blocks: Floats) -> Floats:
    """Blocks [readings, columns] and single columns [readings] side by side."""
    return np.column_stack(blocks)


def coefficient_names(orders: Iterable[int], unit: str) -> tuple[str, ...]:
    """The names that belong to `order_columns`."""
    names: list[str] = []
    for order in orders:
        names += [f"order_{order}_{unit}"] if order == 0 else [f"order_{order}_{p}_{unit}" for p in ("cos", "sin")]
    return tuple(names)


def harmonics(hypothesis: Hypothesis, coefficients: Floats, key: str) -> list[dict[str, float]]:
    """Order, amplitude (under `key`) and phase of each order among the coefficients, as JOINT.yaml has them."""
    parts: dict[int, list[float]] = {}
    for name, value in zip(hypothesis.coefficients, coefficients.tolist(), strict=True):
        found = _NAME.fullmatch(name)
        if found is not None:
            parts.setdefault(int(found[1]), [0.0, 0.0])[found[2] == "sin"] = value
    return [{"order": order, **polar(cos, sin, key)} for order, (cos, sin) in parts.items()]


def polar(cos: float, sin: float, key: str) -> dict[str, float]:
    """Amplitude and phase of A cos φ and A sin φ."""
    return {key: math.hypot(cos, sin), "phase_deg": math.degrees(math.atan2(sin, cos))}


def pattern(angle_deg: Floats, terms: Iterable[tuple[int, float, float]]) -> Floats:
    """Sum of A cos(n θ - φ) over (n, A, φ in degrees), shape [readings]."""
    total = np.zeros_like(angle_deg)
    for order, amplitude, phase_deg in terms:
        total += amplitude * np.cos(angle_rad(angle_deg, order) - math.radians(phase_deg))
    return total


def driven(
    *,
    effect: str,
    label: str,
    cell: Cell,
    conditions: Conditions,
    orders: Sequence[int],
    unit: str,
    driver: Floats | None = None,
    wiggle: Floats | None = None,
    wiggle_size: float = 0.0,
    shape: Mapping[str, float] | None = None,
    doubt_nats: float = 0.0,
) -> Hypothesis:
    """The hypothesis that some orders are there, following `driver` where one is given."""
    return Hypothesis(
        effect=effect,
        label=label,
        cell=cell,
        main=order_columns(conditions.angle_deg, orders, driver),
        coefficients=coefficient_names(orders, unit),
        wiggle=no_columns(len(conditions)) if wiggle is None else wiggle,
        wiggle_size=0.0 if wiggle is None else wiggle_size,
        shape={} if shape is None else shape,
        doubt_nats=doubt_nats,
    )


def distinct_places(angle_deg: Floats) -> Floats:
    """The places in the turn that were measured, told apart to a tenth of a degree, ascending."""
    steps = round(DEG_PER_TURN / _PLACE_DEG)
    place = np.unique(np.round(angle_deg / _PLACE_DEG).astype(np.int64) % steps)
    return place.astype(np.float64) * _PLACE_DEG


def highest_order(conditions: Conditions) -> int:
    """The last order that the measured places can tell from lower ones, at most 40."""
    return min((distinct_places(conditions.angle_deg).size - 1) // 2, HIGHEST_SEARCHED_ORDER)


def wave_hypothesis(effect: str, order: int, conditions: Conditions, overtone_size: float) -> Hypothesis:
    """One order that nothing changes, its first overtone bending it where the places resolve that."""
    overtone = order_columns(conditions.angle_deg, [2 * order])
    resolved = 2 * order <= highest_order(conditions)
    return driven(
        effect=effect,
        label=f"order {order}",
        cell=Cell(order=str(order)),
        conditions=conditions,
        orders=[order],
        unit="arcsec",
        wiggle=overtone if resolved else None,
        wiggle_size=overtone_size,
    )
