"""Where the shaft stands, when, how warm and under which load at each reading of a plan.

The plan's own runs come first, one for each temperature, repeat and direction. In a run the shaft is stopped where
the autocollimator sees the next face, once round, starting at the first stop at or after the encoder's zero. With
the polygon turned on the shaft by s face pitches, face p is seen at the true angle (p - 1 + s) 360 / faces: the
whole part of s only renames the faces, its fraction moves the stops. Then come the segments.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Plan, PlanZero, Segment, SegmentKind
from trueangle.contract.units import DEG_PER_TURN

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SECONDS_PER_HOUR = 3600.0
MOST_READINGS = 2_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSetup:
    """One of the plan's own runs: what distinguishes it from the others."""

    run: int
    temperature_c: float
    """Set point."""
    offset_faces: float
    """Turn of the polygon on the shaft, 0 <= offset < faces."""
    direction: int
    started_s: float

    @property
    def whole_faces(self) -> int:
        """By how many whole faces the polygon is turned: it only renames the faces."""
        return math.floor(self.offset_faces)

    def stops(self, faces: int) -> Integers:
        """Place of each reading in the turn, counted in faces from the first one, shape [faces]."""
        # Downwards the first stop is the same one, then the last: both directions share their zero.
        return self.direction * np.arange(faces) % faces

    def stop_deg(self, faces: int) -> Floats:
        """True angle of each reading, shape [faces]."""
        broken = self.offset_faces - self.whole_faces
        return (self.stops(faces).astype(np.float64) + broken) * (DEG_PER_TURN / faces)

    def stop_faces(self, faces: int) -> Integers:
        """Polygon face 1..n of each reading, shape [faces]."""
        return (self.stops(faces) - self.whole_faces) % faces + 1


def run_setups(plan: Plan) -> Iterator[RunSetup]:
    """The plan's own runs in the order in which they are measured."""
    run = 0
    clock_s = 0.0
    for temperature_c in plan.temperatures_c:
        clock_s += plan.soak_h * SECONDS_PER_HOUR
        for repeat in range(plan.repeats):
            for direction in plan.directions:
                run += 1
                yield RunSetup(
                    run=run,
                    temperature_c=temperature_c,
                    offset_faces=repeat * plan.shift_faces % plan.faces,
                    direction=direction,
                    started_s=clock_s,
                )
                clock_s += plan.faces * plan.seconds_per_reading


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """One way over the angles: a run, or a part of one."""

    run: int
    zero_group: int
    set_point_c: float
    ramp_c_per_h: float
    soaked_since_s: float | None
    """When the chamber was set to this temperature; None: it was already there, or the run has begun."""
    direction: int
    velocity_deg_s: float
    load_nm: float
    polygon_offset: int
    true_deg: Floats
    """[readings], turns kept."""
    time_s: Floats
    """[readings]"""
    face: Integers
    """[readings], 0 against a reference encoder."""

    @property
    def polygon(self) -> bool:
        """Whether polygon and autocollimator give the reference."""
        return bool(self.face[0])


def legs(plan: Plan) -> tuple[Leg, ...]:
    """All readings of the plan in the order in which they are taken; ContractError for more than fit in memory."""
    readings = len(plan.temperatures_c) * plan.repeats * len(plan.directions) * plan.faces
    readings += sum(_segment_readings(segment, plan) for segment in plan.segments)
    if readings > MOST_READINGS:
        expected = f"at most {MOST_READINGS} readings"
        raise ContractError([Fault(where="the plan", expected=expected, found=str(readings))])
    own = tuple(_own_leg(setup, plan) for setup in run_setups(plan))
    return (*own, *_segment_legs(plan, own))


def _own_leg(setup: RunSetup, plan: Plan) -> Leg:
    first_of_temperature = (setup.run - 1) % (plan.repeats * len(plan.directions)) == 0
    elapsed_s = np.arange(plan.faces, dtype=np.float64) * plan.seconds_per_reading
    return Leg(
        run=setup.run,
        zero_group=1 if plan.zero is PlanZero.ONE else setup.run,
        set_point_c=setup.temperature_c,
        ramp_c_per_h=0.0,
        soaked_since_s=setup.started_s - plan.soak_h * SECONDS_PER_HOUR if first_of_temperature else None,
        direction=setup.direction,
        velocity_deg_s=0.0,
        load_nm=0.0,
        polygon_offset=setup.whole_faces,
        true_deg=setup.stop_deg(plan.faces),
        time_s=setup.started_s + elapsed_s,
        face=setup.stop_faces(plan.faces),
    )


def _segment_readings(segment: Segment, plan: Plan) -> int:
    passes = len(segment.temperatures_c) * segment.repeats * len(segment.loads_nm) * len(segment.directions)
    return passes * sum(_way(segment, speed, plan)[0].size for speed in segment.stepping_speeds_deg_s)


def _segment_legs(plan: Plan, own: tuple[Leg, ...]) -> Iterator[Leg]:
    run = len(own)
    clock_s = plan.faces * plan.seconds_per_reading + float(own[-1].time_s[0]) if own else 0.0
    sweep_zero: int | None = None
    for segment in plan.segments:
        sweep = segment.kind is SegmentKind.SWEEP
        zero = segment.zero or (PlanZero.ONE if sweep else PlanZero.PER_RUN)
        group = sweep_zero if sweep else None
        for temperature_c, repeat in _blocks(segment):
            soaked_since_s = None
            if repeat == 0 or segment.ramp_c_per_h != 0.0:
                soaked_since_s = clock_s
                clock_s += (plan.soak_h if segment.soak_h is None else segment.soak_h) * SECONDS_PER_HOUR
            for number, (load_nm, speed_deg_s, direction) in enumerate(_passes(segment)):
                run += number == 0 or not segment.one_run
                group = run if group is None else group
                leg = _leg(segment, plan, direction, speed_deg_s, clock_s)
                clock_s = leg.clock_s
                yield Leg(
                    run=run,
                    zero_group=group if zero is PlanZero.ONE else run,
                    set_point_c=temperature_c,
                    ramp_c_per_h=segment.ramp_c_per_h,
                    soaked_since_s=soaked_since_s if number == 0 else None,
                    direction=direction,
                    velocity_deg_s=direction * speed_deg_s + 0.0,  # -1 times 0 would be written as -0.0
                    load_nm=load_nm,
                    polygon_offset=math.floor(segment.polygon_offset),
                    true_deg=leg.true_deg,
                    time_s=leg.time_s,
                    face=leg.face,
                )
        if sweep and zero is PlanZero.ONE:
            sweep_zero = group


def _blocks(segment: Segment) -> Iterator[tuple[float, int]]:
    for temperature_c in segment.temperatures_c:
        for repeat in range(segment.repeats):
            yield temperature_c, repeat


def _passes(segment: Segment) -> Iterator[tuple[float, float, int]]:
    for load_nm in segment.loads_nm:
        for speed_deg_s in segment.stepping_speeds_deg_s:
            for direction in segment.directions:
                yield load_nm, speed_deg_s, direction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Way:
    """Angles and times of one pass, and the time after it."""

    true_deg: Floats
    time_s: Floats
    face: Integers
    clock_s: float


def _leg(segment: Segment, plan: Plan, direction: int, speed_deg_s: float, clock_s: float) -> _Way:
    true_deg, face, seconds = _way(segment, speed_deg_s, plan)
    # Downwards the same places are met backwards: inside a run the shaft turns round where it stands.
    return _Way(
        true_deg=true_deg[::direction],
        time_s=clock_s + np.arange(true_deg.size, dtype=np.float64) * seconds,
        face=face[::direction],
        clock_s=clock_s + true_deg.size * seconds,
    )


def _way(segment: Segment, speed_deg_s: float, plan: Plan) -> tuple[Floats, Integers, float]:
    """Angles upwards, faces, seconds per reading."""
    given_s = segment.seconds_per_reading
    if segment.kind is SegmentKind.POLYGON:
        whole = math.floor(segment.polygon_offset)
        stop = np.arange(plan.faces * round(segment.turns), dtype=np.int64)
        true_deg = (stop.astype(np.float64) + (segment.polygon_offset - whole)) * (DEG_PER_TURN / plan.faces)
        return true_deg, (stop - whole) % plan.faces + 1, plan.seconds_per_reading if given_s is None else given_s
    step_deg = segment.degrees_per_reading or speed_deg_s * (given_s or 0.0)
    seconds = step_deg / speed_deg_s if given_s is None else given_s
    count = max(1, round(segment.turns * DEG_PER_TURN / step_deg))
    if count > MOST_READINGS:
        expected = f"at most {MOST_READINGS} readings in one pass"
        raise ContractError([Fault(where="a sweep of the plan", expected=expected, found=str(count))])
    true_deg = segment.from_deg + np.arange(count, dtype=np.float64) * step_deg
    return true_deg, np.zeros(count, dtype=np.int64), seconds
