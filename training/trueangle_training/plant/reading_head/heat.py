"""Heat, stepped through the whole campaign: chamber, body of the joint, sensor, and what motion brings in."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.history import follow
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

STEP_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Climate:
    """Temperatures of a campaign on a grid of equal steps in time."""

    grid_s: Floats
    body_c: Floats
    """What grating and shaft have, as long as neither lags."""
    travel_deg: Floats
    """Travel made since the start, on the grid."""
    reading_s: Floats

    def at_readings(self, values: Floats) -> Floats:
        """A course on the grid, at the readings: shape [n]."""
        return np.interp(self.reading_s, self.grid_s, values)

    @property
    def temperature_c(self) -> Floats:
        """Of the body at the readings, shape [n]."""
        return self.at_readings(self.body_c)

    def lagged_c(self, time_constant_s: float) -> Floats:
        """Of a part that lags behind the body, at the readings."""
        start = float(self.body_c[0])
        return self.at_readings(follow(self.body_c, time_constant_s=time_constant_s, start=start, step_s=STEP_S))

    def motion_heat(self, time_constant_s: float, *, loss: float = 0.0) -> Floats:
        """Warming by friction at the readings: degrees of travel kept, with the time constant of cooling.

        `loss`: by how much a warmer bearing turns more easily (thinner grease), relative change for a warming of
        one time constant at 1 deg/s.
        """
        power = np.diff(self.travel_deg, prepend=0.0) / STEP_S
        decay = float(np.exp(-STEP_S / time_constant_s))
        out = np.empty_like(power)
        state = 0.0
        for i, value in enumerate(power.tolist()):
            eased = value / (1.0 + loss * state / time_constant_s)
            state = state * decay + eased * time_constant_s * (1.0 - decay)
            out[i] = state
        return self.at_readings(out)


def draw_climate(schedule: Schedule, rng: np.random.Generator) -> Climate:
    """The chamber comes late to its set point, cycles about it and drifts; the body follows the air."""
    end_s = max(float(schedule.time_s[-1]), float(schedule.path_time_s[-1])) + 2 * STEP_S
    grid = np.arange(0.0, end_s, STEP_S)
    setting = np.interp(grid, schedule.chamber_time_s, schedule.chamber_c)
    air = follow(setting, time_constant_s=float(rng.uniform(300.0, 900.0)), start=20.0, step_s=STEP_S)
    period_s = float(rng.uniform(600.0, 2400.0))
    phase = float(rng.uniform(0, 2 * np.pi))
    air = air + float(rng.uniform(0.03, 0.15)) * np.sin(2 * np.pi * grid / period_s + phase)
    wander = follow(rng.normal(size=grid.size), time_constant_s=1800.0, start=0.0, step_s=STEP_S)
    air = air + float(rng.uniform(0.03, 0.15)) * wander / max(float(wander.std()), 1e-9)
    body = follow(air, time_constant_s=float(rng.uniform(600.0, 1500.0)), start=20.0, step_s=STEP_S)
    path_travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(schedule.path_angle_deg)))])
    return Climate(
        grid_s=grid,
        body_c=body,
        travel_deg=np.interp(grid, schedule.path_time_s, path_travel),
        reading_s=schedule.time_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The temperature sensor beside the reading head."""

    time_constant_s: float
    step_c: float
    bias_c: float
    gain: float

    def readings_c(self, climate: Climate) -> Floats:
        """What it says at the readings, shape [n]."""
        own = climate.lagged_c(self.time_constant_s)
        said = 20.0 + self.gain * (own - 20.0) + self.bias_c
        return np.round(said / self.step_c) * self.step_c


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """An ordinary digital sensor."""
    return Sensor(
        time_constant_s=float(rng.uniform(5.0, 30.0)),
        step_c=float(rng.choice([0.01, 0.0625, 0.1])),
        bias_c=float(rng.normal(0.0, 0.15)),
        gain=1.0 + float(rng.normal(0.0, 0.003)),
    )
