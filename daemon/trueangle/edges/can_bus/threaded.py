"""Any python-can interface but SocketCAN: its calls block, so one thread reads and one writes.

The reading thread touches nothing but `Inbox.put` and its own counters, the writing thread nothing but the
outbox; what they have to tell goes through the loop.
"""

import asyncio
import contextlib
import queue
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

import can

from trueangle.edges.can_bus.link import (
    COALESCE_S,
    BusCounters,
    Frame,
    FrameHandler,
    LinkOwner,
    cannot_open,
    lose,
)
from trueangle.errors import LinkError

INBOX_FRAMES = 8192
"""About one second of a saturated 1 Mbit/s bus (7.4 to 9 kframe/s)."""
OUTBOX_FRAMES = 256
RECEIVE_SLICE_S = 0.1
OPEN_LIMIT_S = 5.0
CLOSE_LIMIT_S = 2.0
CLASSIFIES_ERRORS = frozenset({"socketcan", "socketcand"})
"""Interfaces whose error frames carry the class bits of linux/can/error.h as their id."""


class Inbox:
    """The one hand-over from a reading thread to the loop: bounded, oldest frame dropped first and counted."""

    def __init__(self, loop: asyncio.AbstractEventLoop, on_frames: FrameHandler, counters: BusCounters) -> None:
        self._loop, self._on_frames, self._counters = loop, on_frames, counters
        self._frames: deque[Frame] = deque(maxlen=INBOX_FRAMES)
        self._armed = False

    def put(self, frame: Frame) -> None:
        """From the reading thread: append, and wake the loop once a burst."""
        if len(self._frames) == INBOX_FRAMES:
            self._counters.frames_dropped += 1
        self._frames.append(frame)
        if not self._armed:
            self._armed = True
            self._loop.call_soon_threadsafe(self._loop.call_later, COALESCE_S, self.hand_over)

    def hand_over(self) -> None:
        """On the loop: everything gathered so far, as one batch."""
        self._armed = False  # before the draining: a frame put meanwhile arms again, and none is left behind
        frames = [self._frames.popleft() for _ in range(len(self._frames))]
        if frames:
            self._counters.frames += len(frames)
            self._on_frames(frames)


class ThreadedLink:
    """Any other python-can interface: their calls block, so one thread reads and one writes."""

    def __init__(self, owner: LinkOwner) -> None:
        settings = owner.settings
        self._settings, self._opener, self._counters = settings, owner.opener, owner.counters
        self._lost, self._on_error_frame = owner.lost, owner.on_error_frame
        self._loop = owner.lost.get_loop()
        self._inbox = Inbox(self._loop, owner.on_frames, owner.counters)
        self._cob_ids: frozenset[int] | None = None
        self._outbox: queue.Queue[can.Message] = queue.Queue(OUTBOX_FRAMES)
        self._closing = threading.Event()
        self._opened: asyncio.Future[None] = self._loop.create_future()
        self._ended: asyncio.Future[None] = self._loop.create_future()
        self._reader = threading.Thread(target=self._read, name=f"can-read {settings.name}", daemon=True)

    def listen_to(self, cob_ids: frozenset[int] | None) -> None:
        """Hand on only frames of these COB-IDs, None: all."""
        self._cob_ids = cob_ids

    async def open(self) -> None:
        # A daemon thread, because some interfaces hang in their constructor and nothing can call them back.
        self._reader.start()
        try:
            async with asyncio.timeout(OPEN_LIMIT_S):
                await self._opened
        except TimeoutError as error:
            raise LinkError(f"bus {self._settings.name}: did not open within {OPEN_LIMIT_S:g} s") from error

    def send(self, can_id: int, data: bytes) -> None:
        message = can.Message(arbitration_id=can_id, is_extended_id=False, data=data, check=False)
        try:
            self._outbox.put_nowait(message)
        except queue.Full:
            self._tell(lose, self._lost, f"{OUTBOX_FRAMES} frames wait to be sent")
            raise LinkError(f"bus {self._settings.name}: send queue full") from None

    def hand_over(self) -> None:
        self._inbox.hand_over()

    async def close(self) -> None:
        self._closing.set()
        self._opened.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_LIMIT_S):
                await asyncio.shield(self._ended)
                self._reader.join()  # it has nothing left to do but to return

    def _read(self) -> None:
        writer: threading.Thread | None = None
        bus: can.BusABC | None = None
        try:
            bus = self._opener(self._settings)
            writer = threading.Thread(
                target=self._write, args=(bus,), name=f"can-write {self._settings.name}", daemon=True
            )
            writer.start()
            self._tell(_settle, self._opened)
            self._read_until_closing(bus)
        except Exception as error:  # noqa: BLE001 - back-ends of python-can raise what their vendor's library does
            self._fail(error, opened=writer is not None)
        finally:
            self._closing.set()
            if writer is not None:
                writer.join(CLOSE_LIMIT_S / 2)
            if bus is not None:
                bus.shutdown()
            self._tell(_settle, self._ended)

    def _read_until_closing(self, bus: can.BusABC) -> None:
        while not self._closing.is_set():
            message = bus.recv(RECEIVE_SLICE_S)
            if message is None:
                _raise_if_hung_up(bus)
            elif message.is_error_frame:
                self._counters.error_frames += 1
                if self._settings.interface in CLASSIFIES_ERRORS:
                    self._tell(self._on_error_frame, message.arbitration_id, bytes(message.data))
            elif message.is_remote_frame:
                self._counters.remote_frames += 1
            elif message.is_extended_id:
                self._counters.extended_frames += 1
            elif self._cob_ids is not None and message.arbitration_id not in self._cob_ids:
                self._counters.foreign_frames += 1
            else:
                self._inbox.put((message.arbitration_id, bytes(message.data), time.monotonic_ns()))

    def _write(self, bus: can.BusABC) -> None:
        try:
            while not self._closing.is_set():
                with contextlib.suppress(queue.Empty):
                    bus.send(self._outbox.get(timeout=RECEIVE_SLICE_S), timeout=RECEIVE_SLICE_S)
        except Exception as error:  # noqa: BLE001 - as in _read: a thread's end must become the link's
            self._fail(error, opened=True)
            self._closing.set()

    def _fail(self, error: Exception, *, opened: bool) -> None:
        if opened:
            self._tell(lose, self._lost, f"{type(error).__name__}: {error}")
        else:
            self._tell(_refuse, self._opened, cannot_open(self._settings, error))

    def _tell(self, call: Callable[..., None], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to be told
            self._loop.call_soon_threadsafe(call, *args)


def _settle(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _refuse(future: asyncio.Future[None], reason: str) -> None:
    if not future.done():
        future.set_exception(LinkError(reason))


def _raise_if_hung_up(bus: can.BusABC) -> None:
    """python-can's socketcand takes the end of the stream for silence and spins on it; ask the socket itself."""
    raw = getattr(bus, "_SocketCanDaemonBus__socket", None)
    if isinstance(raw, socket.socket):
        with contextlib.suppress(BlockingIOError):
            if not raw.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                raise ConnectionError("closed by the peer")
