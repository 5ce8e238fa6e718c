"""Every fault of a node, its sensor or its bus, begun and ended while a second joint is served: one rule for all.

The process lives. The other joint is good in every image. No image holds an angle as VALID that is stale or not
the true one. The log has one line where the joint's outage begins, that or a further one names the reason, and one
line where it ends.
"""

import asyncio
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.canopen_device import Address
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    Rig,
    config_yaml,
    correction_arcsec,
    images_of,
    joint_yaml,
    raw_mas,
    same_angle,
    started,
)

from trueangle.core.health import StatusBit
from trueangle.core.registers import RegisterImage

REST = 1_234_567
TRUE_MAS = raw_mas(REST) + 1e3 * correction_arcsec(REST, 2500)
TOLERANCE_MAS = 4.0
"""Rounding, and what the last bit of a temperature that dithers changes; 10 degC change more than 10 (below)."""
STALE_MS = 500
"""As in the configuration."""
RX_OVERFLOW = (0x2000_0004, b"\0\x01\0\0\0\0\0\0")
"""An error frame as linux/can/error.h has it: the controller had no room for what it received."""
BASE, ELBOW = joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx")


def dithering(sample: int) -> int:
    """A sensor's last bit, which a living converter moves."""
    return 2500 + sample // 4 % 2


@dataclass
class Site:
    """Two joints, each on a wire of its own or both on one; a second unit that may come to the first."""

    wire: CanWire = field(default_factory=CanWire)
    other_wire: CanWire = field(default_factory=CanWire)
    node: EncoderNode = field(init=False)
    stranger: EncoderNode = field(init=False)
    syncs: bool = True
    """Whoever sends SYNC on the first wire does so."""

    def __post_init__(self) -> None:
        self.node = EncoderNode(1, self.wire.send, counts=lambda _: REST)
        self.stranger = EncoderNode(
            1, self.wire.send, counts=lambda _: 2 * REST, deaf=True, objects={(0x650B, 0): (815, 4)}
        )
        self.wire.nodes += [self.node, self.stranger]

    def write(self, address: Address, value: int, size: int = 4) -> None:
        """Another master writes to the node: the daemon hears the request as the node does."""
        request = struct.pack("<BHBI", 0x23 | (4 - size) << 2, *address, value)
        self.wire.send(0x601, request)
        self.node.handle(0x601, request)

    def send_twice(self, can_id: int, data: bytes) -> None:
        """Process data come doubled."""
        for _ in range(2 if can_id == 0x181 else 1):
            self.wire.send(can_id, data)

    def storm(self) -> None:
        self.node.objects[0x1001, 0] = (0x81, 1)
        for i in range(200):
            self.wire.send(0x081, bytes((0x10, 0x50, 0x81, i, 0, 0, 0, 0)))

    def flood(self) -> None:
        for i in range(100):
            self.wire.send(0x300 + i, bytes(8))
        self.wire.send(*RX_OVERFLOW)

    def pull(self, *, out: bool) -> None:
        """The adapter."""
        self.wire.absent = out
        if out:
            self.wire.cut()


def nothing(_: Site) -> None:
    """It ends by itself."""


def put(**values: object) -> Callable[[Site], None]:
    """Attributes of the node."""

    def change(site: Site) -> None:
        for name, value in values.items():
            setattr(site.node, name, value)

    return change


def both(*changes: Callable[[Site], None]) -> Callable[[Site], None]:
    def change(site: Site) -> None:
        for one in changes:
            one(site)

    return change


def moved(counts: int) -> Callable[[Site], None]:
    return put(counts=lambda _: counts)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """How it begins and ends, and the bit by which the joint says so."""

    begin: Callable[[Site], None]
    end: Callable[[Site], None]
    bit: StatusBit
    joint: str = BASE
    own_bus: bool = False
    """It takes the whole bus: the other joint is on another."""
    temperatures: Callable[[int], int] | None = None
    foreign_sync: bool = False


WATCHED = BASE.replace("stale_s: 1}", "stale_s: 1, frozen_s: 1, max_rate_c_per_s: 1}")
FACTORY = {(0x1800, 2): (1, 1), (0x1A00, 0): (2, 1), (0x1A00, 1): (0x2100_0010, 4), (0x1A00, 2): (0x6004_0020, 4)}
SWIFT = BASE + "    motion: {max_speed_deg_s: 100000}\n"
"""No jump: what was written to the node alone can tell."""
NODE_ID_TAKEN = both(
    lambda s: setattr(s.stranger, "deaf", False), lambda s: s.stranger.boot_up(s.stranger.objects)
)

FAULTS = {
    "node silent": Fault(begin=put(deaf=True), end=put(deaf=False), bit=StatusBit.STALE),
    "node rebooting": Fault(  # it starts by itself, and sends another mapping on the same COB-ID
        begin=both(lambda s: s.node.reboot(FACTORY), put(state=0x05)),
        end=nothing,
        bit=StatusBit.NODE_NOT_READY,
    ),
    "node replaced": Fault(
        begin=lambda s: s.node.reboot({(0x650B, 0): (815, 4)}),
        end=lambda s: s.node.reboot(),
        bit=StatusBit.ENCODER_DIFFERS,
    ),
    "preset behind our back": Fault(
        begin=both(lambda s: s.write((0x6003, 0), 1000), moved(REST + 1000)),
        end=both(lambda s: s.write((0x6003, 0), 0), moved(REST)),
        bit=StatusBit.ENCODER_DIFFERS,
        joint=SWIFT,
    ),
    "code sequence behind our back": Fault(
        begin=both(lambda s: s.write((0x6000, 0), 5, 2), moved(COUNTS_PER_REV - REST)),
        end=both(lambda s: s.write((0x6000, 0), 4, 2), moved(REST)),
        bit=StatusBit.ENCODER_DIFFERS,
        joint=SWIFT,
    ),
    "scaling behind our back": Fault(
        begin=both(lambda s: s.write((0x6001, 0), 65_536), moved(REST // 50)),
        end=both(lambda s: s.write((0x6001, 0), COUNTS_PER_REV), moved(REST)),
        bit=StatusBit.ENCODER_DIFFERS,
        joint=SWIFT,
    ),
    "node id taken": Fault(
        begin=NODE_ID_TAKEN, end=lambda s: setattr(s.stranger, "deaf", True), bit=StatusBit.NODE_ID_CLASH
    ),
    "wrong mapping": Fault(
        begin=both(put(ignores_mapping=True), lambda s: s.node.reboot(FACTORY)),
        end=put(ignores_mapping=False),
        bit=StatusBit.NODE_FAULT,
    ),
    "short frames": Fault(begin=put(extra_bytes=-1), end=put(extra_bytes=0), bit=StatusBit.STALE),
    "long frames": Fault(begin=put(extra_bytes=2), end=put(extra_bytes=0), bit=StatusBit.STALE),
    "doubled frames": Fault(
        begin=lambda s: setattr(s.node, "send", s.send_twice),
        end=lambda s: setattr(s.node, "send", s.wire.send),
        bit=StatusBit.NODE_ID_CLASH,
    ),
    "frozen frames": Fault(begin=put(frozen=True), end=put(frozen=False), bit=StatusBit.STALE),
    "heartbeat without process data": Fault(
        begin=put(sends_position=False), end=put(sends_position=True), bit=StatusBit.STALE
    ),
    "process data without heartbeat": Fault(
        begin=put(sends_heartbeat=False), end=put(sends_heartbeat=True), bit=StatusBit.NODE_NOT_READY
    ),
    "storm of emergencies": Fault(
        begin=Site.storm,
        end=both(lambda s: s.node.objects.update({(0x1001, 0): (0, 1)}), lambda s: s.node.emergency(0)),
        bit=StatusBit.NODE_FAULT,
    ),
    "position elsewhere and back": Fault(
        begin=moved(REST + COUNTS_PER_REV // 2),
        end=moved(REST),
        bit=StatusBit.POSITION_JUMP,
        joint=BASE + "    motion: {max_speed_deg_s: 10}\n",
    ),
    "temperature broken": Fault(
        begin=put(temperature_centi_c=-12_700),
        end=put(temperature_centi_c=2500),
        bit=StatusBit.TEMPERATURE_BROKEN,
    ),
    "temperature gone": Fault(
        begin=put(sends_temperature=False), end=put(sends_temperature=True), bit=StatusBit.TEMPERATURE_STALE
    ),
    "temperature frozen": Fault(
        begin=put(temperatures=None),
        end=put(temperatures=dithering),
        bit=StatusBit.TEMPERATURE_IMPLAUSIBLE,
        joint=WATCHED,
        temperatures=dithering,
    ),
    "temperature jumping": Fault(
        begin=put(temperatures=lambda sample: 2500 + 1000 * (sample // 4 % 2)),
        end=put(temperatures=dithering),
        bit=StatusBit.TEMPERATURE_IMPLAUSIBLE,
        joint=WATCHED,
        temperatures=dithering,
    ),
    "SYNC lost": Fault(
        begin=lambda s: setattr(s, "syncs", False),
        end=lambda s: setattr(s, "syncs", True),
        bit=StatusBit.SYNC_LOST,
        own_bus=True,
        foreign_sync=True,
    ),
    "bus flooded": Fault(begin=Site.flood, end=nothing, bit=StatusBit.NODE_NOT_READY, own_bus=True),
    "bus lost": Fault(
        begin=lambda s: s.pull(out=True), end=lambda s: s.pull(out=False), bit=StatusBit.BUS_DOWN, own_bus=True
    ),
}


def configured(fault: Fault) -> str:
    """Both joints on the bus arm, or the other one on a bus of its own."""
    if not fault.own_bus:
        return config_yaml(fault.joint, ELBOW)
    config = config_yaml(fault.joint, ELBOW.replace("bus: arm", "bus: leg"))
    if fault.foreign_sync:
        config = config.replace("sync_period_ms: 10, ", "")
    leg = "buses: [{name: leg, interface: socketcan, channel: other, sync_period_ms: 10}, "
    return config.replace("buses: [", leg)


def slot_of(image: RegisterImage, slot: int) -> tuple[StatusBit, int, int, int]:
    """Status, corrected and raw in milli-arcseconds and age in ms of one joint."""
    data = image.read(10 + 12 * (slot - 1), 11)
    assert data is not None
    status, corrected_mas, raw, age_ms = struct.unpack(">I2xii6xH", data)
    return StatusBit(status), corrected_mas, raw, age_ms


@contextmanager
def producing_sync(site: Site, fault: Fault) -> Iterator[None]:
    """Another device sends SYNC on the first wire."""

    async def produce() -> None:
        while True:
            if site.syncs:
                site.wire.send(0x080, b"")
                site.node.handle(0x080, b"")
            await asyncio.sleep(0.01)

    task = asyncio.create_task(produce()) if fault.foreign_sync else None
    try:
        yield
    finally:
        if task is not None:
            task.cancel()


@contextmanager
def on_site(monkeypatch: pytest.MonkeyPatch, site: Site, fault: Fault) -> Iterator[None]:
    wires = {"wire": site.wire, "other": site.other_wire}
    monkeypatch.setattr("trueangle.edges.can_bus.open_python_can", lambda s: wires[s.channel].open(s))
    elbow_wire = site.other_wire if fault.own_bus else site.wire
    elbow_wire.nodes.append(EncoderNode(2, elbow_wire.send, counts=lambda _: REST))
    site.node.temperatures = fault.temperatures
    try:
        with producing_sync(site, fault):
            yield
    finally:
        for wire in wires.values():
            wire.cut()


def test_a_wrong_temperature_would_show() -> None:
    assert not same_angle(round(raw_mas(REST) + 1e3 * correction_arcsec(REST, 3500)), TRUE_MAS, 2 * TOLERANCE_MAS)
    assert same_angle(round(raw_mas(REST) + 1e3 * correction_arcsec(REST, 2501)), TRUE_MAS, TOLERANCE_MAS - 1)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_survived_told_and_never_served(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    fault, site = FAULTS[name], Site()
    images = images_of(monkeypatch)

    async def until_shown(r: Rig, first: int, true: Callable[[StatusBit], bool]) -> None:
        """Until an image from `first` on says so of the joint; one that lives for microseconds counts."""
        seen = first

        def shown() -> bool:
            nonlocal seen
            news, seen = images[seen:], len(images)
            return any(true(slot_of(image, 1)[0]) for image in news)

        await r.until_told(shown)

    async def scenario() -> None:
        with on_site(monkeypatch, site, fault):
            async with started(configured(fault), caplog) as r:
                for slot in (1, 2):
                    await r.until_status(slot, StatusBit.VALID)
                first_image, first_line = len(images), len(caplog.messages)
                fault.begin(site)
                await until_shown(r, first_image, lambda status: fault.bit in status)
                fault.end(site)
                begun = len(images)
                await until_shown(r, begun, lambda status: status == GOOD)
                r.still_running()
                hold_to_the_rule(images[first_image:])
                told_once(caplog.messages[first_line:], fault.bit)

    asyncio.run(scenario())


def hold_to_the_rule(images: list[RegisterImage]) -> None:
    for image in images:
        status, corrected_mas, raw, age_ms = slot_of(image, 1)
        if StatusBit.VALID in status:
            assert age_ms <= STALE_MS
            assert raw == raw_mas(REST)
            assert same_angle(corrected_mas, TRUE_MAS, TOLERANCE_MAS)
        else:
            assert corrected_mas == MARKER
        assert slot_of(image, 2)[0] == GOOD


def told_once(messages: list[str], bit: StatusBit) -> None:
    lines = [message for message in messages if message.startswith("event=joint_")]
    events = [line.split()[0].removeprefix("event=joint_") for line in lines]
    assert events[0] == "not_valid", lines
    assert events[-1] == "valid", lines
    assert set(events[1:-1]) <= {"reason_added"}, lines
    assert all("slot=1 joint='base'" in line for line in lines)
    told: set[str] = set()
    for line in lines[:-1]:
        reasons = set(line.partition("reasons=")[2].split()[0].split(","))
        assert reasons - told, lines  # no line that says nothing new
        told |= reasons
    assert (bit.name or "").lower() in told
