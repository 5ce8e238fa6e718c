"""The result as one page that needs nothing beside itself but the reports it links to."""

from typing import Any

from trueangle_training.blind_check import plots
from trueangle_training.diagnosis.report_page import Picture
from trueangle_training.html_page import page

Json = dict[str, Any]

SHOWN_FAILURES = 400
DASH, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"
NO_SHARES = ("median", "calibration", "sealed minus")
"""In the names of figures that are no counts."""
PLANS = {"paper": "the paper's plan", "rich": "the rich plan", "both": "both plans"}
GROUPS = {
    "all": "all of these together",
    "file": "rows, gaps, decimals",
    "plan": "times, temperatures, loads, speeds",
    "joint": "JOINT.yaml: what is listed",
    "errors": "scatter of the errors (control: must tell)",
}


def check_page(result: Json) -> str:
    """HTML text; the same result gives the same page."""
    return page(
        "blind_check.html.j2",
        {
            "result": result,
            "conditions": result["conditions"],
            "canary": result["canary"],
            "plans": PLANS,
            "groups": GROUPS,
            "pictures": _pictures(result),
            "confusion": _confusion(result),
            "counts": _counts(result["figures"]),
            "shown_failures": SHOWN_FAILURES,
            "percent": _percent,
            "number": _number,
            "value": _value,
            "interval": _interval,
            "bound": _bound,
            "words": _words,
            "answer": _answer,
        },
    )


def _counts(figures: list[Json]) -> dict[str, dict[str, int]]:
    """How many rows of the targets' table are met, undecided, missed, for both columns."""
    rows = [row for row in figures if not row["beside"]]
    return {
        column: {
            status: sum(row[column] == status for row in rows) for status in ("met", "undecided", "missed", "-")
        }
        for column in ("must_is", "ambitious_is")
    }


def _pictures(result: Json) -> list[Picture]:
    found: list[Picture] = []
    if any(row for rows in result["detection"].values() for row in rows):
        found.append(
            Picture(
                name="detection",
                svg=plots.detection(result["detection"]),
                title="Detection against the effect's size",
                caption="Effect-to-noise ratio: RMS outside what re-calibration takes up, over the noise of one "
                "reading. Bars: exact 95 % intervals.",
                words="Share of effects named rightly and of unknown patterns caught, by effect-to-noise ratio.",
            )
        )
    if result["reliability"]:
        found.append(
            Picture(
                name="reliability",
                svg=plots.reliability(result["reliability"]),
                title="Is a stated probability what it says",
                caption="First class of every case that has one, in tenths; the number of cases beside it.",
                words="Share of right classes over their stated probability.",
            )
        )
    if result["closure"]:
        found.append(
            Picture(
                name="closure",
                svg=plots.closure(result["closure"]),
                title="Closure, stated and true",
                caption="Single effects, rightly named. True: of the structure without noise.",
                words="Stated closure over true closure.",
            )
        )
    return found


def _confusion(result: Json) -> Picture | None:
    table = result["confusion"]
    if table is None or not table["truths"]:
        return None
    return Picture(
        name="confusion",
        svg=plots.confusion(table),
        title="What was true, and what was said",
        caption="Rows: the truth (single effects at ENR from 0.5). Columns: the first named effect; an answer "
        "whose class holds the true effect counts as true. Shades: share of the row.",
        words="Confusion matrix by class; its counts are in result.json.",
    )


def _percent(share: float | None) -> str:
    return DASH if share is None else f"{100 * share:.1f} %"


def _number(value: float | None, digits: int = 3) -> str:
    return DASH if value is None else f"{value:.{digits}f}".replace("-", MINUS)


def _value(row: Json) -> str:
    if row["value"] is None:
        return DASH
    return _percent(row["value"]) if row["hits"] is not None else _number(row["value"])


def _interval(row: Json) -> str:
    if row["low"] is None or row["high"] is None:
        return DASH
    if row["hits"] is not None:
        return f"{100 * row['low']:.1f} to {100 * row['high']:.1f} %"
    return f"{_number(row['low'])} to {_number(row['high'])}"


def _bound(row: Json, column: str) -> str:
    sign = "≤" if row["at_most"] else "≥"
    is_share = row["hits"] is not None or (
        row["cases"] == 0 and not any(word in row["name"] for word in NO_SHARES)
    )
    return f"{sign} {100 * row[column]:g} %" if is_share else f"{sign} {row[column]:g}"


def _words(name: str) -> str:
    return name.replace("_", " ").replace(">=", "\N{GREATER-THAN OR EQUAL TO}")


def _answer(case: Json) -> str:
    """Verdict and causes in a line."""
    said = [
        f"{_words(each['effect'])} {each['p']:.2f}"
        + (f" (one of {len(each['class'])}, {each['class_p']:.2f})" if len(each["class"]) > 1 else "")
        for each in case["causes"]
    ]
    kinds = [_words(kind) for kind in case["fault_kinds"]]
    return ": ".join(part for part in (_words(case["verdict"]), ", ".join(said or kinds)) if part)
