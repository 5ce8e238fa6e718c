"""Which changes of a joint's status are worth a line in the log: an outage's begin and end, and what came between.

Rules of this file: an outage is the time between two moments of VALID; its begin is one line, a reason that it
had not had yet is one line, its end is one line with the duration of each reason. A joint that flaps is said to
flap, is then silent but for a sum now and then, and speaks again after it was quiet for a while. Nothing is lost
by silence: outages and their time are counted on.
"""

from collections import deque
from dataclasses import dataclass

from trueangle.core.health import INFORMATION, StatusBit

FLAPPING_OUTAGES = 6
"""So many outages that begin within `FLAPPING_WINDOW_S` are flapping: 12 lines a minute are read by nobody."""
FLAPPING_WINDOW_S = 60.0
QUIET_S = 60.0
"""Without a change for so long, a flapping joint is over it."""
SUM_INTERVAL_S = 600.0

NO_REASONS = StatusBit.VALID | StatusBit.CONFIGURED | INFORMATION


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLine:
    """One line: an event word and key=value."""

    warning: bool
    text: str


def reason_words(status: StatusBit) -> list[str]:
    """The bits that speak against a joint, as words."""
    return [bit.name.lower() for bit in status & ~NO_REASONS if bit.name]


class OutageLog:
    """The outages of one joint since the start; `now_ns` is monotonic."""

    def __init__(self, slot: int, name: str, now_ns: int) -> None:
        self._who = f"slot={slot} joint={name!r}"
        self.outages = 0
        """Begun since the start; the one until the joint is first valid is not counted."""
        self._ended_ns = 0
        """Time of all outages that have ended."""
        self._since_ns: int | None = now_ns
        """Begin of the present outage; None while the joint is valid."""
        self._begun: dict[str, int] = {}
        """Reasons that hold, and since when."""
        self._lasted_ns: dict[str, int] = {}
        """Reasons of this outage and their time so far, without the present stretch."""
        self._begins_ns: deque[int] = deque(maxlen=FLAPPING_OUTAGES)
        self._flapping_since_ns: int | None = None
        self._flaps = 0
        """`outages` when the flapping was last told."""
        self._told_ns = now_ns
        self._changed_ns = now_ns

    def invalid_s(self, now_ns: int) -> float:
        """Time without a valid angle since the start."""
        running_ns = 0 if self._since_ns is None else now_ns - self._since_ns
        return (self._ended_ns + running_ns) * 1e-9

    def restart(self, now_ns: int) -> None:
        """The joint is brought up anew: what held of it before holds no more."""
        if self._since_ns is None:
            self._since_ns = now_ns
        self._begun.clear()
        self._lasted_ns.clear()

    def change(self, status: StatusBit, now_ns: int) -> list[LogLine]:
        """The status word is now this; the lines to log."""
        self._changed_ns = now_ns
        reasons = [] if StatusBit.VALID in status else reason_words(status)
        for reason in [reason for reason in self._begun if reason not in reasons]:
            self._lasted_ns[reason] += now_ns - self._begun.pop(reason)
        unheard = [reason for reason in reasons if reason not in self._lasted_ns]
        for reason in reasons:
            self._begun.setdefault(reason, now_ns)
            self._lasted_ns.setdefault(reason, 0)
        if StatusBit.VALID in status:
            return self._end(now_ns)
        if self._since_ns is None:
            return self._begin(reasons, now_ns)
        if not unheard or self._flapping_since_ns is not None:
            return []
        event = "joint_not_valid" if len(unheard) == len(self._lasted_ns) else "joint_reason_added"
        return [self._line(event, f"reasons={','.join(reasons)} count={self.outages}", warning=True)]

    def _begin(self, reasons: list[str], now_ns: int) -> list[LogLine]:
        self._since_ns = now_ns
        self.outages += 1
        self._begins_ns.append(now_ns)
        if self._flapping_since_ns is not None:
            return []
        first_ns = self._begins_ns[0]
        if len(self._begins_ns) == FLAPPING_OUTAGES and now_ns - first_ns <= FLAPPING_WINDOW_S * 1e9:
            self._flapping_since_ns = self._told_ns = now_ns
            self._flaps = self.outages
            about = (
                f"outages={FLAPPING_OUTAGES} within_s={(now_ns - first_ns) * 1e-9:.1f} reasons={','.join(reasons)}"
            )
            return [self._line("joint_flapping", f"{about} count={self.outages}", warning=True)]
        return [self._line("joint_not_valid", f"reasons={','.join(reasons)} count={self.outages}", warning=True)]

    def _end(self, now_ns: int) -> list[LogLine]:
        if self._since_ns is None:
            return []
        lasted_ns, self._since_ns = now_ns - self._since_ns, None
        self._ended_ns += lasted_ns
        shares = ",".join(f"{reason}:{ns * 1e-9:.3f}" for reason, ns in self._lasted_ns.items())
        self._lasted_ns.clear()
        if self._flapping_since_ns is not None:
            return []
        about = f"after_s={lasted_ns * 1e-9:.3f} reasons_s={shares or 'none'} count={self.outages}"
        return [self._line("joint_valid", about, warning=False)]

    def tick(self, now_ns: int) -> list[LogLine]:
        """What is due although nothing changed."""
        since_ns = self._flapping_since_ns
        if since_ns is None:
            return []
        if now_ns - self._changed_ns >= QUIET_S * 1e9:
            self._flapping_since_ns = None
            self._begins_ns.clear()
            state = "valid" if self._since_ns is None else f"not_valid reasons={','.join(self._begun)}"
            about = f"lasted_s={(self._changed_ns - since_ns) * 1e-9:.1f} outages={self.outages - self._flaps}"
            return [
                self._line("joint_flapping_over", f"{about} state={state}", warning=self._since_ns is not None)
            ]
        if now_ns - self._told_ns >= SUM_INTERVAL_S * 1e9:
            self._told_ns = now_ns
            about = f"for_s={(now_ns - since_ns) * 1e-9:.0f} outages={self.outages - self._flaps}"
            return [self._line("joint_flaps_on", f"{about} count={self.outages}", warning=True)]
        return []

    def _line(self, event: str, about: str, *, warning: bool) -> LogLine:
        return LogLine(warning=warning, text=f"event={event} {self._who} {about}")
