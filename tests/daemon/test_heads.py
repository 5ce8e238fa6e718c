"""Several reading heads: what they cancel, what a lost one costs, and that nothing jumps."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueangle.core.heads import FADE_S, HeadFusion
from trueangle.core.position import Mechanics, PositionTrack

PER_REV = 2**28
"""A count is 0.005 arcsec: quantisation is out of the way."""
MS = 1_000_000
STEP_MS = 5
ECCENTRICITY_ARCSEC = 30.0


def angle_arcsec(one_deg: float, other_deg: float) -> float:
    return math.remainder(one_deg - other_deg, 360.0) * 3600


class Shaft:
    """A shaft with heads that read it with these harmonics of the place where each head stands."""

    def __init__(self, mounting_deg: tuple[float, ...], harmonics_arcsec: dict[int, float], zero_turns: int = 0):
        self.mounting_deg, self.harmonics_arcsec = mounting_deg, harmonics_arcsec
        self.tracks = [
            PositionTrack(PER_REV, Mechanics(range_counts=16 * PER_REV)) for _ in range(len(mounting_deg))
        ]
        self.fusion = HeadFusion(self.tracks, mounting_deg)
        self.zero_turns = zero_turns
        self.now_ns = 0

    def read_deg(self, head: int, shaft_deg: float) -> float:
        place_deg = shaft_deg + self.mounting_deg[head]
        error = sum(a * math.sin(math.radians(n * place_deg)) for n, a in self.harmonics_arcsec.items())
        return place_deg + error / 3600

    def turn_to(self, shaft_deg: float, lost: tuple[int, ...] = ()) -> float:
        """One SYNC; the fused angle."""
        self.now_ns += STEP_MS * MS
        for head, track in enumerate(self.tracks):
            if head not in lost:
                read_deg = self.read_deg(head, shaft_deg) + 360.0 * self.zero_turns
                track.move_to(round(read_deg / 360 * PER_REV) % (16 * PER_REV), self.now_ns)
        self.fusion.fuse([head not in lost for head in range(len(self.tracks))])
        assert self.fusion.raw_deg is not None
        return self.fusion.raw_deg


@settings(deadline=None)
@given(
    heads=st.integers(2, 4),
    shaft_deg=st.floats(0, 360),
    amplitude=st.floats(0.1, 100),
    harmonic=st.integers(1, 7),
)
def test_equally_spaced_heads_cancel_every_harmonic_that_is_no_multiple_of_their_number(
    heads: int, shaft_deg: float, amplitude: float, harmonic: int
) -> None:
    mounting = tuple(360.0 * k / heads for k in range(heads))
    fused_deg = Shaft(mounting, {harmonic: amplitude}).turn_to(shaft_deg)
    left = amplitude * math.sin(math.radians(harmonic * shaft_deg)) if harmonic % heads == 0 else 0.0
    # Half a count of each head.
    assert angle_arcsec(fused_deg, shaft_deg) == pytest.approx(left, abs=0.01)


def test_the_fused_angle_wraps_where_its_heads_lie_on_both_sides_of_zero_and_keeps_its_turns() -> None:
    shaft = Shaft((0.0, 180.0), {1: 3600.0}, zero_turns=3)
    for shaft_deg in (359.99, 359.9999, 0.0001, 0.01):
        fused_deg = shaft.turn_to(shaft_deg + (360 if shaft_deg < 1 else 0))
        assert angle_arcsec(fused_deg, shaft_deg) == pytest.approx(0, abs=0.01)
        assert shaft.fusion.turns == (4 if shaft_deg < 1 else 3)


@pytest.mark.parametrize("lost", [(0,), (1,)])
def test_a_lost_head_and_its_return_never_make_the_angle_jump(lost: tuple[int, ...]) -> None:
    shaft = Shaft((0.0, 180.0), {1: ECCENTRICITY_ARCSEC, 2: 3.0})
    step_deg, before = 0.36, None
    for sample in range(4000):
        missing = lost if 1250 <= sample < 2100 else ()
        fused_deg = shaft.turn_to(step_deg * sample, lost=missing)
        if before is not None:
            moved_arcsec = angle_arcsec(fused_deg, before)
            # The largest slope: of the eccentricity, 30 arcsec * 0.36 deg in radians; of the 2nd, 3 * 2 * that.
            # Fading gives back at most twice 2 * 30 arcsec in 1 s, 0.3 arcsec a sample.
            assert abs(moved_arcsec - step_deg * 3600) < 0.19 + 0.04 + 0.31, sample
        before = fused_deg
    assert not shaft.fusion.lost
    assert angle_arcsec(before or 0.0, step_deg * 3999) == pytest.approx(
        3.0 * math.sin(math.radians(2 * step_deg * 3999)), abs=0.02
    )


@settings(deadline=None, max_examples=60)
@given(st.integers(2, 4), st.integers(0, 99), st.integers(1, 99), st.data())
def test_the_error_after_the_loss_stays_within_the_uncertainty_that_is_told(
    heads: int, lost_at: int, on: int, data: st.DataObject
) -> None:
    mounting = tuple(360.0 * k / heads for k in range(heads))
    shaft = Shaft(mounting, {1: ECCENTRICITY_ARCSEC, 3: 7.0})
    lost = data.draw(st.integers(0, heads - 1))
    for sample in range(100):
        shaft.turn_to(3.6 * sample)
    for sample in range(100, 100 + lost_at):
        shaft.turn_to(3.6 * sample)
    fused_deg = math.nan
    for sample in range(100 + lost_at, 100 + lost_at + on):
        fused_deg = shaft.turn_to(3.6 * sample, lost=(lost,))
    full_deg = Shaft(mounting, {1: ECCENTRICITY_ARCSEC, 3: 7.0}).turn_to(3.6 * (100 + lost_at + on - 1))
    told = shaft.fusion.uncertainty_arcsec
    assert shaft.fusion.lost
    assert told is not None
    assert abs(angle_arcsec(fused_deg, full_deg)) <= told + 0.02
    # And it is no mere alarm: never more than the missing head itself reads wrong.
    assert told <= 2 * 2 * (ECCENTRICITY_ARCSEC + 7.0) / (heads - 1) + 0.1


def test_two_heads_lost_one_after_the_other_leave_an_angle_within_its_uncertainty() -> None:
    mounting = (0.0, 90.0, 180.0, 270.0)
    shaft = Shaft(mounting, {1: ECCENTRICITY_ARCSEC})
    for sample in range(1000):
        shaft.turn_to(0.36 * sample)
    for sample in range(1000, 2000):
        fused_deg = shaft.turn_to(0.36 * sample, lost=(1,) if sample < 1400 else (1, 3))
        told = shaft.fusion.uncertainty_arcsec
        assert told is not None
        assert abs(angle_arcsec(fused_deg, 0.36 * sample)) <= told + 0.02


def test_where_the_heads_were_never_seen_together_the_cost_of_a_lost_one_is_not_known() -> None:
    shaft = Shaft((0.0, 180.0), {1: ECCENTRICITY_ARCSEC})
    for sample in range(100):
        shaft.turn_to(0.36 * sample)  # 36 deg of the turn
    shaft.turn_to(20.0, lost=(1,))
    assert shaft.fusion.uncertainty_arcsec is not None
    shaft.turn_to(200.0, lost=(1,))
    assert shaft.fusion.uncertainty_arcsec is None


def test_a_head_missing_from_the_start_costs_an_unknown_uncertainty() -> None:
    shaft = Shaft((0.0, 180.0), {1: ECCENTRICITY_ARCSEC})
    shaft.turn_to(90.0, lost=(1,))
    assert (shaft.fusion.lost, shaft.fusion.uncertainty_arcsec) == (True, None)
    shaft.turn_to(90.0)
    assert (shaft.fusion.lost, shaft.fusion.uncertainty_arcsec) == (False, 0.0)


def test_a_head_that_answers_another_sync_takes_no_part() -> None:
    """At 72 deg/s one SYNC of 5 ms is 1296 arcsec: the mean of two times would be half of that off."""
    shaft = Shaft((0.0, 180.0), {})
    for sample in range(10):
        shaft.turn_to(0.36 * sample)
    fused_deg = shaft.turn_to(3.6, lost=())
    shaft.now_ns += STEP_MS * MS
    shaft.tracks[0].move_to(round(3.96 / 360 * PER_REV), shaft.now_ns)
    shaft.fusion.fuse([True, True])
    assert shaft.fusion.lost
    assert angle_arcsec(shaft.fusion.raw_deg or 0.0, fused_deg) == pytest.approx(0.36 * 3600, abs=0.01)


def test_heads_that_disagree_say_by_how_much() -> None:
    shaft = Shaft((0.0, 180.0), {})
    shaft.turn_to(10.0)
    assert shaft.fusion.disagreement_arcsec < 0.01
    shaft.now_ns += STEP_MS * MS
    shaft.tracks[0].move_to(round(10.0 / 360 * PER_REV), shaft.now_ns)
    shaft.tracks[1].move_to(round(192.0 / 360 * PER_REV), shaft.now_ns)
    shaft.fusion.fuse([True, True])
    assert shaft.fusion.disagreement_arcsec == pytest.approx(3600.0, abs=0.1)


def test_the_fading_difference_is_counted_as_uncertainty() -> None:
    shaft = Shaft((0.0, 180.0), {1: ECCENTRICITY_ARCSEC})
    for sample in range(1000):
        shaft.turn_to(0.36 * sample)
    for sample in range(1000, 1250):  # lost at 0 deg, back at 90 deg: 30 arcsec apart
        shaft.turn_to(0.36 * sample, lost=(1,))
    fused_deg = shaft.turn_to(0.36 * 1250)
    assert shaft.fusion.lost
    assert shaft.fusion.uncertainty_arcsec == pytest.approx(30.0 * math.exp(-STEP_MS / 1e3 / FADE_S), rel=0.01)
    assert abs(angle_arcsec(fused_deg, 90.0)) == pytest.approx(shaft.fusion.uncertainty_arcsec, abs=0.02)
