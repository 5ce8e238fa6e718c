"""Friction with a memory, stepped along the shaft's path: LuGre in the bearing, Bouc-Wen in a dragged cable."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

BRAKING_STEPS = 8
"""Steps of equal loss of speed while the drive brakes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LuGre:
    """Canudas de Wit et al. 1995, torques over the Coulomb torque.

    z' = v - |v| z / (L g(v)), torque = z / L + viscous v, g(v) = 1 + (breakaway - 1) exp(-(v / stribeck)^2).
    """

    bristle_deg: float
    """L, deflection of the bristles at the Coulomb torque."""
    breakaway: float
    stribeck_deg_s: float
    viscous_s_deg: float
    """Torque for a speed of 1 deg/s."""
    braking_deg_s2: float
    """Deceleration of the drive before a stop."""

    def limit(self, speed_deg_s: float) -> float:
        """Torque of the bristles in steady sliding."""
        return 1.0 + (self.breakaway - 1.0) * float(np.exp(-((speed_deg_s / self.stribeck_deg_s) ** 2)))

    def slid(self, torque: float, travel_deg: float, speed_deg_s: float) -> float:
        """Torque of the bristles after a way at constant speed, exactly."""
        limit = self.limit(speed_deg_s) * (1.0 if travel_deg > 0 else -1.0)
        left = abs(travel_deg) / (abs(limit) * self.bristle_deg)
        return limit + (torque - limit) * float(np.exp(-left))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Stretches of a path between two of its points, arrays of shape [p - 1]."""

    travel_deg: Floats
    speed_deg_s: Floats
    brakes: NDArray[np.bool_]
    """Whether the shaft stands or turns back at the end of it."""


def motion_of(schedule: Schedule) -> Motion:
    """What the drive does on each stretch."""
    travel = np.diff(schedule.path_angle_deg)
    lasts = np.diff(schedule.path_time_s)
    moving = lasts > 0.0
    speed = np.divide(np.abs(travel), lasts, out=np.zeros_like(travel), where=moving)
    brakes = np.ones(travel.size, dtype=np.bool_)
    after = 0.0
    for i in range(travel.size - 1, -1, -1):
        brakes[i] = travel[i] * after <= 0.0
        if moving[i]:
            after = float(travel[i])
    return Motion(travel_deg=travel, speed_deg_s=speed, brakes=brakes)


def lugre_torque(schedule: Schedule, bearing: LuGre) -> Floats:
    """Friction torque over the Coulomb torque at each reading, shape [n]."""
    motion = motion_of(schedule)
    state, out = 0.0, np.zeros(schedule.path_angle_deg.size)
    stretches = zip(motion.travel_deg.tolist(), motion.speed_deg_s.tolist(), motion.brakes.tolist(), strict=True)
    for i, (travel, speed, brakes) in enumerate(stretches, start=1):
        if travel != 0.0:
            state = _moved(state, travel, speed, bearing, brakes=brakes)
        out[i] = state
    return out[schedule.reading_at] + bearing.viscous_s_deg * schedule.velocity_deg_s


def _moved(state: float, travel: float, speed: float, bearing: LuGre, *, brakes: bool) -> float:
    sense = 1.0 if travel > 0 else -1.0
    braking = min(abs(travel), speed**2 / (2.0 * bearing.braking_deg_s2)) if brakes else 0.0
    if abs(travel) > braking:
        state = bearing.slid(state, sense * (abs(travel) - braking), speed)
    if braking > 0.0:
        first = float(np.sqrt(2.0 * bearing.braking_deg_s2 * braking))
        speeds = np.linspace(first, 0.0, BRAKING_STEPS + 1)
        ways = -np.diff(speeds**2) / (2.0 * bearing.braking_deg_s2)
        for way, middle in zip(ways.tolist(), (0.5 * (speeds[1:] + speeds[:-1])).tolist(), strict=True):
            state = bearing.slid(state, sense * way, middle)
    return state


@dataclass(frozen=True, slots=True, kw_only=True)
class BoucWen:
    """A cable or bellows that is dragged along, torque over its largest.

    L dz/dx = 1 - |z|^n (loading sgn(z x') + 1 - loading), Bouc 1967, Wen 1976.
    """

    length_deg: float
    exponent: float
    loading: float
    """0.5 to 1; at 0.5 unloading is straight."""


def bouc_wen_torque(path_deg: Floats, cable: BoucWen) -> Floats:
    """Torque over its largest at each point of a path, shape [p], by Runge and Kutta's fourth order."""
    out = np.zeros(path_deg.size)
    state = 0.0
    for i, travel in enumerate(np.diff(path_deg).tolist(), start=1):
        sense = 1.0 if travel > 0 else -1.0
        way = min(abs(travel), 30.0 * cable.length_deg)
        steps = int(np.ceil(5.0 * way / cable.length_deg))
        for _ in range(steps):
            state = _runge_kutta(state, sense, way / steps / cable.length_deg, cable)
        out[i] = state
    return out


def _runge_kutta(state: float, sense: float, size: float, cable: BoucWen) -> float:
    first = _slope(state, sense, cable)
    second = _slope(state + 0.5 * size * first, sense, cable)
    third = _slope(state + 0.5 * size * second, sense, cable)
    fourth = _slope(state + size * third, sense, cable)
    return state + size / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def _slope(state: float, sense: float, cable: BoucWen) -> float:
    with_it = 1.0 if state * sense > 0 else -1.0
    return sense * (1.0 - abs(state) ** cable.exponent * (cable.loading * with_it + 1.0 - cable.loading))
