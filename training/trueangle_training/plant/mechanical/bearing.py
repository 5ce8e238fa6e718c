"""A ball bearing: at which orders its parts go round, and where its cage stands."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

APART = 0.12
"""Least distance of a bearing's order from whole ones, so that it is not closed over a turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bearing:
    """Balls between two rings, the inner one turning."""

    balls: int
    ball_over_pitch: float
    """Diameter of a ball over that of the pitch circle."""
    contact_deg: float

    @property
    def cage_ratio(self) -> float:
        """Turns of the cage per turn of the shaft, rolling without slip."""
        return 0.5 * (1.0 - self.ball_over_pitch * float(np.cos(np.deg2rad(self.contact_deg))))

    @property
    def passing_ratio(self) -> float:
        """Balls that pass a place of the outer ring, per turn of the shaft."""
        return self.balls * self.cage_ratio

    @property
    def spin_ratio(self) -> float:
        """Turns of a ball about itself per turn of the shaft."""
        across = self.ball_over_pitch * float(np.cos(np.deg2rad(self.contact_deg)))
        return (1.0 - across**2) / (2.0 * self.ball_over_pitch)


def draw_bearing(rng: np.random.Generator) -> Bearing:
    """Deep-groove or angular contact, as large as a joint needs."""
    return Bearing(
        balls=int(rng.integers(7, 15)),
        ball_over_pitch=float(rng.uniform(0.14, 0.27)),
        contact_deg=float(rng.choice([0.0, 15.0, 25.0])),
    )


def whole(order: float) -> bool:
    """Whether an order is as good as closed over a turn."""
    return abs(order - round(order)) < APART


def rolled_turns(schedule: Schedule, *, ratio: float, slip: float) -> Floats:
    """Turns of a rolling part at each reading, shape [n]; it lags by a share `slip` of all travel, either way."""
    turns = schedule.path_angle_deg / 360.0
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turns)))])
    return ratio * (turns - slip * travel)[schedule.reading_at]
