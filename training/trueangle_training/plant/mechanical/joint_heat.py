"""Temperatures of a campaign: the chamber's air, and the joint from head carrier to grating."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.mechanical.heat_line import GRID_S, Row, uniform_row
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

BASE_C = 20.0
SPAN_K = 15.0
NODES = ("head carrier", "flange", "bearing", "shaft", "hub", "grating")
HEAD, GRATING = 0, 5
ROD_NODES = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointHeat:
    """Courses on a grid of equal steps, arrays of shape [g]."""

    grid_s: Floats
    head_c: Floats
    grating_c: Floats
    travel_deg: Floats
    """Made since the start."""
    reading_s: Floats
    """[n]"""

    def at_readings(self, course: Floats) -> Floats:
        """A course of the grid at the readings, shape [n]."""
        return np.interp(self.reading_s, self.grid_s, course)

    @property
    def warming(self) -> Floats:
        """The grating's temperature from 20 degC in units of 15 K at the readings, shape [n]."""
        return (self.at_readings(self.grating_c) - BASE_C) / SPAN_K

    def behind_k(self, diffusion_s: float) -> Floats:
        """Inner half of a badly glued disc less its rim, which follows the joint; at the readings, shape [n]."""
        disc = uniform_row(nodes=ROD_NODES, diffusion_s=diffusion_s)
        rim = self.grating_c - BASE_C
        idle = np.zeros_like(rim)
        nodes = disc.temperatures_k(rim, idle, heated=0, step_s=GRID_S, start=float(rim[0]))
        return self.at_readings(nodes[:, ROD_NODES // 2 :].mean(axis=1) - rim)

    def motion_heat(self, diffusion_s: float, *, film_share: float, place: float) -> Floats:
        """Warming of the shaft by its bearing at the readings, over its largest, shape [n].

        The bearing's ring is the shaft's far end; `place` is where the shaft carries the grating, from 0 at the
        cool end to 1 at the bearing.
        """
        shaft = uniform_row(nodes=ROD_NODES, diffusion_s=diffusion_s, film_share=film_share)
        power = np.diff(self.travel_deg, prepend=0.0) / GRID_S
        nodes = shaft.temperatures_k(np.zeros_like(power), power, heated=ROD_NODES - 1, step_s=GRID_S)
        course = self.at_readings(nodes[:, round(place * (ROD_NODES - 1))])
        return course / max(float(course.max()), 1e-12)


def draw_joint_heat(schedule: Schedule, rng: np.random.Generator) -> JointHeat:
    """A chamber with a two-point controller's ripple, and a joint of aluminium and steel in its moving air."""
    end_s = max(float(schedule.time_s[-1]), float(schedule.path_time_s[-1])) + 2.0 * GRID_S
    grid = np.arange(0.0, end_s, GRID_S)
    air = _air(grid, np.interp(grid, schedule.chamber_time_s, schedule.chamber_c), rng)
    joint = _joint_row(slow_s=float(rng.uniform(600.0, 1500.0)), link_s=float(rng.uniform(1.0, 5.0)))
    nodes = joint.temperatures_k(air - BASE_C, np.zeros_like(air), heated=HEAD, step_s=GRID_S)
    made = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(schedule.path_angle_deg)))])
    return JointHeat(
        grid_s=grid,
        head_c=BASE_C + nodes[:, HEAD],
        grating_c=BASE_C + nodes[:, GRATING],
        travel_deg=np.interp(grid, schedule.path_time_s, made),
        reading_s=schedule.time_s,
    )


def _air(grid_s: Floats, wanted_c: Floats, rng: np.random.Generator) -> Floats:
    """Walls of the chamber are one node behind the set point; the controller saws, the day comes through."""
    chamber = Row(
        capacity_j_k=np.array([1.0]),
        between_w_k=np.array([]),
        film_w_k=np.array([1.0 / float(rng.uniform(200.0, 800.0))]),
    )
    idle = np.zeros_like(grid_s)
    walls = chamber.temperatures_k(wanted_c - BASE_C, idle, heated=0, step_s=GRID_S)[:, 0]
    period_s, height_c = float(rng.uniform(500.0, 2000.0)), float(rng.uniform(0.02, 0.2))
    saw = 2.0 * np.abs(2.0 * ((grid_s / period_s + float(rng.random())) % 1.0) - 1.0) - 1.0
    day = float(rng.uniform(0.0, 0.25)) * np.sin(2.0 * np.pi * (grid_s / 86_400.0 + float(rng.random())))
    return BASE_C + walls + height_c * saw + day


def _joint_row(*, slow_s: float, link_s: float) -> Row:
    """Six nodes; `slow_s`: of the whole in the air, `link_s`: of one node on its neighbour."""
    capacity = np.array([2.0, 3.0, 1.0, 1.5, 1.0, 0.5])
    area = np.array([0.25, 0.3, 0.1, 0.1, 0.1, 0.15])
    return Row(
        capacity_j_k=capacity,
        between_w_k=np.minimum(capacity[1:], capacity[:-1]) / link_s,
        film_w_k=area / area.sum() * capacity.sum() / slow_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A sensor in a bore of the head carrier."""

    time_constant_s: float
    step_c: float
    bias_c: float
    gain: float

    def readings_c(self, heat: JointHeat) -> Floats:
        """What it says at the readings, shape [n]."""
        bore = Row(
            capacity_j_k=np.array([1.0]),
            between_w_k=np.array([]),
            film_w_k=np.array([1.0 / self.time_constant_s]),
        )
        outside = heat.head_c - BASE_C
        own = bore.temperatures_k(
            outside, np.zeros_like(outside), heated=0, step_s=GRID_S, start=float(outside[0])
        )
        said = BASE_C + self.gain * heat.at_readings(own[:, 0]) + self.bias_c
        return np.round(said / self.step_c) * self.step_c


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """An ordinary digital sensor."""
    return Sensor(
        time_constant_s=float(rng.uniform(4.0, 20.0)),
        step_c=float(rng.choice([0.01, 0.0625, 0.1])),
        bias_c=float(rng.normal(0.0, 0.15)),
        gain=1.0 + float(rng.normal(0.0, 0.003)),
    )
