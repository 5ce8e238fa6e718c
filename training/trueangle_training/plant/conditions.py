"""What a campaign's readings were taken under, as far as the judge asks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.history import follow
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """The operator's plan, and courses on a grid of equal steps in time, arrays of shape [g]."""

    schedule: Schedule
    grid_s: Floats
    body_c: Floats
    """Of the body whose temperature the listed effects follow."""
    travel_deg: Floats
    """Travel made since the start."""
    lines_per_rev: int

    def at_readings(self, values: Floats) -> Floats:
        """A course on the grid, at the readings: shape [n]."""
        return np.interp(self.schedule.time_s, self.grid_s, values)

    @property
    def temperature_c(self) -> Floats:
        """Of the body at the readings, shape [n]."""
        return self.at_readings(self.body_c)

    @property
    def from_middle_k(self) -> Floats:
        """Temperature of the body from the middle of the campaign's range, shape [n]."""
        body = self.temperature_c
        return body - 0.5 * (float(body.min()) + float(body.max()))

    @property
    def relative_temperature(self) -> Floats:
        """-1 at the coldest to 1 at the hottest reading, shape [n]."""
        middle = self.from_middle_k
        return middle / max(float(np.abs(middle).max()), 1e-9)

    @property
    def step_s(self) -> float:
        """Of the grid."""
        return float(self.grid_s[1] - self.grid_s[0])

    def lagged_c(self, time_constant_s: float) -> Floats:
        """Of a part that lags behind the body by one time constant, at the readings, shape [n]."""
        start = float(self.body_c[0])
        return self.at_readings(
            follow(self.body_c, time_constant_s=time_constant_s, start=start, step_s=self.step_s)
        )

    def motion_heat(self, time_constant_s: float) -> Floats:
        """Degrees of travel kept, with one time constant of cooling, at the readings, shape [n]."""
        power = np.diff(self.travel_deg, prepend=0.0) / self.step_s
        decay = float(np.exp(-self.step_s / time_constant_s))
        out = np.empty_like(power)
        state = 0.0
        for i, value in enumerate(power.tolist()):
            state = state * decay + value * time_constant_s * (1.0 - decay)
            out[i] = state
        return self.at_readings(out)
