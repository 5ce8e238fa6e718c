"""Diagnose the cases in a pool, one JSON line each; what is already in the file is not done again."""

import json
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tests.benchmarks.diagnosis_check.answers import WAYS
from tests.benchmarks.diagnosis_check.marks import marks_of

from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.wish import Wish

Json = dict[str, Any]

TRIES = 6
"""Seeds tried for a pair or an unknown that the plan must be able to separate."""


def diagnose_one(wish: Wish, way: str) -> Json:
    """Draw, diagnose and mark one case; a failure of the diagnosis is a mark, not an end of the check."""
    key = {"wish": key_of(wish), "way": way}
    case = None
    for attempt in range(TRIES):
        try:
            case = draw_case(replace(wish, seed=wish.seed + 10_000_019 * attempt))
            break
        except CaseNotFoundError:
            continue
    if case is None:
        return {**key, "skipped": "the plan does not let this case be what it should be"}
    try:
        return {**key, **marks_of(wish, case.truth, WAYS[way](case))}
    except Exception as error:  # noqa: BLE001 - one line of the summary says which case broke the diagnosis
        last = traceback.format_exception(error)[-2:]
        return {**key, "case_id": case.truth.case_id, "crashed": "".join(last)}


def key_of(wish: Wish) -> str:
    """A wish as one line of text."""
    return json.dumps(asdict(wish), sort_keys=True)


def records(path: Path) -> list[Json]:
    """Those of a file, none where there is no file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    found: list[Json] = []
    for line in path.read_text("utf-8").splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def run(wished: list[Wish], *, way: str, processes: int, path: Path, console: Console) -> list[Json]:
    """All records, in the order of the wishes; new ones are appended to the file as they come."""
    before = records(path)
    known = {record["wish"]: record for record in before if record.get("way") == way}
    missing = [wish for wish in wished if key_of(wish) not in known]
    path.parent.mkdir(parents=True, exist_ok=True)
    # Written anew, so that nothing is appended to a line that was cut off.
    path.write_text("".join(json.dumps(record) + "\n" for record in before), "utf-8")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with path.open("a", encoding="utf-8") as out, Progress(*columns, console=console) as bars:
        bar = bars.add_task("diagnosing", total=len(wished), completed=len(wished) - len(missing))
        for record in _in_pool(missing, way, processes):
            known[record["wish"]] = record
            out.write(json.dumps(record) + "\n")
            out.flush()
            bars.advance(bar)
    return [known[key_of(wish)] for wish in wished]


def _in_pool(wished: list[Wish], way: str, processes: int) -> Iterator[Json]:
    if processes <= 1:
        yield from (diagnose_one(wish, way) for wish in wished)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        pending = [pool.submit(diagnose_one, wish, way) for wish in wished]
        for done in as_completed(pending):
            yield done.result()
