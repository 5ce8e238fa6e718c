"""A campaign's conditions brought to common scales, for patterns that no physics has scaled."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

STEADY_C = 0.5
"""Temperatures that differ by less are one temperature."""
LEVEL_STEP_C = 1.5
"""Temperatures farther apart than this, with none between, are two levels of the plan."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axes:
    """What a pattern may be a function of; every array has shape [readings], None where nothing varies."""

    angle_rad: Floats
    """Whole turns taken off; the unwrapped angle is `unwrapped_rad`."""
    unwrapped_rad: Floats
    run_index: Integers
    """0, 1, ... in the order of first appearance."""
    runs: int
    within_run: Floats
    """-1 at the run's first reading to +1 at its last, in time where it is known."""
    campaign: Floats
    """-1 at the first reading of the campaign to +1 at the last."""
    temperature: Floats | None
    """-1 at the lowest to +1 at the highest."""
    temperature_level: Integers | None
    """0, 1, ... from cold to warm, where the plan has two to 30 levels."""
    direction: Floats | None
    """+1 and -1, only where both occur."""
    velocity: Floats | None
    """Signed, largest magnitude 1; None at one speed."""
    speed: Floats | None
    """Magnitude, largest 1; None at one speed."""
    load: Floats | None
    """Centred, largest magnitude 1; None at one load."""

    def cosine_sine(self, order: float) -> Floats:
        """[readings, 2], order 0: [readings, 1] of ones."""
        if order == 0:
            return np.ones((self.angle_rad.size, 1))
        angle = self.angle_rad if float(order).is_integer() else self.unwrapped_rad
        return np.column_stack([np.cos(order * angle), np.sin(order * angle)])


def axes_of(conditions: Conditions) -> Axes:
    """The axes along which this plan varies."""
    first, run_index = _in_order(conditions.run)
    order = conditions.time_s if conditions.time_s is not None else np.arange(len(conditions), dtype=np.float64)
    within = np.zeros(len(conditions))
    for each in range(first):
        here = run_index == each
        within[here] = _spread(order[here])
    temperature, level = _temperature(conditions.temperature_c)
    velocity = _scaled(conditions.velocity_deg_s, centred=False)
    speed = (
        None if conditions.velocity_deg_s is None else _scaled(np.abs(conditions.velocity_deg_s), centred=False)
    )
    direction = conditions.direction
    if direction is not None and not ((direction > 0).any() and (direction < 0).any()):
        direction = None
    return Axes(
        angle_rad=np.radians(np.mod(conditions.angle_deg, 360.0)),
        unwrapped_rad=np.radians(conditions.angle_deg),
        run_index=run_index,
        runs=first,
        within_run=within,
        campaign=_spread(order),
        temperature=temperature,
        temperature_level=level,
        direction=direction,
        velocity=velocity,
        speed=speed,
        load=_scaled(conditions.load_nm, centred=True),
    )


def _in_order(run: Integers) -> tuple[int, Integers]:
    values, first, inverse = np.unique(run, return_index=True, return_inverse=True)
    rank = np.empty(values.size, dtype=np.int64)
    rank[np.argsort(first)] = np.arange(values.size)
    return int(values.size), rank[inverse]


def _spread(values: Floats) -> Floats:
    low, span = float(values.min()), float(np.ptp(values))
    return np.zeros_like(values) if span <= 0 else 2.0 * (values - low) / span - 1.0


def _scaled(values: Floats | None, *, centred: bool) -> Floats | None:
    """None where the values are one and the same to 5 %."""
    if values is None:
        return None
    largest = float(np.max(np.abs(values)))
    if float(np.ptp(values)) <= 0.05 * largest or largest == 0:
        return None
    if centred:
        values = values - 0.5 * (float(values.max()) + float(values.min()))
        largest = float(np.max(np.abs(values)))
    return values / largest


def _temperature(temperature_c: Floats | None) -> tuple[Floats | None, Integers | None]:
    if temperature_c is None or float(np.ptp(temperature_c)) <= STEADY_C:
        return None, None
    ordered = np.sort(temperature_c)
    edges = ordered[1:][np.diff(ordered) > LEVEL_STEP_C] - 0.5 * LEVEL_STEP_C
    level = np.searchsorted(edges, temperature_c) if 1 <= edges.size < 30 else None
    return _spread(temperature_c), None if level is None else level.astype(np.int64)
