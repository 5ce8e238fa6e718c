"""SocketCAN read on the loop: no thread, no Message objects, the whole burst at once."""

import asyncio
import contextlib
import errno
import os
import socket
import struct
import sys
import time

import can

from trueangle.edges.can_bus.link import COALESCE_S, Frame, LinkOwner, cannot_open, lose
from trueangle.errors import LinkError

RECEIVE_BUFFER_BYTES = 1 << 20
MAX_DRAIN_FRAMES = 4096
"""At most so many frames in one turn, so that a babbling bus cannot starve the loop."""
FULL_QUEUE_LIMIT = 50
"""ENOBUFS says that the controller's queue is full: normal once, a cut cable when it goes on."""

_CAN_FRAME = struct.Struct("=IB3x8s")
"""struct can_frame of linux/can.h: id with flags, length, 3 bytes of padding, data."""
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_SOL_CAN_RAW, _CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER = 101, 1, 2
_CAN_FILTER = struct.Struct("=II")
"""struct can_filter of linux/can.h: id and mask."""
_STANDARD_DATA = _EXTENDED | _REMOTE | 0x7FF
_ALL_ERRORS = 0x1FFFFFFF
MAX_FILTERS = 512
"""CAN_RAW_FILTER_MAX of linux/can.h."""
_SO_TIMESTAMPNS = 35
"""asm-generic/socket.h; the kernel then tells with each frame when it came, by the wall clock."""
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
WAITED_NS = round(2e9 * COALESCE_S)
"""Frames that waited longer have the time of their arrival; the others that of their reading, which is cheaper."""
CLOCK_SET_NS = 2_000_000
"""The wall clock moved by more against the monotonic one since the socket was empty: it was set."""
_SO_MEMINFO, _MEMINFO_DROPS = 55, 8
"""asm-generic/socket.h and SK_MEMINFO_DROPS of linux/sock_diag.h: drops of a full receive buffer."""


class SocketcanLink:
    """A raw SocketCAN socket read on the loop: no thread, no Message objects, the whole burst at once."""

    def __init__(self, owner: LinkOwner) -> None:
        self._settings, self._opener, self._on_frames = owner.settings, owner.opener, owner.on_frames
        self._counters, self._lost, self._on_error_frame = owner.counters, owner.lost, owner.on_error_frame
        self._loop = owner.lost.get_loop()
        self._bus: can.BusABC | None = None
        self._socket: socket.socket | None = None
        self._drain_timer: asyncio.TimerHandle | None = None
        self._full_in_a_row = 0
        self._drops_seen = 0
        self._cob_ids: frozenset[int] | None = None
        self._emptied_ns = self._wall_ahead_ns = 0
        """When nothing was left in the socket, and how far the wall clock was ahead of the monotonic one then."""

    def listen_to(self, cob_ids: frozenset[int] | None) -> None:
        """Hand on only frames of these COB-IDs, None: all; the kernel sorts them out where it can."""
        self._cob_ids = cob_ids
        if self._socket is not None:
            self._set_kernel_filter(self._socket)

    def _set_kernel_filter(self, raw: socket.socket) -> None:
        if self._cob_ids is None or len(self._cob_ids) > MAX_FILTERS:
            filters = _CAN_FILTER.pack(0, 0)
        else:
            filters = b"".join(_CAN_FILTER.pack(cob_id, _STANDARD_DATA) for cob_id in sorted(self._cob_ids))
        with contextlib.suppress(OSError):  # no raw CAN socket: the frames are sorted out one by one
            raw.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS.to_bytes(4, sys.byteorder))
            raw.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, filters)

    async def open(self) -> None:
        try:
            self._bus = self._opener(self._settings)
            raw = _raw_socket(self._bus)
        except (can.CanError, OSError, ValueError, TypeError) as error:
            raise LinkError(cannot_open(self._settings, error)) from error
        self._socket = raw
        self._set_kernel_filter(raw)
        with contextlib.suppress(OSError):
            raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._note_empty()
        self._loop.add_reader(raw.fileno(), self._wake)

    def send(self, can_id: int, data: bytes) -> None:
        if self._socket is None:
            raise LinkError(f"bus {self._settings.name}: not open")
        try:
            self._socket.send(_CAN_FRAME.pack(can_id, len(data), data))
            self._full_in_a_row = 0
        except OSError as error:
            if error.errno in (errno.ENOBUFS, errno.EAGAIN):
                self._full_in_a_row += 1
            if error.errno not in (errno.ENOBUFS, errno.EAGAIN) or self._full_in_a_row >= FULL_QUEUE_LIMIT:
                self._loop.call_soon_threadsafe(lose, self._lost, f"cannot send: {error}")
            raise LinkError(f"bus {self._settings.name}: cannot send 0x{can_id:03X}: {error}") from error

    def hand_over(self) -> None:
        """Read everything that is there and hand it on as one batch."""
        self._take()

    def _take(self) -> bool:
        """The same; False where nothing was there that anybody listens to."""
        if self._socket is None:
            return False
        frames: list[Frame] = []
        receive, cob_ids, size = self._socket.recv, self._cob_ids, _CAN_FRAME.size
        try:
            waited = True  # until a frame shows that it, and so every later one, has not
            for _ in range(MAX_DRAIN_FRAMES):
                if waited:
                    raw, ancillary, _, _ = self._socket.recvmsg(size, _ANCILLARY_BYTES)
                    stamp_ns = self._arrival_ns(ancillary)
                    waited = time.monotonic_ns() - stamp_ns > WAITED_NS
                else:
                    raw, stamp_ns = receive(size), time.monotonic_ns()
                if len(raw) != size:
                    if not raw:
                        lose(self._lost, "closed by the other side")
                        break
                    self._counters.error_frames += 1
                    continue
                can_id, length, data = _CAN_FRAME.unpack(raw)
                if can_id & (_EXTENDED | _REMOTE | _ERROR):
                    self._count_flagged(can_id, data[:length])
                elif cob_ids is None or can_id in cob_ids:
                    frames.append((can_id, data[:length], stamp_ns))
                else:
                    self._counters.foreign_frames += 1
        except BlockingIOError:
            self._note_empty()
        except OSError as error:
            lose(self._lost, f"cannot receive: {error}")
        if frames:
            self._counters.frames += len(frames)
            self._on_frames(frames)
        return bool(frames)

    def _note_empty(self) -> None:
        self._emptied_ns = time.monotonic_ns()
        self._wall_ahead_ns = time.time_ns() - self._emptied_ns

    def _arrival_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """When the frame came, monotonic: not before the socket was last empty, not after now.

        Where the kernel does not tell, now; where the wall clock was set meanwhile, before or behind the frame,
        the earlier time that can be.
        """
        now_ns = time.monotonic_ns()
        for level, kind, data in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(data) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(data)
                wall_ns, ahead_ns = seconds * 1_000_000_000 + nanoseconds, time.time_ns() - now_ns
                came_ns = wall_ns - self._wall_ahead_ns
                if abs(ahead_ns - self._wall_ahead_ns) <= CLOCK_SET_NS:
                    return max(self._emptied_ns, min(came_ns, now_ns))
                can_be = [at for at in (came_ns, wall_ns - ahead_ns) if self._emptied_ns <= at <= now_ns]
                return min(can_be, default=self._emptied_ns)
        return now_ns

    def _count_flagged(self, can_id: int, data: bytes) -> None:
        if can_id & _ERROR:
            self._counters.error_frames += 1
            self._on_error_frame(can_id & _ALL_ERRORS, data)
        elif can_id & _REMOTE:
            self._counters.remote_frames += 1
        else:
            self._counters.extended_frames += 1

    def _wake(self) -> None:
        if self._socket is not None:
            self._loop.remove_reader(self._socket.fileno())
            self._drain_timer = self._loop.call_later(COALESCE_S, self._drain)

    def _drain(self) -> None:
        """While frames come, look again every `COALESCE_S`: to be woken costs more, and is no sooner."""
        self._drain_timer = None
        if self._socket is None:
            return
        more = True
        try:
            # First: whoever gets the batch must know that frames before it are missing.
            self._count_kernel_drops(self._socket)
            more = self._take()
        finally:
            self._wait(more=more)

    def _wait(self, *, more: bool) -> None:
        if self._socket is None or self._lost.done():
            return
        if more:
            self._drain_timer = self._loop.call_later(COALESCE_S, self._drain)
        else:
            self._loop.add_reader(self._socket.fileno(), self._wake)

    def _count_kernel_drops(self, raw: socket.socket) -> None:
        with contextlib.suppress(OSError, struct.error):  # kernels before 4.12 do not tell
            memory = raw.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
            drops: int = struct.unpack_from("=I", memory, 4 * _MEMINFO_DROPS)[0]
            self._counters.frames_dropped += drops - self._drops_seen
            self._drops_seen = drops

    async def close(self) -> None:
        if self._drain_timer is not None:
            self._drain_timer.cancel()
        if self._socket is not None:
            self._loop.remove_reader(self._socket.fileno())
            self._socket = None
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None


def _raw_socket(bus: can.BusABC) -> socket.socket:
    """The socket of python-can's SocketcanBus, made ready for the loop; OSError where the interface is down."""
    raw = getattr(bus, "socket", None)
    if not isinstance(raw, socket.socket):
        raise TypeError(f"{type(bus).__name__} has no socket")
    raw.setblocking(False)
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    # Binding to an interface that is down succeeds and leaves ENETDOWN behind.
    pending = raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if pending:
        raise OSError(pending, os.strerror(pending))
    return raw
