"""How a log line is written: for people on a terminal, or with the priority that journald reads (sd-daemon(3))."""

import logging

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG = 7


class LogFormatter(logging.Formatter):
    """One record is one line, whatever a file, a node or a peer has written into it; a traceback has its own."""

    def __init__(self, *, journal: bool) -> None:
        super().__init__()
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        """The record's line, and a traceback's lines after it, each with the priority."""
        lines = [visible(record.getMessage())]
        if record.exc_info:
            lines += self.formatException(record.exc_info).splitlines()
        start = f"<{_priority(record.levelno)}>" if self._journal else f"{record.levelname} "
        return "\n".join(start + line for line in lines)


def _priority(level: int) -> int:
    return next((priority for least, priority in _PRIORITIES if level >= least), _DEBUG)


def visible(text: str) -> str:
    """The text with its control characters shown: one of a file's could end the line or steer the terminal."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
        for character in text
    )
