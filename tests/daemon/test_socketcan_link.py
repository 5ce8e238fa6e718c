"""The SocketCAN link: frames in bursts, what the kernel tells and is asked for, errors, the way back."""

import asyncio
import errno
import os
import socket
import struct
import time
from typing import Any, NoReturn

import can
import pytest
from tests.fakes.can_bus_ear import CAN_FRAME, Ear, PairBus, run, socketcan_ear

from trueangle.config import BusConfig
from trueangle.core.health import ServiceBit
from trueangle.edges.can_bus import CanBus, Frame
from trueangle.edges.can_bus.socketcan import RECEIVE_BUFFER_BYTES
from trueangle.errors import LinkError

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


# Frames, flags, errors


def test_socketcan_burst_is_one_batch_with_exact_lengths() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            for length in range(9):
                buses[0].put(0x180 + length, bytes(range(length)))
            await ear.until(lambda: len(ear.frames) == 9)
        assert [(can_id, data) for can_id, data, _ in ear.frames] == [
            (0x180 + n, bytes(range(n))) for n in range(9)
        ]
        assert ear.batches == [9]

    run(scenario)


def test_socketcan_flags_are_counted_and_bus_off_reopens() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            buses[0].put(0x185 | 0x80000000, b"\x01")
            buses[0].put(0x185 | 0x40000000, b"")
            buses[0].far.send(b"short")
            buses[0].put(0x185, b"\x02")
            await ear.until(lambda: len(ear.frames) == 1)
            buses[0].put(0x20000040, bytes(8))
            await ear.until_up(times=2)
        assert ear.frames[0][1] == b"\x02"
        counters = near.counters
        assert (counters.extended_frames, counters.remote_frames, counters.error_frames) == (1, 1, 2)
        assert "bus-off" in ear.states[1][1]

    run(scenario)


def test_socketcan_sends_a_can_frame() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            near.send(0x605, b"\x40\x00\x10")
            assert CAN_FRAME.unpack(buses[0].far.recv(64)) == (0x605, 3, b"\x40\x00\x10\0\0\0\0\0")

    run(scenario)


def test_socketcan_whose_queue_stays_full_is_opened_again() -> None:
    async def scenario() -> None:
        ear, _, near = socketcan_ear()
        async with near:
            await ear.until_up()
            refused = 0
            while refused < 50:
                try:
                    near.send(0x605, bytes(8))
                except LinkError:
                    refused += 1
            await ear.until_up(times=2)
        assert near.counters.send_failures == 50
        assert "cannot send" in ear.states[1][1]

    run(scenario)


def test_socketcan_peer_that_goes_away_is_a_lost_bus() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            buses[0].far.close()
            await ear.until(lambda: len(ear.states) >= 2)
        assert not ear.states[1][0]

    run(scenario)


def test_socketcan_error_passive_shows_until_the_controller_is_well_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            for _ in range(100):
                buses[0].put(0x20000004, b"\0\x20\0\0\0\0\0\0")
            buses[0].put(0x185, b"\x01")
            await ear.until(lambda: len(ear.frames) == 1)
            now_ns = time.monotonic_ns()
            assert near.service_bits(now_ns) == ServiceBit.BUS_DEGRADED
            assert near.service_bits(now_ns) == ServiceBit.BUS_DEGRADED
            buses[0].put(0x20000004, b"\0\x40\0\0\0\0\0\0")
            buses[0].put(0x185, b"\x02")
            await ear.until(lambda: len(ear.frames) == 2)
            assert near.service_bits(now_ns) == ServiceBit(0)
        assert [up for up, _ in ear.states] == [True]  # degraded is not down

    with caplog.at_level("INFO", logger="trueangle"):
        run(scenario)
    told = [m for m in caplog.messages if "bus_degraded" in m]
    assert len(told) == 2
    assert "event=bus_degraded_ends bus=test reason='error-passive' count=100" in told[1]


def test_overrun_of_the_controller_counts_as_dropped_before_the_frames_behind_it() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        dropped_at_frame: list[int] = []
        original = ear.on_frames

        def on_frames(frames: list[Frame]) -> None:
            dropped_at_frame.append(near.counters.frames_dropped)
            original(frames)

        near._on_frames = on_frames
        async with near:
            await ear.until_up()
            buses[0].put(0x20000004, b"\0\x01\0\0\0\0\0\0")
            buses[0].put(0x185, b"\x01")
            await ear.until(lambda: len(ear.frames) == 1)
            assert near.service_bits(time.monotonic_ns()) == ServiceBit.FRAMES_DROPPED
        assert dropped_at_frame == [1]

    run(scenario)


def test_foreign_frames_are_kept_out_and_counted() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        near.listen_to(frozenset({0x185, 0x705}))
        async with near:
            await ear.until_up()
            for i in range(100):
                buses[0].put(0x200 + i, bytes(8))
            buses[0].put(0x185, b"\x01")
            await ear.until(lambda: bool(ear.frames))
            near.listen_to(None)
            buses[0].put(0x200, b"\x02")
            await ear.until(lambda: len(ear.frames) == 2)
        assert [data for _, data, _ in ear.frames] == [b"\x01", b"\x02"]
        assert near.counters.foreign_frames == 100

    run(scenario)


def test_kernel_is_given_the_filter_of_the_known_ids() -> None:
    """struct can_filter of linux/can.h: id, mask; the mask keeps extended and remote frames out."""
    given: dict[tuple[int, int], bytes] = {}

    class Recording(socket.socket):
        def setsockopt(self, level: int, option: int, value: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
            given[level, option] = value

    class Opened(PairBus):
        def __init__(self) -> None:
            super().__init__()
            plain = self.socket
            self.socket = Recording(plain.family, plain.type, plain.proto, plain.detach())

    async def scenario() -> None:
        ear = Ear()
        bus = ear.bus(lambda _: Opened(), interface="socketcan")
        bus.listen_to(frozenset({0x185, 0x081}))
        async with bus:
            await ear.until_up()

    run(scenario)
    assert given[101, 1] == struct.pack("=IIII", 0x081, 0xC00007FF, 0x185, 0xC00007FF)
    assert given[101, 2] == struct.pack("=I", 0x1FFFFFFF)


@pytest.mark.parametrize("number", [errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EIO])
def test_interface_that_goes_down_or_is_removed_is_opened_again(number: int) -> None:
    class Failing(PairBus):
        def __init__(self) -> None:
            super().__init__()
            self.socket.close()
            self.socket = FailingSocket(self.far.family, self.far.type)

    class FailingSocket(socket.socket):
        def recv(self, size: int, flags: int = 0) -> bytes:
            raise OSError(number, os.strerror(number))

        def recvmsg(self, *sizes: int) -> NoReturn:
            raise OSError(number, os.strerror(number))

    async def scenario() -> None:
        ear = Ear()
        buses: list[PairBus] = [Failing(), PairBus()]
        near = ear.bus(lambda _: buses.pop(0), interface="socketcan")
        async with near:
            await ear.until_up()
            assert near._link is not None
            near._link.hand_over()  # what readiness of the socket would call
            await ear.until_up(times=2)
        assert [up for up, _ in ear.states] == [True, False, True]
        assert os.strerror(number) in ear.states[1][1]

    run(scenario)


def test_sync_that_cannot_leave_is_not_announced() -> None:
    """Else the pipeline would wait for answers to a SYNC that no node saw, and not tell that SYNC is lost."""

    async def scenario() -> None:
        ear, buses, near = socketcan_ear(sync_period_ms=1.0)
        async with near:
            await ear.until(lambda: near.counters.sync_skipped > 3)  # nobody reads: the buffer fills
            announced = len(ear.syncs)
            assert announced == near.counters.sync_sent
            del buses

    run(scenario)
