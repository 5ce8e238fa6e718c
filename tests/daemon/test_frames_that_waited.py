"""Frames that lay in the socket while the process stood still have the age of their arrival."""

import time
from contextlib import AsyncExitStack

import pytest
from tests.fakes.can_bus_ear import run, socketcan_ear

MS = 1_000_000
STALL_NS = 200 * MS
ROUNDING_NS = 100_000
"""Between two readings of two clocks."""


@pytest.mark.parametrize("step_ns", [0, -3600 * 1000 * MS, 3600 * 1000 * MS, -150 * MS, 150 * MS])
def test_a_stall_makes_no_frame_younger_also_when_the_wall_clock_is_set_meanwhile(
    step_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel stamps frames by the wall clock, and that may jump."""

    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            for number in range(3):
                buses[0].put(0x181, bytes((number,)))
            sent_ns = time.monotonic_ns()
            # The loop has not turned since: what follows is as if the process had been stopped and went on.
            read_wall_ns, read_ns = time.time_ns, time.monotonic_ns
            with monkeypatch.context() as patched:
                patched.setattr(time, "time_ns", lambda: read_wall_ns() + STALL_NS + step_ns)
                patched.setattr(time, "monotonic_ns", lambda: read_ns() + STALL_NS)
                await ear.until(lambda: len(ear.frames) == 3)
            for _, _, stamp_ns in ear.frames:
                assert stamp_ns <= sent_ns + ROUNDING_NS

    run(scenario)


@pytest.mark.parametrize("step_ns", [-3600 * 1000 * MS, 3600 * 1000 * MS, -500 * MS, 500 * MS])
def test_a_clock_that_was_set_while_nothing_came_makes_no_frame_older(
    step_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As time servers do at boot: a sample a whole period too old looks like a jump, or stale."""

    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        read_wall_ns, read_ns = time.time_ns, time.monotonic_ns
        async with AsyncExitStack() as stack:
            with monkeypatch.context() as patched:
                patched.setattr(time, "time_ns", lambda: read_wall_ns() - STALL_NS - step_ns)
                patched.setattr(time, "monotonic_ns", lambda: read_ns() - STALL_NS)
                await stack.enter_async_context(near)
                await ear.until_up()
            # The socket has been empty for a while, and the clock was set in it.
            sent_ns = time.monotonic_ns()
            buses[0].put(0x181, b"")
            await ear.until(lambda: len(ear.frames) == 1)
            assert sent_ns - ROUNDING_NS <= ear.frames[0][2] <= time.monotonic_ns()

    run(scenario)


def test_frames_that_were_read_at_once_have_the_time_of_their_reading_or_before() -> None:
    async def scenario() -> None:
        ear, buses, near = socketcan_ear()
        async with near:
            await ear.until_up()
            before_ns = time.monotonic_ns()
            buses[0].put(0x181, b"")
            await ear.until(lambda: len(ear.frames) == 1)
            assert before_ns - ROUNDING_NS <= ear.frames[0][2] <= time.monotonic_ns()

    run(scenario)
