"""Recording to files: rotated, bounded in total, on a thread of its own, and never in the way of the loop.

Rules of this file: the loop hands over an image and goes on; what does not fit into the queue is counted and lost.
A disk that takes no more stops the recording, not the daemon: the last line is taken back, and it goes on when
there is room. Only files with our own names are ever deleted.
"""

import contextlib
import datetime
import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from trueangle.core.recording import RecordedJoint, RowMaker, recorded_number
from trueangle.core.register_reading import detail_block, read_detail
from trueangle.core.registers import RegisterImage

QUEUE_IMAGES = 256
RETRY_S = 5.0
ROOM_BYTES = 1_000_000
"""A disk with less room than this is still full: the recording would stop again at once."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordLimits:
    """How much is kept."""

    max_bytes: int
    rotate_bytes: int
    rotate_s: float | None


@dataclass(slots=True)
class _OpenFile:
    joint: RecordedJoint
    path: Path
    number: int
    handle: int
    size: int
    opened_s: float


class RecordFiles:
    """The files of one directory. Every method may raise OSError; no line is then left half written."""

    def __init__(
        self, directory: Path, limits: RecordLimits, *, write: Callable[[int, bytes], int] = os.write
    ) -> None:
        self._directory, self._limits, self._write = directory, limits, write
        self._open: dict[int, _OpenFile] = {}
        self._closed: dict[int, tuple[Path, int]] = {}
        """Number to path and size, of everything recorded that is not being written."""
        self._next = 1

    def take_stock(self) -> None:
        """Find what was recorded before; what a crash left unfinished is finished."""
        self._closed.clear()
        for path in sorted(self._directory.iterdir()):
            number = recorded_number(path.name)
            if number is None or any(number == entry.number for entry in self._open.values()):
                continue
            final = path.with_suffix("") if path.suffix == ".part" else path
            if final != path:
                path.replace(final)
            self._closed[number] = (final, final.stat().st_size)
            self._next = max(self._next, number + 1)

    def append(self, joint: RecordedJoint, line: str, *, now_s: float, stamp: str) -> None:
        """Write one whole line; opens, rotates and deletes as the limits ask."""
        data = line.encode()
        entry = self._open.get(joint.slot)
        if entry is not None and self._is_full(entry, len(data), now_s):
            self.close(joint.slot)
            entry = None
        self._make_room(len(data) + (0 if entry else len(joint.header)))
        entry = self._open.get(joint.slot) or self._begin(joint, now_s, stamp)
        self._put(entry, data)

    def close(self, slot: int) -> None:
        """Finish the file of one joint: on disk first, then under its final name."""
        entry = self._open.pop(slot, None)
        if entry is None:
            return
        self._closed[entry.number] = (entry.path, entry.size)
        try:
            os.fsync(entry.handle)
        finally:
            os.close(entry.handle)
        final = entry.path.with_suffix("")
        entry.path.replace(final)
        self._closed[entry.number] = (final, entry.size)
        _sync_directory(self._directory)

    def close_all(self) -> None:
        """Finish every file, whatever the disk says."""
        for slot in tuple(self._open):
            with contextlib.suppress(OSError):
                self.close(slot)

    @property
    def total_bytes(self) -> int:
        """Of all recorded files."""
        return sum(size for _, size in self._closed.values()) + sum(entry.size for entry in self._open.values())

    def _is_full(self, entry: _OpenFile, more: int, now_s: float) -> bool:
        old = self._limits.rotate_s is not None and now_s - entry.opened_s >= self._limits.rotate_s
        return old or entry.size + more > self._limits.rotate_bytes

    def _make_room(self, more: int) -> None:
        while self.total_bytes + more > self._limits.max_bytes:
            if not self._closed:
                oldest = min(self._open.values(), key=lambda entry: entry.number, default=None)
                if oldest is None:
                    return
                self.close(oldest.joint.slot)
            number = min(self._closed)
            path, _ = self._closed.pop(number)
            path.unlink(missing_ok=True)

    def _begin(self, joint: RecordedJoint, now_s: float, stamp: str) -> _OpenFile:
        number, self._next = self._next, self._next + 1
        path = self._directory / (joint.file_name(number, stamp) + ".part")
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        entry = _OpenFile(joint, path, number, handle, 0, now_s)
        self._open[joint.slot] = entry
        self._put(entry, joint.header.encode())
        return entry

    def _put(self, entry: _OpenFile, data: bytes) -> None:
        written = 0
        try:
            while written < len(data):
                written += self._write(entry.handle, data[written:])
        except OSError:
            # To take bytes back needs no room.
            os.ftruncate(entry.handle, entry.size)
            os.lseek(entry.handle, entry.size, os.SEEK_SET)
            raise
        entry.size += len(data)


class PatientRecorder:
    """Files that stop where the disk takes no more and go on when it does."""

    def __init__(self, files: RecordFiles, directory: Path) -> None:
        self._files, self._directory = files, directory
        self._retry_s: float | None = 0.0
        """When to try again; None while it runs."""
        self._stopped_s = 0.0
        self.stopped = False
        """Plain, so that the loop may look at it from its own thread."""
        self.reason = ""
        self.lines = 0
        self.lines_lost = 0

    def append(self, joint: RecordedJoint, line: str, *, now_s: float, stamp: str) -> None:
        """Write the line, or count it as lost."""
        if self._retry_s is not None and not self._goes_on(now_s):
            self.lines_lost += 1
            return
        try:
            self._files.append(joint, line, now_s=now_s, stamp=stamp)
        except OSError as error:
            self._stop(error, now_s)
            self.lines_lost += 1
            return
        self.lines += 1
        if self.stopped:
            _log.info(
                "event=recorder_resumed directory=%s after_s=%.1f lines_lost=%d",
                self._directory,
                now_s - self._stopped_s,
                self.lines_lost,
            )
            self.stopped, self.reason = False, ""

    def close(self) -> None:
        """Finish every file."""
        self._files.close_all()

    def _goes_on(self, now_s: float) -> bool:
        if self._retry_s is not None and now_s < self._retry_s:
            return False
        try:
            if self.stopped and room_bytes(self._directory) < ROOM_BYTES:
                self._retry_s = now_s + RETRY_S
                return False
            self._files.take_stock()
        except OSError as error:
            self._stop(error, now_s)
            return False
        self._retry_s = None
        return True

    def _stop(self, error: OSError, now_s: float) -> None:
        self._files.close_all()
        self._retry_s = now_s + RETRY_S
        reason = error.strerror or str(error)
        if not self.stopped:
            self._stopped_s = now_s
            _log.error("event=recorder_stopped directory=%s reason=%r", self._directory, reason)
        self.stopped, self.reason = True, reason


def room_bytes(directory: Path) -> int:
    """What an unprivileged process may still write there."""
    told = os.statvfs(directory)
    return told.f_bavail * told.f_frsize


class Recorder:
    """The daemon's recording; `with` runs its thread. `offer` and `note_reference` are for the loop's thread."""

    def __init__(
        self,
        directory: Path,
        joints: Sequence[RecordedJoint],
        limits: RecordLimits,
        *,
        every_s: float,
        files: RecordFiles | None = None,
    ) -> None:
        self.joints = tuple(joints)
        """Replaced as a whole where a reload changes them."""
        self._makers: dict[int, RowMaker] = {}
        self._sink = PatientRecorder(files or RecordFiles(directory, limits), directory)
        self._every_ns = round(every_s * 1e9)
        self._due_ns: int | None = None
        self._started_ns = 0
        self._references: dict[int, float] = {}
        self._queue: queue.Queue[tuple[RegisterImage, Mapping[int, float], int, float] | None] = queue.Queue(
            QUEUE_IMAGES
        )
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self.images_dropped = 0
        """Did not fit into the queue."""
        self._dead = False

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=0.2)
        # A disk that hangs must not hold up the end of the service.
        self._thread.join(0.5)

    @property
    def stopped(self) -> bool:
        """Whether nothing is being written (service bit RECORDER_STOPPED)."""
        return self._sink.stopped or self._dead

    def note_reference(self, slot: int, reference_deg: float) -> None:
        """The joint stands at this true angle now: the next image is recorded with it."""
        if any(joint.slot == slot for joint in self.joints):
            self._references[slot] = reference_deg

    def offer(self, image: RegisterImage, now_ns: int) -> None:
        """Take the image if one is due; never waits."""
        if self._due_ns is None:
            self._due_ns = self._started_ns = now_ns
        if now_ns < self._due_ns and not self._references:
            return
        self._due_ns = max(self._due_ns + self._every_ns, now_ns) if now_ns >= self._due_ns else self._due_ns
        references, self._references = self._references, {}
        try:
            self._queue.put_nowait((image, references, now_ns, time.time()))
        except queue.Full:
            self.images_dropped += 1
            # A reference angle is told once, by a person: it waits for the next image.
            self._references = references | self._references

    def _run(self) -> None:
        try:
            while (item := self._queue.get()) is not None:
                self._record(*item)
        finally:
            self._dead = True
            self._sink.close()

    def _record(self, image: RegisterImage, references: Mapping[int, float], now_ns: int, wall_s: float) -> None:
        moment = datetime.datetime.fromtimestamp(wall_s, datetime.UTC)
        for joint in self.joints:
            block = detail_block(joint.slot)
            data = image.read(block.address, block.count)
            if data is None:
                continue
            line = self._makers.setdefault(joint.slot, RowMaker()).row(
                read_detail(data, joint.slot),
                reference_deg=references.get(joint.slot),
                time_s=(now_ns - self._started_ns) * 1e-9,
                utc=utc_text(moment),
            )
            self._sink.append(joint, line, now_s=now_ns * 1e-9, stamp=file_stamp(moment))


def utc_text(moment: datetime.datetime) -> str:
    """For a cell."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S.") + f"{moment.microsecond // 1000:03d}Z"


def file_stamp(moment: datetime.datetime) -> str:
    """For a file name."""
    return moment.strftime("%Y%m%dT%H%M%SZ")


def _sync_directory(directory: Path) -> None:
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
