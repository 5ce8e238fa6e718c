"""`trueangled` on a terminal of its own: what it writes is kept, keys and sizes are given."""

import asyncio
import contextlib
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from tests.fakes.trueangled_process import command, environment

LIMIT_S = 20.0


class PseudoTerminal:
    """A process on a pty."""

    def __init__(
        self, *arguments: str, columns: int = 80, lines: int = 24, variables: Mapping[str, str] | None = None
    ) -> None:
        self._near, self._far = pty.openpty()
        self.size(columns, lines)
        self.before = termios.tcgetattr(self._far)
        self._process = subprocess.Popen(
            command(*arguments),
            stdin=self._far,
            stdout=self._far,
            stderr=self._far,
            env=environment() | {"TERM": "xterm", "PYTHONIOENCODING": "utf-8"} | dict(variables or {}),
            start_new_session=True,
        )
        self.written = b""
        self._stirred = asyncio.Event()

    async def __aenter__(self) -> Self:
        asyncio.get_running_loop().add_reader(self._near, self._read)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        asyncio.get_running_loop().remove_reader(self._near)
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        os.close(self._near)
        os.close(self._far)

    def _read(self) -> None:
        self.written += os.read(self._near, 65536)
        self._stirred.set()

    @property
    def screen(self) -> str:
        """The last whole screen as text, attributes taken off."""
        last = self.written.decode("utf-8", "replace").rsplit("\x1b[H", 1)[-1]
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", last).replace("\r", "")

    async def until(self, text: str) -> str:
        """Wait for a screen with this text."""
        try:
            async with asyncio.timeout(LIMIT_S):
                while text not in self.screen:
                    self._stirred.clear()
                    await self._stirred.wait()
        except TimeoutError:
            raise AssertionError(f"never shown: {text!r}; last screen:\n{self.screen}") from None
        return self.screen

    def keys(self, text: str) -> None:
        os.write(self._near, text.encode())

    def interrupt(self) -> None:
        """What Ctrl-C does where the terminal controls the process."""
        self._process.send_signal(signal.SIGINT)

    def size(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self._near, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    async def ended(self) -> int:
        """The exit code."""
        return await asyncio.to_thread(self._process.wait, LIMIT_S)

    def settings(self) -> list[object]:
        """Of the terminal now."""
        return termios.tcgetattr(self._far)
