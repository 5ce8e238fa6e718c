"""What shows that two nodes share one node-id, and what only looks like it."""

from hypothesis import given
from hypothesis import strategies as st

from trueangle.core.clash import LATCH_NS, WINDOW, ClashLatch, HeartbeatWatch, SenderWatch

COUNTS_PER_REV = 3_600_000
MS = 1_000_000


def synchronous() -> SenderWatch:
    return SenderWatch(COUNTS_PER_REV, synchronous=True, period_ms=None)


def test_two_shafts_in_turn_are_told_within_the_second_sync() -> None:
    """A B A B, two frames a SYNC: four frames, before many of them were served."""
    watch = synchronous()
    told: list[bool] = []
    for sync in range(2):
        watch.on_sync()
        told += [watch.on_position(counts, sync * 5 * MS) for counts in (1000 + sync, 2_000_000 - sync)]
    assert told == [False, False, False, True]


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
