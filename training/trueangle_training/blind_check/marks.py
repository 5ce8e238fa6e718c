"""One case's marks: truth against answer, as one JSON line."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from trueangle_training.blind_check.answers import Answer
from trueangle_training.blind_check.case_set import ENRS
from trueangle_training.plant.truth import EffectTruth, Truth
from trueangle_training.plant.wish import Wish

Json = dict[str, Any]

CONFIDENT = 0.9
FAULT_WORDS = {
    "direction_swapped": ("direction",),
    "wrong_line_count": ("line", "count", "lattice", "scale"),
    "wrap": ("wrap", "turn"),
    "clock_offset": ("clock", "time"),
    "outliers": ("outlier", "gross", "spike"),
}
"""Of the kinds in report.json that name a fault rightly."""


def marks_of(wish: Wish, truth: Truth, answer: Answer, *, true_closure: float | None = None) -> Json:
    """Everything that the figures are made of; the true closure as `true_closure_of` has it."""
    report = answer.report
    causes: list[Json] = report.get("causes", [])
    seen = [effect for effect in truth.effects if effect.visible]
    if truth.stratum == "withheld":
        seen = [withheld_truth(effect) for effect in seen]
    named = [cause for cause in causes if cause["class_probability"] >= CONFIDENT]
    return {
        "case_id": truth.case_id,
        "seed": wish.seed,
        "plan": wish.plan,
        "plant": wish.plant,
        "stratum": _stratum(truth, seen),
        "names": [effect.name for effect in truth.effects],
        "asked_enr": wish.enr if truth.effects else 0.0,
        "enr": band(seen[0].enr) if seen else 0.0,
        "ratio": wish.ratio,
        "expected": truth.expected,
        "truth": [_effect(effect) for effect in truth.effects],
        "data_fault": truth.data_fault,
        "listed": list(truth.listed),
        "verdict": report["verdict"],
        "causes": causes,
        "unexplained": report.get("unexplained", {}),
        "where": report.get("where", [])[:4],
        "evidence": report.get("evidence", []),
        "fault_kinds": [fault["kind"] for fault in report.get("data_faults", [])],
        "gap": report.get("gap", {}),
        "end_task": report.get("end_task", {}),
        "predicted_visible": answer.visible.get(truth.effects[0].name) if truth.effects else None,
        "true_closure": true_closure,
        "seconds": answer.seconds,
        **_judged(truth, seen, causes, named, report),
    }


def band(enr: float) -> float:
    """The nearest of the ratios that are asked for, on a logarithmic scale; events come in whole counts."""
    return min(ENRS, key=lambda each: abs(np.log(each / max(enr, 1e-9))))


def _stratum(truth: Truth, seen: list[EffectTruth]) -> str:
    """An effect that the plan does not show is a stratum of its own: the right answer is `none`."""
    return "invisible" if truth.stratum in ("single", "withheld") and not seen else truth.stratum


def withheld_truth(effect: EffectTruth) -> EffectTruth:
    """An effect that the library lacks: unknown, or whatever else could carry it."""
    others = tuple(name for name in effect.accepted_names if name != effect.name)
    return replace(effect, in_library=False, accepted_names=others)


def _effect(effect: EffectTruth) -> Json:
    plain = asdict(effect)
    del plain["curve_arcsec"]
    return plain


def _judged(
    truth: Truth, seen: list[EffectTruth], causes: list[Json], named: list[Json], report: Json
) -> dict[str, bool | float | int | None]:
    first = causes[0] if causes else None
    return {
        "claims": report["verdict"] in ("named", "unknown"),
        "right_class": bool(named) and any(meets(named[0], effect) for effect in seen),
        "right_effect": bool(named) and named[0]["effect"] in {effect.name for effect in seen},
        "exact": _exact(seen, named),
        "extra": sum(not any(meets(cause, effect) for effect in seen) for cause in named),
        "confident_wrong": any(_wrong(cause, seen, truth.carried_together) for cause in causes),
        "padded": bool(named) and _padded(named[0], seen),
        "class_size": len(named[0]["class"]) if named else None,
        "caught": report["verdict"] == "unknown" or bool(report.get("unexplained", {}).get("significant")),
        "misnamed": any(not any(_carries(cause, effect) for effect in seen) for cause in named),
        "cell_hit": _cell_hit(seen, report.get("where", [])[:2]),
        "confounded_ok": _exact(seen, named) or _confounded(report, causes, seen, truth.carried_together),
        "confounded_met": _confounded(report, causes, seen, truth.carried_together, lenient=True),
        "fault_named": report["verdict"] == "data_fault",
        "fault_kind": _fault_kind(truth, report),
        "first_probability": first["class_probability"] if first else None,
        "first_right": bool(first) and any(meets(first, effect) for effect in seen) if first else None,
        "first_effect_probability": first["probability"] if first else None,
        "first_effect_right": first["effect"] in {effect.name for effect in seen} if first else None,
    }


def meets(cause: Json, effect: EffectTruth) -> bool:
    """The effect itself is in the class; for what is in no library, an effect that could carry it leads."""
    if effect.in_library:
        return effect.name in cause["class"]
    return cause["effect"] in effect.accepted_names


def _carries(cause: Json, effect: EffectTruth) -> bool:
    return bool({cause["effect"], *cause["class"]} & set(effect.accepted_names))


def _wrong(cause: Json, seen: list[EffectTruth], carriers: tuple[str, ...]) -> bool:
    """Confident of a name that is not there, or of a class without any that is.

    An effect that carries the sum of two is an answer to both: how it is said is judged by `_confounded`.
    """
    if cause["effect"] in carriers:
        return False
    if cause["probability"] >= CONFIDENT and not any(
        cause["effect"] == effect.name or (not effect.in_library and cause["effect"] in effect.accepted_names)
        for effect in seen
    ):
        return True
    return cause["class_probability"] >= CONFIDENT and not any(meets(cause, effect) for effect in seen)


def _exact(seen: list[EffectTruth], named: list[Json]) -> bool:
    """Every effect in the class of a cause of its own, no cause left over."""
    if len(named) != len(seen):
        return False
    if len(seen) == 2:
        straight = meets(named[0], seen[0]) and meets(named[1], seen[1])
        return straight or (meets(named[0], seen[1]) and meets(named[1], seen[0]))
    return all(meets(cause, effect) for cause, effect in zip(named, seen, strict=True))


def _padded(cause: Json, seen: list[EffectTruth]) -> bool:
    """A member of the class that, by the plant, carries less than half of every effect."""
    return any(
        all(member not in effect.contained_in and member != effect.name for effect in seen)
        for member in cause["class"]
    )


def _cell_hit(seen: list[EffectTruth], places: list[Json]) -> bool:
    cells = [asdict(cell) for effect in seen for cell in effect.cells]
    return any(place["cell"] == cell for place in places for cell in cells)


def _confounded(
    report: Json, causes: list[Json], seen: list[EffectTruth], carriers: tuple[str, ...], *, lenient: bool = False
) -> bool:
    """A class that meets one of the two, or what carries their sum; unless lenient, no single name of it.

    To name both, each by a cause of its own, is right too: what is called confounded is so for most of its energy.
    """
    if report["verdict"] == "unknown":
        return True
    accepted = {*carriers, *(name for effect in seen for name in effect.accepted_names)}
    confident = [cause for cause in causes if cause["class_probability"] >= CONFIDENT]
    return bool(confident) and all(
        accepted & set(cause["class"]) and (lenient or len(cause["class"]) > 1 or cause["probability"] < CONFIDENT)
        for cause in confident
    )


def _fault_kind(truth: Truth, report: Json) -> bool | None:
    if truth.data_fault is None:
        return None
    kinds = [fault["kind"] for fault in report.get("data_faults", [])]
    return any(word in kind for kind in kinds for word in FAULT_WORDS[truth.data_fault])
