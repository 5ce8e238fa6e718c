"""Plain courses of what the joint remembers, for the judge: a first-order lag and a friction of Dahl's.

Plants that are to be independent step their own heat and friction.
"""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


def follow(driver: Floats, *, time_constant_s: float, start: float, step_s: float) -> Floats:
    """A body with one time constant behind its driver, both at equal steps; the driver is linear in between.

    y' = (x - y) / tau, solved exactly for a linear x over each step.
    """
    decay = float(np.exp(-step_s / time_constant_s))
    mean = (1.0 - decay) * time_constant_s / step_s
    out = np.empty_like(driver)
    state, before = start, float(driver[0])
    for i, value in enumerate(driver.tolist()):
        state = decay * state + (mean - decay) * before + (1.0 - mean) * value
        before = value
        out[i] = state
    return out


def dahl_state(path_deg: Floats, *, length_deg: float, exponent: float = 1.0, start: float = 0.0) -> Floats:
    """Friction relative to its limit at each point of a path, -1 to 1, shape [p].

    Dahl 1968: dz/dx = (1 - z sgn x')^i sgn x' / length, by the midpoint rule with at least 8 steps a length.
    """
    out = np.empty_like(path_deg)
    state = min(max(start, -1.0), 1.0)
    out[0] = state
    for i, travel in enumerate(np.diff(path_deg).tolist(), start=1):
        sense = 1.0 if travel > 0 else -1.0
        way = abs(travel)
        if way > 60.0 * length_deg:
            state = sense
        elif way > 0.0:
            steps = max(1, int(np.ceil(8.0 * way / length_deg)))
            size = way / steps / length_deg
            for _ in range(steps):
                half = state + 0.5 * size * sense * max(1.0 - state * sense, 0.0) ** exponent
                state += size * sense * max(1.0 - half * sense, 0.0) ** exponent
                state = min(max(state, -1.0), 1.0)
        out[i] = state
    return out


def friction_at_readings(schedule: Schedule, *, length_deg: float, exponent: float = 1.0) -> Floats:
    """The state of a friction at each reading, shape [n], with all motion since the campaign began."""
    return dahl_state(schedule.path_angle_deg, length_deg=length_deg, exponent=exponent)[schedule.reading_at]
