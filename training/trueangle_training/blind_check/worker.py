"""A process that diagnoses what it is handed: `python -m trueangle_training.blind_check.worker`.

It is started without arguments, in a folder of its own, with a bare environment. On stdin comes one question a
line, on stdout goes one answer a line: it is never told where a case lies, what it is called or what is wrong.
"""

import datetime
import json
import os
import sys
import traceback
from collections.abc import Iterator
from typing import TextIO

from trueangle_training.blind_check.answers import Question, answer_of, as_line, pages_of


def main(questions: TextIO, answers: TextIO) -> None:
    """Answer until the questions end."""
    if any(name.startswith("trueangle_training.plant") for name in sys.modules):
        raise RuntimeError("a process that diagnoses must not know how the cases are made")
    for line in questions:
        answers.write(_answered(line))
        answers.flush()


def _answered(line: str) -> str:
    """A diagnosis that fails is an answer, too: the check goes on and counts it."""
    asked = json.loads(line)
    question = Question(
        measured_csv=asked["measured_csv"],
        joint_yaml=asked["joint_yaml"],
        without=tuple(asked["without"]),
        quick=asked["quick"],
    )
    try:
        if asked["pages_on"] is None:
            return as_line(answer_of(question).to_plain())
        return as_line({"pages": pages_of(question, today=datetime.date.fromisoformat(asked["pages_on"]))})
    except Exception as error:  # noqa: BLE001 - a line of the result says which case broke the diagnosis
        return as_line({"crashed": "".join(traceback.format_exception(error)[-2:])})


def _own_stdout() -> Iterator[TextIO]:
    """The pipe for answers; whatever else is printed goes to stderr, where it cannot be taken for one."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8") as pipe:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        yield pipe


if __name__ == "__main__":
    for out in _own_stdout():
        main(sys.stdin, out)
