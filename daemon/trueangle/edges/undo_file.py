"""The undo file: on disk, whole, before the first write to a device."""

import os
from pathlib import Path

from trueangle.contract.errors import ContractError, Fault

MAX_BYTES = 1_000_000


def write_undo(path: Path, text: str, *, replace: bool) -> None:
    """Write and sync the file and its directory; ContractError where it cannot be, or exists and is not ours.

    It is replaced as a whole: a loss of power leaves the old one or the new one.
    """
    if not replace and path.exists():
        advice = "keep it: it may be the only way back; name another with --undo-file"
        raise ContractError([Fault(where=str(path), expected="a new file", found="a file", advice=advice)])
    fresh = path.with_name(path.name + ".new")
    try:
        with fresh.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except OSError as error:
        found = error.strerror or str(error)
        expected = "an undo file that can be written; nothing was changed on the device"
        raise ContractError([Fault(where=str(path), expected=expected, found=found)]) from error


def read_undo(path: Path) -> str:
    """The text; ContractError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", None) or str(error)
        raise ContractError([Fault(where=str(path), expected="a readable undo file", found=found)]) from error
