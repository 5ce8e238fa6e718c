"""The transport to one CAN bus: opens it, reads it in batches, produces SYNC, opens it again when it is lost.

Rules of this package: python-can is met only here. Everything outside runs on the loop. Frames reach
`on_frames` in the order of reception, and every frame that came before a SYNC is handed on before `on_sync`
is called. Nothing here knows what a frame means.
"""

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import can

from trueangle.config import BusConfig
from trueangle.contract.errors import Fault
from trueangle.core.bus import backoff_s, next_sync
from trueangle.core.bus_health import ControllerState, Trouble, read_error_frame
from trueangle.core.health import ServiceBit
from trueangle.edges.can_bus.link import BusCounters, BusOpener, Frame, FrameHandler, Link, LinkOwner, lose
from trueangle.edges.can_bus.socketcan import SocketcanLink
from trueangle.edges.can_bus.threaded import ThreadedLink
from trueangle.errors import LinkError

__all__ = ["BusCounters", "CanBus", "Frame", "open_python_can"]

SYNC_COB_ID = 0x080
FIRST_BACKOFF_S, LIMIT_BACKOFF_S = 0.2, 5.0
STABLE_S = 10.0
"""A bus that held so long starts again with the shortest pause."""

_log = logging.getLogger(__name__)


class CanBus:
    """One CAN bus for as long as the daemon runs; `async with` opens it and keeps it open.

    `on_frames(batch)`, `on_bus_state(up, reason)` and `on_sync(stamp_ns)` are called on the loop's thread.
    Error, remote and extended frames are counted and not handed on. SYNC frames of another producer are part
    of `on_frames`; `on_sync` is called for each own SYNC that left, with the time just before.
    """

    def __init__(
        self,
        settings: BusConfig,
        *,
        on_frames: FrameHandler,
        on_bus_state: Callable[[bool, str], None],
        on_sync: Callable[[int], None] | None = None,
        opener: BusOpener | None = None,
    ) -> None:
        self.settings = settings
        self.counters = BusCounters()
        self._on_frames = on_frames
        self._on_bus_state = on_bus_state
        self._on_sync = on_sync
        self._opener = opener or open_python_can
        self._link: Link | None = None
        self._lost: asyncio.Future[str] | None = None
        """Ends the present opening of the bus."""
        self._sending = threading.Lock()
        self._tasks = asyncio.TaskGroup()
        self._life: asyncio.Task[None] | None = None
        self._reported: tuple[bool, str] | None = None
        self._cob_ids: frozenset[int] | None = None
        self._degraded, self._dropping = Trouble(), Trouble()
        self._drops_seen = 0

    async def __aenter__(self) -> Self:
        await self._tasks.__aenter__()
        self._life = self._tasks.create_task(self._live(), name=f"can-bus {self.settings.name}")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._life is not None:
            self._life.cancel()
        # The group needs to see its own cancellation of the body; the body's errors stay the body's.
        if isinstance(error, asyncio.CancelledError):
            await self._tasks.__aexit__(kind, error, trace)
        else:
            await self._tasks.__aexit__(None, None, None)

    def send(self, can_id: int, data: bytes) -> None:
        """Queue one frame; from any thread. LinkError where the bus is down or its queue full."""
        with self._sending:
            try:
                self._open_link().send(can_id, data)
            except LinkError:
                self.counters.send_failures += 1
                raise
            self.counters.sent += 1

    def listen_to(self, cob_ids: frozenset[int] | None) -> None:
        """Hand on frames of these COB-IDs only, so that foreign traffic costs little; None: all of them."""
        self._cob_ids = cob_ids
        if self._link is not None:
            self._link.listen_to(cob_ids)

    def service_bits(self, now_ns: int) -> ServiceBit:
        """What speaks against the bus although it is open; asked from time to time, logs beginning and end."""
        drops = self.counters.frames_dropped
        if drops != self._drops_seen:
            self._dropping.seen("frames were dropped unread", now_ns, count=drops - self._drops_seen)
            self._drops_seen = drops
        bits = ServiceBit(0)
        for trouble, bit in (
            (self._degraded, ServiceBit.BUS_DEGRADED),
            (self._dropping, ServiceBit.FRAMES_DROPPED),
        ):
            self._log_trouble(trouble, bit, now_ns)
            if trouble.stands:
                bits |= bit
        return bits

    def _log_trouble(self, trouble: Trouble, bit: ServiceBit, now_ns: int) -> None:
        change = trouble.change(now_ns)
        if change is None:
            return
        event = f"{(bit.name or '').lower()}_{'begins' if change.begins else 'ends'}"
        _log.log(
            logging.WARNING if change.begins else logging.INFO,
            "event=%s bus=%s reason=%r count=%d lasted_s=%.1f",
            event, self.settings.name, change.reason, change.count, change.lasted_s,
        )  # fmt: skip

    def _on_error_frame(self, error_class: int, data: bytes) -> None:
        """Counted by the link already."""
        told = read_error_frame(error_class, data)
        if told.state is ControllerState.BUS_OFF and self._lost is not None:
            lose(self._lost, "controller is bus-off: check wiring, termination and bit rate")
        elif told.state is ControllerState.ACTIVE:
            self._degraded.over()
        elif told.state is not None:
            self._degraded.seen(told.text, time.monotonic_ns())
        if told.lost_frames:
            # Nobody knows how many; one is enough to trust no node of the bus until it was asked again.
            self.counters.frames_dropped += 1

    def _open_link(self) -> Link:
        if self._link is None:
            raise LinkError(f"bus {self.settings.name}: down, nothing can be sent")
        return self._link

    async def _live(self) -> None:
        failures = 0
        while True:
            opened_s = time.monotonic()
            reason = await self._open_until_lost()
            failures = 1 if time.monotonic() - opened_s > STABLE_S else failures + 1
            self._report(False, reason)
            await asyncio.sleep(backoff_s(failures, FIRST_BACKOFF_S, LIMIT_BACKOFF_S))

    async def _open_until_lost(self) -> str:
        lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        link = self._new_link(lost)
        link.listen_to(self._cob_ids)
        self._lost = lost
        try:
            await link.open()
            self._link = link
            self.counters.times_opened += 1
            self._report(True, "open")
            async with asyncio.TaskGroup() as tasks:
                sync = tasks.create_task(self._produce_sync(link))
                reason = await lost
                sync.cancel()
        except LinkError as error:
            return str(error)
        finally:
            self._link = None
            await link.close()
        return f"bus {self.settings.name}: {reason}"

    def _new_link(self, lost: asyncio.Future[str]) -> Link:
        owner = LinkOwner(
            settings=self.settings,
            opener=self._opener,
            on_frames=self._on_frames,
            on_error_frame=self._on_error_frame,
            counters=self.counters,
            lost=lost,
        )
        return SocketcanLink(owner) if self.settings.interface == "socketcan" else ThreadedLink(owner)

    def _report(self, up: bool, reason: str) -> None:
        """Tell and log what changed; the same failure again is neither told nor logged."""
        if (up, reason) != self._reported:
            self._reported = (up, reason)
            _log.log(
                logging.INFO if up else logging.WARNING,
                "event=bus_%s bus=%s opened=%d reason=%r",
                "up" if up else "down",
                self.settings.name,
                self.counters.times_opened,
                reason,
            )
            self._on_bus_state(up, reason)

    async def _produce_sync(self, link: Link) -> None:
        """SYNC on an absolute schedule (CiA 301, 7.2.5; without the optional counter byte)."""
        if self.settings.sync_period_ms is None:
            return
        period_ns = round(self.settings.sync_period_ms * 1e6)
        deadline_ns = time.monotonic_ns() + period_ns
        while True:
            await asyncio.sleep((deadline_ns - time.monotonic_ns()) / 1e9)
            stamp_ns = time.monotonic_ns()
            link.hand_over()
            try:
                self.send(SYNC_COB_ID, b"")
            except LinkError:
                self.counters.sync_skipped += 1
            else:
                self.counters.sync_sent += 1
                # No answer can be handed on before this: both happen in one turn of the loop.
                if self._on_sync is not None:
                    self._on_sync(stamp_ns)
            step = next_sync(deadline_ns, period_ns, stamp_ns)
            self.counters.sync_skipped += step.skipped
            deadline_ns = step.deadline_ns


def bus_faults(settings: BusConfig, *, where: str) -> list[Fault]:
    """What no later attempt to open this bus could mend: an unknown interface, an impossible address."""
    if settings.interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        expected = f"an interface of python-can: {known}"
        return [Fault(where=f"{where}.interface", expected=expected, found=settings.interface)]
    if settings.interface != "socketcand":
        return []
    host, port = settings.options.get("host"), settings.options.get("port")
    if isinstance(host, str) and isinstance(port, int) and 0 < port < 65536:
        return []
    found = f"host {host!r}, port {port!r}"
    return [Fault(where=f"{where}.options", expected="host (a text) and port (1 to 65535)", found=found)]


def open_python_can(settings: BusConfig) -> can.BusABC:
    """Open the interface with exactly these settings: python-can's own configuration is ignored."""
    # It logs every attempt on an absent interface and every socketcand line that straddles two reads; what
    # ends a link is logged by CanBus.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    options = dict(settings.options)
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    if settings.interface == "socketcand":
        _expect_socketcand(str(options.get("host", "")), int(options.get("port", 0)))
        # Small frames wait for the peer's delayed acknowledgement (40 ms) unless TCP_NODELAY is set.
        options.setdefault("tcp_tune", True)
    return can.Bus(channel=settings.channel, interface=settings.interface, ignore_config=True, **options)  # pyright: ignore[reportArgumentType]


def _expect_socketcand(host: str, port: int) -> None:
    """OSError unless a socketcand greets there.

    python-can 4.6 tries a refused connection in a busy loop for 10 s, and waits without limit for a greeting.
    """
    with socket.create_connection((host, port), timeout=1.0) as probe:
        greeting = probe.recv(256)
    if not greeting.startswith(b"< hi >"):
        raise ConnectionError(f"{host}:{port} is no socketcand: greeted with {greeting[:40]!r}")
