"""Frames that a real kernel socket drops: counted before those behind them are handed on, served and logged.

A UDP socket on loopback stands for the raw CAN socket: both drop what finds the receive buffer full, and count it
in the same place. A pair of Unix sockets would block its sender instead.
"""

import asyncio
import socket
import struct
import time

import can
import pytest

from trueangle.config import BusConfig
from trueangle.core.health import ServiceBit
from trueangle.edges.can_bus import CanBus, Frame

LIMIT_S = 10.0
CAN_FRAME = struct.Struct("=IB3x8s")
SENT = 20_000
"""Many times what the buffer takes."""


class UdpBus(can.BusABC):
    """Stands for python-can's SocketcanBus."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.far.connect(self.socket.getsockname())
        super().__init__("udp")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("the daemon writes SocketCAN frames itself")

    def put(self, number: int) -> None:
        self.far.send(CAN_FRAME.pack(0x181, 4, struct.pack("<I4x", number)))

    def shutdown(self) -> None:
        super().shutdown()
        self.socket.close()
        self.far.close()


def test_frames_that_the_kernel_drops_are_counted_to_the_last_one_and_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    taken: list[Frame] = []
    dropped_at_batch: list[int] = []

    async def scenario() -> None:
        up, news = asyncio.Event(), asyncio.Event()
        bus = UdpBus()

        def on_frames(frames: list[Frame]) -> None:
            dropped_at_batch.append(near.counters.frames_dropped)
            taken.extend(frames)
            news.set()

        near = CanBus(
            BusConfig(name="test", interface="socketcan", channel="x"),
            on_frames=on_frames,
            on_bus_state=lambda now_up, _: up.set() if now_up else up.clear(),
            opener=lambda _: bus,
        )
        async with asyncio.timeout(LIMIT_S), near:
            await up.wait()
            assert near.service_bits(time.monotonic_ns()) == ServiceBit(0)
            for number in range(SENT):  # the loop stands still meanwhile
                bus.put(number)
            while near.counters.frames + near.counters.frames_dropped < SENT:
                news.clear()
                await news.wait()
            assert near.service_bits(time.monotonic_ns()) == ServiceBit.FRAMES_DROPPED
            # The oldest are kept: what is read is the truth, as far as it goes.
            assert [struct.unpack("<I", data)[0] for _, data, _ in taken] == list(range(len(taken)))
            assert near.counters.frames + near.counters.frames_dropped == SENT
            bus.put(SENT)
            while len(taken) < near.counters.frames or taken[-1][1] != struct.pack("<I", SENT):
                news.clear()
                await news.wait()
            assert near.counters.frames + near.counters.frames_dropped == SENT + 1

    with caplog.at_level("INFO", logger="trueangle"):
        asyncio.run(scenario())
    assert dropped_at_batch[0] > 0, "the frames before the gap were handed on before the gap was known"
    assert any(m.startswith("event=frames_dropped_begins bus=test ") for m in caplog.messages), caplog.messages
    assert any(m.startswith("event=bus_up bus=test opened=1 ") for m in caplog.messages)
