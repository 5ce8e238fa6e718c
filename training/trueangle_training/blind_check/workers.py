"""Processes that diagnose, and the threads that hand them their questions.

A worker gets the text of two files and which effects its library shall lack: no path, no name, no truth. It runs
in an empty folder of its own and sees of the environment only what Python needs. One that dies costs its case.
"""

import contextlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import IO, Self

from trueangle_training.blind_check.answers import Json, Question, as_line

KEPT = ("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "SYSTEMROOT", "MPLCONFIGDIR")
"""Of the environment; the place of our packages is added."""
STOP_TIMEOUT_S = 5.0
SHOWN_CHARACTERS = 600
"""Of what a dead worker left on stderr."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A question and the key by which its answer is known here; the key stays here."""

    key: str
    ask: Callable[[], Question]
    """Reads the case's files when its turn comes: thousands of them need not be in memory."""
    pages_on: str | None = None
    """ISO date: the report's files are wanted, not the answer."""


def answers(tasks: Sequence[Task], *, processes: int) -> Iterator[tuple[str, Json]]:
    """Key and answer as they come: that of the worker, or `crashed` with the reason."""
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    done: queue.SimpleQueue[tuple[str, Json] | BaseException] = queue.SimpleQueue()
    stop = threading.Event()
    living: list[Worker] = []
    threads = [
        threading.Thread(target=_serve, args=(waiting, done, stop, living), daemon=True)
        for _ in range(min(processes, len(tasks)))
    ]
    for thread in threads:
        thread.start()
    try:
        for _ in tasks:
            got = done.get()
            if isinstance(got, BaseException):
                raise got
            yield got
    finally:
        stop.set()
        for worker in tuple(living):
            worker.kill()
        for thread in threads:
            thread.join()


def _serve(
    waiting: "queue.SimpleQueue[Task]",
    done: "queue.SimpleQueue[tuple[str, Json] | BaseException]",
    stop: threading.Event,
    living: "list[Worker]",
) -> None:
    """One worker after the other, one question after the other."""
    worker: Worker | None = None
    try:
        while not stop.is_set():
            try:
                task = waiting.get_nowait()
            except queue.Empty:
                break
            if worker is None:
                worker = Worker()
                living.append(worker)
            got = worker.ask(task.ask(), pages_on=task.pages_on)
            if got is None:
                got = {"crashed": f"the process that diagnosed it died: {worker.last_words()}"}
                living.remove(worker)
                worker.close()
                worker = None
            done.put((task.key, got))
    except BaseException as error:  # noqa: BLE001 - it is raised again where the answers are waited for
        done.put(error)
    finally:
        if worker is not None:
            living.remove(worker)
            worker.close()


class Worker:
    """One process, from its start to its end."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="trueangle-worker-")
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `close`
        self._process = subprocess.Popen(
            [sys.executable, "-m", "trueangle_training.blind_check.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            cwd=self._folder.name,
            env=bare_environment(os.environ),
            # Ctrl-C is for the command, which then ends its workers; they must not die over half an answer.
            start_new_session=True,
            text=True,
            encoding="utf-8",
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def ask(self, question: Question, *, pages_on: str | None) -> Json | None:
        """Its answer; None: it died, or was killed."""
        assert self._process.stdin is not None  # noqa: S101 - as it was started
        assert self._process.stdout is not None  # noqa: S101 - as it was started
        asked = {
            "measured_csv": question.measured_csv,
            "joint_yaml": question.joint_yaml,
            "without": list(question.without),
            "quick": question.quick,
            "pages_on": pages_on,
        }
        try:
            self._process.stdin.write(as_line(asked))
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            return None
        return json.loads(line) if line.endswith("\n") else None

    def last_words(self) -> str:
        """The end of what it wrote to stderr, and its exit code."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(STOP_TIMEOUT_S)
        self._said.seek(0)
        text = self._said.read().decode(errors="replace").strip()[-SHOWN_CHARACTERS:]
        return f"exit code {self._process.poll()}; {text or 'it said nothing'}"

    def kill(self) -> None:
        """From another thread: whoever waits for its answer gets None."""
        self._process.kill()

    def close(self) -> None:
        """End it, whatever it is at."""
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._said.close()
        self._folder.cleanup()


def bare_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """What Python and the libraries need, one thread each, and where our packages lie; nothing of the caller."""
    kept = {name: environment[name] for name in KEPT if name in environment}
    places = [place for place in sys.path if place]
    return kept | {
        "PYTHONPATH": os.pathsep.join(places),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONIOENCODING": "utf-8",
    }
