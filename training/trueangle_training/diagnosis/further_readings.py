"""Further measurements laid out as readings: what could be recommended after a campaign."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]

POLYGON_SECONDS = 15.0
SWEEP_SPEED_DEG_S = 5.0
SAME_STOP_DEG = 0.2
"""Indicated angles of one stop differ by less: eccentricity makes tens of arcseconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One further measurement."""

    name: str
    text: str
    hours: float
    readings: Callable[[Conditions], Conditions | None]
    """The further readings; None where the joint has not what they need."""


def extended(plan: Conditions, name: str, times: int = 1) -> Conditions | None:
    """The plan and after it the readings of the candidate of that name, as often as is said, each time anew.

    None where the joint has not what they need.
    """
    candidate = next(each for each in CANDIDATES if each.name == name)
    for _ in range(times):
        further = candidate.readings(plan)
        if further is None:
            return None
        plan = joined(plan, further)
    return plan


_AT_REST: dict[str, float] = {
    "direction": 1.0,
    "velocity_deg_s": 0.0,
    "load_nm": 0.0,
    "face": 0,
    "polygon_offset": 0,
}


def joined(plan: Conditions, further: Conditions) -> Conditions:
    """The plan and further readings after it; columns that only one of them has are at rest in the other."""
    changed: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {}
    for name in ("angle_deg", "run", "zero_group", "temperature_c", "time_s", *_AT_REST):
        first, second = getattr(plan, name), getattr(further, name)
        if first is None and second is None:
            continue
        # A plan without temperatures was carried out at one: further readings at the same show nothing of heat.
        rest = plan.base_temperature_c if name == "temperature_c" else _AT_REST.get(name, 0.0)
        first = np.full(len(plan), rest) if first is None else first
        second = (
            np.full(len(further), first[-1] if name == "temperature_c" else rest) if second is None else second
        )
        changed[name] = np.concatenate([first, second])
    return replace(plan, **changed)  # type: ignore[arg-type]


def _run(
    plan: Conditions,
    angle_deg: NDArray[np.floating],
    *,
    seconds: float,
    face: NDArray[np.int64] | None = None,
    direction: Floats | float = 1.0,
    velocity: Floats | float = 0.0,
    load: Floats | float | None = None,
    temperature: Floats | float | None = None,
    offset: int = 0,
    after_s: float = 1800.0,
    number: int = 1,
) -> Conditions:
    """One further run under one zero of its own."""
    n = angle_deg.size
    ones = np.ones(n)
    last_s = float(plan.time_s[-1]) if plan.time_s is not None else POLYGON_SECONDS * len(plan)
    usual = float(np.median(plan.load_nm)) if plan.load_nm is not None else 0.0
    base = plan.base_temperature_c if plan.temperature_c is None else float(np.median(plan.temperature_c))
    new_run = int(plan.run.max()) + number
    return replace(
        plan,
        angle_deg=angle_deg.astype(np.float64),
        run=np.full(n, new_run, dtype=np.int64),
        zero_group=np.full(n, int(plan.zero_group.max()) + number, dtype=np.int64),
        temperature_c=ones * (base if temperature is None else temperature),
        time_s=last_s + after_s + seconds * np.arange(n),
        direction=ones * direction,
        velocity_deg_s=ones * velocity,
        load_nm=ones * (usual if load is None else load),
        face=np.zeros(n, dtype=np.int64) if face is None else face,
        polygon_offset=np.full(n, offset, dtype=np.int64),
    )


def _stops(plan: Conditions) -> tuple[Floats, NDArray[np.int64]]:
    """Angles and faces of one turn as the plan measures them; a reference encoder's plan: 24 stops.

    At a stop that the plan has already, the angle that the encoder indicates there: of what repeats in each line,
    the same stop shows the same again.
    """
    faces = plan.faces if plan.faces is not None else 24
    start = float(plan.angle_deg[0])
    number = np.arange(faces)
    nominal = start + 360.0 / faces * number
    off_deg = np.mod(plan.angle_deg[:, None] - nominal + 180.0, 360.0) - 180.0
    there = np.abs(off_deg) < SAME_STOP_DEG
    shown = [float(np.median(off_deg[there[:, i], i])) if there[:, i].any() else 0.0 for i in number]
    named = number + 1 if plan.faces is not None else np.zeros(faces, dtype=np.int64)
    return np.asarray(nominal + shown, dtype=np.float64), named.astype(np.int64)


def _both_ways(plan: Conditions) -> Conditions:
    angle, face = _stops(plan)
    there_and_back = np.concatenate([angle, angle[::-1]])
    direction = np.repeat([1.0, -1.0], angle.size)
    return _run(
        plan, there_and_back, seconds=POLYGON_SECONDS, face=np.concatenate([face, face[::-1]]), direction=direction
    )


def _other_start(plan: Conditions) -> Conditions:
    angle, face = _stops(plan)
    third = angle.size // 3
    onwards = np.concatenate([angle[third:], angle[:third] + 360.0])
    return _run(plan, onwards, seconds=POLYGON_SECONDS, face=np.roll(face, -third))


def _remounted(plan: Conditions) -> Conditions | None:
    if plan.faces is None:
        return None
    angle, face = _stops(plan)
    third = angle.size // 3
    return _run(plan, angle, seconds=POLYGON_SECONDS, face=np.roll(face, -third), offset=third)


def _more_angles(count: int) -> Callable[[Conditions], Conditions]:
    def readings(plan: Conditions) -> Conditions:
        angle = float(plan.angle_deg[0]) + 360.0 / count * np.arange(count)
        return _run(plan, angle, seconds=POLYGON_SECONDS)

    return readings


def _two_speeds(plan: Conditions) -> Conditions:
    angle = float(plan.angle_deg[0]) + 2.0 * np.arange(180)
    velocity = np.repeat([SWEEP_SPEED_DEG_S, 4.0 * SWEEP_SPEED_DEG_S], angle.size)
    return _run(plan, np.concatenate([angle, angle]), seconds=2.0 / SWEEP_SPEED_DEG_S, velocity=velocity)


def _two_loads(plan: Conditions) -> Conditions:
    angle, face = _stops(plan)
    usual = float(np.median(np.abs(plan.load_nm))) if plan.load_nm is not None else 0.0
    load = np.repeat([usual, 3.0 * usual if usual > 0 else 1.0], angle.size)
    return _run(
        plan, np.concatenate([angle, angle]), seconds=POLYGON_SECONDS, face=np.concatenate([face, face]), load=load
    )


def _dense(plan: Conditions) -> Conditions:
    angle = float(plan.angle_deg[0]) + np.arange(0.0, 3 * 360.0, 1.5)
    return _run(plan, angle, seconds=2.0, velocity=0.0)


def _soak_and_ramp(plan: Conditions) -> Conditions | None:
    if plan.temperature_c is None:
        return None
    angle, face = _stops(plan)
    turns = 6
    ramp = np.linspace(15.0, 35.0, turns * angle.size)
    every = np.concatenate([angle + 360.0 * i for i in range(turns)])
    return _run(plan, every, seconds=60.0, face=np.tile(face, turns), temperature=ramp, after_s=4 * 3600.0)


def _motion_then_rest(plan: Conditions) -> Conditions:
    sweep = float(plan.angle_deg[0]) + 20.0 * np.arange(90)
    angle, _ = _stops(plan)
    rest = float(sweep[-1]) + 360.0 / angle.size * np.arange(3 * angle.size)
    velocity = np.concatenate([np.full(sweep.size, 20.0), np.zeros(rest.size)])
    return _run(plan, np.concatenate([sweep, rest]), seconds=20.0, velocity=velocity)


def _other_temperature(plan: Conditions) -> Conditions:
    angle, face = _stops(plan)
    warm = plan.base_temperature_c + 15.0
    return _run(plan, angle, seconds=POLYGON_SECONDS, face=face, temperature=warm, after_s=4 * 3600.0)


CANDIDATES = (
    Candidate(
        name="another start",
        text="Repeat a run beginning a third of a turn farther on.",
        hours=0.2,
        readings=_other_start,
    ),
    Candidate(
        name="both directions",
        text="Measure one run forwards and backwards under one zero.",
        hours=0.4,
        readings=_both_ways,
    ),
    Candidate(
        name="second speed",
        text="Sweep two turns against a reference encoder under one zero, a reading every 2 deg: one turn at "
        "5 deg/s, one at 20 deg/s.",
        hours=0.5,
        readings=_two_speeds,
    ),
    Candidate(
        name="load in a run",
        text="Change the load within a run (one turn at each load, one zero).",
        hours=0.6,
        readings=_two_loads,
    ),
    Candidate(
        name="polygon re-mounted",
        text="Re-mount the polygon a third of its faces farther on the shaft.",
        hours=0.8,
        readings=_remounted,
    ),
    Candidate(
        name="24 more angles",
        text="Measure 24 evenly spaced angles against a reference encoder.",
        hours=1.0,
        readings=_more_angles(24),
    ),
    Candidate(
        name="29 more angles",
        text="Measure 29 evenly spaced angles against a reference encoder.",
        hours=1.1,
        readings=_more_angles(29),
    ),
    Candidate(
        name="dense sweep",
        text="Sweep three turns against a reference encoder, a reading every 1.5 deg.",
        hours=1.2,
        readings=_dense,
    ),
    Candidate(
        name="motion then rest",
        text="Move fast for half an hour, then take readings standing still.",
        hours=1.5,
        readings=_motion_then_rest,
    ),
    Candidate(
        name="soak against ramp",
        text="Measure during a temperature ramp of 20 K in two hours, after a soak.",
        hours=4.0,
        readings=_soak_and_ramp,
    ),
    Candidate(
        name="another temperature",
        text="Measure a run 15 K warmer, after four hours of soak.",
        hours=5.0,
        readings=_other_temperature,
    ),
)
