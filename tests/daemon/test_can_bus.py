"""The CAN transport: python-can's virtual interface, scripted buses, SocketCAN frames through a socket pair."""

import asyncio
import errno
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Coroutine
from typing import Any, NoReturn

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueangle.config import BusConfig
from trueangle.core.bus import backoff_s, next_sync
from trueangle.core.health import ServiceBit
from trueangle.edges.can_bus import CanBus, Frame, open_python_can
from trueangle.edges.can_bus.link import BusCounters
from trueangle.edges.can_bus.threaded import INBOX_FRAMES, Inbox
from trueangle.errors import LinkError

LIMIT_S = 10.0
CAN_FRAME = struct.Struct("=IB3x8s")


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


# SYNC schedule and back-off, pure


@given(
    deadline_ns=st.integers(0, 10**15),
    period_ns=st.integers(500_000, 60 * 10**9),
    late_ns=st.integers(0, 10**12),
)
def test_sync_deadlines_stay_on_their_grid_and_ahead(deadline_ns: int, period_ns: int, late_ns: int) -> None:
    now_ns = deadline_ns + late_ns
    step = next_sync(deadline_ns, period_ns, now_ns)
    assert (step.deadline_ns - deadline_ns) % period_ns == 0
    assert now_ns < step.deadline_ns <= now_ns + period_ns
    assert step.skipped == (step.deadline_ns - deadline_ns) // period_ns - 1


def test_sync_lateness_does_not_add_up() -> None:
    """A thousand SYNC, each 0.9 ms late, end 1000 periods after the first deadline, not 0.9 s later."""
    deadline_ns = 0
    for _ in range(1000):
        step = next_sync(deadline_ns, 5_000_000, deadline_ns + 900_000)
        assert step.skipped == 0
        deadline_ns = step.deadline_ns
    assert deadline_ns == 1000 * 5_000_000


def test_backoff_doubles_up_to_its_limit() -> None:
    assert [backoff_s(n, 0.2, 5.0) for n in (1, 2, 3, 4, 5, 6, 7, 10_000)] == [
        0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0,
    ]  # fmt: skip


# The threaded link


def test_frames_arrive_in_order_with_data_and_a_monotonic_stamp() -> None:
    async def scenario() -> None:
        ear = Ear()
        before_ns = time.monotonic_ns()
        async with ear.bus(open_python_can, channel="in-order"):
            await ear.until_up()
            with can.Bus(interface="virtual", channel="in-order") as far:
                for i in range(50):
                    far.send(message(0x180 + i, bytes((i,))))
                await ear.until(lambda: len(ear.frames) == 50)
        assert [(can_id, data) for can_id, data, _ in ear.frames] == [(0x180 + i, bytes((i,))) for i in range(50)]
        stamps = [before_ns, *(stamp_ns for _, _, stamp_ns in ear.frames), time.monotonic_ns()]
        assert stamps == sorted(stamps)

    run(scenario)


def test_sent_frames_reach_the_bus() -> None:
    async def scenario() -> None:
        ear = Ear()
        bus = ScriptedBus([])
        async with ear.bus(lambda _: bus) as near:
            await ear.until_up()
            near.send(0x601, bytes(range(8)))
            near.send(0x000, b"\x01\x05")
            for _ in range(2):
                assert await asyncio.to_thread(bus.was_sent.acquire, timeout=LIMIT_S)
        assert [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in bus.sent] == [
            (0x601, bytes(range(8)), False),
            (0x000, b"\x01\x05", False),
        ]
        assert near.counters.sent == 2

    run(scenario)


def test_error_remote_and_extended_frames_are_counted_and_not_handed_on() -> None:
    async def scenario() -> None:
        ear = Ear()
        script = [
            message(0x185, is_error_frame=True),
            message(0x185, is_remote_frame=True),
            message(0x185, b"\x01", is_extended_id=True),
            message(0x185, b"\x02"),
        ]
        async with ear.bus(lambda _: ScriptedBus([*script])) as near:
            await ear.until(lambda: bool(ear.frames))
        assert [data for _, data, _ in ear.frames] == [b"\x02"]
        counters = near.counters
        assert (counters.error_frames, counters.remote_frames, counters.extended_frames) == (1, 1, 1)

    run(scenario)


def test_full_inbox_drops_the_oldest_frame_and_counts() -> None:
    async def scenario() -> None:
        taken: list[list[Frame]] = []
        counters = BusCounters()
        inbox = Inbox(asyncio.get_running_loop(), taken.append, counters)
        for i in range(INBOX_FRAMES + 3):
            inbox.put((0x181, b"", i))
        inbox.hand_over()
        assert counters.frames_dropped == 3
        assert [stamp for _, _, stamp in taken[0]] == list(range(3, INBOX_FRAMES + 3))

    asyncio.run(scenario())


def test_bus_that_cannot_open_is_reported_once_and_retried() -> None:
    async def scenario() -> None:
        ear = Ear()
        attempts: list[None] = []

        def opener(_: BusConfig) -> can.BusABC:
            attempts.append(None)
            if len(attempts) < 3:
                raise can.CanInitializationError("no such adapter")
            return ScriptedBus([])

        async with ear.bus(opener) as near:
            await asyncio.sleep(0)
            with pytest.raises(LinkError, match="down"):
                near.send(0x80, b"")
            await ear.until_up()
        assert [up for up, _ in ear.states] == [False, True]
        assert "no such adapter" in ear.states[0][1]
        assert "virtual channel x" in ear.states[0][1]
        assert near.counters.send_failures == 1

    run(scenario)


@pytest.mark.parametrize(
    "error", [can.CanOperationError("bus off"), OSError(errno.ENETDOWN, "down"), RuntimeError("vendor DLL")]
)
def test_reception_that_fails_in_service_is_reported_and_the_bus_opened_again(error: Exception) -> None:
    async def scenario() -> None:
        ear = Ear()
        scripts: list[list[can.Message | Exception | None]] = [[message(0x181), error], [message(0x182)]]
        async with ear.bus(lambda _: ScriptedBus(scripts.pop(0))):
            await ear.until(lambda: len(ear.frames) == 2)
        assert [up for up, _ in ear.states] == [True, False, True]
        assert str(error) in ear.states[1][1]

    run(scenario)


def test_sending_that_fails_is_reported_and_the_bus_opened_again() -> None:
    async def scenario() -> None:
        ear = Ear()
        buses = [ScriptedBus([], send_error=OSError(errno.EPIPE, "Broken pipe")), ScriptedBus([])]
        async with ear.bus(lambda _: buses.pop(0)) as near:
            await ear.until_up()
            near.send(0x601, bytes(8))
            await ear.until_up(times=2)
        assert "Broken pipe" in ear.states[1][1]

    run(scenario)


def test_frame_received_before_a_sync_is_handed_on_before_it() -> None:
    async def scenario() -> None:
        ear = Ear()
        buses: list[PairBus] = []

        def opener(_: BusConfig) -> can.BusABC:
            buses.append(PairBus())
            return buses[0]

        def on_sync(stamp_ns: int) -> None:
            original(stamp_ns)
            if len(ear.syncs) == 1:
                buses[0].put(0x181, b"")  # the answer waits in the socket ...
                time.sleep(0.002)  # ... and the process is late, so that the next SYNC is due before it is read

        original = ear.on_sync
        ear.on_sync = on_sync
        async with ear.bus(opener, interface="socketcan", sync_period_ms=0.5):
            await ear.until(lambda: len(ear.syncs) >= 2)
        assert ear.order[:3] == ["sync", "frame 181", "sync"]

    run(scenario)


def test_sync_is_sent_without_data_and_counted() -> None:
    async def scenario() -> None:
        ear = Ear()
        bus = ScriptedBus([])
        async with ear.bus(lambda _: bus, sync_period_ms=2.0) as near:
            await ear.until(lambda: len(ear.syncs) >= 5)
        assert {(m.arbitration_id, bytes(m.data)) for m in bus.sent} == {(0x080, b"")}
        assert near.counters.sync_sent == len(ear.syncs)
        assert ear.syncs == sorted(ear.syncs)

    run(scenario)


def test_sync_callback_that_fails_ends_the_owner() -> None:
    async def scenario() -> None:
        ear = Ear()

        def on_sync(stamp_ns: int) -> None:
            del stamp_ns
            raise ZeroDivisionError("owner's rule")

        ear.on_sync = on_sync
        with pytest.raises(ExceptionGroup) as caught:
            async with ear.bus(lambda _: ScriptedBus([]), sync_period_ms=1.0):
                await asyncio.Event().wait()
        assert caught.group_contains(ZeroDivisionError)

    run(scenario)


def test_owner_that_is_cancelled_leaves_no_thread() -> None:
    async def scenario() -> None:
        ear = Ear()

        async def own() -> None:
            async with ear.bus(lambda _: ScriptedBus([])):
                await asyncio.Event().wait()

        task = asyncio.create_task(own())
        await ear.until_up()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run(scenario)


# The socketcand interface of python-can and its traps


def test_refused_socketcand_is_told_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
    config = BusConfig(
        name="hub", interface="socketcand", channel="can0", options={"host": "127.0.0.1", "port": port}
    )
    with pytest.raises(ConnectionRefusedError):
        open_python_can(config)


def greet(server: socket.socket, greeting: bytes) -> None:
    client, _ = server.accept()
    with client:
        client.sendall(greeting)


def test_server_that_is_no_socketcand_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        answer = threading.Thread(target=greet, args=(server, b"220 mail ready\r\n"))
        answer.start()
        config = BusConfig(
            name="hub", interface="socketcand", channel="can0", options={"host": "127.0.0.1", "port": port}
        )
        with pytest.raises(ConnectionError, match="no socketcand"):
            open_python_can(config)
        answer.join()


def serve_socketcand(server: socket.socket, received: list[bytes]) -> None:
    """Greets a probe, takes one client into raw mode, and answers its first frame by a frame and hanging up."""
    greet(server, b"< hi >")
    client, _ = server.accept()
    with client:
        client.sendall(b"< hi >")
        for answer in (b"< ok >", b"< ok >"):
            client.recv(256)
            client.sendall(answer)
        received.append(client.recv(256))
        client.sendall(b"< frame 185 1.000001 0102FF >< frame 080 1.000002  >")


def test_socketcand_that_hangs_up_is_noticed_without_sending() -> None:
    async def scenario() -> None:
        ear = Ear()
        with socket.create_server(("127.0.0.1", 0)) as server:
            port: int = server.getsockname()[1]
            received: list[bytes] = []
            thread = threading.Thread(target=serve_socketcand, args=(server, received))
            thread.start()
            options = {"host": "127.0.0.1", "port": port}
            async with ear.bus(open_python_can, interface="socketcand", channel="can0", options=options) as near:
                await ear.until_up()
                near.send(0x605, b"\x40\x00\x10")
                await ear.until(lambda: any(not up for up, _ in ear.states))
            thread.join()
        assert received == [b"< send 605 3 40 0 10 >"]
        assert [(can_id, data) for can_id, data, _ in ear.frames] == [(0x185, b"\x01\x02\xff"), (0x080, b"")]
        assert "closed by the peer" in ear.states[1][1]

    run(scenario)


# SocketCAN


def socketcan_ear(**settings: Any) -> tuple[Ear, list[PairBus], CanBus]:
    ear, buses = Ear(), list[PairBus]()

    def opener(_: BusConfig) -> can.BusABC:
        buses.append(PairBus())
        return buses[-1]

    return ear, buses, ear.bus(opener, interface="socketcan", channel="can0", **settings)


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
    assert "event=bus_degraded_ends reason='error-passive' count=100" in told[1]


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


def test_foreign_frames_are_kept_out_of_the_threads_hand_over_too() -> None:
    async def scenario() -> None:
        ear = Ear()
        script: list[can.Message | Exception | None] = [message(0x300), message(0x185, b"\x01")]
        near = ear.bus(lambda _: ScriptedBus(script))
        near.listen_to(frozenset({0x185}))
        async with near:
            await ear.until(lambda: bool(ear.frames))
        assert [can_id for can_id, _, _ in ear.frames] == [0x185]
        assert near.counters.foreign_frames == 1

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


def test_socketcand_error_frames_tell_their_class() -> None:
    """`< error CLASS TIME >` becomes a message whose id is the class; details are not sent."""

    async def scenario() -> None:
        ear = Ear()
        script: list[can.Message | Exception | None] = [
            message(0x004, is_error_frame=True, is_extended_id=True),
            message(0x185, b"\x01"),
            message(0x040, is_error_frame=True, is_extended_id=True),
        ]
        scripts = [script, []]
        near = ear.bus(lambda _: ScriptedBus(scripts.pop(0)), interface="socketcand")
        async with near:
            await ear.until_up(times=2)
        assert near.service_bits(time.monotonic_ns()) == ServiceBit.BUS_DEGRADED
        assert "bus-off" in ear.states[1][1]

    run(scenario)
