"""When a synchronous sample was taken: which SYNC a frame answers, however late the frame is.

A node samples at SYNC and numbers its samples (its sequence object, else the count of its frames), so the distance
between SYNC number and sample number is constant while the link is prompt. Delay can only make it look larger:
the smallest distance of the last seconds is the true one, and a frame that arrives after later SYNCs is still
given the time of its own. A SYNC that the node missed makes the distance larger for good; until the window has
passed, its samples then look one period older than they are, never younger. A delay that never varies cannot be
told from the distance itself and stays invisible.
"""

from collections import deque

WINDOW_NS = 2_000_000_000
"""A distance is forgotten after one to two windows."""
KEPT_SYNCS = 4096
"""Four seconds at 1 kHz; older SYNCs have the time of the oldest one kept, which is old enough."""


class SyncHistory:
    """The SYNCs of one bus."""

    __slots__ = ("_stamps_ns", "number")

    def __init__(self) -> None:
        self.number = 0
        """SYNCs seen so far; 0: none, the bus has no SYNC."""
        self._stamps_ns: deque[int] = deque(maxlen=KEPT_SYNCS)

    def add(self, stamp_ns: int) -> None:
        """A SYNC was sent or seen."""
        self.number += 1
        self._stamps_ns.append(stamp_ns)

    @property
    def last_ns(self) -> int | None:
        """The time of the last SYNC; None: none was seen."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    def stamp_ns(self, number: int) -> int:
        """The time of that SYNC; of the nearest kept one where it is not kept."""
        behind = self.number - number
        if behind <= 0:
            return self._stamps_ns[-1]
        return self._stamps_ns[-1 - min(behind, len(self._stamps_ns) - 1)]


class SampleTime:
    """Gives one joint's samples the time of the SYNC that they answer."""

    __slots__ = ("_before", "_now", "_window_start_ns")

    def __init__(self) -> None:
        self._now: int | None = None
        self._before: int | None = None
        self._window_start_ns = 0

    def stamp_ns(self, sample_number: int, history: SyncHistory, received_ns: int) -> int:
        """The time of sample `sample_number`, which arrived at `received_ns`."""
        if history.number == 0:
            return received_ns
        distance = history.number - sample_number
        if self._now is None or received_ns - self._window_start_ns > WINDOW_NS:
            self._before, self._now, self._window_start_ns = self._now, distance, received_ns
        elif distance < self._now:
            self._now = distance
        nearest = self._now if self._before is None or self._now < self._before else self._before
        # No sample is younger than its frame: a number that jumped makes the distance too small.
        return min(received_ns, history.stamp_ns(sample_number + nearest))
