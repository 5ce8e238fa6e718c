"""Whether a temperature can behave as this one does: it neither freezes nor jumps.

Rules of this file: a value that jumped is implausible, and so are the next ones, until `SETTLE_VALUES` in a row
lie within the rate of each other, so that a sensor that comes back from a fault does not flicker. A value that
never changes in its last bit is a frozen converter, where the configuration says so.
"""

from dataclasses import dataclass

SETTLE_VALUES = 5
RATE_MARGIN_C = 0.5
"""A step that is no jump whatever the interval: noise, and the quantisation of common sensors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureLimits:
    """What a temperature of this joint cannot do. None: not looked for."""

    frozen_s: float | None = None
    """No change of the raw value for longer: frozen."""
    max_rate_c_per_s: float | None = None


class TemperatureWatch:
    """Mutable state of one temperature source."""

    __slots__ = ("_changed_ns", "_raw", "_stamp_ns", "_unsettled", "_value_c", "limits")

    def __init__(self, limits: TemperatureLimits) -> None:
        self.limits = limits
        self.forget()

    def forget(self) -> None:
        """The source left service."""
        self._raw: int | None = None
        self._value_c = 0.0
        self._stamp_ns = self._changed_ns = 0
        self._unsettled = 0
        """Values to come before a jump is forgotten."""

    def take(self, raw: int, value_c: float, stamp_ns: int) -> None:
        """A new value, as received and in degC."""
        rate = self.limits.max_rate_c_per_s
        if rate is not None and self._raw is not None:
            elapsed_s = max(0, stamp_ns - self._stamp_ns) * 1e-9
            if abs(value_c - self._value_c) > rate * elapsed_s + RATE_MARGIN_C:
                self._unsettled = SETTLE_VALUES
            elif self._unsettled:
                self._unsettled -= 1
        if raw != self._raw:
            self._raw, self._changed_ns = raw, stamp_ns
        self._value_c, self._stamp_ns = value_c, stamp_ns

    def plausible(self, now_ns: int) -> bool:
        """Neither frozen nor jumped."""
        frozen_s = self.limits.frozen_s
        frozen = frozen_s is not None and self._raw is not None and now_ns - self._changed_ns > frozen_s * 1e9
        return not frozen and self._unsettled == 0
