"""What a CAN controller says of its bus by error frames, and when that is a trouble and when it is over.

Source of the bits: linux/can/error.h; socketcand tells the class alone. A driver need not say that all is well
again, so a trouble also ends when nothing was heard of it for `QUIET_NS`.
"""

import enum
from dataclasses import dataclass

QUIET_NS = 5_000_000_000

_CONTROLLER, _PROTOCOL, _NO_ACKNOWLEDGE, _BUS_OFF, _BUS_ERROR, _RESTARTED = 0x04, 0x08, 0x20, 0x40, 0x80, 0x100
_RX_OVERFLOW, _TX_OVERFLOW, _RX_WARNING, _TX_WARNING, _RX_PASSIVE, _TX_PASSIVE, _ACTIVE = (
    1 << n for n in range(7)
)
_CONTROLLER_BYTE = 1


class ControllerState(enum.Enum):
    """The error state of a CAN controller (ISO 11898-1), as far as an error frame tells it."""

    ACTIVE = "error-active"
    WARNING = "error warning"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFrame:
    """What one error frame says."""

    state: ControllerState | None
    """None: it says nothing of the state."""
    text: str
    lost_frames: bool = False
    """The controller had no room: frames are missing that no socket counts."""


def read_error_frame(error_class: int, data: bytes) -> ErrorFrame:
    """The meaning of an error frame: `error_class` is its CAN id without flags, `data` may be missing."""
    detail = data[_CONTROLLER_BYTE] if len(data) > _CONTROLLER_BYTE else 0
    if error_class & _BUS_OFF:
        return ErrorFrame(state=ControllerState.BUS_OFF, text="bus-off")
    lost = bool(error_class & _CONTROLLER and detail & _RX_OVERFLOW)
    state: ControllerState | None = None
    if error_class & _RESTARTED:
        state = ControllerState.ACTIVE
    if error_class & _CONTROLLER:
        if detail & (_RX_PASSIVE | _TX_PASSIVE):
            state = ControllerState.PASSIVE
        elif detail & (_RX_WARNING | _TX_WARNING) or not detail:
            state = ControllerState.WARNING  # without detail it speaks of one of them, which is not told
        elif detail & _ACTIVE:
            state = ControllerState.ACTIVE
    words = [] if state is None else [state.value]
    words += ["receive buffer of the controller overran"] if lost else []
    words += ["nobody acknowledges"] if error_class & _NO_ACKNOWLEDGE else []
    words += ["bus errors"] if error_class & (_PROTOCOL | _BUS_ERROR) else []
    words += ["transmit buffer of the controller is full"] if detail & _TX_OVERFLOW else []
    return ErrorFrame(state=state, text=", ".join(words) or f"error class 0x{error_class:X}", lost_frames=lost)


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleChange:
    """A trouble has begun or ended."""

    begins: bool
    reason: str
    """Of its beginning."""
    count: int
    """How often it was seen; 0 at the beginning."""
    lasted_s: float


class Trouble:
    """One kind of trouble of one bus: begins when it is seen, ends by word or by quiet."""

    __slots__ = ("_begun_ns", "_count", "_last_ns", "_reason", "_told")

    def __init__(self) -> None:
        self._begun_ns: int | None = None
        self._last_ns = 0
        self._count = 0
        self._reason = ""
        self._told = False

    def seen(self, reason: str, now_ns: int, *, count: int = 1) -> None:
        """It shows."""
        if self._begun_ns is None:
            self._begun_ns, self._reason, self._count, self._told = now_ns, reason, 0, False
        self._count += count
        self._last_ns = now_ns

    def over(self) -> None:
        """The controller says that it is over."""
        self._last_ns = -QUIET_NS

    @property
    def stands(self) -> bool:
        """Whether it has begun and `change` has not told its end."""
        return self._begun_ns is not None

    def change(self, now_ns: int) -> TroubleChange | None:
        """What is new since the last call; called from time to time."""
        if self._begun_ns is None:
            return None
        if not self._told:
            self._told = True
            return TroubleChange(begins=True, reason=self._reason, count=0, lasted_s=0.0)
        if now_ns - self._last_ns < QUIET_NS:
            return None
        lasted_s = (now_ns - self._begun_ns) * 1e-9
        self._begun_ns = None
        return TroubleChange(begins=False, reason=self._reason, count=self._count, lasted_s=lasted_s)
