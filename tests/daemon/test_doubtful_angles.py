"""Angles that only look right: a velocity from meaningless stamps, a turn that nobody counted, heads apart."""

import math
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.daemon.test_heads import MS, PER_REV, Shaft
from tests.daemon.test_serving_policy import LIMITS, MARKER, MAS, VALID, Rig
from tests.daemon.test_serving_policy import PER_REV as RIG_PER_REV

from trueangle.core.health import NodeCondition, StatusBit
from trueangle.core.position import Mechanics, MotionLimits
from trueangle.core.serving import ServingPolicy

COMPENSATED = ServingPolicy(latency_max_ms=20.0)
GEARED = Mechanics(
    motor_turns=3, joint_turns=1, range_counts=4 * RIG_PER_REV, motion=MotionLimits(max_speed_deg_s=3600)
)
"""Four turns of the motor are no whole number of the joint's: after a wrap the counts alone tell no angle."""


def frame(rig: Rig, counts: int) -> tuple[int, bytes, int]:
    return (0x181, struct.pack("<I", counts), rig.now_ns)


@given(
    gaps_ns=st.lists(
        st.sampled_from([1_000, 5_000, 100_000, 900_000, 1_000_000, 5_000_000]), min_size=4, max_size=9
    ),
    speed_deg_s=st.sampled_from([-300.0, -1.0, 0.0, 1.0, 300.0]),
    wait_ms=st.sampled_from([0.0, 5.0, 19.0]),
)
def test_an_angle_moved_on_is_never_further_from_the_truth_than_the_joint_can_have_moved(
    gaps_ns: list[int], speed_deg_s: float, wait_ms: float
) -> None:
    """A node that sends every 1 ms by itself; its frames waited together and were read in one go, or two."""
    motion = MotionLimits(max_speed_deg_s=360.0)
    rig = Rig(COMPENSATED, mechanics=Mechanics(motion=motion), synchronous=False)
    sampled_s = 0.0
    for gap_ns in gaps_ns:
        rig.now_ns += gap_ns
        sampled_s += 1e-3
        rig.warm()
        rig.feed(frame(rig, round((90 + speed_deg_s * sampled_s) % 360 * 10_000)))
    rig.wait(wait_ms)
    served = rig.served
    assert VALID in served.status
    # From the last sample, at most as far as the joint moves in twice the age: never turns away from it.
    away_deg = abs(math.remainder(served.corrected / MAS - served.raw / MAS - 30 / 3600, 360.0))
    assert away_deg <= 360.0 * 2 * (wait_ms + 1.0) * 1e-3


def test_a_range_that_ran_over_leaves_a_geared_joint_unreferenced_when_its_node_comes_back() -> None:
    rig = Rig(mechanics=GEARED)
    for counts in (14_300_000, 14_350_000, 14_399_000, 1_000, 50_000):
        rig.pipeline.on_sync("arm", rig.now_ns)
        rig.now_ns += 5 * MS
        rig.feed(frame(rig, counts))
    assert StatusBit.NOT_REFERENCED in rig.served.status
    for condition in (NodeCondition.SILENT, NodeCondition.RUNNING):
        rig.run(condition)
    for _ in range(3):
        rig.pipeline.on_sync("arm", rig.now_ns)
        rig.now_ns += 5 * MS
        rig.feed(frame(rig, 50_000))
    assert StatusBit.NOT_REFERENCED in rig.served.status
    assert rig.served.corrected == MARKER


def test_neither_a_spike_nor_a_cleared_fault_references_a_joint_whose_range_ran_over() -> None:
    rig = Rig(mechanics=GEARED)
    spike = 5_000_000
    for counts in (14_300_000, 14_399_000, 1_000, *[1_000] * 5, spike, *[1_000] * 30):
        rig.pipeline.on_sync("arm", rig.now_ns)
        rig.now_ns += 5 * MS
        rig.feed(frame(rig, counts))
    assert StatusBit.POSITION_JUMP not in rig.served.status
    assert StatusBit.NOT_REFERENCED in rig.served.status
    rig.pipeline.clear_jump(1, rig.now_ns)
    assert rig.served.status & (VALID | StatusBit.NOT_REFERENCED) == StatusBit.NOT_REFERENCED
    rig.pipeline.set_referenced(1, rig.now_ns)
    assert VALID in rig.served.status


@pytest.mark.parametrize("uncertainty_arcsec", [-1.0, -0.001, math.nan, -math.inf, math.inf])
@pytest.mark.parametrize("second_head", [False, True])
def test_an_uncertainty_that_is_none_is_never_below_the_limit(
    uncertainty_arcsec: float, second_head: bool
) -> None:
    rig = Rig(limits=replace(LIMITS, max_uncertainty_arcsec=5.0), second_head=second_head).running()
    rig.model.uncertainty_arcsec = uncertainty_arcsec
    for angle_deg in (90.1, 90.2):
        rig.cycle(angle_deg)
    assert StatusBit.UNCERTAINTY_HIGH in rig.served.status
    assert rig.served.corrected == MARKER


def test_heads_of_two_syncs_are_not_averaged_however_close_the_syncs_came() -> None:
    """A late SYNC and the next one in time lie closer than a period; at 360 deg/s 0.3 ms are 389 arcsec."""
    shaft = Shaft((0.0, 180.0), {})
    shaft.turn_to(10.0)
    shaft.turn_to(10.0)
    shaft.now_ns += 300_000
    for head, track in enumerate(shaft.tracks):
        if head == 0:
            track.move_to(round((10.0 + 360.0 * 300e-6) / 360 * PER_REV), shaft.now_ns)
    shaft.fusion.fuse([True, True])
    assert shaft.fusion.raw_deg == pytest.approx(10.0 + 360.0 * 300e-6, abs=1e-5)
    assert shaft.fusion.lost


def test_a_late_head_is_not_averaged_with_one_that_missed_a_sync() -> None:
    """Both have the stamp of the SYNC before the last, and their samples are one SYNC apart."""
    rig = Rig(second_head=True)
    for angle_deg in (90.0, 91.0, 92.0):
        rig.cycle(angle_deg)
    rig.cycle(93.0, heads=(1,))
    rig.cycle(94.0, heads=(0,))
    rig.pipeline.on_sync("arm", rig.now_ns)
    rig.now_ns += MS
    late = (0x182, struct.pack("<I", 940_000 + 1_800_000), rig.now_ns)
    rig.feed(late, frame(rig, 950_000))
    assert rig.served.raw in (94 * MAS, 95 * MAS)
