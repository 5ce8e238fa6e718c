"""Joints as the pipeline would hand them to the register map."""

import datetime
from dataclasses import replace

from trueangle.core.health import StatusBit
from trueangle.core.registers import JointIdentity, JointState

GOOD = StatusBit.VALID | StatusBit.CONFIGURED

_STATE = JointState(
    status=GOOD,
    sequence=4711,
    corrected_deg=123.4567891,
    raw_deg=123.4512345,
    correction_arcsec=19.99656,
    temperature_c=23.456,
    age_ms=1.7,
    uncertainty_arcsec=2.348,
    velocity_deg_s=-45.5,
    turns=-3,
    raw_counts=89_888,
    frames_received=1_000_001,
    frames_lost=7,
)


def joint_state(**changes: object) -> JointState:
    """A valid joint, every field with a value of its own; named fields changed."""
    return _STATE._replace(**changes)


def joint_identity(slot: int = 1, **changes: object) -> JointIdentity:
    """An identity whose every field has a value of its own."""
    identity = JointIdentity(
        slot=slot,
        node_id=slot + 10,
        model_id=bytes(range(0xA0, 0xA8)),
        calibration_date=datetime.date(2026, 3, 9),
        calibration_due=datetime.date(2027, 3, 9),
        vendor_id=0x0000_0159,
        product_code=0x1234_5678,
        revision_number=0x0001_0002,
        serial_number=0xCAFE_0000 + slot,
    )
    return replace(identity, **changes)  # pyright: ignore[reportArgumentType]
