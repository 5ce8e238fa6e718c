"""What came out, as JSON data: the figures, and what one needs to believe or to mend them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from trueangle_training.blind_check.canary import CONTROL, Song
from trueangle_training.blind_check.figures import (
    Figure,
    by_name,
    caught,
    inflation,
    of,
    plan,
    right,
    settled,
    table,
    told,
    withheld_table,
)
from trueangle_training.blind_check.intervals import exact_binomial

Json = dict[str, Any]

IN_FAMILY = ("A", "B")
"""Plants that the diagnosis was improved on; the others are blind."""
SHOWN_CASES = 30
"""Worst ones, and as many by chance: these have full reports."""
WEIGHTS = {
    "a confident wrong name": 8.0,
    "a claim on a sound joint": 6.0,
    "misnamed": 5.0,
    "a fault not seen": 4.0,
    "not found": 3.0,
    "not the exact set": 2.0,
    "another fault": 1.0,
    "the wrong place": 1.0,
    "closure": 1.0,
}
"""How bad each failing is; a name that is wrong and believed comes first."""


def withheld_figures_of(without: Sequence[Json], restored: Sequence[Json]) -> Json:
    """Of a set with effects withheld, and of the same one with them put back."""
    gone, back = ([record for record in each if "verdict" in record] for each in (without, restored))
    return {
        "figures": _plain(withheld_table(gone, back)),
        "by_withheld": _by_withheld(gone, back),
        "confusion": None,
        "reliability": _reliability(back),
        "detection": {},
        "closure": _closure_points(back),
    }


def figures_of(records: Sequence[Json], *, family: tuple[int, int] | None = None) -> Json:
    """All tables of a set; `family`: right classes and cases of the in-family plant, judged elsewhere."""
    judged = [record for record in records if "verdict" in record]
    plants = sorted({record["plant"] for record in judged})
    plans = sorted({record["plan"] for record in judged})
    own = told(r for r in judged if r["plant"] in IN_FAMILY)
    others = told(r for r in judged if r["plant"] not in IN_FAMILY)
    return {
        "figures": _plain([*table(judged), inflation(family or own, others)]),
        "by_plan": {each: _plain(table(plan(judged, each))) for each in plans},
        "by_plant": {each: _plain(table([r for r in judged if r["plant"] == each])) for each in plants},
        "by_effect": {each: _by_effect(plan(judged, each)) for each in plans},
        "confusion": _confusion(judged),
        "reliability": _reliability(judged),
        "detection": {each: _detection(plan(judged, each)) for each in plans},
        "closure": _closure_points(judged),
        "mean_class_size": _mean(r["class_size"] for r in judged if r["class_size"]),
        "padded_classes": _mean(float(r["padded"]) for r in of(judged, "single") if r["right_class"]),
        "none_at_enr_0.2": _mean(float(r["verdict"] == "none") for r in of(judged, "single") if r["enr"] < 0.5),
        "visible": _visible(judged),
        "seconds": {each: _seconds(plan(judged, each)) for each in plans},
    }


def _plain(figures: Iterable[Figure]) -> list[Json]:
    return [figure.to_plain() for figure in figures]


def _by_effect(records: list[Json]) -> dict[str, Json]:
    rows: dict[str, Json] = {}
    for stratum, hit in (("single", right), ("unknown", caught)):
        for name, cases in by_name(of(records, stratum)).items():
            enrs = sorted({record["enr"] for record in cases})
            strong = [r for r in cases if r["enr"] >= 1]
            hits = sum(hit(r) for r in strong)
            rows[name] = {
                "stratum": stratum,
                "hits": hits,
                "cases": len(strong),
                "interval": exact_binomial(hits, len(strong)) if strong else None,
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


def _by_withheld(without: list[Json], restored: list[Json]) -> dict[str, Json]:
    """Each effect: what was said without it, what with it."""
    rows: dict[str, Json] = {}
    back = {r["case_id"]: r for r in restored if r["restored"]}
    for name, cases in by_name(of(without, "withheld")).items():
        pairs = [(case, back[case["case_id"]]) for case in cases if case["case_id"] in back]
        closures = [r["true_closure"] for _, r in pairs if r["true_closure"] is not None and right(r)]
        rows[name] = {
            "cases": len(cases),
            "plan": cases[0]["plan"],
            "unknown": sum(caught(r) for r in cases),
            "right_cell": sum(caught(r) and r["cell_hit"] for r in cases),
            "its_class": sum(r["verdict"] == "named" and not r["misnamed"] for r in cases),
            "misnamed": sum(bool(r["misnamed"]) for r in cases),
            "named_when_back": sum(right(r) for _, r in pairs),
            "back": len(pairs),
            "closure_when_back": float(np.median(closures)) if closures else None,
        }
    return rows


def _confusion(records: list[Json]) -> Json:
    """Rows: what was true; columns: what was said first. An answer whose class holds the truth is the truth."""
    rows: dict[str, dict[str, int]] = {}
    for record in records:
        true = _true_word(record)
        if true is not None:
            said = _said_word(record, true)
            rows.setdefault(true, {})
            rows[true][said] = rows[true].get(said, 0) + 1
    last = ["unknown pattern", "sound", "hidden by the plan", "broken file"]
    truths = [*sorted(name for name in rows if name not in last), *(name for name in last if name in rows)]
    ends = ["unknown", "none", "data fault", "insufficient"]
    said = {word for row in rows.values() for word in row}
    answers = [*sorted(said - set(ends)), *(word for word in ends if word in said)]
    return {
        "truths": truths,
        "answers": answers,
        "counts": [[rows[true].get(word, 0) for word in answers] for true in truths],
    }


def _true_word(record: Json) -> str | None:
    stratum = record["stratum"]
    if stratum == "single":
        return record["names"][0] if record["enr"] >= 0.5 else None
    words = {"noise": "sound", "parametric": "sound", "invisible": "hidden by the plan", "broken": "broken file"}
    return "unknown pattern" if stratum == "unknown" else words.get(stratum)


def _said_word(record: Json, true: str) -> str:
    verdict = record["verdict"]
    if verdict != "named":
        return verdict.replace("_", " ")
    if record["right_class"] and record["stratum"] == "single":
        return true
    return record["causes"][0]["effect"]


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


def _detection(records: list[Json]) -> list[Json]:
    """By effect-to-noise ratio: single effects told, single effects noticed at all, unknown patterns caught."""
    single, unknown = of(records, "single"), of(records, "unknown")
    rows: list[Json] = []
    for enr in sorted({r["enr"] for r in [*single, *unknown]}):
        here, strange = ([r for r in each if r["enr"] == enr] for each in (single, unknown))
        counts = {
            "told": (sum(right(r) for r in here), len(here)),
            "noticed": (sum(r["claims"] for r in here), len(here)),
            "caught": (sum(caught(r) for r in strange), len(strange)),
        }
        rows.append(
            {
                "enr": enr,
                **{
                    name: {"hits": hits, "cases": cases, "interval": exact_binomial(hits, cases)}
                    for name, (hits, cases) in counts.items()
                    if cases
                },
            }
        )
    return rows


def _closure_points(records: list[Json]) -> list[Json]:
    """Cases whose closure is stated and known."""
    return [
        {
            "case_id": r["case_id"],
            "enr": r["enr"],
            "stated": r["gap"]["closure"],
            "interval": r["gap"].get("closure_interval"),
            "true": r["true_closure"],
        }
        for r in of(records, "single")
        if r["gap"].get("closure") is not None and r["true_closure"] is not None and r["right_class"]
    ]


def _visible(records: list[Json]) -> Json:
    """Visible fraction as the design check foretells it, against the plant's own."""
    pairs = np.array(
        [
            (r["predicted_visible"], r["truth"][0]["visible_fraction"])
            for r in of(records, "single")
            if r["predicted_visible"] is not None
        ]
    ).reshape(-1, 2)
    apart = np.abs(pairs[:, 0] - pairs[:, 1])
    return {
        "cases": int(apart.size),
        "median_apart": float(np.median(apart)) if apart.size else None,
        "most_apart": float(apart.max()) if apart.size else None,
    }


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


def failing_of(record: Json) -> tuple[str, ...]:
    """What is wrong with an answer, the worst first; empty: nothing."""
    if "verdict" not in record:
        return ()
    stratum, enr = record["stratum"], record["enr"]
    sound = stratum in ("noise", "parametric", "invisible")
    strange = stratum in ("unknown", "withheld")
    wrong = {
        "a confident wrong name": record["confident_wrong"],
        "a claim on a sound joint": sound and record["verdict"] != "none",
        "misnamed": strange and record["misnamed"],
        "a fault not seen": stratum == "broken" and not record["fault_named"],
        "not found": (stratum == "single" and not record["right_class"] and enr >= 0.5)
        or (strange and not settled(record) and enr >= 1)
        or (stratum == "confounded" and not record["confounded_ok"]),
        "not the exact set": stratum == "pair" and not record["exact"],
        "another fault": stratum == "broken" and record["fault_named"] and not record["fault_kind"],
        # The quick way gives no place to an effect of the scatter.
        "the wrong place": stratum in ("single", "unknown")
        and enr >= 0.5
        and not record["cell_hit"]
        and bool(record["where"] or record["verdict"] == "none"),
        "closure": _closure_error(record) > 0.1,
    }
    return tuple(name for name, here in wrong.items() if here)


def badness(record: Json) -> float:
    """The larger the worse; of equal failings the one on the stronger effect, then the surer one."""
    failings = failing_of(record)
    if not failings:
        return 0.0
    surest = max((cause["class_probability"] for cause in record["causes"]), default=0.0)
    return sum(WEIGHTS[name] for name in failings) + 0.1 * min(record["enr"], 5.0) + 0.01 * surest


def _closure_error(record: Json) -> float:
    said, true = record["gap"].get("closure"), record["true_closure"]
    if (
        said is None
        or true is None
        or record["stratum"] != "single"
        or not record["right_class"]
        or record["enr"] < 1
    ):
        return 0.0
    return abs(said - true)


def chosen_cases(records: Sequence[Json], *, seed: int) -> tuple[list[Json], list[Json]]:
    """The worst, and some by chance, of those that were diagnosed."""
    judged = [record for record in records if "verdict" in record]
    bad = [record for record in judged if badness(record) > 0]
    worst = sorted(bad, key=lambda record: (-badness(record), record["case_id"]))[:SHOWN_CASES]
    rng = np.random.default_rng([seed, 2])
    places = rng.choice(len(judged), size=min(SHOWN_CASES, len(judged)), replace=False) if judged else []
    return worst, [judged[place] for place in sorted(places)]


def report_name(record: Json) -> str:
    """Of a record with the effects that its library lacked: the folder of its full report."""
    return "-without-".join([record["case_id"], *record["without"]])


def shown_of(record: Json) -> Json:
    """A case as a row of a list: truth, answer, what is wrong."""
    causes = [
        {"effect": c["effect"], "p": c["probability"], "class": c["class"], "class_p": c["class_probability"]}
        for c in record["causes"]
    ]
    return {
        "case_id": record["case_id"],
        "report": report_name(record),
        "without": record["without"],
        "wish": record["wish"],
        "plan": record["plan"],
        "plant": record["plant"],
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
        "failings": list(failing_of(record)),
    }


def canary_plain(songs: Sequence[Song], shuffled: Json) -> Json:
    """What the canary says, and whether it may be believed."""
    told = [each for each in songs if each.group != CONTROL]
    control = [each for each in songs if each.group == CONTROL]
    return {
        "songs": [
            {
                "task": each.task,
                "group": each.group,
                "cases": each.cases,
                "area": each.area,
                "shuffled_area": each.shuffled_area,
                "p_value": each.p_value,
                "leaks": each.leaks and each.group != CONTROL,
                "control": each.group == CONTROL,
            }
            for each in songs
        ],
        "judged": any(each.area is not None for each in told),
        "leaks": any(each.leaks for each in told),
        "control_tells": any(each.leaks for each in control),
        "shuffled": shuffled,
    }
