"""Python-can buses made of scripts and socket pairs, and an ear that collects what a `CanBus` tells of them."""

import asyncio
import socket
import struct
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import can

from trueangle.config import BusConfig
from trueangle.edges.can_bus import CanBus, Frame

LIMIT_S = 10.0
CAN_FRAME = struct.Struct("=IB3x8s")
"""struct can_frame of linux/can.h."""


class Ear:
    """Collects what a bus tells, and wakes the test at each piece of news."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.batches: list[int] = []
        self.states: list[tuple[bool, str]] = []
        self.syncs: list[int] = []
        self.order: list[str] = []
        self._news = asyncio.Event()

    def bus(self, opener: Callable[[BusConfig], can.BusABC], **settings: Any) -> CanBus:
        defaults: dict[str, Any] = {"name": "test", "interface": "virtual", "channel": "x"}
        config = BusConfig(**(defaults | settings))
        return CanBus(
            config,
            on_frames=self.on_frames,
            on_bus_state=self.on_bus_state,
            on_sync=self.on_sync,
            opener=opener,
        )

    def on_frames(self, frames: list[Frame]) -> None:
        self.frames += frames
        self.batches.append(len(frames))
        self.order += [f"frame {can_id:03X}" for can_id, _, _ in frames]
        self._news.set()

    def on_bus_state(self, up: bool, reason: str) -> None:
        self.states.append((up, reason))
        self._news.set()

    def on_sync(self, stamp_ns: int) -> None:
        self.syncs.append(stamp_ns)
        self.order.append("sync")
        self._news.set()

    async def until(self, true: Callable[[], bool]) -> None:
        async with asyncio.timeout(LIMIT_S):
            while not true():
                await self._news.wait()
                self._news.clear()

    async def until_up(self, times: int = 1) -> None:
        await self.until(lambda: sum(up for up, _ in self.states) >= times)


class ScriptedBus(can.BusABC):
    """A python-can bus whose reception follows a script: messages, None for silence, errors to raise."""

    def __init__(self, script: list[can.Message | Exception | None], send_error: Exception | None = None) -> None:
        self._script = script
        self._send_error = send_error
        self.sent: list[can.Message] = []
        self.was_sent = threading.Semaphore(0)
        self.closed = threading.Event()
        super().__init__("scripted")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._script:
            self.closed.wait(timeout)
            return None, True
        step = self._script.pop(0)
        if isinstance(step, Exception):
            raise step
        return step, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._send_error is not None:
            raise self._send_error
        self.sent.append(msg)
        self.was_sent.release()

    def shutdown(self) -> None:
        super().shutdown()
        self.closed.set()


class PairBus(can.BusABC):
    """Stands for python-can's SocketcanBus: `socket` is one end of a datagram pair that carries can_frames."""

    def __init__(self) -> None:
        self.socket, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        super().__init__("pair")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("the daemon writes SocketCAN frames itself")

    def put(self, can_id: int, data: bytes) -> None:
        self.far.send(CAN_FRAME.pack(can_id, len(data), data))

    def shutdown(self) -> None:
        super().shutdown()
        self.socket.close()
        self.far.close()


def run(scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(scenario())
    assert not [t.name for t in threading.enumerate() if t.name.startswith("can-")]


def message(can_id: int, data: bytes = b"", **flags: Any) -> can.Message:
    return can.Message(**{"arbitration_id": can_id, "data": data, "is_extended_id": False} | flags)


def socketcan_ear(**settings: Any) -> tuple[Ear, list[PairBus], CanBus]:
    ear, buses = Ear(), list[PairBus]()

    def opener(_: BusConfig) -> can.BusABC:
        buses.append(PairBus())
        return buses[-1]

    return ear, buses, ear.bus(opener, interface="socketcan", channel="can0", **settings)
