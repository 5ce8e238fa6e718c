"""SIGHUP: new configuration and models come into force between two cycles, or nothing changes at all.

The PLC's connection is the same throughout; every image that is served on the way is looked at.
"""

import asyncio
import gc
import os
import shutil
import signal
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import pytest
from tests.daemon.test_service_life import Manager
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.modbus_tcp_client import read_request
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    MODELS,
    Rig,
    config_yaml,
    correction_arcsec,
    joint_yaml,
    raw_mas,
    same_angle,
    started,
)

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.registers import RegisterImage
from trueangle.edges.modbus_server import ModbusTcpServer
from trueangle.service import Loaded, load
from trueangle.service.arrangement import Arrangement

BASE, ELBOW = joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx")
TWO = config_yaml(BASE, ELBOW)
REST_COUNTS = 1_234_567


class Site:
    """A directory with configuration and models, as on a controller; what SIGHUP makes the service read."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "trueangled.yaml"
        for name in ("good", "twin", "partial"):
            shutil.copy(MODELS / f"{name}.onnx", folder)
        self.folder = folder
        self.loads = 0
        self.gate = threading.Event()
        """Clear: loading waits, in its thread."""
        self.gate.set()
        self.planted: Exception | None = None

    def write(self, config: str) -> None:
        self.path.write_text(config, "utf-8")

    def load_again(self) -> Loaded:
        self.loads += 1
        assert self.gate.wait(20)
        if self.planted is not None:
            raise self.planted
        return load(self.path)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


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


@pytest.fixture
def images(monkeypatch: pytest.MonkeyPatch) -> list[RegisterImage]:
    """Every image that was ever served: one that lives for microseconds is met by no poll, but a PLC may."""
    seen: list[RegisterImage] = []
    publish = ModbusTcpServer.publish

    def record(server: ModbusTcpServer, image: RegisterImage) -> None:
        seen.append(image)
        publish(server, image)

    monkeypatch.setattr(ModbusTcpServer, "publish", record)
    return seen


def statuses(images: list[RegisterImage], slot: int) -> set[StatusBit]:
    words = [image.read(10 + 12 * (slot - 1), 2) for image in images]
    return {StatusBit(int.from_bytes(word, "big")) for word in words if word is not None}


def node(node_id: int = 1) -> EncoderNode:
    made = EncoderNode(node_id, lambda _id, _data: None)
    made.counts = lambda _: REST_COUNTS
    return made


class Running:
    """A service on one wire for each bus, and the log it writes."""

    def __init__(self, r: Rig, site: Site, caplog: pytest.LogCaptureFixture) -> None:
        self.r, self.site, self._caplog = r, site, caplog

    async def reload(self, config: str | None = None) -> None:
        """Write this configuration, send SIGHUP and wait for the outcome."""
        if config is not None:
            self.site.write(config)
        before = self._outcomes()
        os.kill(os.getpid(), signal.SIGHUP)
        await self.r.until_told(lambda: self._outcomes() > before)

    def _outcomes(self) -> int:
        first = ("event=reloaded", "event=reload_refused fault=1 ")
        return sum(message.startswith(first) for message in self._caplog.messages)


Start = Callable[..., AbstractAsyncContextManager[Running]]


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, site: Site) -> Start:
    """Gives a running service whose buses are these wires."""

    @asynccontextmanager
    async def within(
        config: str, wires: dict[str, CanWire], environment: dict[str, str] | None = None
    ) -> AsyncIterator[Running]:
        for wire in wires.values():
            for device in wire.nodes:
                device.send = wire.send
        monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", lambda s: wires[s.channel].open(s))
        site.write(config)
        async with started(config, caplog, environment, site.load_again) as r:
            try:
                yield Running(r, site, caplog)
            finally:
                site.gate.set()
        for wire in wires.values():
            wire.cut()

    return within


def one_wire(*nodes: EncoderNode) -> dict[str, CanWire]:
    wire = CanWire()
    wire.nodes += nodes
    return {"wire": wire}


# What did not change goes on


def test_joints_that_did_not_change_stay_valid_in_every_image_and_their_nodes_are_left_alone(
    start: Start, images: list[RegisterImage], caplog: pytest.LogCaptureFixture
) -> None:
    nodes = [node(1), node(2)]

    async def scenario() -> None:
        async with start(TWO, one_wire(*nodes)) as s:
            for slot in (1, 2):
                await s.r.until_status(slot, StatusBit.VALID)
            told, writes, served = [len(n.nmt) for n in nodes], [len(n.writes) for n in nodes], len(images)
            before = await s.r.fast(1)
            await s.reload()
            await s.r.until(1, lambda read: read.sequence > before.sequence + 20)
            assert statuses(images[served:], 1) == statuses(images[served:], 2) == {GOOD}
            assert [len(n.nmt) for n in nodes] == told
            assert [len(n.writes) for n in nodes] == writes
            assert (await s.r.live(1)).frames_lost == 0
            assert "event=reloaded kept=2 anew=0 slots_gone=none" in caplog.text

    asyncio.run(scenario())


def test_a_kept_joint_is_served_by_the_new_arrangement_and_goes_stale_in_it(start: Start) -> None:
    """Kept must not mean frozen: its samples arrive, and their absence is seen."""
    device = node()

    async def scenario() -> None:
        async with start(config_yaml(BASE), one_wire(device)) as s:
            await s.r.until_status(1, StatusBit.VALID)
            await s.reload()
            device.counts = lambda _: REST_COUNTS + 100_000
            await s.r.until(1, lambda read: read.raw_mas == raw_mas(REST_COUNTS + 100_000))
            device.deaf = True
            await s.r.until(1, lambda read: StatusBit.STALE in read.status)
            device.deaf = False
            await s.r.until_status(1, StatusBit.VALID)

    asyncio.run(scenario())


# What changed is brought up anew


def test_a_model_that_changed_takes_its_joint_alone_through_a_new_bring_up(
    start: Start, images: list[RegisterImage], site: Site
) -> None:
    nodes = [node(1), node(2)]

    async def scenario() -> None:
        async with start(TWO, one_wire(*nodes)) as s:
            for slot in (1, 2):
                await s.r.until_status(slot, StatusBit.VALID)
            nodes[1].reads.clear()
            served, told = len(images), len(nodes[0].nmt)
            shutil.copy(MODELS / "partial.onnx", site.folder / "twin.onnx")
            await s.reload()
            read = await s.r.until_status(2, StatusBit.VALID)
            expected = raw_mas(REST_COUNTS) + 1e3 * correction_arcsec(REST_COUNTS, 2500, "partial.onnx")
            assert same_angle(read.corrected_mas, expected, 1)
            assert {(0x1018, 4), (0x6000, 0), (0x6003, 0), (0x1A00, 1)} <= set(nodes[1].reads)
            assert statuses(images[served:], 1) == {GOOD}
            assert len(nodes[0].nmt) == told
            # Between the old model and the new one was the marker, and nothing of one with the other.
            corrected = {image.read(10 + 12 + 3, 2) for image in images[served:]}
            assert MARKER.to_bytes(4, "big", signed=True) in corrected

    asyncio.run(scenario())


def test_joints_come_and_go_on_an_open_bus_and_connection(start: Start) -> None:
    nodes = [node(1), node(2)]

    async def scenario() -> None:
        async with start(config_yaml(BASE), one_wire(*nodes)) as s:
            await s.r.until_status(1, StatusBit.VALID)
            assert (await s.r.fast(2)).status == StatusBit(0)
            await s.reload(TWO)
            await s.r.until_status(2, StatusBit.VALID)
            told = len(nodes[0].nmt)
            await s.reload(config_yaml(ELBOW))
            assert (await s.r.fast(1)).status == StatusBit(0)
            assert (await s.r.fast(1)).corrected_mas == MARKER
            answer = await s.r.plc.ask(read_request(4, 1000, 10))
            assert answer[7:] == b"\x84\x02"
            await s.r.until(2, lambda read: read.status == GOOD)
            assert len(nodes[0].nmt) == told

    asyncio.run(scenario())


def test_two_joints_that_swap_their_nodes_are_both_brought_up_anew(
    start: Start, images: list[RegisterImage]
) -> None:
    """The slot is the old one and the COB-ID is known: nothing of the other node may be shown under it."""
    nodes = [node(1), node(2)]
    nodes[1].counts = lambda _: 2_000_000
    swapped = TWO.replace("node_id: 1", "node_id: 9").replace("node_id: 2", "node_id: 1")
    swapped = swapped.replace("node_id: 9", "node_id: 2")

    async def scenario() -> None:
        async with start(TWO, one_wire(*nodes)) as s:
            for slot in (1, 2):
                await s.r.until_status(slot, StatusBit.VALID)
            served = len(images)
            await s.reload(swapped)
            read = await s.r.until_status(1, StatusBit.VALID)
            assert read.raw_mas == raw_mas(2_000_000)
            await s.r.until_status(2, StatusBit.VALID)
            # The first image of the new arrangement knows neither joint.
            seen = [image for image in images[served:] if (image.read(1000 + 5, 1) or b"")[-1:] == b"\x02"]
            assert seen
            raws = {image.read(10 + 5, 2) for image in seen}
            assert raws == {MARKER.to_bytes(4, "big", signed=True), raw_mas(2_000_000).to_bytes(4, "big")}

    asyncio.run(scenario())


def test_a_bus_whose_settings_changed_is_opened_anew_and_the_other_goes_on(
    start: Start, images: list[RegisterImage]
) -> None:
    wires = {"w1": CanWire(), "w2": CanWire(), "w3": CanWire()}
    devices = {name: node(1) for name in wires}
    for name, wire in wires.items():
        wire.nodes.append(devices[name])
    devices["w3"].counts = lambda _: 2_000_000
    knee = ELBOW.replace("bus: arm", "bus: leg").replace("node_id: 2", "node_id: 1")
    leg = "buses: [{name: leg, interface: socketcan, channel: w2, sync_period_ms: 10}, "
    config = config_yaml(BASE, knee, channel="w1").replace("buses: [", leg)

    async def scenario() -> None:
        async with start(config, wires) as s:
            for slot in (1, 2):
                await s.r.until_status(slot, StatusBit.VALID)
            served = len(images)
            await s.reload(config.replace("channel: w2", "channel: w3"))
            await s.r.until(2, lambda read: read.raw_mas == raw_mas(2_000_000) and StatusBit.VALID in read.status)
            assert statuses(images[served:], 1) == {GOOD}
            assert wires["w2"]._far is None  # the old one is closed, so nothing of it can come any more
            assert any(StatusBit.BUS_DOWN in status for status in statuses(images[served:], 2))

    asyncio.run(scenario())


# What is refused changes nothing


def bad_model(site: Site) -> None:
    (site.folder / "twin.onnx").write_bytes(b"\x08\x07garbage" * 500)


def bad_configuration(site: Site) -> None:
    site.write(TWO.replace("node_id: 1", "node_id: 300").replace("stale_ms: 500", "stale: 500"))


def no_configuration(site: Site) -> None:
    site.path.unlink()


def truncated_configuration(site: Site) -> None:
    site.write(TWO[: len(TWO) // 2] + "{")


def empty_model(site: Site) -> None:
    (site.folder / "good.onnx").write_bytes(b"")


def model_of_the_other_joint(site: Site) -> None:
    shutil.copy(site.folder / "good.onnx", site.folder / "twin.onnx")


def unforeseen(site: Site) -> None:
    site.planted = ZeroDivisionError("planted")


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (bad_model, "twin.onnx: expected an ONNX model that ONNX Runtime can load"),
        (empty_model, "expected an ONNX model, found an empty file"),
        (model_of_the_other_joint, "joint elbow: expected a model of its own"),
        (bad_configuration, "did you mean stale_ms?"),
        (truncated_configuration, "trueangled.yaml"),
        (no_configuration, "expected a readable file, found No such file or directory"),
        (unforeseen, "ZeroDivisionError: planted"),
    ],
)
def test_what_is_refused_leaves_all_as_it_was_and_says_why_until_a_good_one_comes(
    start: Start,
    site: Site,
    images: list[RegisterImage],
    manager: Manager,
    caplog: pytest.LogCaptureFixture,
    spoil: Callable[[Site], None],
    found: str,
) -> None:
    nodes = [node(1), node(2)]

    async def scenario() -> None:
        async with start(TWO, one_wire(*nodes), environment=manager.environment) as s:
            for slot in (1, 2):
                await s.r.until_status(slot, StatusBit.VALID)
            await s.r.until_told(lambda: manager.heard("READY=1"))
            served, told = len(images), [len(n.nmt) for n in nodes]
            spoil(site)
            await s.reload()
            assert any(m.startswith("event=reload_refused fault=1 of=") and found in m for m in caplog.messages), (
                caplog.text
            )
            before = await s.r.fast(1)
            await s.r.until(1, lambda read: read.sequence > before.sequence + 5)
            assert statuses(images[served:], 1) == statuses(images[served:], 2) == {GOOD}
            assert [len(n.nmt) for n in nodes] == told
            assert await s.r.service_status() == ServiceBit.ALL_VALID | ServiceBit.RELOAD_REFUSED
            await s.r.until_told(lambda: sum(m.startswith("READY=1") for m in manager.read()) == 2)
            (last,) = [m for m in manager.read() if m.startswith("READY=1")][1:]
            assert last.startswith("READY=1\nSTATUS=2 of 2 joints valid; reload refused: ")
            assert found in last
            site.planted = None
            for name in ("good", "twin"):
                shutil.copy(MODELS / f"{name}.onnx", site.folder)
            await s.reload(TWO)
            assert await s.r.service_status() == ServiceBit.ALL_VALID
            assert statuses(images[served:], 1) == {GOOD}
            assert "refused" not in s.r.service.status_text()

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("port: 0", "port: 5021"), "modbus.port: expected 0 as at the start, found 5021; restart the service"),
        (("port: 0", "port: 0, unit_id: 9"), "modbus.unit_id: expected 1 as at the start, found 9"),
    ],
)
def test_what_only_a_restart_can_change_is_refused_with_all_the_rest_of_the_file(
    start: Start, caplog: pytest.LogCaptureFixture, change: tuple[str, str], found: str
) -> None:
    async def scenario() -> None:
        async with start(TWO, one_wire(node(1), node(2))) as s:
            await s.r.until_status(2, StatusBit.VALID)
            await s.reload(config_yaml(BASE).replace(*change))
            assert found in caplog.text
            assert (await s.r.fast(2)).status == GOOD  # the joint that the new file no longer has

    asyncio.run(scenario())


# When it comes


def test_plcs_read_valid_angles_while_the_files_are_being_loaded(start: Start, site: Site) -> None:
    async def scenario() -> None:
        async with start(TWO, one_wire(node(1), node(2))) as s:
            await s.r.until_status(1, StatusBit.VALID)
            site.gate.clear()
            os.kill(os.getpid(), signal.SIGHUP)
            await s.r.until_told(lambda: site.loads == 1)
            before = await s.r.fast(1)
            after = await s.r.until(1, lambda read: read.sequence > before.sequence + 20)
            assert after.status == GOOD
            site.gate.set()

    asyncio.run(scenario())


def test_however_often_it_is_asked_during_a_reload_one_more_follows(
    start: Start, site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        async with start(TWO, one_wire(node(1), node(2))) as s:
            await s.r.until_status(1, StatusBit.VALID)
            site.gate.clear()
            os.kill(os.getpid(), signal.SIGHUP)
            await s.r.until_told(lambda: site.loads == 1)
            for _ in range(5):
                os.kill(os.getpid(), signal.SIGHUP)
                await asyncio.sleep(0)
            site.write(config_yaml(BASE))
            site.gate.set()
            await s.r.until_told(lambda: caplog.text.count("event=reloaded") == 2)
            before = await s.r.fast(1)
            await s.r.until(1, lambda read: read.sequence > before.sequence + 20)
            assert site.loads == 2
            assert (await s.r.fast(2)).status == StatusBit(0)  # the last state of the file is in force

    asyncio.run(scenario())


def test_systemd_is_told_reloading_with_the_monotonic_time_and_ready_when_every_joint_is_decided(
    start: Start, site: Site, manager: Manager
) -> None:
    async def scenario() -> None:
        async with start(config_yaml(BASE), one_wire(node(1), node(2)), environment=manager.environment) as s:
            await s.r.until_told(lambda: manager.heard("READY=1"))
            await s.reload(TWO)
            await s.r.until_told(lambda: len([m for m in manager.read() if m.startswith("READY=1")]) == 2)
            told = [m for m in manager.told if m.startswith(("READY", "RELOADING"))]
            assert told[0] == "READY=1\nSTATUS=1 of 1 joints valid"
            first, second = told[1].split("\n")
            assert first == "RELOADING=1"
            key, microseconds = second.split("=")
            assert key == "MONOTONIC_USEC"
            # CLOCK_MONOTONIC, as systemd reads it: not before this test's process began to listen, not ahead.
            assert 0 < int(microseconds) <= asyncio.get_running_loop().time() * 1e6
            assert told[2] == "READY=1\nSTATUS=2 of 2 joints valid"

    asyncio.run(scenario())


def test_a_stop_during_a_reload_is_an_orderly_one(start: Start, site: Site, manager: Manager) -> None:
    async def scenario() -> None:
        async with start(TWO, one_wire(node(1), node(2)), environment=manager.environment) as s:
            await s.r.until_status(1, StatusBit.VALID)
            site.gate.clear()
            os.kill(os.getpid(), signal.SIGHUP)
            await s.r.until_told(lambda: site.loads == 1)
            os.kill(os.getpid(), signal.SIGTERM)
            await asyncio.wait([s.r.task], timeout=20)
            assert s.r.task.done()
            assert manager.read()[-1] == "STOPPING=1"
            site.gate.set()

    asyncio.run(scenario())


def test_arrangements_that_were_replaced_do_not_pile_up(start: Start, site: Site) -> None:
    async def scenario() -> None:
        async with start(TWO, one_wire(node(1), node(2))) as s:
            await s.r.until_status(1, StatusBit.VALID)
            for stale_ms in (600, 500, 600, 500):
                await s.reload(TWO.replace("stale_ms: 500", f"stale_ms: {stale_ms}"))
                await s.r.until_status(1, StatusBit.VALID)
            # The tick may hold the one before until it runs again. `type`: isinstance asks proxies, which raise.
            assert sum(type(one) is Arrangement for one in gc.get_objects()) <= 2

    asyncio.run(scenario())
