"""A site as on a controller, with configuration, models and nodes, and a service that SIGHUP makes read them."""

import os
import shutil
import signal
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.running_service import (
    MODELS,
    Rig,
    config_yaml,
    joint_yaml,
    started,
)

from trueangle.core.health import StatusBit
from trueangle.core.registers import RegisterImage
from trueangle.service import Loaded, load

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


@asynccontextmanager
async def running_on(
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    config: str,
    wires: dict[str, CanWire],
    environment: dict[str, str] | None = None,
) -> AsyncIterator[Running]:
    """A running service whose buses are these wires."""
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


def one_wire(*nodes: EncoderNode) -> dict[str, CanWire]:
    wire = CanWire()
    wire.nodes += nodes
    return {"wire": wire}
