"""Rules of time on a CAN bus: when SYNC is due, and how long to wait before trying again."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SyncStep:
    """Where the SYNC schedule goes on."""

    deadline_ns: int
    """Monotonic time at which the next SYNC is due."""
    skipped: int
    """Whole periods that went by without a SYNC, because the process came too late for them."""


def next_sync(deadline_ns: int, period_ns: int, now_ns: int) -> SyncStep:
    """The step after the SYNC that was due at `deadline_ns` and left at `now_ns >= deadline_ns`.

    Deadlines stay on the grid `deadline_ns + k * period_ns`, so lateness never adds up; a deadline already in
    the past is skipped and counted, so the nodes never see a burst that makes up for lost time.
    """
    skipped = max(0, (now_ns - deadline_ns) // period_ns)
    return SyncStep(deadline_ns=deadline_ns + (skipped + 1) * period_ns, skipped=skipped)


def backoff_s(failures: int, first_s: float, limit_s: float) -> float:
    """The pause after `failures` failures in a row (>= 1): `first_s`, doubled each time, at most `limit_s`."""
    return min(limit_s, first_s * 2.0 ** min(failures - 1, 30))
