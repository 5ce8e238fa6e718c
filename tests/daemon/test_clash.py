"""What shows that two nodes share one node-id, and what only looks like it."""

import math
import random

from hypothesis import given, settings
from hypothesis import strategies as st

from trueangle.core.clash import LATCH_NS, WINDOW, ClashLatch, HeartbeatWatch, SenderWatch

COUNTS_PER_REV = 3_600_000
MS = 1_000_000


def synchronous() -> SenderWatch:
    return SenderWatch(COUNTS_PER_REV, synchronous=True, period_ms=None)


def after_lone_service(syncs: int = 500) -> SenderWatch:
    """2.5 s of one shaft that turns, each SYNC answered."""
    watch = synchronous()
    for sync in range(syncs):
        watch.on_sync()
        assert not watch.on_position(1000 + sync, sync * 5 * MS)
    return watch


def told_of_two(watch: SenderWatch, *, stranger_first: bool, from_sync: int = 500) -> list[bool]:
    told: list[bool] = []
    for sync in range(from_sync, from_sync + 2):
        watch.on_sync()
        counts = (1000 + sync, 2_000_000 - sync)
        places = reversed(counts) if stranger_first else counts
        told += [watch.on_position(place, sync * 5 * MS) for place in places]
    return told


def test_first_frame_of_a_second_shaft_tells_where_it_comes_behind_the_first_ones() -> None:
    """A SYNC asks for one frame: another one, that comes from elsewhere, is somebody else's."""
    assert told_of_two(after_lone_service(), stranger_first=False)[:2] == [False, True]


def test_second_shaft_that_answers_before_the_first_is_told_by_the_next_frame() -> None:
    """Nothing tells the stranger's frame from a jump until the other one has come, too."""
    assert told_of_two(after_lone_service(), stranger_first=True)[:2] == [False, True]


def test_two_shafts_from_the_start_are_told_within_the_second_sync() -> None:
    """A B A B: how many frames the bus still owed is not known yet."""
    assert told_of_two(synchronous(), stranger_first=False, from_sync=0) == [False, False, False, True]


def test_frames_lost_long_ago_do_not_hide_a_second_shaft() -> None:
    watch = synchronous()
    for sync in range(2000):
        watch.on_sync()
        if sync not in (20, 30, 700):
            assert not watch.on_position(1000 + sync, sync * 5 * MS)
    assert told_of_two(watch, stranger_first=False, from_sync=2000)[:2] == [False, True]


def test_doubled_frame_of_one_shaft_is_no_clash_at_rest_or_turning() -> None:
    """CAN sends a frame again whose last bit was disturbed for its sender alone."""
    for step in (0, 1, 4000):
        watch = synchronous()
        for sync in range(1000):
            assert not watch.on_sync()
            for _ in range(2 if sync % 7 == 0 else 1):
                assert not watch.on_position(1000 + step * sync, sync * 5 * MS)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), speed=st.integers(-40_000, 40_000), noise=st.integers(0, 3))
def test_late_lost_and_doubled_frames_of_one_shaft_are_no_clash(seed: int, speed: int, noise: int) -> None:
    """A bus that stalls, recovers, loses and repeats, under a shaft that swings to and fro and rests."""
    chance = random.Random(seed)  # noqa: S311 - comes again with its seed
    watch = synchronous()
    waiting: list[int] = []
    place, stalled = 0.0, 0
    for sync in range(1200):
        assert not watch.on_sync()
        place += speed * math.sin(sync / 150) if sync % 600 < 450 else 0
        if chance.random() > 0.01:
            waiting.append((round(place) + chance.randint(-noise, noise)) % COUNTS_PER_REV)
        stalled = stalled - 1 if stalled else chance.choice((0,) * 60 + (3, 20))
        held = len(waiting) if stalled else 0 if chance.random() < 0.9 else 1
        while len(waiting) > held:
            counts = waiting.pop(0)
            for _ in range(2 if chance.random() < 0.01 else 1):
                assert not watch.on_position(counts, sync * 5 * MS)


@given(start=st.integers(0, COUNTS_PER_REV), step=st.integers(-400_000, 400_000), noise=st.integers(0, 3))
def test_one_shaft_that_turns_is_no_clash_however_late_its_frames(start: int, step: int, noise: int) -> None:
    """Each second SYNC brings no frame, the next two: a node that answers late."""
    watch = synchronous()
    for sync in range(4 * WINDOW):
        assert not watch.on_sync()
        for frame in (2 * (sync // 2), 2 * (sync // 2) + 1) if sync % 2 else ():
            counts = (start + frame * step + (frame % 2) * noise) % COUNTS_PER_REV
            assert not watch.on_position(counts, sync * 5 * MS)


def test_vibration_at_half_the_sync_rate_is_no_clash() -> None:
    """The positions take turns, but one comes with each SYNC."""
    watch = synchronous()
    for sync in range(4 * WINDOW):
        assert not watch.on_sync()
        assert not watch.on_position(1000 + 500 * (sync % 2), sync * 5 * MS)


def test_two_shafts_at_one_angle_are_told_by_their_rhythm() -> None:
    watch = synchronous()
    told = False
    for sync in range(2 * WINDOW):
        told = watch.on_sync() or told
        for _ in range(2):
            assert not watch.on_position(1000, sync * 5 * MS)
    assert told


def test_burst_after_a_stall_is_no_clash() -> None:
    """A gateway holds 40 frames back and then sends them at once: one window is full, the next is not."""
    watch = synchronous()
    for sync in range(6 * WINDOW):
        assert not watch.on_sync()
        frames = 0 if sync < 40 else 41 if sync == 40 else 1
        for frame in range(frames):
            assert not watch.on_position(1000 + 10 * (sync + frame), sync * 5 * MS)


def test_two_timers_in_turn_are_told_without_sync() -> None:
    watch = SenderWatch(COUNTS_PER_REV, synchronous=False, period_ms=10)
    told = [watch.on_position(1000 if i % 2 == 0 else 9000, (10 * (i // 2) + 3 * (i % 2)) * MS) for i in range(4)]
    assert told == [False, False, False, True]


def test_two_timers_at_one_angle_are_told_by_their_rhythm() -> None:
    watch = SenderWatch(COUNTS_PER_REV, synchronous=False, period_ms=10)
    assert any(watch.on_position(1000, 5 * i * MS) for i in range(5 * WINDOW))
    watch = SenderWatch(COUNTS_PER_REV, synchronous=False, period_ms=10)
    assert not any(watch.on_position(1000, 10 * i * MS) for i in range(5 * WINDOW))


def test_dithering_of_a_node_that_sends_on_change_is_no_clash() -> None:
    watch = SenderWatch(COUNTS_PER_REV, synchronous=False, period_ms=None)
    assert not any(watch.on_position(1000 + 50 * (i % 2), i * MS) for i in range(100))
    assert any(watch.on_position(1000 + 500_000 * (i % 2), i * MS) for i in range(4))


def test_heartbeats_of_one_node_are_no_clash_and_of_two_are() -> None:
    one, two = HeartbeatWatch(200), HeartbeatWatch(200)
    assert not any(one.on_heartbeat(200 * i * MS + (i % 3) * 20 * MS) for i in range(100))
    assert any(two.on_heartbeat(100 * i * MS) for i in range(10))


def test_clash_is_over_only_after_time_in_service_without_evidence() -> None:
    latch = ClashLatch()
    assert latch.on_evidence(0)
    assert not latch.on_evidence(1)
    latch.on_service(None)  # taken out to be identified again
    assert not latch.ends(10 * LATCH_NS)
    latch.on_service(10 * LATCH_NS)
    assert not latch.ends(11 * LATCH_NS - 1)
    assert latch.ends(11 * LATCH_NS)
    assert not latch.active
