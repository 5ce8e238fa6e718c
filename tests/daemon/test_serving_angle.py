"""How the served angle is made: the user's zero, the way since the sample, several reading heads."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.daemon.test_serving_policy import CONFIGURED, HOLD, MARKER, MAS, MS, RAW, VALID, Rig

from trueangle.core.health import NodeCondition, StatusBit
from trueangle.core.position import Mechanics, MotionLimits
from trueangle.core.serving import ServingPolicy


@settings(deadline=None)
@given(st.floats(-720, 720), st.floats(0, 359.999))
def test_a_user_zero_moves_what_is_served_and_nothing_else(zero_deg: float, angle_deg: float) -> None:
    rig = Rig().running(angle_deg=angle_deg)
    before, asked = rig.served, len(rig.model.asked_deg)
    rig.pipeline.set_user_zero(1, zero_deg, rig.now_ns)
    rig.cycle(angle_deg)
    served = rig.served
    assert rig.model.asked_deg[asked:] == [rig.model.asked_deg[asked - 1]]
    assert served.raw == before.raw
    moved_mas = math.remainder(before.corrected - served.corrected - zero_deg * MAS, 360 * MAS)
    # Two roundings to a milli-arcsecond.
    assert abs(moved_mas) <= 1.0
    assert (StatusBit.USER_PRESET in served.status) == (zero_deg != 0)
    assert abs(math.remainder(served.user_zero - zero_deg * MAS, 360 * MAS)) <= 0.51
    assert VALID in served.status


def test_held_and_raw_angles_are_in_the_frame_of_the_user_too() -> None:
    for policy in (HOLD, RAW):
        rig = Rig(policy, user_zero_deg=10.0).running()
        if policy is RAW:
            rig.model.correction_arcsec = math.nan
            rig.cycle()
        else:
            rig.wait(60)
        expected = 80 * MAS + (30_000 if policy is HOLD else 0)
        assert rig.served.corrected == expected


def test_latency_compensation_moves_the_angle_on_and_asks_the_model_about_the_sample() -> None:
    rig = Rig(ServingPolicy(latency_max_ms=4.0))
    for angle_deg in (90.0, 90.5, 91.0):  # 100 deg/s
        rig.cycle(angle_deg)
    served = rig.served
    assert served.status == VALID | CONFIGURED | StatusBit.LATENCY_COMPENSATED
    # Published 1 ms after its SYNC: 0.1 deg further.
    assert served.corrected == pytest.approx(91.1 * MAS + 30_000, abs=1)
    assert served.raw == 91 * MAS
    assert rig.model.asked_deg[-1] == 91.0
    # 0.1 deg * 50 us / 5 ms = 3.6 arcsec, 2 arcsec of the model; the counts give 0.03.
    assert served.uncertainty == pytest.approx(100 * math.hypot(3.6, 2.0), rel=1e-3)
    rig.pipeline.tick(rig.now_ns)  # 5 ms old: beyond the limit
    assert rig.served.status == VALID | CONFIGURED
    assert rig.served.corrected == 91 * MAS + 30_000
    assert [after for _, after in rig.changes if StatusBit.LATENCY_COMPENSATED in after] in ([], [served.status])


def test_nothing_is_compensated_before_a_velocity_is_known() -> None:
    rig = Rig(ServingPolicy(latency_max_ms=100.0))
    for _ in range(2):
        rig.cycle()
        assert rig.served.status == VALID | CONFIGURED


def test_a_lost_head_leaves_a_valid_angle_that_says_so() -> None:
    rig = Rig(second_head=True).running()
    rig.cycle(heads=(0,))
    rig.cycle(heads=(0,))
    assert rig.served.status == VALID | CONFIGURED | StatusBit.HEAD_LOST
    assert rig.served.corrected == 90 * MAS + 30_000
    rig.pipeline.on_node(1, NodeCondition.NOT_READY, rig.now_ns, head=1)
    assert rig.served.status == VALID | CONFIGURED | StatusBit.HEAD_LOST


def test_the_first_head_may_be_the_one_that_is_lost() -> None:
    rig = Rig(second_head=True).running()
    rig.cycle(heads=())
    rig.feed((0x182, struct.pack("<I", 270 * 10_000), rig.now_ns))
    rig.cycle(heads=())
    rig.feed((0x182, struct.pack("<I", 270 * 10_000), rig.now_ns))
    assert rig.served.status & ~StatusBit.HEAD_LOST == VALID | CONFIGURED
    assert rig.served.raw == 90 * MAS


def test_no_head_left_is_no_angle() -> None:
    rig = Rig(second_head=True).running()
    rig.run(NodeCondition.NOT_READY)
    assert StatusBit.NODE_NOT_READY in rig.served.status
    assert (rig.served.corrected, rig.served.raw) == (MARKER, MARKER)


def test_a_head_that_jumped_or_differs_takes_no_part() -> None:
    motion = Mechanics(motion=MotionLimits(max_speed_deg_s=100.0))
    rig = Rig(second_head=True, mechanics=motion).running()
    for _ in range(3):
        rig.pipeline.on_sync("arm", rig.now_ns)
        rig.now_ns += MS
        first, second = struct.pack("<I", 900_000), struct.pack("<I", 300_000)
        rig.feed((0x181, first, rig.now_ns), (0x182, second, rig.now_ns))
        rig.now_ns += 4 * MS
    assert rig.served.status == VALID | CONFIGURED | StatusBit.HEAD_LOST
    assert rig.served.corrected == 90 * MAS + 30_000
    rig.pipeline.on_node(1, NodeCondition.DIFFERS, rig.now_ns, head=1)
    rig.cycle()
    assert StatusBit.HEAD_LOST in rig.served.status
    assert rig.served.raw == 90 * MAS


def test_heads_too_far_apart_are_a_fault() -> None:
    rig = Rig(second_head=True, max_head_difference_arcsec=60.0).running()
    rig.pipeline.on_sync("arm", rig.now_ns)
    rig.now_ns += MS
    rig.feed((0x181, struct.pack("<I", 900_000), rig.now_ns), (0x182, struct.pack("<I", 2_701_000), rig.now_ns))
    assert rig.served.status == CONFIGURED | StatusBit.NODE_FAULT
