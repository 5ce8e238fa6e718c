"""The terminal of a person: a full screen that is given back as it was, keys, progress, questions."""

import asyncio
import codecs
import os
import signal
import termios
import tty
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self, TextIO

ENTER, LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_HOME, _TO_LINE_END, _BELOW = "\x1b[H", "\x1b[K", "\x1b[J"
CTRL_C, CTRL_D = "\x03", "\x04"


def speaks_unicode(stream: TextIO) -> bool:
    """Whether the stream can show more than ASCII."""
    try:
        return codecs.lookup(stream.encoding or "ascii").name.startswith("utf")
    except LookupError:
        return False


def wants_colour(environment: Mapping[str, str]) -> bool:
    """Whether colours may be sent: not where NO_COLOR holds any text (no-color.org) or the terminal has none."""
    return not environment.get("NO_COLOR") and environment.get("TERM") != "dumb"


class FullScreen:
    """The alternate screen with keys one by one; `with` gives the terminal back whatever happens."""

    def __init__(self, keyboard: TextIO, screen: TextIO) -> None:
        self._keyboard, self._screen = keyboard, screen
        self._before: list[object] | None = None

    def __enter__(self) -> Self:
        number = self._keyboard.fileno()
        self._before = termios.tcgetattr(number)
        # Ctrl-C comes as a key: the way out is then the same as by q. Ctrl-Z would leave the screen as it is.
        tty.setraw(number, termios.TCSANOW)
        self._screen.write(ENTER)
        self._screen.flush()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._screen.write(LEAVE)
            self._screen.flush()
        finally:
            if self._before is not None:
                termios.tcsetattr(self._keyboard.fileno(), termios.TCSANOW, self._before)  # pyright: ignore[reportArgumentType]

    def size(self) -> tuple[int, int]:
        """Columns and lines now."""
        columns, lines = os.get_terminal_size(self._screen.fileno())
        return max(columns, 20), max(lines, 5)

    def show(self, lines: Sequence[str]) -> None:
        """Draw over what stands there: clearing first would flicker."""
        body = "\r\n".join(line + _TO_LINE_END for line in lines)
        self._screen.write(f"{_HOME}{body}{_BELOW}")
        self._screen.flush()

    def on_keys(self, loop: asyncio.AbstractEventLoop, take: Callable[[str], None]) -> Callable[[], object]:
        """Hand every burst of keys to `take` ('' at the end of input); returns the way to stop."""
        number = self._keyboard.fileno()

        def read() -> None:
            try:
                data = os.read(number, 64)
            except OSError:
                data = b""
            take(data.decode("utf-8", "replace"))

        loop.add_reader(number, read)
        return lambda: loop.remove_reader(number)


class Progress:
    """One line that counts up on a terminal; silent on anything else."""

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label = stream, label
        self._shown = stream.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown:
            self._stream.write(f"\r{_TO_LINE_END}")
            self._stream.flush()

    def __call__(self, part: float, text: str = "") -> None:
        """`part` of the work, 0 to 1, is done."""
        if self._shown:
            full = round(20 * min(1.0, max(0.0, part)))
            bar = "#" * full + "." * (20 - full)
            self._stream.write(f"\r{self._label} [{bar}] {100 * part:3.0f} % {text}{_TO_LINE_END}")
            self._stream.flush()


def ask(question: str, *, keyboard: TextIO, screen: TextIO) -> str | None:
    """The answer of a person; None where there is no terminal or its end came. Ctrl-C is KeyboardInterrupt."""
    if not keyboard.isatty():
        return None
    screen.write(question)
    screen.flush()
    # asyncio's handler would only note the signal, and the loop stands still until the line is whole.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        line = keyboard.readline()
    finally:
        signal.signal(signal.SIGINT, before)
    return line.strip() if line else None


def says_yes(answer: str | None) -> bool:
    """Only the whole word counts: a key hit by mistake writes nothing."""
    return answer is not None and answer.strip().lower() == "yes"
