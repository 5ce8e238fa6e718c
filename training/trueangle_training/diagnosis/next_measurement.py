"""The cheapest further measurement that separates what this plan cannot tell apart, or shows what it cannot see.

Each candidate is laid out as readings, appended to the plan, and judged by the same design check as the plan
itself: what is recommended has been simulated, not looked up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.containment import LEAST_VISIBLE
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.problem import Problem, recalibration_span
from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]

TELLING_READINGS = 12.0
"""Energy of a pattern that another cannot carry (or that re-calibration cannot take up), in readings: with an
effect as large as the noise of one reading, half as many nats."""
SHAPES = 8
"""Of the named effect, spread over its grid."""
MOST_ROWS_OF_PLAN = 1500
"""Of the plan, the first readings of each run: what the runs have in common is enough here."""
POLYGON_SECONDS = 15.0
SWEEP_SPEED_DEG_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Extension:
    """One candidate and what it would bring."""

    name: str
    text: str
    """What to do, in one sentence."""
    hours: float
    """Rough cost, for the order only."""
    separates: tuple[str, ...]
    """Members of the class that could no longer be mistaken for the named one."""
    shows: tuple[str, ...]
    """Effects that become visible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NextMeasurement:
    """The recommendation."""

    text: str
    chosen: Extension | None
    """None: nothing is left to separate or to show, or no candidate would."""
    candidates: tuple[Extension, ...]
    """All that were simulated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Candidate:
    name: str
    text: str
    hours: float
    readings: Callable[[Conditions], Conditions | None]
    """The further readings; None where the joint has not what they need."""


def next_measurement(
    problem: Problem, design: Design, effect_class: Sequence[str] = (), found_labels: Sequence[str] = ()
) -> NextMeasurement:
    """Recommend for a class with several members (the named one first), otherwise for what the plan cannot see.

    `found_labels`: labels of the hypotheses that were found of the named one; without them all its shapes count.
    """
    suspects = tuple(effect_class) if len(effect_class) > 1 else ()
    unseen = tuple(dict.fromkeys((*design.invisible, *design.not_testable)))
    if not suspects and not unseen:
        return NextMeasurement(
            text="No further measurement is needed: the plan sees every effect of the library.",
            chosen=None,
            candidates=(),
        )
    plan = _thinned(problem.conditions)
    tried: list[Extension] = []
    for candidate in _CANDIDATES:
        further = candidate.readings(plan)
        if further is not None:
            tried.append(_judged(problem, plan, further, candidate, suspects, unseen, found_labels))
    key = (lambda each: len(each.separates)) if suspects else (lambda each: len(each.shows))
    useful = [each for each in tried if key(each) > 0]
    if not useful:
        none = f"none of the {len(tried)} further measurements that were tried in simulation"
        if suspects:
            text = f"Nothing to measure for that: {none} tells {_and(suspects)} apart."
        else:
            text = f"Nothing more to measure: {none} would show {_and(unseen)}, which this plan hides."
        return NextMeasurement(text=text, chosen=None, candidates=tuple(tried))
    most = max(key(each) for each in useful)
    chosen = min((each for each in useful if key(each) == most), key=lambda each: (each.hours, -len(each.shows)))
    text = _separating(chosen, suspects) if suspects else _showing(chosen, unseen)
    return NextMeasurement(text=text, chosen=chosen, candidates=tuple(tried))


def _showing(chosen: Extension, unseen: Sequence[str]) -> str:
    left = [name for name in unseen if name not in chosen.shows]
    sentence = f"{chosen.text} This would show {_and(chosen.shows)}, which this plan hides"
    return sentence + (f"; {_and(left)} would stay hidden." if left else ".")


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _separating(chosen: Extension, suspects: Sequence[str]) -> str:
    left = [name for name in suspects[1:] if name not in chosen.separates]
    sentence = f"{chosen.text} It tells {suspects[0]} from {_and(chosen.separates)}."
    return sentence + (f" It does not tell it from {_and(left)}." if left else "")


def _judged(
    problem: Problem,
    plan: Conditions,
    further: Conditions,
    candidate: _Candidate,
    suspects: Sequence[str],
    unseen: Sequence[str],
    found_labels: Sequence[str],
) -> Extension:
    conditions = _joined(plan, further)
    wanted = {*suspects, *unseen}
    library = {name: effect for name, effect in problem.library.items() if name in wanted}
    modelled, names, drift = recalibration_span(conditions, problem.joint)
    extended = Problem(
        conditions=conditions,
        error_arcsec=np.zeros(len(conditions)),
        joint=problem.joint,
        nominal_arcsec=np.zeros(len(conditions)),
        modelled=modelled,
        modelled_effects=names,
        drift=drift,
        hypotheses=tuple(
            replace(each, family=name, nature=effect.nature)
            for name, effect in library.items()
            for each in effect.hypotheses(conditions)
        ),
        library=library,
    )
    seen = design_check(extended)
    carried = _carried(extended, seen, suspects, found_labels)
    least = max(TELLING_READINGS / len(conditions), LEAST_VISIBLE)
    return Extension(
        name=candidate.name,
        text=candidate.text,
        hours=candidate.hours,
        separates=tuple(name for name in suspects[1:] if carried[name] <= 1.0 - least),
        shows=tuple(name for name in unseen if seen.visible.get(name, 0.0) >= least),
    )


def _carried(
    extended: Problem, seen: Design, suspects: Sequence[str], found_labels: Sequence[str]
) -> dict[str, float]:
    """Of each other suspect, how much of the first one's shapes it can carry, on the average over the shapes."""
    if not suspects:
        return {}
    owner = np.array([each.effect or "" for each in extended.hypotheses])
    shapes = [i for i, each in enumerate(extended.hypotheses) if each.effect == suspects[0]]
    found = [i for i in shapes if extended.hypotheses[i].label in found_labels] or shapes
    visible = [i for i in found if seen.spans.visible[i] >= LEAST_VISIBLE]
    chosen = (
        [visible[i] for i in np.unique(np.linspace(0, len(visible) - 1, SHAPES).astype(np.int64))]
        if visible
        else []
    )
    shares = {name: [1.0] * (not chosen) for name in suspects[1:]}
    for shape in chosen:
        by_shape = seen.spans.carried_at_best(np.array([shape]), average=False)
        for name, values in shares.items():
            values.append(float(np.max(by_shape[owner == name], initial=0.0)))
    return {name: float(np.mean(values)) for name, values in shares.items()}


def _thinned(conditions: Conditions) -> Conditions:
    if len(conditions) <= MOST_ROWS_OF_PLAN:
        return conditions
    runs = np.unique(conditions.run)
    share = max(1, MOST_ROWS_OF_PLAN // runs.size)
    kept = [
        rows[np.unique(np.linspace(0, rows.size - 1, share).astype(np.int64))]
        for rows in (np.flatnonzero(conditions.run == run) for run in runs)
    ]
    return conditions.rows(np.sort(np.concatenate(kept)))


_AT_REST: dict[str, float] = {
    "direction": 1.0,
    "velocity_deg_s": 0.0,
    "load_nm": 0.0,
    "face": 0,
    "polygon_offset": 0,
}


def _joined(plan: Conditions, further: Conditions) -> Conditions:
    """The plan and further readings after it; columns that only one of them has are at rest in the other."""
    changed: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {}
    for name in ("angle_deg", "run", "zero_group", "temperature_c", "time_s", *_AT_REST):
        first, second = getattr(plan, name), getattr(further, name)
        if first is None and second is None:
            continue
        rest = _AT_REST.get(name, 0.0)
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
    """Angles and faces of one turn as the plan measures them; a reference encoder's plan: 24 stops."""
    faces = plan.faces if plan.faces is not None else 24
    start = float(plan.angle_deg[0])
    number = np.arange(faces)
    named = number + 1 if plan.faces is not None else np.zeros(faces, dtype=np.int64)
    return np.asarray(start + 360.0 / faces * number, dtype=np.float64), named.astype(np.int64)


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
    return _run(plan, angle + 360.0 / angle.size * third, seconds=POLYGON_SECONDS, face=np.roll(face, -third))


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


_CANDIDATES = (
    _Candidate(
        name="another start",
        text="Repeat a run beginning a third of a turn farther on.",
        hours=0.2,
        readings=_other_start,
    ),
    _Candidate(
        name="both directions",
        text="Measure one run forwards and backwards under one zero.",
        hours=0.4,
        readings=_both_ways,
    ),
    _Candidate(
        name="second speed",
        text="Sweep two turns against a reference encoder under one zero, a reading every 2 deg: one turn at "
        "5 deg/s, one at 20 deg/s.",
        hours=0.5,
        readings=_two_speeds,
    ),
    _Candidate(
        name="load in a run",
        text="Change the load within a run (one turn at each load, one zero).",
        hours=0.6,
        readings=_two_loads,
    ),
    _Candidate(
        name="polygon re-mounted",
        text="Re-mount the polygon a third of its faces farther on the shaft.",
        hours=0.8,
        readings=_remounted,
    ),
    _Candidate(
        name="24 more angles",
        text="Measure 24 evenly spaced angles against a reference encoder.",
        hours=1.0,
        readings=_more_angles(24),
    ),
    _Candidate(
        name="29 more angles",
        text="Measure 29 evenly spaced angles against a reference encoder.",
        hours=1.1,
        readings=_more_angles(29),
    ),
    _Candidate(
        name="dense sweep",
        text="Sweep three turns against a reference encoder, a reading every 1.5 deg.",
        hours=1.2,
        readings=_dense,
    ),
    _Candidate(
        name="motion then rest",
        text="Move fast for half an hour, then take readings standing still.",
        hours=1.5,
        readings=_motion_then_rest,
    ),
    _Candidate(
        name="soak against ramp",
        text="Measure during a temperature ramp of 20 K in two hours, after a soak.",
        hours=4.0,
        readings=_soak_and_ramp,
    ),
    _Candidate(
        name="another temperature",
        text="Measure a run 15 K warmer, after four hours of soak.",
        hours=5.0,
        readings=_other_temperature,
    ),
)
