"""The figures of the check, each with its interval and with what it must reach."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from trueangle_training.blind_check.intervals import bootstrap, calibration_error, exact_binomial

Json = dict[str, Any]
Pick = Callable[[Json], bool]

NOT_PREDICTABLE = ("random", "event", "variance")
"""Kinds whose next draw no model foretells: closure is not asked of them."""


class Status(StrEnum):
    """Whether a bound is kept, by the interval."""

    MET = "met"
    """Even the interval's far end keeps it."""
    UNDECIDED = "undecided"
    """The interval holds the bound: more cases would tell."""
    MISSED = "missed"
    """Even the interval's near end misses it."""
    NOT_JUDGED = "-"
    """No case."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """What a figure must reach, and what would be better still."""

    must: float
    ambitious: float
    interval_below: float | None = None
    """Where it is given, the figure itself keeps the bound and its interval stays below this: 11 of 400."""
    least_cases: int = 0
    """Fewer leave it undecided: by chance alone a calibration error is too large, a worst effect too bad."""
    beside: bool = False
    """Reported, but no row of the targets' table."""

    @property
    def at_most(self) -> bool:
        """The figure must stay below, not above."""
        return self.ambitious < self.must


BOUNDS = {
    "false alarm, noise only": Bound(must=0.03, ambitious=0.01, interval_below=0.05),
    "claim on a parametric-only gap": Bound(must=0.03, ambitious=0.01),
    "claim on an effect that the plan hides": Bound(must=0.03, ambitious=0.01, beside=True),
    "data fault said of sound data": Bound(must=0.01, ambitious=0.0, beside=True),
    "right class, ENR >= 0.5": Bound(must=0.93, ambitious=0.97),
    "right class, ENR 0.2, rich plan": Bound(must=0.70, ambitious=0.85),
    "right class, ENR 0.2, paper's plan": Bound(must=0.35, ambitious=0.45),
    "worst single effect, ENR >= 1": Bound(must=0.80, ambitious=0.90, least_cases=60),
    "exact set, one effect, ENR >= 0.5": Bound(must=0.90, ambitious=0.95, beside=True),
    "confident wrong name, all strata": Bound(must=0.03, ambitious=0.01),
    "unknown caught, ENR >= 1": Bound(must=0.90, ambitious=0.98),
    "unknown caught, ENR 0.5, paper's plan": Bound(must=0.60, ambitious=0.75),
    "unknown misnamed": Bound(must=0.08, ambitious=0.03),
    "withheld, ENR >= 1: unknown in the right cell, or its class": Bound(must=0.90, ambitious=0.98),
    "withheld, misnamed": Bound(must=0.08, ambitious=0.03),
    "put back in the library: named": Bound(must=0.80, ambitious=0.90),
    "put back in the library: true closure, median": Bound(must=0.90, ambitious=0.95),
    "cases beside it: a claim on a sound joint": Bound(must=0.03, ambitious=0.01, beside=True),
    "sealed minus in-family, right class": Bound(must=0.05, ambitious=0.02),
    "true cell among the first two": Bound(must=0.95, ambitious=0.98),
    "separable pair 1:0.7, exact set": Bound(must=0.75, ambitious=0.90),
    "separable pair 1:0.3, exact set": Bound(must=0.50, ambitious=0.75, beside=True),
    "confounded pair: class or abstains": Bound(must=0.95, ambitious=0.99),
    "confounded pair: met at all": Bound(must=0.95, ambitious=0.99, beside=True),
    "calibration error, class": Bound(must=0.05, ambitious=0.03, least_cases=800),
    "calibration error, name": Bound(must=0.05, ambitious=0.03, least_cases=800, beside=True),
    "broken input: a data fault": Bound(must=0.95, ambitious=1.0, beside=True),
    "broken input: the right fault": Bound(must=0.90, ambitious=1.0, beside=True),
    "closure error, median, ENR >= 0.5": Bound(must=0.06, ambitious=0.04),
    "closure error, median, ENR >= 1": Bound(must=0.02, ambitious=0.01),
    "true closure, median, ENR >= 1": Bound(must=0.90, ambitious=0.95, beside=True),
    "closure of the ceiling, median, ENR >= 1": Bound(must=0.90, ambitious=0.95),
    "closure interval holds the true closure": Bound(must=0.90, ambitious=0.95, beside=True),
    "end-task gap after / before, ENR >= 1": Bound(must=0.30, ambitious=0.15),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One row of the table."""

    name: str
    bound: Bound
    value: float | None
    """None: no case to judge it by."""
    low: float | None
    high: float | None
    """95 % interval: exact of shares, by bootstrap of medians and the like."""
    hits: int | None
    """None for medians and the like."""
    cases: int

    @property
    def must(self) -> Status:
        """Against the bound that must be reached."""
        return self._against(self.bound.must)

    @property
    def ambitious(self) -> Status:
        """Against the bound that is aimed at."""
        return self._against(self.bound.ambitious)

    def _against(self, bound: float) -> Status:
        if self.value is None or self.low is None or self.high is None:
            return Status.NOT_JUDGED
        sign = 1.0 if self.bound.at_most else -1.0
        near, far = sorted((sign * self.low, sign * self.high))
        if self.cases < self.bound.least_cases:
            return Status.UNDECIDED
        if near > sign * bound:
            return Status.MISSED
        limit = self.bound.interval_below
        if limit is not None:
            return Status.MET if self.value <= bound and self.high <= limit else Status.UNDECIDED
        return Status.MET if far <= sign * bound else Status.UNDECIDED

    def to_plain(self) -> Json:
        """JSON data."""
        return {
            "name": self.name,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "hits": self.hits,
            "cases": self.cases,
            "at_most": self.bound.at_most,
            "must": self.bound.must,
            "ambitious": self.bound.ambitious,
            "must_is": self.must.value,
            "ambitious_is": self.ambitious.value,
            "beside": self.bound.beside,
        }


def share(name: str, records: Iterable[Json], hit: Pick, *, bound: str = "") -> Figure:
    """How many of the records are hits, with the exact interval of Clopper and Pearson."""
    chosen = list(records)
    hits = sum(bool(hit(record)) for record in chosen)
    low, high = exact_binomial(hits, len(chosen)) if chosen else (None, None)
    value = hits / len(chosen) if chosen else None
    return _figure(name, BOUNDS[bound or name], value, low, high, hits, len(chosen))


def median(name: str, values: Iterable[float]) -> Figure:
    """The middle value, with its bootstrap interval."""
    found = np.array([value for value in values if math.isfinite(value)])
    low, high = bootstrap(found, lambda rows: float(np.median(rows))) if found.size > 1 else (None, None)
    value = float(np.median(found)) if found.size else None
    return _figure(name, BOUNDS[name], value, low, high, None, int(found.size))


def calibration(name: str, records: list[Json], stated: str, true: str) -> Figure:
    """Of the first cause of every case that has one."""
    rows = np.array([(r[stated], r[true]) for r in records if r[stated] is not None], dtype=np.float64)
    rows = rows.reshape(-1, 2)
    low, high = bootstrap(rows, calibration_error) if rows.shape[0] > 1 else (None, None)
    value = calibration_error(rows) if rows.shape[0] else None
    return _figure(name, BOUNDS[name], value, low, high, None, int(rows.shape[0]))


def _figure(
    name: str,
    bound: Bound,
    value: float | None,
    low: float | None,
    high: float | None,
    hits: int | None,
    cases: int,
) -> Figure:
    return Figure(name=name, bound=bound, value=value, low=low, high=high, hits=hits, cases=cases)


def table(records: list[Json]) -> list[Figure]:
    """Every row for these records, of one plan or of all."""
    single, unknown = of(records, "single"), of(records, "unknown")
    strong = [r for r in single if r["enr"] >= 0.5]
    weak = [r for r in single if r["enr"] < 0.5]
    faint = [r for r in plan(unknown, "paper") if r["enr"] == 0.5]
    placed = [*strong, *(r for r in unknown if r["enr"] >= 0.5)]
    return [
        share("false alarm, noise only", of(records, "noise"), claims),
        share("claim on a parametric-only gap", of(records, "parametric"), claims),
        share("claim on an effect that the plan hides", of(records, "invisible"), claims),
        share("data fault said of sound data", sound(records), lambda r: r["fault_named"]),
        share("right class, ENR >= 0.5", strong, right),
        share("right class, ENR 0.2, rich plan", plan(weak, "rich"), right),
        share("right class, ENR 0.2, paper's plan", plan(weak, "paper"), right),
        worst_effect(single),
        share("exact set, one effect, ENR >= 0.5", strong, lambda r: r["exact"]),
        share("confident wrong name, all strata", records, lambda r: r["confident_wrong"]),
        share("unknown caught, ENR >= 1", (r for r in unknown if r["enr"] >= 1), caught),
        share("unknown caught, ENR 0.5, paper's plan", faint, caught),
        share("unknown misnamed", unknown, lambda r: r["misnamed"]),
        share("true cell among the first two", placed, lambda r: r["cell_hit"]),
        share("separable pair 1:0.7, exact set", ratio(records, 0.7), lambda r: r["exact"]),
        share("separable pair 1:0.3, exact set", ratio(records, 0.3), lambda r: r["exact"]),
        share("confounded pair: class or abstains", of(records, "confounded"), lambda r: r["confounded_ok"]),
        share("confounded pair: met at all", of(records, "confounded"), lambda r: r["confounded_met"]),
        calibration("calibration error, class", records, "first_probability", "first_right"),
        calibration("calibration error, name", records, "first_effect_probability", "first_effect_right"),
        share("broken input: a data fault", of(records, "broken"), lambda r: r["fault_named"]),
        share("broken input: the right fault", of(records, "broken"), lambda r: bool(r["fault_kind"])),
        *closures(single),
    ]


def withheld_table(without: list[Json], restored: list[Json]) -> list[Figure]:
    """Rows for cases of an effect that simulator and library lack, and for the same ones with it put back."""
    gone = [r for r in of(without, "withheld") if r["enr"] >= 1]
    back = [r for r in of(restored, "single") if r["enr"] >= 1 and r["restored"]]
    predictable = [r for r in back if r["truth"][0]["kind"] not in NOT_PREDICTABLE]
    sound_ones = [r for r in without if r["stratum"] in ("noise", "parametric", "invisible")]
    return [
        share("withheld, ENR >= 1: unknown in the right cell, or its class", gone, placed_or_class),
        share("withheld, misnamed", gone, lambda r: r["misnamed"]),
        share("put back in the library: named", back, right),
        median(
            "put back in the library: true closure, median",
            (r["true_closure"] for r in predictable if r["true_closure"] is not None),
        ),
        share("cases beside it: a claim on a sound joint", sound_ones, claims),
    ]


def inflation(family: tuple[int, int], sealed: tuple[int, int]) -> Figure:
    """Right class at ENR >= 0.5 on the plant that the diagnosis was improved on, minus that on the others.

    Hits and cases of both; the interval is Newcombe's, of the difference of two shares by their own intervals
    (Newcombe 1998, method 10, with exact ones).
    """
    name = "sealed minus in-family, right class"
    if not family[1] or not sealed[1]:
        return _figure(name, BOUNDS[name], None, None, None, None, 0)
    first, second = family[0] / family[1], sealed[0] / sealed[1]
    (first_low, first_high), (second_low, second_high) = exact_binomial(*family), exact_binomial(*sealed)
    value = first - second
    low = value - math.hypot(first - first_low, second_high - second)
    high = value + math.hypot(first_high - first, second - second_low)
    return _figure(name, BOUNDS[name], value, low, high, None, sealed[1])


def told(records: Iterable[Json]) -> tuple[int, int]:
    """Single effects at ENR >= 0.5: right classes, cases."""
    strong = [r for r in of(records, "single") if r["enr"] >= 0.5]
    return sum(right(r) for r in strong), len(strong)


def closures(single: list[Json]) -> list[Figure]:
    """How far adding the named effect closes the gap, as said and as it truly does."""
    mean = [r for r in single if r["truth"][0]["kind"] not in NOT_PREDICTABLE and r["right_class"]]

    def errors(least: float) -> list[float]:
        pairs = [(r["gap"].get("closure"), r["true_closure"]) for r in mean if r["enr"] >= least]
        return [abs(said - true) for said, true in pairs if said is not None and true is not None]

    strong = [r for r in mean if r["enr"] >= 1]
    gaps = [r["gap"] for r in strong if r["gap"].get("closure") is not None and r["gap"].get("ceiling")]
    inside = [r for r in mean if r["gap"].get("closure_interval") and r["true_closure"] is not None]
    left = [r["end_task"].get("gap_left") for r in strong]
    true = [r["true_closure"] for r in strong]
    return [
        median("closure error, median, ENR >= 0.5", errors(0.5)),
        median("closure error, median, ENR >= 1", errors(1.0)),
        median("true closure, median, ENR >= 1", (value for value in true if value is not None)),
        median("closure of the ceiling, median, ENR >= 1", (gap["closure"] / gap["ceiling"] for gap in gaps)),
        share("closure interval holds the true closure", inside, _inside),
        median("end-task gap after / before, ENR >= 1", (value for value in left if value is not None)),
    ]


def _inside(record: Json) -> bool:
    low, high = record["gap"]["closure_interval"]
    return low <= record["true_closure"] <= high


def worst_effect(single: list[Json]) -> Figure:
    """The effect that is told least often at ENR >= 1."""
    row = "worst single effect, ENR >= 1"
    found = [
        share(f"{row}: {name}", records, right, bound=row)
        for name, records in by_name(r for r in single if r["enr"] >= 1).items()
    ]
    return min(found, key=lambda figure: (figure.value or 0.0, -figure.cases), default=share(row, [], right))


def of(records: Iterable[Json], stratum: str) -> list[Json]:
    """Those of one stratum."""
    return [record for record in records if record["stratum"] == stratum]


def sound(records: Iterable[Json]) -> list[Json]:
    """All whose file is as it should be."""
    return [record for record in records if record["data_fault"] is None]


def plan(records: Iterable[Json], name: str) -> list[Json]:
    """Those of one plan."""
    return [record for record in records if record["plan"] == name]


def ratio(records: Iterable[Json], value: float) -> list[Json]:
    """Separable pairs of one ratio."""
    return [record for record in of(records, "pair") if record["ratio"] == value]


def by_name(records: Iterable[Json]) -> dict[str, list[Json]]:
    """By the first effect."""
    found: dict[str, list[Json]] = {}
    for record in records:
        found.setdefault(record["names"][0], []).append(record)
    return dict(sorted(found.items()))


def claims(record: Json) -> bool:
    """Structure is claimed."""
    return record["claims"]


def right(record: Json) -> bool:
    """The effect is in the class of the first named cause."""
    return record["right_class"]


def caught(record: Json) -> bool:
    """Said to be unknown."""
    return record["caught"]


def settled(record: Json) -> bool:
    """Said to be unknown, or a name that could carry it."""
    return record["caught"] or (record["verdict"] == "named" and not record["misnamed"])


def placed_or_class(record: Json) -> bool:
    """Unknown with the true cell among the first two, or a name that could carry it."""
    if record["verdict"] == "named" and not record["misnamed"]:
        return True
    return record["caught"] and record["cell_hit"]
