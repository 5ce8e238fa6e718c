"""The sealed cases asked of the workers; answers are kept under the state of the diagnosis that gave them."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueangle_training.blind_check.answers import Question
from trueangle_training.blind_check.seal import CASES, JOINT, MEASURED, Seal
from trueangle_training.blind_check.workers import Task, answers
from trueangle_training.files import write_whole

Json = dict[str, Any]

ANSWERS, REPORTS = "answers", "reports"
SHOWN_DIGITS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """Every case of a sealed set, asked with one library."""

    folder: Path
    """Of the set."""
    seal: Seal
    without: tuple[str, ...]
    """Effects that the library lacks, for all its cases alike."""
    quick: bool
    diagnosis_sha256: str

    @property
    def answers(self) -> Path:
        """Where its answers are kept; another library or another diagnosis has its own place."""
        words = [self.diagnosis_sha256[:SHOWN_DIGITS], *(["quick"] if self.quick else [])]
        words += [f"without-{name}" for name in self.without]
        return self.folder / ANSWERS / "-".join(words)

    def question(self, case_id: str) -> Question:
        """As a worker gets it: the texts, nothing of where they are from."""
        place = self.folder / CASES / case_id
        return Question(
            measured_csv=(place / MEASURED).read_text("utf-8"),
            joint_yaml=(place / JOINT).read_text("utf-8"),
            without=self.without,
            quick=self.quick,
        )

    def answer(self, case_id: str) -> Json | None:
        """What was said of a case; None: nothing yet."""
        path = self.answers / f"{case_id}.json"
        return json.loads(path.read_text("utf-8")) if path.exists() else None


def ask_all(rounds: Sequence[Round], *, processes: int, told: Callable[[int, int], None]) -> None:
    """All that is still missing, one file an answer, so that a second call goes on where the first was cut off.

    `told` is called with how many answers are there, and how many there will be.
    """
    places: dict[str, Path] = {}
    tasks: list[Task] = []
    total = 0
    for number, each in enumerate(rounds):
        each.answers.mkdir(parents=True, exist_ok=True)
        total += len(each.seal.case_ids)
        for case_id in each.seal.case_ids:
            path = each.answers / f"{case_id}.json"
            if not path.exists():
                key = f"{number}/{case_id}"
                places[key] = path
                tasks.append(Task(key=key, ask=lambda each=each, case_id=case_id: each.question(case_id)))
    done = total - len(tasks)
    told(done, total)
    for key, answer in answers(tasks, processes=processes):
        write_whole(places[key], (json.dumps(answer) + "\n").encode())
        done += 1
        told(done, total)


def write_reports(
    chosen: Mapping[str, tuple[Round, str]],
    folder: Path,
    *,
    on: str,
    processes: int,
    told: Callable[[int, int], None],
) -> dict[str, str]:
    """The full reports of chosen cases, as `trueangle diagnose` makes them, under their names.

    Name to why there is none. Reports of an earlier choice are taken away.
    """
    if (folder / REPORTS).is_dir():
        shutil.rmtree(folder / REPORTS)
    tasks = [
        Task(key=name, ask=lambda each=each, case_id=case_id: each.question(case_id), pages_on=on)
        for name, (each, case_id) in chosen.items()
    ]
    told(0, len(tasks))
    failed: dict[str, str] = {}
    for number, (key, answer) in enumerate(answers(tasks, processes=processes), start=1):
        if "crashed" in answer:
            failed[key] = answer["crashed"]
        for name, text in answer.get("pages", {}).items():
            place = folder / REPORTS / key
            place.mkdir(parents=True, exist_ok=True)
            write_whole(place / name, text.encode())
        told(number, len(tasks))
    return failed
