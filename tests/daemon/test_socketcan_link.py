"""What the SocketCAN link owes to the kernel: its drops, its buffer, its pending error, its bursts."""

import asyncio
import errno
import os
import socket
import struct
from typing import Any

import can
import pytest
from tests.fakes.can_bus_ear import Ear, PairBus, run, socketcan_ear

from trueangle.config import BusConfig
from trueangle.edges.can_bus import CanBus, Frame
from trueangle.edges.can_bus.socketcan import RECEIVE_BUFFER_BYTES

SO_MEMINFO, MEMINFO_WORDS, DROPS_WORD = 55, 9, 8
"""asm-generic/socket.h; linux/sock_diag.h: SK_MEMINFO_DROPS is the ninth UNSIGNED32."""


class KernelSocket(socket.socket):
    """One whose kernel says what the test wants it to say."""

    drops = 0
    pending = 0
    asked: dict[tuple[int, int], Any]

    def setsockopt(self, level: int, option: int, value: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        self.asked[level, option] = value

    def getsockopt(self, level: int, option: int, size: int = 0) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        if option == SO_MEMINFO:
            words = [0] * MEMINFO_WORDS
            words[DROPS_WORD] = self.drops
            return struct.pack(f"={MEMINFO_WORDS}I", *words)[:size]
        if option == socket.SO_ERROR:
            pending, self.pending = self.pending, 0
            return pending
        return super().getsockopt(level, option)


class KernelBus(PairBus):
    def __init__(self, pending: int = 0) -> None:
        super().__init__()
        plain = self.socket
        self.kernel = KernelSocket(plain.family, plain.type, plain.proto, plain.detach())
        self.kernel.asked, self.kernel.pending = {}, pending
        self.socket = self.kernel


def kernel_ear(*buses: KernelBus) -> tuple[Ear, CanBus]:
    ear, opened = Ear(), list(buses)

    def opener(_: BusConfig) -> can.BusABC:
        return opened.pop(0)

    return ear, ear.bus(opener, interface="socketcan", channel="can0")


def test_frames_that_the_kernel_dropped_are_counted_before_the_frames_behind_them() -> None:
    """Whoever gets the batch must know that a boot-up message may be missing in it."""

    async def scenario() -> None:
        bus = KernelBus()
        ear, near = kernel_ear(bus)
        dropped_at_frame: list[int] = []
        original = ear.on_frames

        def on_frames(frames: list[Frame]) -> None:
            dropped_at_frame.append(near.counters.frames_dropped)
            original(frames)

        near._on_frames = on_frames
        async with near:
            await ear.until_up()
            for drops in (0, 7, 7, 12):  # since the socket was opened
                bus.kernel.drops = drops
                bus.put(0x185, b"")
                seen = len(ear.frames)
                await ear.until(lambda seen=seen: len(ear.frames) > seen)
        assert dropped_at_frame == [0, 7, 7, 12]

    run(scenario)


def test_drops_of_an_opening_before_are_not_taken_back() -> None:
    """A new socket counts from 0 again."""

    async def scenario() -> None:
        first, second = KernelBus(), KernelBus()
        first.kernel.drops, second.kernel.drops = 7, 2
        ear, near = kernel_ear(first, second)
        async with near:
            await ear.until_up()
            first.put(0x185, b"")
            await ear.until(lambda: len(ear.frames) == 1)
            first.far.close()
            await ear.until_up(times=2)
            second.put(0x185, b"")
            await ear.until(lambda: len(ear.frames) == 2)
        assert near.counters.frames_dropped == 9

    run(scenario)


def test_the_kernel_is_asked_for_room_for_a_burst() -> None:
    async def scenario() -> None:
        bus = KernelBus()
        ear, near = kernel_ear(bus)
        async with near:
            await ear.until_up()
        assert bus.kernel.asked[socket.SOL_SOCKET, socket.SO_RCVBUF] == RECEIVE_BUFFER_BYTES

    run(scenario)


def test_an_interface_that_is_down_is_no_open_bus() -> None:
    """Binding to it succeeds; only the error that waits in the socket tells."""

    async def scenario() -> None:
        ear, near = kernel_ear(KernelBus(pending=errno.ENETDOWN), KernelBus())
        async with near:
            await ear.until_up()
        assert [up for up, _ in ear.states] == [False, True]
        assert os.strerror(errno.ENETDOWN) in ear.states[0][1]
        assert near.counters.times_opened == 1

    run(scenario)


def test_frames_of_one_coalescing_time_are_one_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wake-up for each frame costs three times as much: frames that come while one waits go with it."""
    monkeypatch.setattr("trueangle.edges.can_bus.socketcan.COALESCE_S", 0.2)

    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            for counts in range(5):
                buses[0].put(0x185, bytes((counts,)))
                for _ in range(3):  # turns of the loop, in which the socket is ready
                    await asyncio.sleep(0)
            await ear.until(lambda: len(ear.frames) == 5)
        assert ear.batches == [5]

    run(scenario)


def test_a_babbling_bus_holds_up_the_loop_for_one_drain_and_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueangle.edges.can_bus.socketcan.MAX_DRAIN_FRAMES", 4)

    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            for counts in range(10):
                buses[0].put(0x185, bytes((counts,)))
            await ear.until(lambda: len(ear.frames) == 10)
        assert ear.batches == [4, 4, 2]
        assert [data[0] for _, data, _ in ear.frames] == list(range(10))

    run(scenario)
