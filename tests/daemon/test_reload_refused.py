"""SIGHUP that is refused, and SIGHUP at any moment: what is in force stays, and systemd is told of it."""

import asyncio
import gc
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path

import pytest
from tests.fakes.reload_site import (
    BASE,
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
    MODELS,
    config_yaml,
    images_of,
)
from tests.fakes.systemd_manager import Manager

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.registers import RegisterImage
from trueangle.service.arrangement import Arrangement

Start = Callable[..., AbstractAsyncContextManager[Running]]


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
    return images_of(monkeypatch)


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, site: Site) -> Start:
    return partial(running_on, site, monkeypatch, caplog)


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
