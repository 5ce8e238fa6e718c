"""Temperatures of a campaign whose soak is too short: the joint is still under way when it is read."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

GRID_S = 8.0
ROOM_C = 20.0
SLAB_MODES = 4


def one_pole(driver: Floats, *, time_constant_s: float, start: float, step_s: float = GRID_S) -> Floats:
    """A lumped mass behind its surroundings at equal steps, shape [g]; between two, their mean drives it."""
    decay = float(np.exp(-step_s / time_constant_s))
    held = 0.5 * (driver + np.concatenate([driver[:1], driver[:-1]]))
    held[0] = start
    out, _ = lfilter([1.0 - decay], [1.0, -decay], held, zi=[decay * start])
    return np.asarray(out, dtype=np.float64)


def slab_mean(driver: Floats, *, time_constant_s: float, start: float, step_s: float = GRID_S) -> Floats:
    """Mean temperature of a slab that is heated at one face and insulated at the other, shape [g].

    Its step response is 1 - sum_j 8 / (pi m_j)^2 exp(-m_j^2 t / tau), m_j = 1, 3, 5, ... (Carslaw and Jaeger,
    Conduction of Heat in Solids, chapter III); the modes left out are given to the fastest one.
    """
    odd = 2.0 * np.arange(SLAB_MODES) + 1.0
    weights = 8.0 / (np.pi * odd) ** 2
    weights[-1] += 1.0 - float(weights.sum())
    parts = [
        weight * one_pole(driver, time_constant_s=time_constant_s / m**2, start=start, step_s=step_s)
        for weight, m in zip(weights.tolist(), odd.tolist(), strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0), dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Soak:
    """Courses on a grid of equal steps, shape [g]."""

    grid_s: Floats
    body_c: Floats
    travel_deg: Floats
    """Made since the start."""
    reading_s: Floats
    """[n]"""

    def at_readings(self, course: Floats) -> Floats:
        """A course of the grid at the readings, shape [n]."""
        return np.interp(self.reading_s, self.grid_s, course)

    @property
    def temperature_c(self) -> Floats:
        """Of the body at the readings, shape [n]."""
        return self.at_readings(self.body_c)

    def behind_c(self, time_constant_s: float) -> Floats:
        """Of a disc that is heated through its hub, at the readings."""
        return self.at_readings(
            slab_mean(self.body_c, time_constant_s=time_constant_s, start=float(self.body_c[0]))
        )

    def friction_heat(self, time_constant_s: float, *, slow_share: float = 0.0) -> Floats:
        """Warming by motion at the readings, in degrees of travel: a ring, and a shaft four times as slow."""
        power = np.diff(self.travel_deg, prepend=0.0) / GRID_S * time_constant_s
        ring = one_pole(power, time_constant_s=time_constant_s, start=0.0)
        shaft = one_pole(power, time_constant_s=4.0 * time_constant_s, start=0.0)
        return self.at_readings((1.0 - slow_share) * ring + slow_share * shaft)


def draw_soak(schedule: Schedule, rng: np.random.Generator) -> Soak:
    """A chamber that swings in on its set point, and a heavy joint that follows within half an hour or more."""
    end_s = max(float(schedule.time_s[-1]), float(schedule.path_time_s[-1])) + 2.0 * GRID_S
    grid = np.arange(0.0, end_s, GRID_S)
    wanted = np.interp(grid, schedule.chamber_time_s, schedule.chamber_c)
    air = swinging(wanted, period_s=float(rng.uniform(900.0, 2400.0)), damping=float(rng.uniform(0.45, 0.9)))
    hunting = np.sign(np.sin(2.0 * np.pi * grid / float(rng.uniform(300.0, 1500.0)) + float(rng.uniform(0, 6.28))))
    air = air + float(rng.uniform(0.02, 0.2)) * hunting
    hall = np.sin(2.0 * np.pi * grid / 86_400.0 + float(rng.uniform(0.0, 2.0 * np.pi)))
    air = air + float(rng.uniform(0.0, 0.3)) * hall
    body = one_pole(air, time_constant_s=float(rng.uniform(1500.0, 4000.0)), start=ROOM_C)
    made = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(schedule.path_angle_deg)))])
    return Soak(
        grid_s=grid,
        body_c=body,
        travel_deg=np.interp(grid, schedule.path_time_s, made),
        reading_s=schedule.time_s,
    )


def swinging(wanted: Floats, *, period_s: float, damping: float) -> Floats:
    """A controller of second order with overshoot, from its set point's beginning on, shape [g].

    y'' + 2 d w y' + w^2 (y - x) = 0 by the bilinear transform.
    """
    w = 2.0 * np.pi / period_s
    k = 2.0 / GRID_S
    lead = k**2 + 2.0 * damping * w * k + w**2
    fed = np.array([1.0, 2.0, 1.0]) * w**2 / lead
    back = np.array([lead, 2.0 * (w**2 - k**2), k**2 - 2.0 * damping * w * k + w**2]) / lead
    first = float(wanted[0])
    return first + np.asarray(lfilter(fed, back, wanted - first), dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """A resistance thermometer clamped to the joint, warmed by its own current while it is read out."""

    time_constant_s: float
    step_c: float
    bias_c: float
    gain: float
    warming_c: float
    """Of its own, when it has been read out for long."""
    warming_s: float
    """Time constant of that."""

    def readings_c(self, soak: Soak, on_since_s: Floats) -> Floats:
        """What it says at the readings; `on_since_s` [n] is how long it has been read out in this run."""
        own = soak.at_readings(
            one_pole(soak.body_c, time_constant_s=self.time_constant_s, start=float(soak.body_c[0]))
        )
        warmed = self.warming_c * -np.expm1(-on_since_s / self.warming_s)
        said = ROOM_C + self.gain * (own + warmed - ROOM_C) + self.bias_c
        return np.round(said / self.step_c) * self.step_c


def draw_probe(rng: np.random.Generator) -> Probe:
    """An ordinary thermometer, adjusted at its working current."""
    return Probe(
        time_constant_s=float(rng.uniform(2.0, 12.0)),
        step_c=float(rng.choice([0.01, 0.02, 0.05, 0.1])),
        bias_c=float(rng.normal(0.0, 0.12)),
        gain=1.0 + float(rng.normal(0.0, 0.003)),
        warming_c=float(rng.uniform(0.005, 0.04)),
        warming_s=float(rng.uniform(20.0, 90.0)),
    )
