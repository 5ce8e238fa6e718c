"""Rolling along the shaft's path."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


def cage_angle_deg(schedule: Schedule, *, ratio: float, slip_per_turn: float) -> Floats:
    """Angle of a bearing's cage (or of a rolling set) at each reading, shape [n].

    It rolls at `ratio` turns per turn of the shaft, forth and back, and slips a little with all travel.
    """
    rolled = ratio * schedule.path_angle_deg
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(schedule.path_angle_deg)))])
    return (rolled + slip_per_turn * travel)[schedule.reading_at]
