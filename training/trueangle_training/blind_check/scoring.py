"""The opened truths held against the answers."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

from trueangle_training.blind_check.answers import Answer, answer_of_plain
from trueangle_training.blind_check.asking import Round
from trueangle_training.blind_check.closure import true_closure_of
from trueangle_training.blind_check.marks import marks_of
from trueangle_training.blind_check.seal import SealedCase, key_of

Json = dict[str, Any]

SERIAL_BELOW = 100
"""Cases: starting processes takes longer than so few."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scored:
    """One round, marked."""

    records: tuple[Json, ...]
    """In the order of the cases; `crashed` where the diagnosis failed."""
    answered: tuple[tuple[SealedCase, Answer], ...]


def scored(asked: Round, cases: Sequence[SealedCase], *, processes: int, restored: bool = False) -> Scored:
    """Marks of every case. `restored`: a withheld effect is back in the library and must be named again."""
    if restored:
        cases = [_put_back(case) for case in cases]
    found = [(case, asked.answer(case.case_id)) for case in cases]
    answered = [
        (case, answer_of_plain(plain)) for case, plain in found if plain is not None and "crashed" not in plain
    ]
    closures = dict(
        zip((case.case_id for case, _ in answered), _closures(asked, answered, processes), strict=True)
    )
    by_id = {case.case_id: answer for case, answer in answered}
    records: list[Json] = []
    for number, (case, plain) in enumerate(found):
        key = {"case_id": case.case_id, "wish": key_of(case.wish), "restored": restored and _was_withheld(case)}
        if case.case_id in by_id:
            marks = marks_of(case.wish, case.truth, by_id[case.case_id], true_closure=closures[case.case_id])
            records.append({**marks, **key})
        else:
            reason = "no answer" if plain is None else plain["crashed"]
            records.append({**key, "crashed": reason, "number": number})
    return Scored(records=tuple(records), answered=tuple(answered))


def _was_withheld(case: SealedCase) -> bool:
    return case.wish.stratum == "withheld"


def _put_back(case: SealedCase) -> SealedCase:
    return replace(case, truth=replace(case.truth, stratum="single")) if _was_withheld(case) else case


def _closures(
    asked: Round, answered: Sequence[tuple[SealedCase, Answer]], processes: int
) -> Iterator[float | None]:
    tasks = [(asked, case, answer) for case, answer in answered]
    if processes <= 1 or len(tasks) < SERIAL_BELOW:
        yield from map(_closure, tasks)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_closure, tasks, chunksize=8)


def _closure(task: tuple[Round, SealedCase, Answer]) -> float | None:
    asked, case, answer = task
    if case.truth.data_fault is not None:
        return None
    question = asked.question(case.case_id)
    return true_closure_of(
        question.measured_csv,
        question.joint_yaml,
        truth_arcsec=case.truth.structure_arcsec,
        explained_arcsec=answer.explained_arcsec,
    )
