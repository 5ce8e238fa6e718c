"""The file of presets in the state directory: replaced whole, and on the disk before anybody is told so."""

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from trueangle.contract.errors import ContractError, Fault
from trueangle.core.presets import MAX_PRESETS_BYTES, Preset, presets_text, read_presets

FILE_NAME = "presets.json"

_LOG = logging.getLogger(__name__)


def load_presets(directory: Path) -> tuple[Preset, ...]:
    """The stored presets, none if there is no file; ContractError where the file cannot be read as presets."""
    path = directory / FILE_NAME
    try:
        with path.open("rb") as file:
            data = file.read(MAX_PRESETS_BYTES + 1)
    except FileNotFoundError:
        return ()
    except OSError as error:
        found = error.strerror or str(error)
        raise ContractError([Fault(where=str(path), expected="a readable file", found=found)]) from error
    if len(data) > MAX_PRESETS_BYTES:
        expected = f"at most {MAX_PRESETS_BYTES} bytes"
        raise ContractError([Fault(where=str(path), expected=expected, found="a larger file")])
    return read_presets(data.decode("utf-8", errors="replace"), source=str(path))


def write_presets(directory: Path, text: str) -> None:
    """Replace the file so that after a power failure either the old or the new one is there, whole; or OSError.

    The order is that of rename(2) and fsync(2): the new content first, then its name, then the directory.
    """
    path = directory / FILE_NAME
    beside = directory / f".{FILE_NAME}.new"
    before = path.read_bytes() if path.exists() else None
    with beside.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
    try:
        descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError:
        # Whoever is told that it is not stored must not find it in force after the next start.
        with contextlib.suppress(OSError):
            _put_back(path, beside, before)
        raise


def _put_back(path: Path, beside: Path, before: bytes | None) -> None:
    if before is None:
        path.unlink()
    else:
        beside.write_bytes(before)
        beside.replace(path)


class PresetFile:
    """`core.commands.PresetStore`: writes in a thread, because an fsync may take a second on an SD card."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._tasks: set[asyncio.Task[None]] = set()

    def save(self, presets: Iterable[Preset], done: Callable[[bool], None]) -> None:
        """Replace the stored presets; `done` is called on the loop."""
        text = presets_text(presets)
        task = asyncio.get_running_loop().create_task(self._save(text, done))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Wait for what is being written."""
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _save(self, text: str, done: Callable[[bool], None]) -> None:
        try:
            await asyncio.to_thread(write_presets, self._directory, text)
        except OSError as error:
            _LOG.error("event=presets_not_stored directory=%s reason=%r", self._directory, error.strerror)
            done(False)
        else:
            done(True)
