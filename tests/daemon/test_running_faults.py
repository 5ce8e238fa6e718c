"""Faults of nodes and buses against the running daemon: the joint is out, by name, and the others go on."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import can
import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    Rig,
    config_yaml,
    joint_yaml,
    on_wire,
    raw_mas,
    started,
)

from trueangle.config import BusConfig
from trueangle.core.health import StatusBit

BASE, ELBOW = joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx")
ONE, TWO = config_yaml(BASE), config_yaml(BASE, ELBOW)
REST, ELSEWHERE = 1_234_567, 2_345_678

Scenario = Callable[[Rig], Coroutine[Any, Any, None]]
Run = Callable[..., None]


def node(node_id: int = 1, *, counts: int = REST, **more: Any) -> EncoderNode:
    return EncoderNode(node_id, lambda _id, _data: None, counts=lambda _: counts, **more)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> Run:
    def go(scenario: Scenario, config: str, *nodes: EncoderNode) -> None:
        async def within() -> None:
            async with on_wire(monkeypatch, CanWire(), *nodes), started(config, caplog) as r:
                await scenario(r)

        asyncio.run(within())

    return go


async def pauses(count: int) -> None:
    """Turns of the loop in which the daemon reads what lies in its socket."""
    for _ in range(count):
        await asyncio.sleep(0.002)


def test_frozen_frames_grow_old(run: Run) -> None:
    """The same sample again and again, in time: the counter that stands still tells."""
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.frozen = True
        read = await r.until(1, lambda read: StatusBit.STALE in read.status)
        assert read.corrected_mas == MARKER
        device.frozen = False
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


def test_heartbeat_without_process_data_is_stale(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.sends_position = False
        await r.until_status(1, StatusBit.STALE)
        device.sends_position = True
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


def test_process_data_without_heartbeat_are_not_believed(run: Run, caplog: pytest.LogCaptureFixture) -> None:
    """Frames on the right COB-ID prove nothing about who sends them."""
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.sends_heartbeat = False
        read = await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        assert read.corrected_mas == MARKER
        assert "no heartbeat for 1.5 s" in caplog.text
        device.sends_heartbeat = True
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


def test_storm_of_emergencies_leaves_the_other_joint_valid(run: Run, caplog: pytest.LogCaptureFixture) -> None:
    first, second = node(1), node(2)

    async def scenario(r: Rig) -> None:
        for slot in (1, 2):
            await r.until_status(slot, StatusBit.VALID)
        first.objects[0x1001, 0] = (0x81, 1)
        for burst in range(20):
            for i in range(50):
                first.send(0x081, bytes((0x10, 0x50, 0x81, burst, i, 0, 0, 0)))
            await pauses(1)
            assert (await r.fast(2)).status == GOOD
        assert StatusBit.VALID not in (await r.fast(1)).status
        first.objects[0x1001, 0] = (0, 1)
        first.emergency(0)
        await r.until_status(1, StatusBit.VALID)
        assert sum("EMCY" in message for message in caplog.messages) == 1
        assert any("emergencies=1000" in message for message in caplog.messages)

    run(scenario, TWO, first, second)


def test_foreign_traffic_disturbs_nothing(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        for _ in range(40):
            for i in range(100):
                device.send(0x300 + i, bytes(8))
            await pauses(1)
            assert (await r.fast(1)).status == GOOD

    run(scenario, ONE, device)


def test_wall_clock_that_is_set_back_moves_no_deadline(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        with monkeypatch.context() as patched:
            patched.setattr(time, "time", lambda: 0.0)
            patched.setattr(time, "time_ns", lambda: 0)
            for _ in range(50):
                await pauses(1)
                assert (await r.fast(1)).status == GOOD
            device.deaf = True
            await r.until_status(1, StatusBit.STALE)  # and not only when its heartbeats are missed

    run(scenario, ONE, device)


def test_second_unit_with_the_same_node_id_takes_the_joint_out_until_it_is_gone(
    run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    first, other = node(1), node(2)
    stranger = node(1, counts=ELSEWHERE, deaf=True, objects={(0x650B, 0): (815, 4)})

    async def scenario(r: Rig) -> None:
        for slot in (1, 2):
            await r.until_status(slot, StatusBit.VALID)
        stranger.deaf = False
        stranger.boot_up(stranger.objects)
        await r.until(1, lambda read: StatusBit.NODE_ID_CLASH in read.status)
        assert "two nodes" in caplog.text
        for _ in range(100):  # whichever of the two sends: never as good
            read = await r.fast(1)
            assert StatusBit.VALID not in read.status
            assert read.corrected_mas == MARKER
            assert (await r.fast(2)).status == GOOD
            await pauses(1)
        stranger.deaf = True
        read = await r.until_status(1, StatusBit.VALID)
        assert read.raw_mas == raw_mas(REST)

    run(scenario, TWO, first, other, stranger)


def test_timer_driven_encoder_is_served_without_any_sync(
    run: Run, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    device = node(objects={(0x1800, 5): (0, 2), (0x1801, 5): (0, 2)})
    driven = joint_yaml(1, "base", more="    tpdo: {trigger: timer, period_ms: 20}\n").replace(
        "every_syncs: 4,", "tpdo: {trigger: timer, period_ms: 100},"
    )
    config = config_yaml(driven).replace("sync_period_ms: 10, ", "")

    async def drive() -> None:
        for turn in range(10_000):
            device.elapse()
            if turn % 25 == 0 and device.objects[0x1017, 0][0]:
                device.heartbeat()
            await asyncio.sleep(0.02)

    async def scenario(r: Rig) -> None:
        driving = asyncio.create_task(drive())
        read = await r.until_status(1, StatusBit.VALID)
        assert read.raw_mas == raw_mas(REST)
        assert device.objects[0x1800, 5] == (20, 2)
        driving.cancel()
        await r.until(1, lambda read: StatusBit.STALE in read.status)
        with contextlib.suppress(asyncio.CancelledError):
            await driving

    del monkeypatch, caplog
    run(scenario, config, device)


@asynccontextmanager
async def on_wires(monkeypatch: pytest.MonkeyPatch, wires: dict[str, CanWire]) -> AsyncIterator[None]:
    """A wire for each channel."""

    def open_wire(settings: BusConfig) -> can.BusABC:
        return wires[settings.channel].open(settings)

    monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", open_wire)
    try:
        yield
    finally:
        for wire in wires.values():
            wire.cut()


def test_same_node_id_on_two_buses_is_two_nodes_and_one_bus_lost_leaves_the_other(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    arm, leg = CanWire(), CanWire()
    first, second = node(1, counts=REST), node(1, counts=ELSEWHERE)
    for wire, device in ((arm, first), (leg, second)):
        device.send = wire.send
        wire.nodes.append(device)
    other = ELBOW.replace("bus: arm", "bus: leg").replace("node_id: 2", "node_id: 1")
    buses = "buses: [{name: leg, interface: socketcan, channel: two, sync_period_ms: 10}, {name: arm,"
    config = config_yaml(BASE, other, channel="one").replace("buses: [{name: arm,", buses)

    async def scenario() -> None:
        async with on_wires(monkeypatch, {"one": arm, "two": leg}), started(config, caplog) as r:
            assert (await r.until_status(1, StatusBit.VALID)).raw_mas == raw_mas(REST)
            assert (await r.until_status(2, StatusBit.VALID)).raw_mas == raw_mas(ELSEWHERE % COUNTS_PER_REV)
            arm.absent = True
            arm.cut()
            await r.until(1, lambda read: StatusBit.BUS_DOWN in read.status)
            assert (await r.fast(2)).status == GOOD
            arm.absent = False
            await r.until_status(1, StatusBit.VALID)

    asyncio.run(scenario())
