"""Friction without time: elastic stops in parallel (Prandtl 1928, Ishlinskii 1944)."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


def stop_state(path_deg: Floats, *, threshold_deg: float) -> Floats:
    """A spring behind a slider, -1 to 1 of its slip force, at each point of a path of turning points, shape [p].

    z <- clip(z + dx, -r, r); exact for any step, as the path goes one way between two points.
    """
    out = np.empty_like(path_deg)
    state = 0.0
    out[0] = 0.0
    for i, travel in enumerate(np.diff(path_deg).tolist(), start=1):
        state = min(max(state + travel, -threshold_deg), threshold_deg)
        out[i] = state
    return out / threshold_deg


def friction_at_readings(schedule: Schedule, *, thresholds_deg: Floats, weights: Floats) -> Floats:
    """Torque of several stops, -1 to 1 when the weights' sum is 1, shape [n]."""
    path = sum(
        (
            weight * stop_state(schedule.path_angle_deg, threshold_deg=threshold)
            for weight, threshold in zip(weights.tolist(), thresholds_deg.tolist(), strict=True)
        ),
        np.zeros_like(schedule.path_angle_deg),
    )
    return path[schedule.reading_at]
