"""`report.json` and `design.json`: the keys that outside tools rely on, and the shipped schemas that fix them."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib import resources
from typing import Any

from trueangle_training.diagnosis.findings import (
    SCHEMA_VERSION,
    Cause,
    EndTask,
    Estimate,
    Findings,
    Gap,
    Place,
    PlanSight,
    Subject,
)

REPORT_SCHEMA = "report.schema.json"
DESIGN_SCHEMA = "design.schema.json"
SIGNIFICANT_DIGITS = 6
"""Of every number in the files: more would only show the library's rounding."""


def schema(name: str) -> dict[str, Any]:
    """One of the two JSON schemas of this package."""
    text = (resources.files("trueangle_training.diagnosis") / name).read_text(encoding="utf-8")
    return json.loads(text)


def report_json(findings: Findings) -> bytes:
    """`report.json`; the same findings give the same bytes."""
    return _bytes(report_plain(findings))


def design_json(sight: PlanSight) -> bytes:
    """`design.json`; the same plan gives the same bytes."""
    return _bytes(design_plain(sight))


def report_plain(findings: Findings) -> dict[str, Any]:
    """The document as JSON data."""
    return {
        "schema_version": SCHEMA_VERSION,
        "subject": _subject(findings.subject),
        "verdict": findings.conclusion.value,
        "unexplained": {
            "significant": findings.unexplained.significant,
            "nearest_effect": findings.unexplained.nearest_effect,
            "nearest_share": _number(findings.unexplained.nearest_share),
        },
        "data_faults": [
            {"kind": fault.kind, "rows": list(fault.rows), "text": fault.text} for fault in findings.data_faults
        ],
        "causes": [_cause(cause) for cause in findings.causes],
        "where": [_place(place) for place in findings.where],
        "gap": _gap(findings.gap),
        "waterfall": [
            {"effect": step.effect, "closure": _number(step.closure), "interval": _pair(step.interval)}
            for step in findings.waterfall
        ],
        "end_task": _end_task(findings.end_task),
        "parameters_moving": [
            {"effect": each.effect, "over": each.over, "p_value": _number(each.p_value)}
            for each in findings.drifting
        ],
        "invisible": list(findings.invisible),
        "not_testable": list(findings.not_testable),
        "not_testable_because": dict(findings.not_testable),
        "next_measurement": findings.next_measurement,
        "notes": list(findings.notes),
    }


def design_plain(sight: PlanSight) -> dict[str, Any]:
    """The document as JSON data."""
    carried: dict[str, dict[str, float | None]] = {seen.effect: {} for seen in sight.effects}
    for pair in sight.pairs:
        carried.setdefault(pair.effect, {})[pair.by] = _number(pair.fraction)
    return {
        "schema_version": SCHEMA_VERSION,
        "subject": _subject(sight.subject),
        "testable": list(sight.testable),
        "effects": [
            {
                "effect": seen.effect,
                "visible_fraction": _number(seen.visible_fraction),
                "reason": seen.reason,
                "carried_by": carried.get(seen.effect, {}),
            }
            for seen in sight.effects
        ],
        "invisible": list(sight.invisible),
        "not_testable": list(sight.not_testable),
        "not_testable_because": dict(sight.not_testable),
        "next_measurement": sight.next_measurement,
        "notes": list(sight.notes),
    }


def _subject(subject: Subject) -> dict[str, Any]:
    return {**asdict(subject), "modelled_effects": list(subject.modelled_effects)}


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.effect,
        "probability": _number(cause.probability),
        "class": list(cause.members),
        "class_probability": _number(cause.class_probability),
        "kind": cause.kind.value,
        "parameters": _parameters(cause.parameters),
        "closes": _number(cause.closes),
        "closes_interval": _pair(cause.closes_interval),
        "label": cause.label,
        "cell": None if cause.cell is None else asdict(cause.cell),
    }


def _parameters(parameters: Mapping[str, Estimate]) -> dict[str, Any]:
    return {
        name: {"value": _number(each.value), "standard_uncertainty": _number(each.standard_uncertainty)}
        for name, each in parameters.items()
    }


def _place(place: Place) -> dict[str, Any]:
    return {
        "cell": asdict(place.cell),
        "share": _number(place.share),
        "could_carry": _number(place.could_carry),
        "p_value": _number(place.p_value),
        "significant": place.significant,
        "runs_needed": place.runs_needed,
    }


def _gap(gap: Gap) -> dict[str, Any]:
    plain = {name: _number(value) for name, value in asdict(gap).items() if name != "closure_interval"}
    return {**plain, "closure_interval": _pair(gap.closure_interval)}


def _end_task(end_task: EndTask) -> dict[str, Any]:
    return {
        "method": end_task.method,
        "compensable": end_task.compensable,
        "missing_input": end_task.missing_input,
        "not_compensable": [
            {"effect": name, "missing_input": missing} for name, missing in end_task.not_compensable.items()
        ],
        "none_arcsec": _number(end_task.none_arcsec),
        "simulator_arcsec": _number(end_task.simulator_arcsec),
        "explained_arcsec": _number(end_task.explained_arcsec),
        "oracle_arcsec": _number(end_task.oracle_arcsec),
        "gap_left": _number(end_task.gap_left),
    }


def _pair(interval: tuple[float, float] | None) -> list[float | None] | None:
    return None if interval is None else [_number(interval[0]), _number(interval[1])]


def _number(value: float | None) -> float | None:
    """JSON has no NaN: what is not known is null."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def _bytes(document: dict[str, Any]) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
