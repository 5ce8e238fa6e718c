"""SIGHUP: new configuration and models come into force between two cycles, or nothing changes at all.

The PLC's connection is the same throughout; every image that is served on the way is looked at.
"""

import asyncio
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.modbus_tcp_client import read_request
from tests.fakes.reload_site import (
    BASE,
    ELBOW,
    REST_COUNTS,
    TWO,
    Running,
    Site,
    node,
    one_wire,
    running_on,
    statuses,
)
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    MODELS,
    config_yaml,
    correction_arcsec,
    images_of,
    raw_mas,
    same_angle,
)

from trueangle.core.health import StatusBit
from trueangle.core.registers import RegisterImage

Start = Callable[..., AbstractAsyncContextManager[Running]]


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.fixture
def images(monkeypatch: pytest.MonkeyPatch) -> list[RegisterImage]:
    return images_of(monkeypatch)


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, site: Site) -> Start:
    return partial(running_on, site, monkeypatch, caplog)


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
