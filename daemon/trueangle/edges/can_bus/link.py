"""What the two kinds of link have in common: the frames they hand on, what they count, how they end."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import can

from trueangle.config import BusConfig

Frame = tuple[int, bytes, int]
"""COB-ID (11 bit), data (0 .. 8 bytes), time of reception (time.monotonic_ns)."""
FrameHandler = Callable[[list[Frame]], None]
BusOpener = Callable[[BusConfig], can.BusABC]

COALESCE_S = 0.001
"""A wake-up of the loop costs more than a frame: gather for 1 ms, then take all. Bounds the added age."""


@dataclass(slots=True)
class BusCounters:
    """What happened on a bus since the start. One thread writes a field, or a lock is held (what is sent)."""

    frames: int = 0
    frames_dropped: int = 0
    """Received, but the loop was too late: oldest first."""
    error_frames: int = 0
    remote_frames: int = 0
    extended_frames: int = 0
    foreign_frames: int = 0
    """Of COB-IDs that nobody here listens to; those that the kernel's filter holds back are not counted."""
    sent: int = 0
    send_failures: int = 0
    sync_sent: int = 0
    sync_skipped: int = 0
    """Periods without a SYNC: the process was late, or the frame could not be queued."""
    times_opened: int = 0


ErrorHandler = Callable[[int, bytes], None]
"""Takes an error frame on the loop: its class (the CAN id without flags) and its data."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOwner:
    """What a link needs of the bus that opens it."""

    settings: BusConfig
    opener: BusOpener
    on_frames: FrameHandler
    on_error_frame: ErrorHandler
    counters: BusCounters
    lost: asyncio.Future[str]
    """Set by the link with the reason for its end."""


class Link(Protocol):
    """One opening of the bus, from `open` to `close`."""

    def listen_to(self, cob_ids: frozenset[int] | None) -> None: ...
    async def open(self) -> None: ...
    def send(self, can_id: int, data: bytes) -> None: ...
    def hand_over(self) -> None: ...
    async def close(self) -> None: ...


def lose(lost: asyncio.Future[str], reason: str) -> None:
    if not lost.done():
        lost.set_result(reason)


def cannot_open(settings: BusConfig, error: Exception) -> str:
    return (
        f"bus {settings.name}: cannot open {settings.interface} channel {settings.channel}: "
        f"{type(error).__name__}: {error}"
    )
