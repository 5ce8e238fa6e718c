"""The cheapest further measurement that separates what this plan cannot tell apart, or shows what it cannot see.

Each candidate is laid out as readings, appended to the plan, and judged by the same design check as the plan
itself: what is recommended has been simulated, not looked up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.containment import LEAST_VISIBLE
from trueangle_training.diagnosis.design_check import CARRIED, Design, design_check
from trueangle_training.diagnosis.found_effect import Curve
from trueangle_training.diagnosis.further_readings import CANDIDATES, Candidate, extended
from trueangle_training.diagnosis.problem import Problem, recalibration_span
from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]

TELLING_READINGS = 12.0
"""Energy of a pattern that another cannot carry (or that re-calibration cannot take up), in readings: with an
effect as large as the noise of one reading, half as many nats."""
LEAVES_THE_CLASS = CARRIED - 0.02
"""Largest share of the named effect's pattern that another may carry, over plan and further readings together,
and still be told from it. A class holds what carries `CARRIED` of the pattern, which is then not quite the same.
"""
TIMES = (1, 2, 4, 8)
"""How often a measurement may be asked for: one run among twenty-one moves a containment little."""
SHAPES = 8
"""Of the named effect, spread over its grid."""
MOST_ROWS_OF_PLAN = 1500
"""Of the plan, the first readings of each run: what the runs have in common is enough here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Extension:
    """One candidate and what it would bring."""

    name: str
    times: int
    """How often, each time under a zero of its own."""
    text: str
    """What to do, in one sentence or two."""
    hours: float
    """Rough cost of all of it, for the order only."""
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


def next_measurement(
    problem: Problem, design: Design, effect_class: Sequence[str] = (), found: Curve | None = None
) -> NextMeasurement:
    """Recommend for a class with several members (the named one first), otherwise for what the plan cannot see.

    `found`: the named one as it was found; without it all its shapes count.
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
    for candidate in CANDIDATES:
        for times in TIMES if suspects else TIMES[:1]:
            conditions = extended(plan, candidate.name, times)
            if conditions is None or (times > 1 and len(conditions) > 2 * len(plan)):
                # More than the campaign has is a campaign of its own, no next measurement.
                break
            tried.append(_judged(problem, conditions, candidate, times, suspects, unseen, found))
            if len(tried[-1].separates) == len(suspects) - 1:
                break
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
    sentence = f"{chosen.text} Appended to this campaign it tells {suspects[0]} from {_and(chosen.separates)}."
    return sentence + (f" It does not tell it from {_and(left)}." if left else "")


def _judged(
    problem: Problem,
    conditions: Conditions,
    candidate: Candidate,
    times: int,
    suspects: Sequence[str],
    unseen: Sequence[str],
    found: Curve | None,
) -> Extension:
    """`conditions`: of the plan and of the candidate's readings."""
    wanted = {*suspects, *unseen}
    library = {name: effect for name, effect in problem.library.items() if name in wanted}
    modelled, names, drift = recalibration_span(conditions, problem.joint)
    whole = Problem(
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
    seen = design_check(whole)
    carried = _carried(whole, seen, suspects, found)
    least = max(TELLING_READINGS / len(conditions), LEAST_VISIBLE)
    return Extension(
        name=candidate.name,
        times=times,
        text=candidate.text if times == 1 else f"{candidate.text} Do so {times} times, each under its own zero.",
        hours=times * candidate.hours,
        separates=tuple(name for name in suspects[1:] if carried[name] <= min(1.0 - least, LEAVES_THE_CLASS)),
        shows=tuple(name for name in unseen if seen.visible.get(name, 0.0) >= least),
    )


def _carried(whole: Problem, seen: Design, suspects: Sequence[str], found: Curve | None) -> dict[str, float]:
    """Of each other suspect, how much of the first one it can carry: of it as found, or of its shapes' average."""
    if not suspects:
        return {}
    owner = np.array([each.effect or "" for each in whole.hypotheses])
    shares: list[Floats] = []
    curve = np.zeros(len(whole)) if found is None else found(whole.conditions)
    if np.any(curve):
        shares.append(seen.spans.carried(curve))
    else:
        shapes = np.flatnonzero((owner == suspects[0]) & (seen.spans.visible >= LEAST_VISIBLE))
        some = np.unique(np.linspace(0, shapes.size - 1, SHAPES).astype(np.int64)) if shapes.size else shapes
        shares += [seen.spans.carried_at_best(shapes[[i]], average=False) for i in some]
    if not shares:
        return dict.fromkeys(suspects[1:], 1.0)
    return {
        name: float(np.mean([np.max(share[owner == name], initial=0.0) for share in shares]))
        for name in suspects[1:]
    }


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
