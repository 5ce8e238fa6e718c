"""Counts to angle: wraps, direction, gear, jumps, references; numbers from arithmetic of their own."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueangle.core.position import Mechanics, MotionLimits, PositionTrack, extrapolate

MS = 1_000_000
PER_REV = 36_000
"""One count is 0.01 deg."""
SLOW = MotionLimits(max_speed_deg_s=100.0, margin_deg=0.1, jitter_ms=1.0, settle_samples=3)
"""At 5 ms: at most 0.7 deg between two samples."""


def track(per_rev: int = PER_REV, **mechanics: object) -> PositionTrack:
    return PositionTrack(per_rev, Mechanics(**mechanics))  # pyright: ignore[reportArgumentType]


def follow(position: PositionTrack, *angles_deg: float, start_ms: int = 0) -> None:
    """One sample each 5 ms."""
    for number, angle_deg in enumerate(angles_deg):
        position.move_to(round(angle_deg * 100), (start_ms + 5 * number) * MS)


@settings(deadline=None)
@given(
    per_rev=st.integers(2, 2**32),
    revolutions=st.integers(1, 8),
    start=st.integers(0, 2**34),
    steps=st.lists(st.integers(-(2**30), 2**30), max_size=20),
    direction=st.sampled_from((1, -1)),
    gear=st.tuples(st.integers(1, 500), st.integers(1, 500)),
)
def test_turns_and_angle_together_are_the_way_travelled_across_every_wrap(
    per_rev: int, revolutions: int, start: int, steps: list[int], direction: int, gear: tuple[int, int]
) -> None:
    """The position unrolled, by fractions that never wrap, against what the track makes of wrapped counts."""
    total = per_rev * (revolutions + 1)
    position = track(
        per_rev, range_counts=total, direction=direction, motor_turns=gear[0], joint_turns=gear[1], absolute=False
    )
    unrolled = start % total
    position.move_to(unrolled, 0)
    for number, step in enumerate(steps, start=1):
        # Half of the range or more in one interval cannot be told from the other way round.
        limit = max(0, (total - 1) // 2 - 1)
        unrolled += max(-limit, min(limit, step))
        position.move_to(unrolled % total, number * MS)
    joint_turns = Fraction(direction * unrolled * gear[1], per_rev * gear[0])
    assert position.raw_deg is not None
    assert position.turns is not None
    assert 0.0 <= position.raw_deg < 360.0
    # Rounding of one division in binary64, at most 360.
    assert abs(float(joint_turns - position.turns) * 360.0 - position.raw_deg) < 1e-9


@settings(deadline=None)
@given(st.integers(2, 2**32), st.integers(0, 2**32 - 1))
def test_direction_minus_one_mirrors_the_angle(per_rev: int, counts: int) -> None:
    there, back = track(per_rev), track(per_rev, direction=-1)
    there.move_to(counts, 0)
    back.move_to(counts, 0)
    assert there.raw_deg is not None
    assert back.raw_deg is not None
    assert (there.raw_deg + back.raw_deg) % 360.0 == pytest.approx(0.0, abs=1e-9) or (
        there.raw_deg + back.raw_deg
    ) == pytest.approx(360.0, abs=1e-9)


def test_velocity_has_the_sign_of_the_joint_and_goes_on_across_the_end_of_the_range() -> None:
    total = 3 * PER_REV
    for direction in (1, -1):
        position = track(range_counts=total, direction=direction)
        position.move_to(total - 10, 0)
        position.move_to(10, 5 * MS)  # 20 counts, 0.2 deg in 5 ms
        assert position.velocity_deg_s == pytest.approx(direction * 40.0)


def test_a_single_turn_encoder_counts_no_turns_that_a_start_would_forget() -> None:
    position = track(range_counts=PER_REV)
    follow(position, 359.9, 0.1, 0.3)
    assert position.turns == 0
    assert position.velocity_deg_s == pytest.approx(40.0)


def test_a_motor_encoder_whose_range_is_no_whole_joint_turn_loses_its_reference_where_the_range_ends() -> None:
    """4 motor turns are 0.4 joint turns: after the wrap a start would place the joint 0.4 turns away."""
    position = track(range_counts=4 * PER_REV, motor_turns=10)
    position.move_to(4 * PER_REV - 5, 0)
    assert position.referenced
    position.move_to(5, 5 * MS)
    assert not position.referenced


def test_no_range_told_leaves_whole_revolutions() -> None:
    position = track()
    position.move_to(3 * PER_REV + 9000, 0)
    assert (position.turns, position.raw_deg) == (3, 90.0)
    position.move_to(2**32 - 1, 5 * MS)
    assert position.turns == (2**32 - 1) // PER_REV


def test_a_movement_within_the_speed_is_believed_also_after_a_long_silence() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.6, 11.2)
    position.move_to(9000, 5_000 * MS)  # 90 deg, five seconds later
    assert not position.jumped
    assert position.velocity_deg_s is not None


def test_a_jump_is_not_believed_and_the_joint_is_not_referenced() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.0, 12.0)
    assert position.jumped
    assert not position.referenced
    assert position.velocity_deg_s is None


def test_a_preset_that_stays_is_never_believed_however_consistent() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.0, *([50.0] * 1000))
    assert position.jumped
    position.clear_jump()
    assert not position.jumped
    assert position.referenced


def test_a_spike_is_believed_again_after_so_many_consistent_samples() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.0, 80.0, 10.1, 10.1, 10.1)
    assert position.jumped
    follow(position, 10.1, start_ms=30)
    assert not position.jumped
    assert position.referenced


def test_a_second_jump_to_yet_another_place_proves_nothing() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.0, 80.0, 40.0, *([40.0] * 100))
    assert position.jumped


def test_a_return_after_the_joint_could_have_got_there_proves_nothing() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 10.0, *([80.0] * 200), *([10.0] * 100))  # 1 s: the joint can have moved 100 deg
    assert position.jumped


def test_a_spike_from_a_moved_zero_is_no_return_to_where_it_was() -> None:
    position = track(motion=SLOW)
    moved = [50.0 - 0.25 * n for n in range(60)]  # a zero moved by 40 deg, a shaft that turns on at 50 deg/s
    follow(position, 10.0, 10.0, *moved, 170.0, *[moved[-1] - 0.25 * n for n in range(2, 100)])
    assert position.jumped


def test_a_node_identified_anew_is_believed() -> None:
    position = track(motion=SLOW)
    follow(position, 10.0, 80.0)
    position.forget()
    follow(position, 80.0, 80.0)
    assert not position.jumped
    assert position.referenced


def test_an_encoder_without_absolute_zero_is_referenced_by_its_reference_alone_and_not_after_a_jump() -> None:
    position = track(motion=SLOW, absolute=False)
    follow(position, 10.0, 10.0)
    assert not position.referenced
    position.set_referenced()
    follow(position, 10.0, 80.0, 10.0, 10.0, 10.0, 10.0, start_ms=10)
    assert not position.jumped
    assert not position.referenced


def test_two_samples_of_one_time_are_judged_by_the_jitter() -> None:
    position = track(motion=SLOW)
    position.move_to(1000, 0)
    position.move_to(1019, 0)  # 0.19 deg: 0.1 deg in 1 ms of jitter, 0.1 deg margin
    assert not position.jumped
    position.move_to(1040, 0)
    assert position.jumped


def test_the_way_since_the_sample_has_the_uncertainty_of_its_velocity() -> None:
    position = track()
    follow(position, 10.0, 10.5, 11.0)
    way = extrapolate(position, 0.002)
    assert way is not None
    assert way.moved_deg == pytest.approx(0.2)
    # 0.01 deg counts, 36 arcsec: 36 / sqrt(6) * 2/5 = 5.879; jitter: 0.2 deg * 50 us / 5 ms = 7.2 arcsec.
    assert way.uncertainty_arcsec == pytest.approx((5.879**2 + 7.2**2) ** 0.5, rel=1e-3)


def test_an_accelerating_joint_costs_uncertainty_and_an_unknown_velocity_gives_no_way() -> None:
    position = track()
    follow(position, 10.0)
    assert extrapolate(position, 0.002) is None
    follow(position, 10.0, 10.5, start_ms=5)
    steady = extrapolate(position, 0.002)
    follow(position, 11.5, start_ms=15)
    accelerating = extrapolate(position, 0.002)
    assert steady is not None
    assert accelerating is not None
    # From 100 to 200 deg/s in 5 ms: 20,000 deg/s2 * 2 ms * 7 ms / 2 = 0.14 deg.
    assert accelerating.uncertainty_arcsec == pytest.approx(0.14 * 3600, rel=1e-3)
