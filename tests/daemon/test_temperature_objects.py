"""Temperatures as their makers have them: CiA 404, CiA 401, a vendor's object; mapped, told by change, polled."""

import struct
from dataclasses import dataclass

import pytest
from tests.fakes.canopen_device import Address
from tests.fakes.master_bench import BRISK, NODE_ID, bench, run
from tests.fakes.pipeline_line import GOOD, Line, joint

from trueangle.config import parse_config
from trueangle.contract.errors import ContractError
from trueangle.core.frames import NodePlan, Quantity
from trueangle.core.health import StatusBit
from trueangle.core.node_setup import NodeState
from trueangle.process_data import node_plans

HEAD = "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: c0}]\njoints:\n"
INTERRUPT: Address = (0x6423, 0)


@dataclass(frozen=True, kw_only=True)
class Unit:
    """A temperature module: what the configuration says of it, what it holds at 25 degC."""

    keys: str
    objects: dict[Address, tuple[int, int]]
    entry: int
    frame: bytes
    raw: int

    def yaml(self, more: str = "") -> str:
        text = joint(1, temperature=f"node_id: {NODE_ID}, {more}")
        return text.replace("index: 0x7130, subindex: 1, degc_per_unit: 0.01", self.keys)


CIA_404 = Unit(
    keys="index: 0x7130, subindex: 1, degc_per_unit: 0.1",
    objects={(0x7130, 1): (250, 2), (0x6132, 1): (1, 1)},
    entry=0x7130_0110,
    frame=struct.pack("<h", 250),
    raw=250,
)
CIA_401 = Unit(
    keys="index: 0x6401, subindex: 2, degc_per_unit: 0.01220703125, offset_c: -50",  # 32768 are 400 K
    objects={(0x6401, 2): (6144, 2), INTERRUPT: (1, 1)},
    entry=0x6401_0210,
    frame=struct.pack("<h", 6144),
    raw=6144,
)
VENDOR = Unit(
    keys="index: 0x2120, subindex: 0, bits: 8, degc_per_unit: 1, offset_c: -64, signed: false",
    objects={(0x2120, 0): (89, 1)},
    entry=0x2120_0008,
    frame=b"\x59",
    raw=89,
)
UNITS = pytest.mark.parametrize("unit", [CIA_404, CIA_401, VENDOR], ids=["cia404", "cia401", "vendor"])


def sensor_plan(text: str) -> NodePlan:
    plans = node_plans(parse_config(HEAD + text, source="t.yaml").joints, "arm")
    (plan,) = [plan for plan in plans if plan.node_id == NODE_ID]
    return plan


def shown_c(line: Line) -> float | None:
    line.pipeline.tick(line.now_ns)
    return line.pipeline.states[1].temperature_c


@UNITS
@pytest.mark.parametrize(
    "way", ["every_syncs: 10", "tpdo: {trigger: timer, period_ms: 500}"], ids=["sync", "timer"]
)
def test_mapped_temperature_is_set_up_read_back_and_served_in_degrees(unit: Unit, way: str) -> None:
    async def scenario() -> None:
        objects = unit.objects | {(0x1800, 5): (0, 2)}
        async with bench(plan=sensor_plan(unit.yaml(way)), device={"objects": objects}) as b:
            await b.until(NodeState.RUNNING)
        assert b.device.objects[0x1A00, 1] == (unit.entry, 4)

    run(scenario)
    line = Line(unit.yaml(way))
    line.cycle(1)
    line.feed((0x180 + NODE_ID, unit.frame))
    assert shown_c(line) == pytest.approx(25.0, abs=1e-9)
    assert line.status(1) == GOOD


@UNITS
def test_temperature_that_cannot_be_mapped_is_polled(unit: Unit) -> None:
    text = unit.yaml("poll_ms: 10")

    async def scenario() -> None:
        async with bench(plan=sensor_plan(text), device={"objects": unit.objects}) as b:
            await b.until(NodeState.RUNNING)
            await b.until_true(lambda: len(b.values) >= 3)
            assert set(b.values) == {(1, Quantity.TEMPERATURE, unit.raw)}
            assert b.device.objects[0x1800, 1][0] & 0x8000_0000  # nothing is mapped: no frame is wanted

    run(scenario)
    line = Line(text)
    line.cycle(1)
    line.pipeline.on_value(1, Quantity.TEMPERATURE, unit.raw, line.now_ns)
    assert shown_c(line) == pytest.approx(25.0, abs=1e-9)
    assert line.status(1) == GOOD


@UNITS
def test_temperature_told_by_change_alone_lives_with_its_node(unit: Unit) -> None:
    line = Line(unit.yaml("tpdo: {trigger: event}"))
    line.cycle(1)
    line.pipeline.on_value(1, Quantity.TEMPERATURE, unit.raw, line.now_ns)
    line.run(5, 1, also=lambda: line.pipeline.on_alive("arm", NODE_ID, line.now_ns))
    assert line.status(1) == GOOD
    line.run(2.1, 1)
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_temperature_that_owes_a_frame_by_its_event_timer_is_not_kept_fresh_by_heartbeats() -> None:
    """Unchanged would have been sent again: silence of the value, not of the node, is a dead sensor."""
    line = Line(CIA_404.yaml("tpdo: {trigger: event, period_ms: 500}"))
    line.cycle(1)
    line.pipeline.on_value(1, Quantity.TEMPERATURE, CIA_404.raw, line.now_ns)
    assert line.status(1) == GOOD
    line.run(2.1, 1, also=lambda: line.pipeline.on_alive("arm", NODE_ID, line.now_ns))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_temperature_that_is_sent_less_often_than_it_goes_stale_is_refused() -> None:
    with pytest.raises(ContractError, match=r"tpdo\.period_ms: expected less than stale_s \(2 s\), found 2000 ms"):
        sensor_plan(CIA_404.yaml("tpdo: {trigger: timer, period_ms: 2000}"))


def test_analogue_input_that_does_not_tell_of_changes_is_a_fault_until_it_does() -> None:
    """CiA 401 has 0x6423 FALSE by default: no change is ever sent, and silence would look like calm."""
    plan = sensor_plan(CIA_401.yaml("tpdo: {trigger: event}"))

    async def scenario() -> None:
        objects = CIA_401.objects | {INTERRUPT: (0, 1)}
        async with bench(plan=plan, timing=BRISK, device={"objects": objects}) as b:
            report = await b.until(NodeState.FAULT)
            assert "0x6423:0 expected 1 found 0" in report.reason
            b.device.objects[INTERRUPT] = (1, 1)
            await b.until(NodeState.RUNNING)
            await b.until_true(lambda: (1, Quantity.TEMPERATURE, CIA_401.raw) in b.values)

    run(scenario)


def test_analogue_input_that_sends_with_sync_needs_no_interrupt() -> None:
    assert sensor_plan(CIA_401.yaml()).expected == ()
