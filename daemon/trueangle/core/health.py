"""What is known about each joint's trust: status bits, numbered once and never re-used.

Rules of this file: a joint is VALID when no reason against it is known; every reason is a bit of its own; what is
only information says nothing against the angle. Nothing else in the daemon decides what is served.
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
    NOT_REFERENCED = 1 << 12
    POSITION_JUMP = 1 << 13
    UNCERTAINTY_HIGH = 1 << 14
    CALIBRATION_PAST_DUE = 1 << 15
    HELD = 1 << 16
    RAW_SERVED = 1 << 17
    LATENCY_COMPENSATED = 1 << 18
    HEAD_LOST = 1 << 19
    TEMPERATURE_IMPLAUSIBLE = 1 << 20
    NODE_ID_CLASH = 1 << 21
    USER_PRESET = 1 << 22
    SYNC_LOST = 1 << 23


INFORMATION = (
    StatusBit.HELD
    | StatusBit.RAW_SERVED
    | StatusBit.LATENCY_COMPENSATED
    | StatusBit.HEAD_LOST
    | StatusBit.USER_PRESET
)
"""Bits that say how an angle was made, never why there is none."""

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
    StatusBit.NOT_REFERENCED: "the encoder's zero is not known: reference not passed yet, or lost by a jump",
    StatusBit.POSITION_JUMP: "the position moved faster than the joint can; not believed until it is explained",
    StatusBit.UNCERTAINTY_HIGH: "the uncertainty is above the configured limit, or not known where it must be",
    StatusBit.CALIBRATION_PAST_DUE: "the calibration is past due, or the clock stands before its date",
    StatusBit.HELD: "corrected holds the last good angle, by configuration; age is that angle's",
    StatusBit.RAW_SERVED: "corrected holds the angle without correction, by configuration",
    StatusBit.LATENCY_COMPENSATED: "corrected was moved on by the velocity to the moment of publication",
    StatusBit.HEAD_LOST: "a reading head of several is missing; uncertainty says what that costs",
    StatusBit.TEMPERATURE_IMPLAUSIBLE: "the temperature is frozen or jumped",
    StatusBit.NODE_ID_CLASH: "two nodes answer to this node-id",
    StatusBit.USER_PRESET: "a user zero is in force: corrected = raw + correction - user_zero",
    StatusBit.SYNC_LOST: "SYNC, which makes the encoder sample, is not seen any more",
}


class ServiceBit(enum.IntFlag):
    """Bits of the service status word (UINT16) in the header of the fast image."""

    ALL_VALID = 1 << 0
    BUS_DOWN = 1 << 1
    FRAMES_DROPPED = 1 << 2
    BUS_DEGRADED = 1 << 3
    RECORDER_STOPPED = 1 << 4
    RELOAD_REFUSED = 1 << 5
    COMMANDS_ENABLED = 1 << 6


SERVICE_MEANING: dict[ServiceBit, str] = {
    ServiceBit.ALL_VALID: "every configured joint is valid",
    ServiceBit.BUS_DOWN: "at least one CAN bus is not open",
    ServiceBit.FRAMES_DROPPED: "frames of a CAN bus were dropped before they were read",
    ServiceBit.BUS_DEGRADED: "a CAN controller warns of errors or is error-passive",
    ServiceBit.RECORDER_STOPPED: "the recorder is configured and does not write",
    ServiceBit.RELOAD_REFUSED: "the last reload was refused: configuration and models of before are in force",
    ServiceBit.COMMANDS_ENABLED: "this daemon takes commands",
}


class NodeCondition(enum.Enum):
    """What the pipeline needs to know of a node's life cycle."""

    NOT_READY = "not ready"
    SILENT = "silent"
    """Out of service for silence or with its bus: nothing speaks against what it said before."""
    RUNNING = "running"
    """Identified as expected, configured, mapping read back, operational."""
    DIFFERS = "differs"
    """Running, but not the encoder, or not set as, at calibration."""
    FAULT = "fault"
    ID_CLASH = "node-id clash"


GOOD = StatusBit.VALID | StatusBit.CONFIGURED
"""The status word of a joint that nothing speaks against."""
_AGAINST_NODE = {
    NodeCondition.NOT_READY: StatusBit.NODE_NOT_READY,
    NodeCondition.SILENT: StatusBit.NODE_NOT_READY,
    NodeCondition.DIFFERS: StatusBit.ENCODER_DIFFERS,
    NodeCondition.FAULT: StatusBit.NODE_FAULT,
    NodeCondition.ID_CLASH: StatusBit.NODE_ID_CLASH,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """When a joint stops being served as corrected."""

    stale_ms: float
    temperature_stale_s: float
    sensor_range_c: Interval
    """Outside: a broken sensor."""
    model_angle_deg: Interval
    model_temperature_c: Interval
    max_uncertainty_arcsec: float | None = None
    """Standard uncertainty, k = 1; None: no limit."""
    serve_past_due: bool = False
    """CALIBRATION_PAST_DUE is information and no reason."""


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
    uncertainty_arcsec: float | None = None
    """Of the angle as it would be served; None: not known."""
    uncertainty_needed: bool = False
    """Something is known to have enlarged the uncertainty: not to know by how much is a reason."""
    referenced: bool = True
    jumped: bool = False
    past_due: bool = False
    temperature_fault: bool = False
    """The sensor's own status says that the value is not valid."""
    temperature_plausible: bool = True
    sync_lost: bool = False
    heads_disagree: bool = False


def judge(evidence: Evidence, limits: Limits) -> StatusBit:
    """The joint's status word: every reason that holds, VALID exactly when none does."""
    # Plain numbers until something is wrong: an operation on flags costs more than all comparisons of limits.
    against = _against_source(evidence, limits) | _against_temperature(evidence, limits)
    against |= _against_correction(evidence, limits)
    status = StatusBit.CONFIGURED | against if against else GOOD
    if evidence.past_due and limits.serve_past_due:
        status |= StatusBit.CALIBRATION_PAST_DUE
    return status


def _against_source(evidence: Evidence, limits: Limits) -> int:
    """Bus, node and position."""
    against = 0 if evidence.node is NodeCondition.RUNNING else int(_AGAINST_NODE[evidence.node])
    if not evidence.bus_up:
        against |= StatusBit.BUS_DOWN
    if evidence.sync_lost:
        against |= StatusBit.SYNC_LOST
    if evidence.age_ms is None or evidence.age_ms > limits.stale_ms:
        against |= StatusBit.STALE
    if not evidence.referenced:
        against |= StatusBit.NOT_REFERENCED
    if evidence.jumped:
        against |= StatusBit.POSITION_JUMP
    if evidence.heads_disagree:
        against |= StatusBit.NODE_FAULT
    return against


def _against_temperature(evidence: Evidence, limits: Limits) -> int:
    against = 0
    if evidence.temperature_age_s is None or evidence.temperature_age_s > limits.temperature_stale_s:
        against |= StatusBit.TEMPERATURE_STALE
    if evidence.temperature_fault:
        against |= StatusBit.TEMPERATURE_BROKEN
    if not evidence.temperature_plausible:
        against |= StatusBit.TEMPERATURE_IMPLAUSIBLE
    if evidence.temperature_c is not None:
        if not limits.sensor_range_c.holds(evidence.temperature_c):
            against |= StatusBit.TEMPERATURE_BROKEN
        if not limits.model_temperature_c.holds(evidence.temperature_c):
            against |= StatusBit.TEMPERATURE_OUTSIDE_MODEL
    return against


def _against_correction(evidence: Evidence, limits: Limits) -> int:
    against = 0
    if evidence.raw_deg is not None:
        if not limits.model_angle_deg.holds(evidence.raw_deg):
            against |= StatusBit.ANGLE_OUTSIDE_MODEL
        correction, uncertainty = evidence.correction_arcsec, evidence.uncertainty_arcsec
        if evidence.temperature_c is not None and (
            correction is None or not abs(correction) <= MAX_CORRECTION_ARCSEC
        ):
            against |= StatusBit.MODEL_REFUSED
        limit = limits.max_uncertainty_arcsec
        # A comparison with NaN is false: an uncertainty that is no number is never below the limit.
        if (limit is not None and (uncertainty is None or not uncertainty <= limit)) or (
            evidence.uncertainty_needed and uncertainty is None
        ):
            against |= StatusBit.UNCERTAINTY_HIGH
    if evidence.past_due and not limits.serve_past_due:
        against |= StatusBit.CALIBRATION_PAST_DUE
    return against
