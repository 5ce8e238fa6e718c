"""Two nodes with one node-id: what shows it in frames that all look right.

CAN has no sender address, so two units with the same node-id are one to every listener. Frames of theirs that are
equal and start at the same bit melt into one; frames that differ and collide become error frames. What is left,
and is looked for here and in the master:

- a frame that no SYNC asked for, and that lies elsewhere than the one before it: at once, and where the stranger
  answers first, with the next frame;
- positions of two shafts take turns (A B A B) closer together than one sender may send;
- one COB-ID comes twice as often as it was told to, for good: `SenderWatch`;
- heartbeats come twice as often as 0x1017 says: `HeartbeatWatch`;
- one SDO request gets two answers (the master's SDO port).

Two units that stand at the same angle and answer in step cannot be told apart, and then do no harm.
"""

from collections import deque

WINDOW = 32
"""SYNCs, or timer periods, in which frames are counted."""
DOUBLED = 1.5
"""So many times the expected frames, in two windows in a row: late frames that come in a burst fill only one."""
LATCH_NS = 2_000_000_000
"""A clash is over when it did not show for so long."""
ALTERNATION = 8
"""Two senders: positions repeat in turn, at least so many times closer than they lie apart ..."""
MINIMUM_COUNTS = 4
NOISE_TURN = 1 / 432_000
"""... and they lie further apart than noise: 3 arcsec, and 4 counts. What is closer is left to the rhythm."""
OWED_AT_FIRST = WINDOW
"""So many frames may be on their way when a node comes into service."""
OWED_NS = 2_000_000_000
"""A frame that was owed for so long, at all times, was lost or never sent."""
FREE_EVENT_TURN = 1 / 3600
"""Of a node that sends when it likes, only positions 0.1 deg apart count: its rhythm says nothing."""
HEARTBEATS = 8
HEARTBEAT_SHARE = 0.6


class SenderWatch:
    """Looks at every position frame of one COB-ID; True is evidence that two nodes send it."""

    __slots__ = (
        "_before",
        "_counts_per_rev",
        "_frames",
        "_full_windows",
        "_in_interval",
        "_least_counts",
        "_least_owed",
        "_owed",
        "_owed_since_ns",
        "_period_ns",
        "_synchronous",
        "_syncs",
        "_window_start_ns",
    )

    def __init__(self, counts_per_rev: int, *, synchronous: bool, period_ms: float | None) -> None:
        self._counts_per_rev = counts_per_rev
        self._least_counts = max(MINIMUM_COUNTS, counts_per_rev * NOISE_TURN)
        self._synchronous = synchronous
        """One frame a SYNC."""
        self._period_ns = None if period_ms is None else round(period_ms * 1e6)
        """One frame in so long; None: whenever the value changes."""
        self.forget()

    def forget(self) -> None:
        """The node left service: begin anew."""
        self._before: deque[tuple[int, int]] = deque(maxlen=3)
        self._in_interval = 0
        self._frames = self._syncs = self._full_windows = 0
        self._window_start_ns: int | None = None
        self._owed = self._least_owed = OWED_AT_FIRST
        """SYNCs that were not answered yet, and the least of them in the last while."""
        self._owed_since_ns: int | None = None

    def on_sync(self) -> bool:
        """A SYNC that the node answers; evidence where the last window was the second full one."""
        self._in_interval = 0
        self._owed += 1
        self._syncs += 1
        return self._synchronous and self._syncs == WINDOW and self._end_window()

    def on_position(self, counts: int, stamp_ns: int) -> bool:
        """A frame with this position arrived."""
        self._in_interval += 1
        self._frames += 1
        evidence = self._takes_turns(counts, stamp_ns) or (self._synchronous and self._unasked(counts, stamp_ns))
        self._before.append((counts, stamp_ns))
        if self._period_ns is not None and not self._synchronous:
            if self._window_start_ns is None:
                self._window_start_ns = stamp_ns
            elif stamp_ns - self._window_start_ns >= WINDOW * self._period_ns:
                self._window_start_ns = stamp_ns
                evidence = self._end_window() or evidence
        return evidence

    def _end_window(self) -> bool:
        self._full_windows = self._full_windows + 1 if self._frames > DOUBLED * WINDOW else 0
        self._frames = self._syncs = 0
        return self._full_windows >= 2

    def _unasked(self, counts: int, stamp_ns: int) -> bool:
        """One SYNC makes one frame: more of them, however late, are another node's, or one sent twice."""
        if self._in_interval > 1 and self._before and self._before[-1][0] == counts:
            return False  # sent twice, perhaps: it answers nothing
        if self._owed:
            self._owed -= 1
            self._least_owed = min(self._least_owed, self._owed)
            if self._owed_since_ns is None:
                self._owed_since_ns = stamp_ns
            elif stamp_ns - self._owed_since_ns > OWED_NS:
                self._owed -= self._least_owed
                self._least_owed, self._owed_since_ns = self._owed, stamp_ns
            return False
        if len(self._before) < 2:
            return False
        (b, _), (c, _) = list(self._before)[-2:]
        last = self._distance(c, counts)
        near = min(self._distance(b, c), self._distance(b, counts))
        return last >= self._least_counts and near * ALTERNATION <= last

    def _takes_turns(self, counts: int, stamp_ns: int) -> bool:
        if len(self._before) < 3 or (self._synchronous and self._in_interval < 2):
            return False
        (a, _), (b, b_ns), (c, c_ns) = self._before
        last, near = self._distance(c, counts), self._distance(b, counts)
        if last < self._least_counts or near * ALTERNATION > last:
            return False  # whatever the older ones say: a joint at rest or on its way, nearly every frame
        apart = min(self._distance(a, b), self._distance(b, c), last)
        near = max(self._distance(a, c), near)
        least = self._least_counts
        if not self._synchronous and self._period_ns is None:
            least = max(least, self._counts_per_rev * FREE_EVENT_TURN)
        if apart < least or near * ALTERNATION > apart:
            return False
        if self._synchronous or self._period_ns is None:
            return True
        return min(c_ns - b_ns, stamp_ns - c_ns) < 0.75 * self._period_ns

    def _distance(self, one: int, other: int) -> int:
        turned = (one - other) % self._counts_per_rev
        return min(turned, self._counts_per_rev - turned)


class HeartbeatWatch:
    """Looks at the rhythm of one node's heartbeats, whose period it confirmed."""

    __slots__ = ("_period_ns", "_stamps_ns")

    def __init__(self, period_ms: int) -> None:
        self._period_ns = period_ms * 1_000_000
        self._stamps_ns: deque[int] = deque(maxlen=HEARTBEATS + 1)

    def on_heartbeat(self, stamp_ns: int) -> bool:
        """True: they come too often for one node."""
        self._stamps_ns.append(stamp_ns)
        if len(self._stamps_ns) <= HEARTBEATS:
            return False
        return stamp_ns - self._stamps_ns[0] < HEARTBEAT_SHARE * HEARTBEATS * self._period_ns


class ClashLatch:
    """Holds a clash until the node was in service, looked at and without evidence for `LATCH_NS`.

    Out of service no frame is looked at, so that time does not count.
    """

    __slots__ = ("_since_ns", "active")

    def __init__(self) -> None:
        self.active = False
        self._since_ns: int | None = None

    def on_evidence(self, now_ns: int) -> bool:
        """True where it is the first: the clash begins."""
        began, self.active = not self.active, True
        self._since_ns = now_ns
        return began

    def on_service(self, now_ns: int | None) -> None:
        """The node came into service, or (None) left it."""
        self._since_ns = now_ns

    def ends(self, now_ns: int) -> bool:
        """True once, when it is over."""
        if not self.active or self._since_ns is None or now_ns - self._since_ns < LATCH_NS:
            return False
        self.active = False
        return True
