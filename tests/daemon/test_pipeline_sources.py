"""Positions and temperatures that come by other ways than a SYNC of the encoder's own node; two nodes with one id.

Time is an argument here: nothing waits, and no wall clock is asked.
"""

import struct

import pytest
from tests.fakes.pipeline_line import GOOD, MS, Line, joint, position

from trueangle.core.frames import Quantity
from trueangle.core.health import NodeCondition, ServiceBit, StatusBit

SENSOR = 40


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


# A sensor on another bus


def elsewhere(slot: int, more: str = "") -> str:
    return joint(slot, temperature=f"bus: leg, node_id: {SENSOR}, {more}")


def test_temperature_comes_from_a_node_on_another_bus_and_from_no_other() -> None:
    line = Line(elsewhere(1), buses=("arm", "leg"))
    assert 0x180 + SENSOR in line.pipeline.process_data("leg")
    assert 0x180 + SENSOR not in line.pipeline.process_data("arm")
    line.cycle(1)
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), bus="arm")  # the same COB-ID there is somebody else's
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), bus="leg")
    assert line.status(1) == GOOD


def test_sensor_bus_that_goes_down_takes_the_temperature_with_it_and_is_told() -> None:
    line = Line(elsewhere(1), buses=("arm", "leg"))
    line.cycle(1)
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), bus="leg")
    assert line.service() == ServiceBit.ALL_VALID
    line.pipeline.on_sensor("leg", SENSOR, NodeCondition.NOT_READY, line.now_ns)
    line.pipeline.on_bus("leg", up=False, now_ns=line.now_ns)
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    assert line.service() == ServiceBit.BUS_DOWN


def test_node_with_the_encoders_id_on_another_bus_is_not_the_encoder() -> None:
    """Both have node-id 1: the life of one says nothing of the other."""
    line = Line(joint(1, temperature="bus: leg, node_id: 1, tpdo: {trigger: event}"), buses=("arm", "leg"))
    line.cycle(1)
    line.feed((0x181, struct.pack("<h", 2500)), bus="leg")
    assert line.status(1) == GOOD
    line.pipeline.on_sensor("leg", 1, NodeCondition.NOT_READY, line.now_ns)
    assert line.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_sync_of_the_sensors_bus_is_none_of_the_encoders() -> None:
    line = Line(elsewhere(1), buses=("arm", "leg"))
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), bus="leg")
    line.run(0.1, 1)
    line.pipeline.on_sync("leg", line.now_ns)
    line.run(0.2, 1, sync=False, also=lambda: line.pipeline.on_sync("leg", line.now_ns))
    assert StatusBit.SYNC_LOST in line.status(1)


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
    assert line.asked == [("arm", 1, "two nodes send its positions")]
    # The master asks who it is; by then the second unit is gone again.
    line.pipeline.on_node(1, NodeCondition.NOT_READY, line.now_ns)
    line.pipeline.on_node(1, NodeCondition.RUNNING, line.now_ns)
    line.feed(*warm)
    line.run(1.9, 1, 2)
    assert StatusBit.NODE_ID_CLASH in line.status(1)
    line.feed(*warm)
    line.run(0.2, 1, 2)
    assert line.asked[1:] == [("arm", 1, "two nodes sent its positions, one is left")]
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


HEADS = "further_heads: [{node_id: 9, mounting_deg: 180, encoder: {counts_per_rev: 3276800}}], "


def heads(line: Line, *second: int) -> None:
    """One SYNC: the first head at 0 deg, and what is sent with the second head's node-id."""
    line.pipeline.on_sync("arm", line.now_ns)
    line.now_ns += MS
    line.feed(position(1, 0), *(position(9, counts) for counts in second))
    line.now_ns += 4 * MS


def test_clash_of_a_further_head_costs_only_that_head_and_ends_when_one_is_left() -> None:
    line = Line(joint(1, more=HEADS))
    line.feed((0x281, struct.pack("<h", 2500)))
    for _ in range(40):
        heads(line, 1_638_400)
    assert line.status(1) == GOOD
    for _ in range(2):
        heads(line, 1_638_400, 99_000)
    assert StatusBit.HEAD_LOST in line.status(1)
    assert line.asked == [("arm", 9, "two nodes send its positions")]
    line.pipeline.on_node(1, NodeCondition.NOT_READY, line.now_ns, head=1)
    line.pipeline.on_node(1, NodeCondition.RUNNING, line.now_ns, head=1)
    for _ in range(500):
        heads(line, 1_638_400)
    assert line.asked[1:] == [("arm", 9, "two nodes sent its positions, one is left")]
    line.pipeline.on_node(1, NodeCondition.NOT_READY, line.now_ns, head=1)
    line.pipeline.on_node(1, NodeCondition.RUNNING, line.now_ns, head=1)
    line.feed((0x281, struct.pack("<h", 2500)))
    for _ in range(500):
        heads(line, 1_638_400)
    line.feed((0x281, struct.pack("<h", 2500)))
    assert line.status(1) == GOOD
    assert len(line.asked) == 2


@pytest.mark.parametrize("second", ["a joint", "a sensor"])
def test_sync_of_another_bus_between_two_heads_does_not_fuse_half_a_sample(second: str) -> None:
    leg = joint(2).replace("bus: arm", "bus: leg") if second == "a joint" else ""
    line = Line(joint(1, temperature=f"bus: leg, node_id: {SENSOR}", more=HEADS) + leg, buses=("arm", "leg"))
    line.feed((0x180 + SENSOR, struct.pack("<h", 2500)), bus="leg")
    seen: set[StatusBit] = set()
    for cycle in range(40):
        line.pipeline.on_sync("arm", line.now_ns)
        line.now_ns += MS
        line.feed(position(1, 0))
        line.pipeline.on_sync("leg", line.now_ns)
        line.feed(position(2), bus="leg")
        line.pipeline.on_bus("leg", up=cycle % 2 == 0, now_ns=line.now_ns)
        if cycle > 2:
            seen.add(line.status(1))
        line.feed(position(9, 1_638_400))
        line.now_ns += 4 * MS
        if cycle > 2:
            seen.add(line.status(1))
    assert seen == {GOOD}


def test_heads_of_a_bus_whose_sync_ceased_do_not_hold_up_the_cycles_of_another_bus() -> None:
    leg = joint(2, more=HEADS).replace("bus: arm", "bus: leg")
    line = Line(joint(1) + leg, buses=("arm", "leg"))
    line.feed((0x281, struct.pack("<h", 2500)))
    for _ in range(3):
        line.pipeline.on_sync("leg", line.now_ns)
        line.feed(position(2, 0), position(9, 1_638_400), bus="leg")
        line.cycle(1)
    line.pipeline.on_sync("leg", line.now_ns)  # the last one, and nobody answers it any more
    line.run(0.2, 1)
    images = len(line.images)
    line.pipeline.on_sync("arm", line.now_ns)
    line.now_ns += MS
    line.feed(position(1))
    assert len(line.images) == images + 1
    assert line.pipeline.states[1].age_ms == pytest.approx(1.0)
