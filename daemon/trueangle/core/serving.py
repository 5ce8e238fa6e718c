"""What stands in a joint's corrected registers: the angle, or what the configuration asks for in its place.

Rules of this file: without a word of the configuration an angle that is not VALID is the marker. A held angle was
VALID at its sample, is at most `hold_ms` old counted from that sample, and is held only through silence: stale
position or temperature, SYNC or bus gone, node gone quiet. Any other reason (another identity, a fault, a jump, a
lost reference, a node that starts anew) may mean that the phase has moved: it drops the held angle for good. Raw
stands in only where the position itself is good and only its correction is not.
"""

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

from trueangle.core.correction import Correction
from trueangle.core.health import INFORMATION, StatusBit
from trueangle.core.position import AngleSource, Extrapolation, extrapolate

HOLDABLE = (
    StatusBit.STALE
    | StatusBit.TEMPERATURE_STALE
    | StatusBit.SYNC_LOST
    | StatusBit.BUS_DOWN
    | StatusBit.NODE_NOT_READY
)
"""Silence. NODE_NOT_READY only of a silent node, see `ServedJoint.drop_held`."""
AGAINST_CORRECTION_ALONE = (
    StatusBit.TEMPERATURE_STALE
    | StatusBit.TEMPERATURE_BROKEN
    | StatusBit.TEMPERATURE_IMPLAUSIBLE
    | StatusBit.TEMPERATURE_OUTSIDE_MODEL
    | StatusBit.ANGLE_OUTSIDE_MODEL
    | StatusBit.MODEL_REFUSED
    | StatusBit.UNCERTAINTY_HIGH
    | StatusBit.CALIBRATION_PAST_DUE
)
_VALID = int(StatusBit.VALID)
_NEITHER_REASON = StatusBit.VALID | StatusBit.CONFIGURED | INFORMATION


class WhenNotValid(enum.Enum):
    """What a corrected register holds without VALID."""

    MARKER = "marker"
    HOLD = "hold"
    RAW = "raw"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServingPolicy:
    """How one joint is served."""

    when_not_valid: WhenNotValid = WhenNotValid.MARKER
    hold_ms: float = 0.0
    """Of a held angle, counted from its sample."""
    latency_max_ms: float | None = None
    """A younger sample is moved on to the moment of publication; None: never."""


class Served(NamedTuple):
    """One joint's corrected angle as it goes into the registers. None: the marker."""

    bits: StatusBit
    """Status with the bits that say how the angle was made."""
    corrected_deg: float | None = None
    correction_arcsec: float | None = None
    uncertainty_arcsec: float | None = None
    age_ms: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    corrected_deg: float
    """Before the user's zero."""
    correction: Correction
    stamp_ns: int


class ServedJoint:
    """Decides what is served of one joint; keeps the last good angle."""

    __slots__ = ("_held", "policy", "user_zero_deg", "user_zero_known")

    def __init__(self, policy: ServingPolicy, user_zero_deg: float) -> None:
        self.policy = policy
        self.user_zero_deg = user_zero_deg
        """Taken off what is served and never off the model's input."""
        self.user_zero_known = True
        """False: a zero is stored that belongs to another encoder or model."""
        self._held: _Held | None = None

    def drop_held(self) -> None:
        """The node said or did something after which its last angle may not be its angle any more."""
        self._held = None

    def serve(
        self,
        status: StatusBit,
        *,
        raw_deg: float | None,
        correction: Correction | None,
        moved_deg: float | None,
        stamp_ns: int | None,
        now_ns: int,
        age_ms: float | None,
    ) -> Served:
        """The angle for this status; `moved_deg`: since the sample, None where it is not moved on."""
        if self.user_zero_deg:
            status |= StatusBit.USER_PRESET
        if int(status) & _VALID:
            if correction is None or raw_deg is None or stamp_ns is None:
                return Served(bits=status & ~StatusBit.VALID, age_ms=age_ms)
            return self._serve_good(status, raw_deg, correction, moved_deg, stamp_ns, age_ms)
        against = status & ~_NEITHER_REASON
        if against & ~HOLDABLE:
            self._held = None
        if self.policy.when_not_valid is WhenNotValid.HOLD and self._held is not None:
            held_ms = (now_ns - self._held.stamp_ns) * 1e-6
            if 0.0 <= held_ms <= self.policy.hold_ms:
                return self._serve_held(status, self._held, held_ms)
            self._held = None
        elif (
            self.policy.when_not_valid is WhenNotValid.RAW
            and raw_deg is not None
            and not against & ~AGAINST_CORRECTION_ALONE
        ):
            return Served(
                bits=status | StatusBit.RAW_SERVED, corrected_deg=raw_deg - self.user_zero_deg, age_ms=age_ms
            )
        return Served(bits=status, age_ms=age_ms)

    def _serve_good(
        self,
        status: StatusBit,
        raw_deg: float,
        correction: Correction,
        moved_deg: float | None,
        stamp_ns: int,
        age_ms: float | None,
    ) -> Served:
        corrected_deg = correction.corrected_deg(raw_deg)
        if self.policy.when_not_valid is WhenNotValid.HOLD:
            self._held = _Held(corrected_deg=corrected_deg, correction=correction, stamp_ns=stamp_ns)
        if moved_deg is not None:
            status |= StatusBit.LATENCY_COMPENSATED
            corrected_deg += moved_deg
        return Served(
            bits=status,
            corrected_deg=corrected_deg - self.user_zero_deg,
            correction_arcsec=correction.correction_arcsec,
            uncertainty_arcsec=correction.uncertainty_arcsec,
            age_ms=age_ms,
        )

    def _serve_held(self, status: StatusBit, held: _Held, held_ms: float) -> Served:
        return Served(
            bits=status | StatusBit.HELD,
            corrected_deg=held.corrected_deg - self.user_zero_deg,
            correction_arcsec=held.correction.correction_arcsec,
            uncertainty_arcsec=held.correction.uncertainty_arcsec,
            age_ms=held_ms,
        )


def in_quadrature_arcsec(first: float | None, *others: float | None) -> float | None:
    """Independent standard uncertainties added; None where one is not known."""
    total = 0.0 if first is None else first * first
    for other in others:
        if first is None or other is None:
            return None
        total += other * other
    return None if first is None else math.sqrt(total)


def moved_since_sample(policy: ServingPolicy, angle: AngleSource, age_ms: float | None) -> Extrapolation | None:
    """The way from the sample to now; None where the angle is not moved on."""
    limit_ms = policy.latency_max_ms
    if limit_ms is None or age_ms is None or age_ms > limit_ms:
        return None
    return extrapolate(angle, age_ms * 1e-3)
