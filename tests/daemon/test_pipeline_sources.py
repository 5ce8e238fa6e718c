"""Positions and temperatures that come by other ways than a SYNC of the encoder's own node; two nodes with one id.

Time is an argument here: nothing waits, and no wall clock is asked.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from trueangle.config import JointConfig, parse_config
from trueangle.core.frames import Quantity
from trueangle.core.health import NodeCondition, StatusBit
from trueangle.core.pipeline import Frame, Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.process_data import node_plans
from trueangle.service import joint_channel, joint_identity, load_joints

MODELS = Path(__file__).parents[1] / "data" / "models"
MS = 1_000_000
GOOD = StatusBit.CONFIGURED | StatusBit.VALID
REST = 1_234_567
SENSOR = 40


def joint(slot: int, *, temperature: str = "", more: str = "") -> str:
    """Joint 1 has good.onnx, joint 2 its twin."""
    model = "good.onnx" if slot == 1 else "twin.onnx"
    return (
        f"  - {{slot: {slot}, name: j{slot}, bus: arm, node_id: {slot}, model: {model}, {more}\n"
        f"     encoder: {{counts_per_rev: 3276800}},\n"
        f"     temperature: {{index: 0x7130, subindex: {slot}, degc_per_unit: 0.01, stale_s: 2, "
        f"{temperature}}}}}\n"
    )


@dataclass
class Line:
    """The pipeline of these joints on one bus; nodes in service, SYNC seen, positions at rest."""

    text: str
    now_ns: int = 10**12
    images: list[RegisterImage] = field(default_factory=list[RegisterImage])
    asked: list[tuple[int, str]] = field(default_factory=list[tuple[int, str]])

    def __post_init__(self) -> None:
        head = "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: c0}]\njoints:\n"
        config = parse_config(head + self.text, source="t.yaml")
        loaded = load_joints(config, base=MODELS, source="t.yaml")
        self.joints: dict[int, JointConfig] = {j.slot: j for j in config.joints}
        plans = node_plans(config.joints, "arm")
        self.pipeline = Pipeline(
            [joint_channel(entry) for entry in loaded],
            RegisterMap([joint_identity(entry) for entry in loaded]),
            publish=self.images.append,
            on_status=lambda slot, before, after: None,
            sensors=[("arm", plan) for plan in plans],
            on_clash=lambda slot, reason: self.asked.append((slot, reason)),
        )
        self.pipeline.on_bus("arm", up=True, now_ns=self.now_ns)
        for plan in plans:
            if plan.slot is not None:
                self.pipeline.on_node(plan.slot, NodeCondition.RUNNING, self.now_ns)
            self.pipeline.on_sensor("arm", plan.node_id, NodeCondition.RUNNING, self.now_ns)

    def feed(self, *frames: tuple[int, bytes]) -> None:
        batch: list[Frame] = [(cob_id, data, self.now_ns) for cob_id, data in frames]
        self.pipeline.on_frames("arm", batch, self.now_ns)

    def cycle(self, *slots: int, counts: int = REST, sync: bool = True) -> None:
        """5 ms: SYNC, 1 ms later positions of these slots."""
        if sync:
            self.pipeline.on_sync("arm", self.now_ns)
        self.now_ns += MS
        self.feed(*(position(slot, counts) for slot in slots))
        self.now_ns += 4 * MS

    def run(self, seconds: float, *slots: int, sync: bool = True, also: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds * 200)):
            self.cycle(*slots, sync=sync)
            if also is not None:
                also()

    def status(self, slot: int) -> StatusBit:
        self.pipeline.tick(self.now_ns)
        data = self.images[-1].read(10 + 12 * (slot - 1), 2)
        assert data is not None
        return StatusBit(int.from_bytes(data, "big"))


def position(slot: int, counts: int = REST) -> tuple[int, bytes]:
    return (0x180 + slot, struct.pack("<I", counts))


# Temperature on another node


def remote(slot: int, more: str = "") -> str:
    return joint(slot, temperature=f"node_id: {SENSOR}, tpdo: {{trigger: event}}, {more}")


def test_temperatures_of_one_frame_reach_their_joints() -> None:
    line = Line(remote(1) + remote(2))
    line.cycle(1, 2)
    line.feed((0x180 + SENSOR, struct.pack("<hh", 2500, -400)))
    assert line.status(1) == GOOD
    assert line.status(2) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_OUTSIDE_MODEL


def test_silent_sensor_on_a_living_node_is_fresh_and_on_a_dead_one_is_not() -> None:
    """CiA 404 units send only at a change of 1 degC by default: an hour of silence is nothing wrong."""
    line = Line(remote(1))
    line.cycle(1)
    line.pipeline.on_value(1, Quantity.TEMPERATURE, 2500, line.now_ns)  # asked once, when it came into service
    line.run(10, 1, also=lambda: line.pipeline.on_alive("arm", SENSOR, line.now_ns))
    assert line.status(1) == GOOD
    line.run(2.1, 1)  # no heartbeat any more
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_sensor_that_sends_by_sync_is_not_kept_fresh_by_its_nodes_life() -> None:
    """Its node lives, but the frames that it owes do not come."""
    line = Line(joint(1))
    line.cycle(1)
    line.feed((0x281, struct.pack("<h", 2500)))
    assert line.status(1) == GOOD
    line.run(2.1, 1, also=lambda: line.pipeline.on_alive("arm", 1, line.now_ns))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_life_of_a_node_that_never_told_a_temperature_makes_none_fresh() -> None:
    line = Line(remote(1))
    line.run(1, 1, also=lambda: line.pipeline.on_alive("arm", SENSOR, line.now_ns))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_sensor_node_that_leaves_service_takes_its_temperatures_with_it() -> None:
    line = Line(remote(1) + joint(2))
    line.cycle(1, 2)
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), (0x282, struct.pack("<h", 2500)))
    line.pipeline.on_sensor("arm", SENSOR, NodeCondition.NOT_READY, line.now_ns)
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)))  # before it was identified again: not believed
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    assert line.status(2) == GOOD


def test_reboot_of_the_encoder_does_not_forget_the_temperature_of_another_node() -> None:
    line = Line(remote(1))
    line.pipeline.on_value(1, Quantity.TEMPERATURE, 2500, line.now_ns)
    line.pipeline.on_node(1, NodeCondition.NOT_READY, line.now_ns)
    line.pipeline.on_node(1, NodeCondition.RUNNING, line.now_ns)
    line.cycle(1)
    assert line.status(1) == GOOD


def test_sensor_frame_of_another_length_is_never_decoded() -> None:
    line = Line(remote(1))
    line.cycle(1)
    line.feed((0x180 + SENSOR, b"\xc4\x09\x00"))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    assert line.pipeline.counters.misfit_frames == 1


def test_status_of_the_sensor_breaks_the_temperature_and_mends_it() -> None:
    line = Line(joint(1, temperature="status: {index: 0x6150, subindex: 1}"))
    line.cycle(1)
    line.feed((0x281, struct.pack("<hB", 2500, 0)))
    assert line.status(1) == GOOD
    line.feed((0x281, struct.pack("<hB", 2500, 1)))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_BROKEN
    line.feed((0x281, struct.pack("<hB", 2500, 0)))
    assert line.status(1) == GOOD


def test_temperature_counts_for_nothing_until_its_status_was_told() -> None:
    line = Line(joint(1, temperature="status: {index: 0x6150, subindex: 1, poll_ms: 100}"))
    line.cycle(1)
    line.feed((0x281, struct.pack("<h", 2500)))
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    line.pipeline.on_value(1, Quantity.TEMPERATURE_STATUS, 0, line.now_ns)
    assert line.status(1) == GOOD


# Positions without SYNC


TIMER = "tpdo: {trigger: timer, period_ms: 5}, "


def test_timer_driven_joint_beside_synchronous_ones_has_the_age_of_its_arrival() -> None:
    line = Line(joint(1) + joint(2, more=TIMER))
    line.feed((0x281, struct.pack("<h", 2500)), (0x282, struct.pack("<h", 2500)))
    line.run(0.5, 1)
    line.feed(position(2))
    line.now_ns += 3 * MS
    line.pipeline.tick(line.now_ns)
    assert line.pipeline.states[2].age_ms == pytest.approx(3.0)
    assert line.status(2) == GOOD


def test_timer_driven_joint_knows_no_lost_sync() -> None:
    line = Line(joint(1) + joint(2, more=TIMER))
    line.feed((0x281, struct.pack("<h", 2500)), (0x282, struct.pack("<h", 2500)))
    line.run(0.5, 1, 2)
    line.run(0.2, 1, 2, sync=False)  # both go on sending, though nobody sends SYNC
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.SYNC_LOST | StatusBit.STALE
    assert line.status(2) == GOOD
    line.run(0.1, 1, 2)
    assert line.status(1) == GOOD


def test_joint_that_waits_for_no_sync_does_not_hold_up_the_cycle_of_the_others() -> None:
    line = Line(joint(1) + joint(2, more=TIMER))
    line.run(0.1, 1, 2)
    images = len(line.images)
    line.pipeline.on_sync("arm", line.now_ns)
    line.feed(position(1))
    assert len(line.images) == images + 1


# Two nodes, one id


def test_two_senders_take_the_joint_out_until_they_were_asked_and_one_is_left() -> None:
    line = Line(joint(1) + joint(2))
    warm = [(0x281, struct.pack("<h", 2500)), (0x282, struct.pack("<h", 2500))]
    line.feed(*warm)
    line.run(0.2, 1, 2)
    assert line.status(1) == GOOD
    for _ in range(2):  # a second unit with node-id 1 was plugged in
        line.pipeline.on_sync("arm", line.now_ns)
        line.now_ns += MS
        line.feed(position(1), position(1, 2_000_000), position(2))
        line.now_ns += 4 * MS
    assert StatusBit.NODE_ID_CLASH in line.status(1)
    assert StatusBit.VALID not in line.status(1)
    assert line.status(2) == GOOD
    assert line.asked == [(1, "two nodes send its positions")]
    # The master asks who it is; by then the second unit is gone again.
    line.pipeline.on_node(1, NodeCondition.NOT_READY, line.now_ns)
    line.pipeline.on_node(1, NodeCondition.RUNNING, line.now_ns)
    line.feed(*warm)
    line.run(1.9, 1, 2)
    assert StatusBit.NODE_ID_CLASH in line.status(1)
    line.feed(*warm)
    line.run(0.2, 1, 2)
    assert line.asked[1:] == [(1, "two nodes sent its positions, one is left")]
    assert StatusBit.NODE_ID_CLASH not in line.status(1)


def test_doubled_frame_is_no_clash_and_refreshes_nothing_for_long() -> None:
    """CAN itself repeats a frame whose last bit was disturbed for its sender alone."""
    line = Line(joint(1))
    line.feed((0x281, struct.pack("<h", 2500)))
    for i in range(100):
        line.pipeline.on_sync("arm", line.now_ns)
        line.now_ns += MS
        line.feed(*[position(1)] * (2 if i % 10 == 0 else 1))
        line.now_ns += 4 * MS
    assert line.status(1) == GOOD
    assert line.asked == []
    line.now_ns += 51 * MS
    assert StatusBit.STALE in line.status(1)
