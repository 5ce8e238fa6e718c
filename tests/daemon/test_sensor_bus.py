"""A running service whose joint is on one bus and its temperature on another: loss, return, reload."""

import asyncio
import os
import shutil
import signal
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.running_service import MODELS, config_yaml, joint_yaml, raw_mas, started

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.service import load

REST, SENSOR = 1_234_567, 40
NO_TEMPERATURE = StatusBit.TEMPERATURE_STALE


def config(sensor_sync_ms: int = 10) -> str:
    leg = f"buses: [{{name: leg, interface: socketcan, channel: two, sync_period_ms: {sensor_sync_ms}}}, "
    text = config_yaml(joint_yaml(1, "base"), channel="one").replace("buses: [", leg)
    return text.replace("index: 0x7130", f"bus: leg, node_id: {SENSOR}, index: 0x7130")


def test_temperature_of_another_bus_corrects_dies_with_that_bus_and_comes_back(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    wires = {"one": CanWire(), "two": CanWire()}
    encoder = EncoderNode(1, wires["one"].send, counts=lambda _: REST, sends_temperature=False)
    sensor = EncoderNode(SENSOR, wires["two"].send)
    wires["one"].nodes.append(encoder)
    wires["two"].nodes.append(sensor)
    monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", lambda s: wires[s.channel].open(s))
    shutil.copy(MODELS / "good.onnx", tmp_path)
    path = tmp_path / "trueangled.yaml"
    path.write_text(config(), "utf-8")

    async def scenario() -> None:
        async with started(config(), caplog, load_again=lambda: load(path)) as r:
            read = await r.until_status(1, StatusBit.VALID)
            assert (read.raw_mas, read.temperature_centi_c) == (raw_mas(REST), 2500)
            wires["two"].absent = True
            wires["two"].cut()
            read = await r.until(1, lambda read: StatusBit.VALID not in read.status)
            assert read.status == StatusBit.CONFIGURED | NO_TEMPERATURE  # the joint's own bus goes on
            assert await r.service_status() & ServiceBit.BUS_DOWN
            wires["two"].absent = False
            await r.until_status(1, StatusBit.VALID)
            assert not await r.service_status() & ServiceBit.BUS_DOWN
            # The sensor's bus is opened anew: the joint is brought up with it, the encoder's bus stays open.
            path.write_text(config(sensor_sync_ms=12), "utf-8")
            os.kill(os.getpid(), signal.SIGHUP)
            await r.until_told(lambda: "event=reloaded kept=0 anew=1" in caplog.text)
            await r.until_status(1, StatusBit.VALID)

    asyncio.run(scenario())
    for wire in wires.values():
        wire.cut()
    assert sum(m.startswith("event=bus_down bus=leg ") for m in caplog.messages) == 1
    assert not any(m.startswith("event=bus_down bus=arm ") for m in caplog.messages)
