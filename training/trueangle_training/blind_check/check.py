"""The check from the first draw to the page; `seal` before `asking` before `opened` is what makes it blind."""

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

from trueangle_training.blind_check import looks
from trueangle_training.blind_check.asking import Round, ask_all, write_reports
from trueangle_training.blind_check.canary import Traits, songs, traits_of
from trueangle_training.blind_check.case_set import FULL, PlanChoice, effects_of, wishes, withheld_wishes
from trueangle_training.blind_check.frozen import commit, diagnosis_sha256
from trueangle_training.blind_check.page import check_page
from trueangle_training.blind_check.result import (
    canary_plain,
    chosen_cases,
    failing_of,
    figures_of,
    report_name,
    shown_of,
    withheld_figures_of,
)
from trueangle_training.blind_check.scoring import Scored, scored
from trueangle_training.blind_check.seal import SealedCase, opened, sealed
from trueangle_training.blind_check.shuffled import shuffled_score
from trueangle_training.files import write_whole
from trueangle_training.plant.plants import PLANTS
from trueangle_training.plant.wish import Wish
from trueangle_training.progress import Progress

Json = dict[str, Any]
Bar = Callable[[str], AbstractContextManager[Progress]]
"""Opens a progress bar under a title."""

RESULT_JSON, RESULT_HTML, MARKS = "result.json", "result.html", "marks.jsonl"
WITHHELD_CASES = 12
"""Of one effect where no number is given: nine of it at three sizes, three beside it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What is to be checked."""

    folder: Path
    cases: int | None
    """None: all of the targets' sizes."""
    seed: int
    plants: tuple[str, ...]
    plan: PlanChoice
    withhold: str | None
    """An effect, or `all`; None: an ordinary set."""
    quick: bool
    processes: int
    reports: bool
    looks: Sequence[Json] | None
    """Those before this one; None: nobody keeps count."""
    family: tuple[int, int] | None
    """Right classes and cases of the in-family plant in an earlier result."""
    today: date

    @property
    def effects(self) -> tuple[str, ...]:
        """To withhold, one after the other."""
        if self.withhold is None:
            return ()
        return effects_of(self.plants) if self.withhold == "all" else (self.withhold,)

    @property
    def cases_of_one_effect(self) -> int:
        """Of each withheld effect; as many are asked twice."""
        return WITHHELD_CASES if self.cases is None else max(self.cases // len(self.effects), 1)

    @property
    def conditions(self) -> Json:
        """What makes the set what it is."""
        return {
            "plant": "".join(self.plants),
            "plan": self.plan,
            "seed": self.seed,
            "cases": (self.cases or FULL.total)
            if self.withhold is None
            else self.cases_of_one_effect * len(self.effects),
            "withhold": self.withhold,
        }


def run(order: Order, *, say: Callable[[str], None], bar: Bar) -> Json:
    """The result, written; `say` gets the seal before anything is diagnosed.

    ContractError: the folder holds another set, or what was sealed has been changed.
    """
    frozen = diagnosis_sha256()
    seen = looks.seen_in(order.looks, order.conditions, diagnosis=frozen, quick=order.quick)
    rounds = _sealed_rounds(order, frozen, bar)
    manifest = _manifest_sha256(rounds)
    cases = sum(len(each.seal.case_ids) for each in _once(rounds))
    skipped = sum(len(each.seal.skipped) for each in _once(rounds))
    say(f"{'sealed':<17}{cases} cases, manifest SHA-256 {manifest}")
    with bar(f"diagnosing {sum(len(each.seal.case_ids) for each in rounds)} cases") as progress:
        ask_all(rounds, processes=order.processes, told=progress)
    changed = diagnosis_sha256() != frozen
    with bar("opening the seal, scoring") as progress:
        progress(0, 1)
        truths = [opened(each.folder, each.seal) for each in rounds]
        parts = [
            scored(each, own, processes=order.processes, restored=order.withhold is not None and not each.without)
            for each, own in zip(rounds, truths, strict=True)
        ]
        progress(1, 1)
    records = [record for part in parts for record in part.records]
    result: Json = {
        "schema_version": 1,
        "conditions": {**order.conditions, "quick": order.quick},
        "plants": {letter: PLANTS[letter].description for letter in order.plants},
        "seal": {"manifest_sha256": manifest, "cases": cases, "skipped": skipped},
        "commit": commit(),
        "diagnosis_sha256": frozen,
        "diagnosis_changed": changed,
        "on": order.today.isoformat(),
        "seen": asdict(seen),
        "not_asked": [
            name for name in order.effects if name not in {gone for each in rounds for gone in each.without}
        ],
        "crashed": [record for record in records if "crashed" in record],
        **_figures(order, rounds, parts),
        "canary": _canary(rounds, truths, parts, order.seed),
    }
    return _written(order, result, rounds, parts, bar)


def _sealed_rounds(order: Order, frozen: str, bar: Bar) -> list[Round]:
    """All sets sealed before the first diagnosis; of a withheld effect two rounds, without it and with it."""
    sets: list[tuple[Path, tuple[str, ...], list[Wish]]] = []
    if order.withhold is None:
        sizes = FULL.scaled(order.cases) if order.cases else FULL
        wished = wishes(sizes, plan=order.plan, plants=order.plants, seed=order.seed)
        sets.append((order.folder, (), wished))
    for effect in order.effects:
        each = order.cases_of_one_effect
        wished = withheld_wishes(effect, each, plan=order.plan, plants=order.plants, seed=order.seed)
        if wished:
            sets.append((order.folder / f"without-{effect}", (effect,), wished))
    total, before = sum(len(wished) for *_, wished in sets), 0
    rounds: list[Round] = []
    with bar(f"drawing {total} cases") as progress:
        for folder, without, wished in sets:
            conditions = order.conditions
            if without:
                conditions |= {"withhold": without[0], "cases": order.cases_of_one_effect}
            seal = sealed(
                folder,
                wished,
                conditions,
                processes=order.processes,
                told=lambda done, before=before: progress(before + done, total),
            )
            before += len(wished)
            rounds += [
                Round(folder=folder, seal=seal, without=gone, quick=order.quick, diagnosis_sha256=frozen)
                for gone in ([without, ()] if without else [()])
            ]
    return rounds


def _once(rounds: Sequence[Round]) -> list[Round]:
    """One round of each set."""
    return list({each.folder: each for each in rounds}.values())


def _manifest_sha256(rounds: Sequence[Round]) -> str:
    """The set's; of several sets the hash over theirs, in their order."""
    own = [each.seal.manifest_sha256 for each in _once(rounds)]
    return own[0] if len(own) == 1 else hashlib.sha256("".join(own).encode()).hexdigest()


def _figures(order: Order, rounds: Sequence[Round], parts: Sequence[Scored]) -> Json:
    if order.withhold is None:
        return figures_of(parts[0].records, family=order.family)
    pairs = list(zip(rounds, parts, strict=True))
    without = [record for each, part in pairs if each.without for record in part.records]
    restored = [record for each, part in pairs if not each.without for record in part.records]
    return withheld_figures_of(without, restored)


def _canary(
    rounds: Sequence[Round], truths: Sequence[Sequence[SealedCase]], parts: Sequence[Scored], seed: int
) -> Json:
    """Over the cases of each set once."""
    cases: dict[str, tuple[Round, SealedCase]] = {}
    for each, own in zip(rounds, truths, strict=True):
        cases |= {case.case_id: (each, case) for case in own}
    listed = list(cases.values())

    def traits_at(place: int) -> Traits:
        each, case = listed[place]
        question = each.question(case.case_id)
        return traits_of(question.measured_csv, question.joint_yaml)

    known = [
        (case.truth.stratum, f"{case.wish.plan} {case.wish.plant}", ", ".join(case.wish.names))
        for _, case in listed
    ]
    answered = [
        pair for each, part in zip(rounds, parts, strict=True) if not each.without for pair in part.answered
    ]
    shuffled = shuffled_score([case for case, _ in answered], [answer for _, answer in answered], seed=seed)
    return canary_plain(songs(known, traits_at), shuffled)


def _written(order: Order, result: Json, rounds: Sequence[Round], parts: Sequence[Scored], bar: Bar) -> Json:
    """Records, chosen reports, result and page."""
    asked = [(each, record) for each, part in zip(rounds, parts, strict=True) for record in part.records]
    own = {(record["case_id"], each.without): each for each, record in asked}
    first = [record | {"without": list(each.without)} for each, record in asked]
    worst, random = chosen_cases(first, seed=order.seed)
    failures = [record for record in first if failing_of(record)]
    lines = "".join(json.dumps(record, sort_keys=True) + "\n" for record in first)
    write_whole(order.folder / MARKS, lines.encode())
    failed: dict[str, str] = {}
    if order.reports:
        chosen = {
            report_name(record): (own[record["case_id"], tuple(record["without"])], record["case_id"])
            for record in (*worst, *random)
        }
        with bar(f"writing the reports of {len(chosen)} cases") as progress:
            failed = write_reports(
                chosen, order.folder, on=order.today.isoformat(), processes=order.processes, told=progress
            )
    result = result | {
        "worst": [shown_of(record) for record in worst],
        "random": [shown_of(record) for record in random],
        "failures": [shown_of(record) for record in failures],
        "reports": order.reports,
        "reports_failed": failed,
    }
    write_whole(order.folder / RESULT_JSON, (json.dumps(result, indent=1) + "\n").encode())
    write_whole(order.folder / RESULT_HTML, check_page(result).encode())
    return result
