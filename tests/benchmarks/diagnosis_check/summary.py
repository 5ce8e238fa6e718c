"""What came out, as Markdown for people and JSON for programs."""

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np
from tests.benchmarks.diagnosis_check.figures import by_name, caught, of, plan, right, settled, share, table
from tests.benchmarks.diagnosis_check.intervals import exact_binomial

Json = dict[str, Any]

WORST = "worst single effect, ENR >= 1"


def document(records: list[Json], conditions: Json) -> Json:
    """Everything, as JSON data."""
    judged = [record for record in records if "verdict" in record]
    plans = sorted({record["plan"] for record in judged})
    return {
        "conditions": conditions,
        "cases": len(judged),
        "skipped": sum("skipped" in record for record in records),
        "crashed": [record for record in records if "crashed" in record],
        "tables": {
            name: [{**asdict(figure), "reached": figure.reached} for figure in table(rows)]
            for name, rows in [("all", judged), *((each, plan(judged, each)) for each in plans)]
        },
        "per_effect": {each: _per_effect(plan(judged, each)) for each in plans},
        "reliability": _reliability(judged),
        "mean_class_size": _mean(r["class_size"] for r in judged if r["class_size"]),
        "padded_classes": _mean(float(r["padded"]) for r in of(judged, "single") if r["right_class"]),
        "none_at_enr_0.2": _mean(float(r["verdict"] == "none") for r in of(judged, "single") if r["enr"] < 0.5),
        "seconds": {each: _seconds(plan(judged, each)) for each in plans},
        "failures": [_failure(record) for record in judged if _failed(record)],
    }


def _per_effect(records: list[Json]) -> dict[str, Json]:
    rows: dict[str, Json] = {}
    for stratum, hit in (("single", right), ("unknown", caught)):
        for name, cases in by_name(of(records, stratum)).items():
            enrs = sorted({record["enr"] for record in cases})
            rows[name] = {
                "stratum": stratum,
                "at_least_1": asdict(share(name, (r for r in cases if r["enr"] >= 1), hit, bound=WORST)),
                "by_enr": {
                    f"{enr:g}": [
                        sum(hit(r) for r in cases if r["enr"] == enr),
                        sum(r["enr"] == enr for r in cases),
                    ]
                    for enr in enrs
                },
                "misnamed": sum(bool(r["misnamed"]) for r in cases),
                "predicted_visible": _mean(
                    r["predicted_visible"] for r in cases if r["predicted_visible"] is not None
                ),
                "true_visible": _mean(r["truth"][0]["visible_fraction"] for r in cases),
            }
    return rows


def _reliability(records: list[Json]) -> list[Json]:
    stated = np.array([r["first_probability"] for r in records if r["first_probability"] is not None])
    true = np.array([r["first_right"] for r in records if r["first_probability"] is not None], dtype=np.float64)
    rows: list[Json] = []
    for low in np.arange(0.0, 1.0, 0.1):
        inside = (stated >= low) & (stated < low + 0.1 + (low > 0.85))
        if inside.any():
            hits, cases = int(true[inside].sum()), int(inside.sum())
            rows.append(
                {
                    "from": round(float(low), 1),
                    "cases": cases,
                    "stated": float(stated[inside].mean()),
                    "right": hits / cases,
                    "interval": exact_binomial(hits, cases),
                }
            )
    return rows


def _seconds(records: list[Json]) -> Json:
    values = np.array([record["seconds"] for record in records])
    return {
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "most": float(values.max()),
    }


def _mean(values: Iterable[float]) -> float | None:
    found = list(values)
    return float(np.mean(found)) if found else None


def _failed(record: Json) -> bool:
    if record["confident_wrong"]:
        return True
    stratum = record["stratum"]
    if stratum in ("noise", "parametric", "invisible"):
        return record["verdict"] != "none"
    if stratum == "single":
        return not record["right_class"] and record["enr"] >= 0.5
    if stratum in ("unknown", "withheld"):
        return record["misnamed"] or (not settled(record) and record["enr"] >= 1)
    if stratum == "pair":
        return not record["exact"]
    return not (record["confounded_ok"] if stratum == "confounded" else record["fault_kind"])


def _failure(record: Json) -> Json:
    """What one needs to find out why."""
    causes = [
        {"effect": c["effect"], "p": c["probability"], "class": c["class"], "class_p": c["class_probability"]}
        for c in record["causes"]
    ]
    return {
        "case_id": record["case_id"],
        "wish": record["wish"],
        "stratum": record["stratum"],
        "truth": [
            {"name": t["name"], "enr": t["enr"], "visible": t["visible_fraction"], "accepted": t["accepted_names"]}
            for t in record["truth"]
        ],
        "listed": record["listed"],
        "data_fault": record["data_fault"],
        "verdict": record["verdict"],
        "fault_kinds": record["fault_kinds"],
        "causes": causes,
        "evidence": record["evidence"],
    }


def markdown(whole: Json) -> str:
    """The tables, then every failure in a line."""
    lines = ["# Diagnosis check", "", *_conditions(whole), ""]
    for name, figures in whole["tables"].items():
        lines += [f"## {name}", "", *_head("figure", "must", "ambitious", "found", "95 %", "cases", "reached")]
        lines += [_row(figure) for figure in figures] + [""]
    for name, effects in whole["per_effect"].items():
        columns = ("effect", "right, ENR >= 1", "95 %", "by ENR", "misnamed", "visible: predicted, true")
        lines += [f"## each effect, {name}", "", *_head(*columns)]
        lines += [_effect_row(effect, row) for effect, row in effects.items()] + [""]
    lines += ["## reliability of the first class", "", *_head("stated", "right", "95 %", "cases")]
    lines += [
        f"| {row['stated']:.2f} | {row['right']:.2f} | {_between(*row['interval'])} | {row['cases']} |"
        for row in whole["reliability"]
    ]
    lines += ["", "## failures", ""]
    lines += [_failure_line(failure) for failure in whole["failures"]]
    lines += [f"- CRASHED {each['wish']}: {each['crashed'].strip()}" for each in whole["crashed"]]
    return "\n".join(lines) + "\n"


def _conditions(whole: Json) -> list[str]:
    lines = [f"- {name}: {value}" for name, value in whole["conditions"].items()]
    lines.append(
        f"- cases: {whole['cases']}; {whole['skipped']} left out, as the plan cannot hold them; "
        f"{len(whole['crashed'])} crashed"
    )
    lines.append(
        f"- mean class size {_text(whole['mean_class_size'])}; right classes with a member that, by the plant, "
        f"carries less than half {_text(whole['padded_classes'])}; `none` at ENR 0.2 "
        f"{_text(whole['none_at_enr_0.2'])}"
    )
    return [*lines, f"- processor seconds a case: {whole['seconds']}"]


def _head(*names: str) -> list[str]:
    return ["| " + " | ".join(names) + " |", "|---" * len(names) + "|"]


def _row(figure: Json) -> str:
    sign = "<=" if figure["at_most"] else ">="
    count = figure["cases"] if figure["hits"] is None else f"{figure['hits']}/{figure['cases']}"
    return (
        f"| {figure['name']} | {sign} {figure['must']:g} | {sign} {figure['ambitious']:g} "
        f"| {_text(figure['value'])} | {_between(figure['low'], figure['high'])} | {count} | {figure['reached']} |"
    )


def _effect_row(effect: str, row: Json) -> str:
    strong = row["at_least_1"]
    ratios = ", ".join(f"{enr}: {hits}/{cases}" for enr, (hits, cases) in row["by_enr"].items())
    return (
        f"| {effect} | {strong['hits']}/{strong['cases']} | {_between(strong['low'], strong['high'])} | {ratios} "
        f"| {row['misnamed']} | {_text(row['predicted_visible'])}, {_text(row['true_visible'])} |"
    )


def _failure_line(failure: Json) -> str:
    truth = ", ".join(f"{each['name']} (ENR {each['enr']:.2f})" for each in failure["truth"]) or "nothing"
    said = ", ".join(
        f"{each['effect']} {each['p']:.2f} of {each['class']} {each['class_p']:.2f}" for each in failure["causes"]
    )
    proof = "; ".join(
        f"{each['label']} {each['log_evidence']:g} ({each['share']:g})" for each in failure["evidence"]
    )
    fault = ""
    if failure["data_fault"] or failure["fault_kinds"]:
        fault = f", fault {failure['data_fault']} -> {failure['fault_kinds']}"
    head = f"- `{failure['case_id']}` {failure['stratum']}: {truth}{fault} -> {failure['verdict']}: {said}"
    return f"{head} | {proof} | {failure['wish']}"


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _between(low: float | None, high: float | None) -> str:
    return "-" if low is None or high is None else f"{low:.3f} - {high:.3f}"
