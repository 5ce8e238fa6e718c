"""What is known about each joint's trust: status bits, numbered once and never re-used."""

import enum


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
    StatusBit.NODE_NOT_READY: "the node is not identified, configured and started yet",
    StatusBit.NODE_FAULT: "the node refused its set-up or reports a fault (EMCY, encoder alarm)",
    StatusBit.BUS_DOWN: "the CAN bus of this joint is not open",
}
