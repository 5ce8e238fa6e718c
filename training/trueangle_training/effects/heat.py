"""Temperatures that lag behind and heat that motion leaves, carried through the whole campaign.

Both are first-order states x' = (u - x) / τ. Between two knots of the time line the input is linear (temperature)
or constant (speed), and the step is exact: with a = exp(-Δt/τ),

    temperature:  x1 = a x0 + u1 - a u0 - (u1 - u0) (τ/Δt) (1 - a)
    speed:        x1 = a x0 + (1 - a) u1
"""

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import NEW_RUN_GAP_S
from trueangle_training.effects.conditions import Conditions, Timeline

Floats = NDArray[np.float64]

RESOLVED_TIME_CONSTANTS_S = (60.0, 120.0, 240.0, 480.0, 900.0, 1800.0, 3600.0, 7200.0, 14400.0)


class BetweenRuns(Enum):
    """How the temperature went from one run to the next, where only the readings are known."""

    STEP = "step"
    """At once after the last reading, then held: the chamber is set and the joint soaks."""
    RAMP = "ramp"
    """Evenly until the next reading."""


def timeline(conditions: Conditions, between: BetweenRuns) -> Timeline | None:
    """The known time line, or one inferred from the readings; None where times or temperatures are missing.

    An inferred one begins at time 0 in equilibrium at the base temperature.
    """
    if conditions.timeline is not None:
        return conditions.timeline
    time_s, temperature_c = conditions.complete("time_s"), conditions.complete("temperature_c")
    if time_s is None or temperature_c is None:
        return None
    order = np.argsort(time_s, kind="stable")
    time_s, temperature_c, run = time_s[order], temperature_c[order], conditions.run[order]
    gap = np.ones(time_s.size, dtype=bool)
    gap[1:] = (np.diff(run) != 0) | (np.diff(time_s) > NEW_RUN_GAP_S)
    began_s = min(0.0, float(time_s[0]))
    if between is BetweenRuns.STEP:
        at = np.flatnonzero(gap)
        before_s = np.concatenate([[began_s], time_s[at[1:] - 1]])
        # The step stands at the time of the reading before it, with the temperature of the one after it.
        time_s = np.insert(time_s, at, before_s)
        temperature_c = np.insert(temperature_c, at, temperature_c[at])
    return Timeline(
        time_s=np.concatenate([[began_s], time_s]),
        temperature_c=np.concatenate([[conditions.base_temperature_c], temperature_c]),
    )


def lagged_temperature_c(conditions: Conditions, time_constant_s: float, between: BetweenRuns) -> Floats | None:
    """Temperature of a body that follows the sensor's with a time constant, shape [readings]."""
    line = timeline(conditions, between)
    if line is None or conditions.time_s is None:
        return None
    step_s = np.maximum(np.diff(line.time_s, prepend=line.time_s[0]), 0.0)
    rise_c = np.diff(line.temperature_c, prepend=line.temperature_c[0])
    kept = np.exp(-step_s / time_constant_s)
    taken = -np.expm1(-step_s / time_constant_s)
    slope = np.divide(rise_c * time_constant_s, step_s, out=np.zeros_like(step_s), where=step_s > 0)
    before_c = line.temperature_c - rise_c
    inflow = np.where(step_s > 0, rise_c + taken * (before_c - slope), 0.0)
    kept[0], inflow[0] = 0.0, line.temperature_c[0]
    return _at_readings(conditions.time_s, line.time_s, first_order(kept, inflow))


def motion_heat_deg_s(conditions: Conditions, time_constant_s: float, power: float = 1.0) -> Floats | None:
    """|speed|^power smoothed with the time constant: what it would be in the long run, shape [readings].

    The speed is the mean one from reading to reading of a run, so that a joint that is turned from stop to stop
    warms too; over a pause and between runs, where the turns need not be counted on, it is taken to stand.
    """
    time_s = conditions.complete("time_s")
    if time_s is None:
        return None
    order = np.argsort(time_s, kind="stable")
    step_s = np.diff(time_s[order], prepend=time_s[order[0]])
    turned_deg = np.abs(np.diff(conditions.angle_deg[order], prepend=conditions.angle_deg[order[0]]))
    moving = (step_s > 0) & (step_s <= NEW_RUN_GAP_S)
    moving[1:] &= np.diff(conditions.run[order]) == 0
    speed_deg_s = np.divide(turned_deg, step_s, out=np.zeros_like(step_s), where=moving)
    kept = np.exp(-step_s / time_constant_s)
    inflow = -np.expm1(-step_s / time_constant_s) * speed_deg_s**power
    kept[0] = 0.0
    return _at_readings(time_s, time_s[order], first_order(kept, inflow))


def _at_readings(time_s: Floats, knots_s: Floats, state: Floats) -> Floats:
    """The state at the readings' times, which are knots: the last of several knots at one time."""
    return state[np.searchsorted(knots_s, time_s, side="right") - 1]


def first_order(kept: Floats, inflow: Floats) -> Floats:
    """x[k] = kept[k] x[k-1] + inflow[k] with x[-1] = 0, shape [steps], in log2(steps) passes over the array."""
    kept, state = kept.copy(), inflow.copy()
    distance = 1
    while distance < state.size:
        # Each pass joins two neighbouring stretches: (a, b) after (a', b') is (a a', a b' + b).
        state[distance:] += kept[distance:] * state[:-distance]
        kept[distance:] = kept[distance:] * kept[:-distance]
        distance *= 2
    return state
