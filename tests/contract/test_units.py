"""Angles wrap into [0, 360) and subtract by the shorter way."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trueangle.contract.units import angle_difference_deg, wrap_deg

ANGLES = st.floats(min_value=-1e6, max_value=1e6)


@given(ANGLES)
def test_a_wrapped_angle_is_at_least_0_and_less_than_360(angle_deg: float) -> None:
    assert 0.0 <= wrap_deg(angle_deg) < 360.0


def test_a_tiny_negative_angle_wraps_to_0_and_not_to_360() -> None:
    # -1e-20 % 360 rounds to 360.0 in binary64
    assert wrap_deg(-1e-20) == 0.0
    assert wrap_deg(np.array([-1e-20, 359.5, 720.25])).tolist() == [0.0, 359.5, 0.25]


@given(st.floats(min_value=0, max_value=359.999), st.integers(min_value=-100, max_value=100))
def test_whole_turns_do_not_change_a_difference(angle_deg: float, turns: int) -> None:
    # 36000 deg has a spacing of 7e-12 deg
    assert abs(angle_difference_deg(angle_deg + 360.0 * turns, angle_deg)) < 1e-10


def test_the_difference_crosses_the_seam_by_the_shorter_way() -> None:
    assert angle_difference_deg(0.5, 359.5) == 1.0
    assert angle_difference_deg(359.5, 0.5) == -1.0
    assert angle_difference_deg(np.array([180.0, 10.0]), 0.0).tolist() == [-180.0, 10.0]
