"""The running daemon's own life: buses that fail, a port that is taken, what systemd is told, the orderly stop.

Notifications are read from a real datagram socket, as systemd reads them.
"""

import asyncio
import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request
from tests.fakes.running_service import (
    GOOD,
    LIMIT_S,
    MARKER,
    Rig,
    config_yaml,
    joint_yaml,
    on_virtual_bus,
    on_wire,
    raw_mas,
    started,
)
from tests.fakes.systemd_manager import Manager

from trueangle.core.health import StatusBit
from trueangle.core.pipeline import Pipeline
from trueangle.edges.systemd import ServiceNotifier
from trueangle.errors import LinkError

BASE, ELBOW = joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx")
ONE, TWO = config_yaml(BASE), config_yaml(BASE, ELBOW)
BUS_DOWN_SERVICE = 1 << 1
Serve = Callable[..., AbstractAsyncContextManager[Rig]]


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(tmp_path / "notify")
    yield made
    made.socket.close()


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


def node(node_id: int = 1) -> EncoderNode:
    made = EncoderNode(node_id, lambda _id, _data: None)
    made.counts = lambda _: 1_234_567
    return made


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> Serve:
    """Gives a running service on a wire with nodes; `environment` as systemd sets it."""

    @asynccontextmanager
    async def within(
        config: str, *nodes: EncoderNode, wire: CanWire | None = None, environment: dict[str, str] | None = None
    ) -> AsyncIterator[Rig]:
        async with on_wire(monkeypatch, wire or CanWire(), *nodes), started(config, caplog, environment) as r:
            yield r

    return within


# The bus


def test_a_bus_that_cannot_open_is_reported_and_the_service_is_ready_all_the_same(
    caplog: pytest.LogCaptureFixture, manager: Manager
) -> None:
    """With python-can's own SocketCAN, on an interface that no machine has."""

    async def scenario() -> None:
        config = config_yaml(BASE, channel="nosuchcan0")
        async with started(config, caplog, manager.environment) as r:
            await r.until_told(lambda: manager.heard("READY=1"))
            read = await r.until(1, lambda read: StatusBit.BUS_DOWN in read.status)
            assert (read.corrected_mas, read.raw_mas) == (MARKER, MARKER)
            assert await r.service_status() == BUS_DOWN_SERVICE
        assert "0 of 1 joints valid; base: " in manager.ready()
        assert "bus_down" in manager.ready()
        assert "cannot open socketcan channel nosuchcan0" in caplog.text

    asyncio.run(scenario())


def test_a_bus_that_appears_later_is_opened_and_served(serve: Serve) -> None:
    wire = CanWire()
    wire.absent = True

    async def scenario() -> None:
        async with serve(ONE, node(), wire=wire) as r:
            await r.until(1, lambda read: StatusBit.BUS_DOWN in read.status)
            wire.absent = False
            await r.until_status(1, StatusBit.VALID)
            assert await r.service_status() == 1

    asyncio.run(scenario())


def test_a_bus_that_is_lost_takes_its_joints_out_and_comes_back(serve: Serve) -> None:
    wire = CanWire()

    async def scenario() -> None:
        async with serve(ONE, node(), wire=wire) as r:
            await r.until_status(1, StatusBit.VALID)
            wire.absent = True
            wire.cut()
            read = await r.until(1, lambda read: StatusBit.BUS_DOWN in read.status)
            assert read.raw_mas == MARKER
            wire.absent = False
            await r.until_status(1, StatusBit.VALID)

    asyncio.run(scenario())


def test_equal_nodes_on_two_buses_are_told_apart_and_one_bus_may_fail(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wires = {"arm": CanWire(), "leg": CanWire()}
    angles_counts = {"arm": 1_000_000, "leg": 2_000_000}
    for name, wire in wires.items():
        device = EncoderNode(1, wire.send, counts=lambda _, name=name: angles_counts[name])
        wire.nodes.append(device)
    monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", lambda s: wires[s.name].open(s))
    second = (
        joint_yaml(2, "knee", model="twin.onnx")
        .replace("bus: arm", "bus: leg")
        .replace("node_id: 2", "node_id: 1")
    )
    config = config_yaml(BASE, second).replace(
        "buses: [", "buses: [{name: leg, interface: socketcan, channel: w2, sync_period_ms: 10}, "
    )

    async def scenario() -> None:
        async with started(config, caplog) as r:
            for slot, name in ((1, "arm"), (2, "leg")):
                read = await r.until_status(slot, StatusBit.VALID)
                assert read.raw_mas == raw_mas(angles_counts[name])
            wires["arm"].absent = True
            wires["arm"].cut()
            await r.until(1, lambda read: StatusBit.BUS_DOWN in read.status)
            read = await r.fast(2)
            assert (read.status, read.raw_mas) == (GOOD, raw_mas(angles_counts["leg"]))
            assert await r.service_status() == BUS_DOWN_SERVICE
        wires["leg"].cut()

    asyncio.run(scenario())


def test_a_port_that_is_taken_ends_the_service_with_the_address_and_advice(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        with socket.create_server(("127.0.0.1", 0)) as holder:
            port = holder.getsockname()[1]
            with pytest.raises(LinkError, match=f"expected to bind 127.0.0.1:{port}, got .*; try another"):
                async with started(config_yaml(BASE, port=port), caplog):
                    raise AssertionError("a service that cannot be read")

    asyncio.run(scenario())


# What systemd is told


def test_ready_comes_when_every_joint_is_served(serve: Serve, manager: Manager) -> None:
    async def scenario() -> None:
        async with serve(TWO, node(1), node(2), environment=manager.environment) as r:
            await r.until_told(lambda: manager.heard("READY=1"))
            # The text is of the moment of READY: sent earlier, it would count fewer.
            assert manager.ready() == "READY=1\nSTATUS=2 of 2 joints valid"
            for slot in (1, 2):
                assert (await r.fast(slot)).status == GOOD

    asyncio.run(scenario())


def test_ready_waits_for_a_silent_node_until_it_is_reported_lost(
    serve: Serve, manager: Manager, caplog: pytest.LogCaptureFixture
) -> None:
    deaf = node(2)
    deaf.deaf = True

    async def scenario() -> None:
        async with serve(TWO, node(1), deaf, environment=manager.environment) as r:
            await r.until_told(lambda: manager.heard("READY=1"))
            assert "READY=1\nSTATUS=1 of 2 joints valid; elbow: " in manager.ready()
            assert "node_not_ready" in manager.ready()
        order = [
            m for m in caplog.messages if "event=ready" in m or ("event=node_lost " in m and "node_id=2 " in m)
        ]
        assert "event=node_lost " in order[0]
        assert "event=ready" in order[1]

    asyncio.run(scenario())


def test_ready_does_not_wait_for_ever_for_a_node_without_temperature(serve: Serve, manager: Manager) -> None:
    cold = node()
    cold.sends_temperature = False

    async def scenario() -> None:
        async with serve(ONE, cold, environment=manager.environment) as r:
            await r.until_told(lambda: manager.heard("READY=1"))
            assert manager.ready() == "READY=1\nSTATUS=0 of 1 joints valid; base: temperature_stale"

    asyncio.run(scenario())


def test_the_watchdog_is_fed_only_after_ready_and_while_images_are_published(
    serve: Serve, manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        async with serve(ONE, node(), environment=manager.environment) as r:
            await r.until_told(lambda: manager.read().count("WATCHDOG=1") >= 3)
            first = [message.split("=")[0] for message in manager.told if not message.startswith("STATUS")]
            assert first[0] == "READY"
            # The pipeline stands still; loop, bus and Modbus go on.
            monkeypatch.setattr(Pipeline, "_serve", lambda _self, _now_ns: None)
            stuck = len(manager.read())
            await r.until_told(lambda: sum(m.startswith("STATUS") for m in manager.read()[stuck:]) >= 2)
            assert "WATCHDOG=1" not in manager.told[stuck:]

    asyncio.run(scenario())


def test_an_image_of_a_pipeline_that_stands_still_is_soon_served_no_more(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without systemd nobody would end such a process: its last angle must not stay valid for ever.

    Nor until a wall clock that was set back has caught up.
    """

    async def scenario() -> None:
        async with serve(ONE, node()) as r:
            await r.until_status(1, StatusBit.VALID)
            monkeypatch.setattr(time, "time", lambda: 0.0)
            monkeypatch.setattr(time, "time_ns", lambda: 0)
            monkeypatch.setattr(Pipeline, "_serve", lambda _self, _now_ns: None)
            async with asyncio.timeout(LIMIT_S):
                while (answer := await r.plc.ask(read_request(4, 10, 12)))[7] == 4:
                    pass
            assert answer[7:] == b"\x84\x06"  # server device busy

    asyncio.run(scenario())


def test_a_pipeline_that_raises_ends_the_service_and_the_feeding(
    serve: Serve, manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The supervisor starts it again; staying up without a pipeline would serve the last image for ever."""

    def broken(_self: Pipeline, _now_ns: int) -> None:
        raise ZeroDivisionError("planted")

    async def scenario() -> None:
        with pytest.raises((ZeroDivisionError, ExceptionGroup)):  # noqa: PT012 - the service ends within
            async with serve(ONE, node(), environment=manager.environment) as r:
                await r.until_status(1, StatusBit.VALID)
                await r.until_told(lambda: manager.heard("WATCHDOG=1"))
                monkeypatch.setattr(Pipeline, "_serve", broken)
                before = len(manager.read())
                async with asyncio.timeout(LIMIT_S):
                    await asyncio.wait([r.task])
                assert "WATCHDOG=1" not in manager.read()[before:]
                assert manager.told[-1] == "STOPPING=1"
                assert await r.plc.at_end()

    asyncio.run(scenario())


def test_a_manager_that_reads_nothing_does_not_stop_the_service(serve: Serve, manager: Manager) -> None:
    """Its queue is full after some ten messages; to wait for it would freeze every register at its last value."""
    over, frozen = threading.Event(), threading.Event()

    def relieve() -> None:
        """Lets a service that waits for its manager go on, so that this test fails instead of hanging."""
        if not over.wait(LIMIT_S):
            frozen.set()
            while not over.wait(0.01):
                manager.read()

    async def scenario() -> None:
        async with serve(ONE, node(), environment=manager.environment) as r:
            fill_queue(manager.environment["NOTIFY_SOCKET"])
            seen: set[int] = set()
            while len(seen) < 200:  # two seconds of samples: STATUS and WATCHDOG are due several times
                read = await r.until_status(1, StatusBit.VALID)
                seen.add(read.sequence)

    relief = threading.Thread(target=relieve)
    relief.start()
    try:
        asyncio.run(scenario())
    finally:
        over.set()
        relief.join()
    assert not frozen.is_set()


def fill_queue(path: str) -> None:
    """Send datagrams until the kernel takes no more."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as filler:
        filler.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                filler.sendto(b"X=1", path)


def test_ready_that_found_no_room_is_said_again_with_the_next_status(manager: Manager) -> None:
    """Else a start that was good would end at systemd's TimeoutStartSec."""
    notifier = ServiceNotifier(manager.environment)
    fill_queue(manager.environment["NOTIFY_SOCKET"])
    notifier.ready("2 of 2 joints valid")
    manager.read()
    notifier.status("2 of 2 joints valid")
    notifier.status("1 of 2 joints valid")
    notifier.close()
    assert manager.ready() == "READY=1\nSTATUS=2 of 2 joints valid"
    assert manager.told[-1] == "STATUS=1 of 2 joints valid"


# The orderly stop


def test_sigterm_says_stopping_ends_connections_and_leaves_nothing(serve: Serve, manager: Manager) -> None:
    async def scenario() -> None:
        async with serve(TWO, node(1), node(2), environment=manager.environment) as r:
            await r.until_status(1, StatusBit.VALID)
            idle = await ModbusTcpClient.connect(r.port)
            await idle.ask(read_request(4, 0, 10))
            os.kill(os.getpid(), signal.SIGTERM)
            async with asyncio.timeout(LIMIT_S):
                await asyncio.wait([r.task])
            r.task.result()
            assert manager.read()[-1] == "STOPPING=1"
            assert await r.plc.at_end()
            assert await idle.at_end()
            await idle.close()
            assert asyncio.all_tasks() == {asyncio.current_task()}
            with pytest.raises(ConnectionRefusedError):
                await ModbusTcpClient.connect(r.port)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL

    asyncio.run(scenario())


def test_no_angle_is_served_any_more_once_the_stop_has_begun(
    caplog: pytest.LogCaptureFixture, manager: Manager
) -> None:
    """Closing a bus takes its thread a while; the last image would look valid, and of an age that stands still."""
    channel = "trueangle-stop"

    async def scenario() -> None:
        config = config_yaml(BASE, interface="virtual", channel=channel)
        async with on_virtual_bus(channel, node()), started(config, caplog, manager.environment) as r:
            await r.until_status(1, StatusBit.VALID)
            r.service.stop()
            with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
                await read_after_stopping(r, manager)

    asyncio.run(scenario())


async def read_after_stopping(r: Rig, manager: Manager) -> None:
    """Ask until the connection ends; no answer may come to a question put after STOPPING."""
    while True:
        stopping = manager.heard("STOPPING=1")
        read = await r.fast(1)
        assert not stopping, read


def test_a_stop_while_a_node_is_being_set_up_does_not_wait_for_it(serve: Serve) -> None:
    deaf = node()
    deaf.deaf = True

    async def scenario() -> None:
        async with serve(ONE, deaf) as r:
            await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(scenario())
