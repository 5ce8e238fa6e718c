"""Child processes of the demo: started in sessions of their own, their output kept, always ended."""

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from trueangle.contract.errors import TrueangleError

STOP_TIMEOUT_S = 5.0
_PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a process gets when its parent dies."""


class ChildError(TrueangleError):
    """A child process ended or never said what was waited for; the message holds its last lines."""


class Child:
    """One process; its stdout and stderr go to a log file, its stdin closes when this process dies."""

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        self.name, self.log = name, log
        with log.open("wb") as output:
            # A session of its own: Ctrl-C reaches the demo alone, which then ends its children in order.
            self._process = subprocess.Popen(  # noqa: S603 - our own commands, no shell
                list(command),
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                # Even a demo that is killed leaves nothing running.
                preexec_fn=_die_with_parent,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def finished(self) -> bool:
        """Whether it has ended; ChildError where it ended badly."""
        code = self._process.poll()
        if code is not None and code != 0:
            raise ChildError(f"{self.name} ended with code {code}:\n{self.tail()}")
        return code is not None

    def wait_for_line(self, word: str, timeout_s: float) -> str:
        """The first line of its output that holds `word`; ChildError when it ends or the time is up."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            for line in self.log.read_text("utf-8", "replace").splitlines():
                if word in line:
                    return line
            if self.finished():
                raise ChildError(f"{self.name} ended before it said {word!r}:\n{self.tail()}")
            if time.monotonic() > deadline_s:
                raise ChildError(f"{self.name} did not say {word!r} within {timeout_s:g} s:\n{self.tail()}")
            time.sleep(0.02)

    def tail(self) -> str:
        """Its last lines, indented."""
        lines = self.log.read_text("utf-8", "replace").splitlines()[-15:]
        return "\n".join(f"    {line}" for line in lines)

    def stop(self) -> int:
        """End it orderly, or by force after some seconds; the exit code."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return self._process.wait()


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def run_all(
    children: Sequence[tuple[str, Sequence[str], Path]], *, at_once: int, on_done: Callable[[int], None]
) -> None:
    """Run commands to their ends, some at a time; `on_done` gets the number finished.

    ChildError on the first that fails; the others are ended.
    """
    waiting = list(children)
    running: list[Child] = []
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                running.append(Child(*waiting.pop(0)))
            still = [child for child in running if not child.finished()]
            if len(still) < len(running):
                running = still
                on_done(len(children) - len(waiting) - len(running))
            time.sleep(0.02)
    finally:
        for child in running:
            child.stop()
