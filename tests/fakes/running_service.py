"""The real service on a wire of fake nodes, read over Modbus TCP by formats of its own, taken from the table."""

import asyncio
import math
import re
import struct
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np
import onnxruntime
import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request

from trueangle.config import parse_config
from trueangle.core.health import StatusBit
from trueangle.core.registers import RegisterImage
from trueangle.edges.modbus_server import ModbusTcpServer
from trueangle.edges.systemd import ServiceNotifier
from trueangle.service import Loaded, Service, load_joints

MODELS = Path(__file__).parents[1] / "data" / "models"
LIMIT_S = 20.0
"""A condition that has not come true by then never will, however loaded the machine."""
GOOD = StatusBit.VALID | StatusBit.CONFIGURED
MARKER = -(2**31)

_HEADER = struct.Struct(">HHIHIH4x")
_SLOT = struct.Struct(">IHiiihHH")
_LIVE = struct.Struct(">IIHHidfidffifffIIII")


@dataclass(frozen=True, slots=True, kw_only=True)
class FastSlot:
    """One slot of the fast image as a PLC reads it."""

    status: StatusBit
    sequence: int
    corrected_mas: int
    raw_mas: int
    correction_mas: int
    temperature_centi_c: int
    age_ms: int
    uncertainty: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Live:
    """The live part of a detail block."""

    cycle: int
    status: StatusBit
    sequence: int
    node_id: int
    corrected_mas: int
    corrected_deg: float
    corrected_float32_deg: float
    raw_mas: int
    raw_deg: float
    raw_float32_deg: float
    velocity_deg_s: float
    turns: int
    temperature_c: float
    correction_arcsec: float
    uncertainty_arcsec: float
    age_ms: int
    raw_counts: int
    frames_received: int
    frames_lost: int


def joint_yaml(slot: int, name: str, *, model: str = "good.onnx", more: str = "") -> str:
    """A joint whose node-id is its slot; its limits are far above the pauses of a loaded machine."""
    return f"""\
  - slot: {slot}
    name: {name}
    bus: arm
    node_id: {slot}
    model: {model}
    stale_ms: 500
    heartbeat_ms: 500
    encoder: {{counts_per_rev: {COUNTS_PER_REV}}}
    temperature: {{index: 0x7130, subindex: 1, degc_per_unit: 0.01, every_syncs: 4, stale_s: 1}}
    sequence: {{index: 0x2100, subindex: 0}}
{more}"""


def config_yaml(
    *joints: str, interface: str = "socketcan", channel: str = "wire", port: int = 0, options: str = "{}"
) -> str:
    return (
        f"schema_version: 1\nmodbus: {{port: {port}}}\n"
        f"buses: [{{name: arm, interface: {interface}, channel: {channel}, sync_period_ms: 10, "
        f"options: {options}}}]\njoints:\n" + "".join(joints)
    )


def correction_arcsec(counts: int, temperature_centi_c: int, model: str = "good.onnx") -> float:
    """What the model file says of this sample, by ONNX Runtime alone: no line of the daemon takes part."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(MODELS / model), options, providers=["CPUExecutionProvider"])
    feed = {
        "angle_deg": np.array([counts % COUNTS_PER_REV * 360.0 / COUNTS_PER_REV]),
        "temperature_c": np.array([temperature_centi_c * 0.01]),
    }
    return float(np.asarray(session.run(["correction_arcsec"], feed)[0])[0])


def raw_mas(counts: int) -> int:
    """The raw angle in milli-arcseconds, by integers: exact to the half."""
    return round(counts % COUNTS_PER_REV * 1_296_000_000 / COUNTS_PER_REV)


@dataclass
class Rig:
    """A running service and one Modbus connection to it."""

    service: Service
    task: asyncio.Task[None]
    port: int
    plc: ModbusTcpClient

    async def registers(self, address: int, count: int, function: int = 4) -> bytes:
        answer = await self.plc.ask(read_request(function, address, count))
        assert answer[7] == function, f"exception {answer.hex()}"
        return answer[9:]

    async def first_image(self) -> None:
        """Until then the server says that it is busy (exception 06), and nothing else."""
        async with asyncio.timeout(LIMIT_S):
            while (answer := await self.plc.ask(read_request(4, 0, 1)))[7] != 4:
                assert answer[7:] == b"\x84\x06"
                self.still_running()

    async def fast(self, slot: int) -> FastSlot:
        status, *rest = _SLOT.unpack(await self.registers(10 + 12 * (slot - 1), 12))
        names = ("sequence", "corrected_mas", "raw_mas", "correction_mas", "temperature_centi_c", "age_ms")
        values = dict(zip((*names, "uncertainty"), rest, strict=True))
        return FastSlot(status=StatusBit(status), **values)

    async def live(self, slot: int) -> Live:
        values = _LIVE.unpack(await self.registers(1000 + 100 * (slot - 1), 40))
        told = dict(zip(Live.__dataclass_fields__, values, strict=True))
        return Live(**(told | {"status": StatusBit(values[1])}))  # pyright: ignore[reportArgumentType]

    async def service_status(self) -> int:
        return _HEADER.unpack(await self.registers(0, 10))[5]

    async def until(self, slot: int, true: Callable[[FastSlot], bool]) -> FastSlot:
        """Read the slot over Modbus until this holds; what never may be served is looked for in every answer."""
        async with asyncio.timeout(LIMIT_S):
            while True:
                read = await self.fast(slot)
                self.check(read)
                if true(read):
                    return read
                await asyncio.sleep(0.002)

    async def until_status(self, slot: int, status: StatusBit) -> FastSlot:
        """Until the status word is exactly this, CONFIGURED aside."""
        return await self.until(slot, lambda read: read.status == status | StatusBit.CONFIGURED)

    async def until_told(self, true: Callable[[], bool]) -> None:
        """Wait for something on the nodes' or the log's side."""
        async with asyncio.timeout(LIMIT_S):
            while not true():
                self.still_running()
                await asyncio.sleep(0.002)

    def still_running(self) -> None:
        if self.task.done():
            self.task.result()
            raise AssertionError("the service has stopped")

    @staticmethod
    def check(read: FastSlot) -> None:
        """The one rule without exception: a corrected angle is there exactly when the joint is VALID."""
        assert (read.corrected_mas != MARKER) == (StatusBit.VALID in read.status), read


def port_of(messages: list[str]) -> int | None:
    """The Modbus port that the log names."""
    for message in messages:
        found = re.search(r"event=modbus_listening .*port=(\d+)", message)
        if found:
            return int(found[1])
    return None


@asynccontextmanager
async def started(
    config: str,
    caplog: pytest.LogCaptureFixture,
    environment: Mapping[str, str] | None = None,
    load_again: Callable[[], Loaded] | None = None,
    state_directory: Path | None = None,
) -> AsyncIterator[Rig]:
    """The service as the command line would run it, listening; stopped in order at the end, no task left."""
    caplog.set_level("INFO")
    first = len(caplog.messages)
    parsed = parse_config(config, source="test.yaml")
    notifier = ServiceNotifier(environment or {})
    joints = load_joints(parsed, base=MODELS, source="test.yaml")
    service = Service(parsed, joints, notifier, load_again=load_again, state_directory=state_directory)
    task = asyncio.create_task(service.run())
    try:
        async with asyncio.timeout(LIMIT_S):
            while (port := port_of(caplog.messages[first:])) is None:
                if task.done():
                    task.result()
                await asyncio.sleep(0.002)
        plc = await ModbusTcpClient.connect(port)
        try:
            rig = Rig(service, task, port, plc)
            await rig.first_image()
            yield rig
        finally:
            await plc.close()
    finally:
        service.stop()
        async with asyncio.timeout(LIMIT_S):
            await asyncio.wait([task])
        notifier.close()
    task.result()


@asynccontextmanager
async def on_wire(monkeypatch: pytest.MonkeyPatch, wire: CanWire, *nodes: EncoderNode) -> AsyncIterator[None]:
    """Whatever bus the daemon opens is this wire, with these nodes on it."""
    for node in nodes:
        node.send = wire.send
    wire.nodes += nodes
    monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", wire.open)
    try:
        yield
    finally:
        wire.cut()


@asynccontextmanager
async def on_virtual_bus(channel: str, *nodes: EncoderNode) -> AsyncIterator[None]:
    """These nodes on python-can's virtual interface: through the threads that all but SocketCAN take."""
    far = can.Bus(interface="virtual", channel=channel, ignore_config=True)

    def send(can_id: int, data: bytes) -> None:
        far.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def take(message: can.Message) -> None:
        for node in nodes:
            node.handle(message.arbitration_id, bytes(message.data))

    for node in nodes:
        node.send = send
    notifier = can.Notifier(far, [take], timeout=0.05, loop=asyncio.get_running_loop())
    try:
        yield
    finally:
        await asyncio.to_thread(notifier.stop)
        far.shutdown()


def images_of(monkeypatch: pytest.MonkeyPatch) -> list[RegisterImage]:
    """Every image served from now on: one that lives for microseconds is met by no poll, but a PLC may."""
    seen: list[RegisterImage] = []
    publish = ModbusTcpServer.publish

    def record(server: ModbusTcpServer, image: RegisterImage) -> None:
        seen.append(image)
        publish(server, image)

    monkeypatch.setattr(ModbusTcpServer, "publish", record)
    return seen


def same_angle(one_mas: int, other_mas: float, tolerance_mas: float) -> bool:
    """Equal within the tolerance, across 0 as well."""
    return abs(math.remainder(one_mas - other_mas, 1_296_000_000)) <= tolerance_mas
