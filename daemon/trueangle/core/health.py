"""What is known about each joint's trust: status bits, numbered once and never re-used.

Rules of this file: a joint is VALID when no reason against it is known; every reason is a bit of its own; nothing
else in the daemon decides what is served.
"""

import enum
from dataclasses import dataclass

from trueangle.contract.metadata import Interval

MAX_CORRECTION_ARCSEC = 18_000.0
"""5 deg: no encoder is that wrong; a larger correction, an infinite one or NaN is a broken model."""


class StatusBit(enum.IntFlag):
    """Bits of a joint's status word (UINT32). A number, once given, keeps its meaning for ever."""

    VALID = 1 << 0
    CONFIGURED = 1 << 1
    STALE = 1 << 2
    TEMPERATURE_STALE = 1 << 3
    TEMPERATURE_BROKEN = 1 << 4
    ANGLE_OUTSIDE_MODEL = 1 << 5
    TEMPERATURE_OUTSIDE_MODEL = 1 << 6
    MODEL_REFUSED = 1 << 7
    ENCODER_DIFFERS = 1 << 8
    NODE_NOT_READY = 1 << 9
    NODE_FAULT = 1 << 10
    BUS_DOWN = 1 << 11


STATUS_MEANING: dict[StatusBit, str] = {
    StatusBit.VALID: "the corrected angle is good; every other use of it is wrong while this bit is clear",
    StatusBit.CONFIGURED: "a joint is configured in this slot",
    StatusBit.STALE: "no position arrived within the configured limit",
    StatusBit.TEMPERATURE_STALE: "no temperature arrived within the configured limit",
    StatusBit.TEMPERATURE_BROKEN: "the temperature sensor reports a fault or an impossible value",
    StatusBit.ANGLE_OUTSIDE_MODEL: "the angle lies outside the range the model was calibrated for",
    StatusBit.TEMPERATURE_OUTSIDE_MODEL: "the temperature lies outside the range the model was calibrated for",
    StatusBit.MODEL_REFUSED: "the model gave no usable correction",
    StatusBit.ENCODER_DIFFERS: "the encoder is not the one, or not set as it was, at calibration",
    StatusBit.NODE_NOT_READY: "the node is not identified, configured and started yet, or lost",
    StatusBit.NODE_FAULT: "the node refused its set-up or reports a fault (EMCY, encoder alarm)",
    StatusBit.BUS_DOWN: "the CAN bus of this joint is not open",
}


class ServiceBit(enum.IntFlag):
    """Bits of the service status word (UINT16) in the header of the fast image."""

    ALL_VALID = 1 << 0
    BUS_DOWN = 1 << 1
    RELOAD_REFUSED = 1 << 5


SERVICE_MEANING: dict[ServiceBit, str] = {
    ServiceBit.ALL_VALID: "every configured joint is valid",
    ServiceBit.BUS_DOWN: "at least one CAN bus is not open",
    ServiceBit.RELOAD_REFUSED: "the last reload was refused: configuration and models of before are in force",
}


class NodeCondition(enum.Enum):
    """What the pipeline needs to know of a node's life cycle."""

    NOT_READY = "not ready"
    RUNNING = "running"
    """Identified as expected, configured, mapping read back, operational."""
    DIFFERS = "differs"
    """Running, but not the encoder, or not set as, at calibration."""
    FAULT = "fault"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """When a joint stops being served as corrected."""

    stale_ms: float
    temperature_stale_s: float
    sensor_range_c: Interval
    """Outside: a broken sensor."""
    model_angle_deg: Interval
    model_temperature_c: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All that is known of one joint at one moment. None: never seen."""

    bus_up: bool
    node: NodeCondition
    age_ms: float | None
    raw_deg: float | None
    temperature_c: float | None
    temperature_age_s: float | None
    correction_arcsec: float | None
    """The model's answer for the latest sample; None without angle or temperature."""


def judge(evidence: Evidence, limits: Limits) -> StatusBit:
    """The joint's status word: every reason that holds, VALID exactly when none does."""
    reasons = StatusBit(0)
    if not evidence.bus_up:
        reasons |= StatusBit.BUS_DOWN
    if evidence.node is NodeCondition.NOT_READY:
        reasons |= StatusBit.NODE_NOT_READY
    elif evidence.node is NodeCondition.FAULT:
        reasons |= StatusBit.NODE_FAULT
    elif evidence.node is NodeCondition.DIFFERS:
        reasons |= StatusBit.ENCODER_DIFFERS
    if evidence.age_ms is None or evidence.age_ms > limits.stale_ms:
        reasons |= StatusBit.STALE
    if evidence.temperature_age_s is None or evidence.temperature_age_s > limits.temperature_stale_s:
        reasons |= StatusBit.TEMPERATURE_STALE
    if evidence.temperature_c is not None:
        if not limits.sensor_range_c.holds(evidence.temperature_c):
            reasons |= StatusBit.TEMPERATURE_BROKEN
        if not limits.model_temperature_c.holds(evidence.temperature_c):
            reasons |= StatusBit.TEMPERATURE_OUTSIDE_MODEL
    if evidence.raw_deg is not None and not limits.model_angle_deg.holds(evidence.raw_deg):
        reasons |= StatusBit.ANGLE_OUTSIDE_MODEL
    if evidence.raw_deg is not None and evidence.temperature_c is not None:
        correction = evidence.correction_arcsec
        if correction is None or not abs(correction) <= MAX_CORRECTION_ARCSEC:
            reasons |= StatusBit.MODEL_REFUSED
    return StatusBit.CONFIGURED | (reasons or StatusBit.VALID)
