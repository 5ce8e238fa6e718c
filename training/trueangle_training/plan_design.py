"""What a calibration plan can see, how long it takes and how well it averages noise, before it is measured."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint, Plan, PlanZero
from trueangle.contract.units import ARCSEC_PER_TURN
from trueangle_training.methods.separable import harmonics
from trueangle_training.simulator.schedule import RunSetup, run_setups

Floats = NDArray[np.float64]

WORST_CONDITION = 10.0
"""Of the harmonics' design: 1 for equal faces; beyond 10 the noise of single faces is magnified."""
HIGHEST_ORDER_ASKED = 60
DEFAULT_SETUP_MIN = 30.0
"""To install and adjust polygon and autocollimator: Jia et al. 2020, section 4.1, within 30 min."""
MINUTES_PER_HOUR, SECONDS_PER_HOUR = 60.0, 3600.0
SAME_OFFSET_FACES = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanTime:
    """Hours of one campaign."""

    setup_h: float
    """The first installation."""
    soak_h: float
    remount_h: float
    """Turning the polygon on the shaft, and adjusting again."""
    reading_h: float
    remounts: int

    @property
    def total_h(self) -> float:
        """All of it."""
        return self.setup_h + self.soak_h + self.remount_h + self.reading_h


@dataclass(frozen=True, slots=True, kw_only=True)
class OrdersSeen:
    """Harmonics of the angle that the plan tells from all lower ones and from the zeros of its runs."""

    highest: int
    """All orders up to here."""
    places: int
    """Distinct stops in the turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoefficientNoise:
    """Standard uncertainty of one Fourier coefficient from the noise of the readings alone: sigma sqrt(2 / N)."""

    reading_arcsec: float
    """sigma, of one reading."""
    steady_arcsec: float
    """N: all readings; for what does not change with temperature."""
    one_temperature_arcsec: float
    """N: the readings of one temperature."""


def plan_readings(plan: Plan) -> int:
    """How many readings the plan has."""
    return plan.faces * plan.repeats * len(plan.directions) * len(plan.temperatures_c)


def plan_time(
    plan: Plan, *, setup_min: float = DEFAULT_SETUP_MIN, remount_min: float = DEFAULT_SETUP_MIN
) -> PlanTime:
    """Hours from the first screw to the last reading."""
    offsets = [setup.offset_faces for setup in run_setups(plan)]
    remounts = sum(abs(after - before) > SAME_OFFSET_FACES for before, after in itertools.pairwise(offsets))
    return PlanTime(
        setup_h=setup_min / MINUTES_PER_HOUR,
        soak_h=plan.soak_h * len(plan.temperatures_c),
        remount_h=remounts * remount_min / MINUTES_PER_HOUR,
        reading_h=plan_readings(plan) * plan.seconds_per_reading / SECONDS_PER_HOUR,
        remounts=remounts,
    )


def one_temperature(plan: Plan) -> tuple[RunSetup, ...]:
    """The runs at the plan's first temperature: all temperatures have the same stops."""
    return tuple(setup for setup in run_setups(plan) if setup.temperature_c == plan.temperatures_c[0])


def orders_seen(plan: Plan) -> OrdersSeen:
    """From the condition of harmonics plus one free zero a mounting, so for any shift.

    n equal faces give (n - 1) / 2. Repeats shifted by a third of the pitch give n - 1: order n is the same at all
    faces of a mounting and cannot be told from the mounting's zero.
    """
    mountings = {round(setup.offset_faces % 1.0, 6): setup for setup in one_temperature(plan)}
    angle_deg = np.concatenate([setup.stop_deg(plan.faces) for setup in mountings.values()])
    zeros = np.kron(np.eye(len(mountings)), np.ones((plan.faces, 1)))
    highest = 0
    for order in range(1, min((angle_deg.size - 1) // 2, HIGHEST_ORDER_ASKED) + 1):
        design = np.concatenate([zeros, harmonics(angle_deg, tuple(range(1, order + 1)))], axis=1)
        if design.shape[1] > design.shape[0] or np.linalg.cond(design) > WORST_CONDITION:
            break
        highest = order
    return OrdersSeen(highest=highest, places=int(angle_deg.size))


def reading_noise_arcsec(joint: Joint) -> float:
    """Standard deviation of one reading: scatter, autocollimator and the rounding to counts together."""
    count_arcsec = ARCSEC_PER_TURN / joint.encoder.counts_per_rev
    parts = (joint.noise.repeatability_arcsec, joint.reference.autocollimator_arcsec, count_arcsec / 12**0.5)
    return float(np.sqrt(np.sum(np.square(parts))))


def coefficient_noise(plan: Plan, reading_arcsec: float) -> CoefficientNoise:
    """sigma sqrt(2 / N): the variance of cos and sin over N equally spread readings is N / 2."""
    readings = plan_readings(plan)
    here = readings // len(plan.temperatures_c)
    return CoefficientNoise(
        reading_arcsec=reading_arcsec,
        steady_arcsec=reading_arcsec * (2.0 / readings) ** 0.5,
        one_temperature_arcsec=reading_arcsec * (2.0 / here) ** 0.5,
    )


def recommended_shift(repeats: int) -> float:
    """Parts of the face pitch: a third from three repeats on, half with two, none with one."""
    return 0.0 if repeats < 2 else 0.5 if repeats == 2 else 1.0 / 3.0


def shifted(plan: Plan, shift_faces: float) -> Plan:
    """The plan with its repeats shifted; a shifted plan has a zero for every run."""
    zero = plan.zero if shift_faces == 0.0 else PlanZero.PER_RUN
    return replace(plan, shift_faces=shift_faces, zero=zero)
