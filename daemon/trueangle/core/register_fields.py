"""The register map, version 1: every field once, in the order in which it lies in the registers.

Rules of this file: addresses follow from the order, so a field is only ever added by taking reserved registers and
raising MAP_VERSION; big-endian, most significant word first. The image and the documentation both read this list.
"""

import enum
from dataclasses import dataclass

MAP_VERSION = 1
SLOTS = 32
SLOTS_PER_GROUP = 6
BLOCK_STRIDE = 100
"""Distance of block starts, in registers: block b starts at 0-based address 100 * b."""
FIRST_DETAIL_BLOCK = 10
"""Blocks 0..5 are the fast groups, block 10 + slot - 1 is the detail block of a slot."""


class RegisterType(enum.Enum):
    """Wire type: struct code, length in registers, and the value that means 'missing' (None: never missing)."""

    UINT16 = ("H", 1, 0xFFFF)
    INT16 = ("h", 1, -0x8000)
    UINT32 = ("I", 2, 0xFFFF_FFFF)
    INT32 = ("i", 2, -0x8000_0000)
    FLOAT32 = ("f", 2, float("nan"))
    FLOAT64 = ("d", 4, float("nan"))
    BYTES8 = ("8s", 4, b"\xff" * 8)
    RESERVED_2 = ("4x", 2, None)
    RESERVED_10 = ("20x", 10, None)

    def __init__(self, code: str, registers: int, missing: float | bytes | None) -> None:
        self.code = code
        self.registers = registers
        self.missing = missing


@dataclass(frozen=True, slots=True)
class RegisterField:
    """One value of the map."""

    name: str
    type: RegisterType
    meaning: str
    unit: str = ""
    """Unit of the scaled value; empty for counts, bits and numbers without a unit."""
    scale: str = "1"
    """Value in `unit` of one count, as decimal text, so that the documentation repeats it exactly."""
    may_be_missing: bool = True
    """False: every bit pattern is a value."""


_T = RegisterType

FAST_HEADER = (
    RegisterField("map_version", _T.UINT16, "version of this register map", may_be_missing=False),
    RegisterField("joints_configured", _T.UINT16, "joints of the whole daemon", may_be_missing=False),
    RegisterField(
        "cycle_counter",
        _T.UINT32,
        "counts register images; equal to the tail in one whole read",
        may_be_missing=False,
    ),
    RegisterField(
        "heartbeat",
        _T.UINT16,
        "counts finished sample cycles; stands still while no joint sends positions",
        may_be_missing=False,
    ),
    RegisterField(
        "not_valid",
        _T.UINT32,
        "bit s-1 set: slot s is configured and not valid (all 32 slots)",
        may_be_missing=False,
    ),
    RegisterField("service_status", _T.UINT16, "status bits of the daemon itself", may_be_missing=False),
    RegisterField("reserved", _T.RESERVED_2, "zero", may_be_missing=False),
)

FAST_SLOT = (
    RegisterField("status", _T.UINT32, "status bits of the joint; 0: no joint in this slot", may_be_missing=False),
    RegisterField(
        "sequence", _T.UINT16, "number of the sample; 65535 is a number too unless raw is missing as well"
    ),
    RegisterField(
        "corrected",
        _T.INT32,
        "corrected angle, 0 to 1295999999; missing unless VALID, HELD or RAW_SERVED",
        "arcsec",
        "0.001",
    ),
    RegisterField("raw", _T.INT32, "angle without correction, 0 to 1295999999", "arcsec", "0.001"),
    RegisterField(
        "correction",
        _T.INT32,
        "corrected = raw + correction - user_zero; missing where not applied",
        "arcsec",
        "0.001",
    ),
    RegisterField("temperature", _T.INT16, "temperature used for the correction", "degC", "0.01"),
    RegisterField(
        "age",
        _T.UINT16,
        "age of the sample when published; with HELD: of the held one; 65534: that or older",
        "ms",
    ),
    RegisterField(
        "uncertainty",
        _T.UINT16,
        "standard uncertainty (k = 1) of corrected; 65534: that or more",
        "arcsec",
        "0.01",
    ),
)

FAST_TAIL = (
    RegisterField("cycle_counter_tail", _T.UINT32, "cycle_counter again: torn reads show", may_be_missing=False),
)

DETAIL_LIVE = (
    RegisterField("cycle_counter", _T.UINT32, "counts register images", may_be_missing=False),
    RegisterField("status", _T.UINT32, "status bits of the joint", may_be_missing=False),
    RegisterField(
        "sequence", _T.UINT16, "number of the sample; 65535 is a number too unless raw is missing as well"
    ),
    RegisterField("node_id", _T.UINT16, "CANopen node-id", may_be_missing=False),
    RegisterField(
        "corrected",
        _T.INT32,
        "corrected angle, 0 to 1295999999; missing unless VALID, HELD or RAW_SERVED",
        "arcsec",
        "0.001",
    ),
    RegisterField("corrected_float64", _T.FLOAT64, "the same angle, in [0, 360)", "deg"),
    RegisterField(
        "corrected_float32", _T.FLOAT32, "the same angle, in [0, 360); step near 360: 0.11 arcsec", "deg"
    ),
    RegisterField("raw", _T.INT32, "angle without correction, 0 to 1295999999", "arcsec", "0.001"),
    RegisterField("raw_float64", _T.FLOAT64, "the same angle, in [0, 360)", "deg"),
    RegisterField("raw_float32", _T.FLOAT32, "the same angle, in [0, 360); step near 360: 0.11 arcsec", "deg"),
    RegisterField("velocity", _T.FLOAT32, "rate of the angle", "deg/s"),
    RegisterField("turns", _T.INT32, "whole turns that belong to raw (never add them to corrected)", "turn"),
    RegisterField("temperature", _T.FLOAT32, "temperature used for the correction", "degC"),
    RegisterField(
        "correction", _T.FLOAT32, "corrected = raw + correction - user_zero; missing where not applied", "arcsec"
    ),
    RegisterField("uncertainty", _T.FLOAT32, "standard uncertainty (k = 1) of corrected", "arcsec"),
    RegisterField("age", _T.UINT32, "age of the sample when published; with HELD: of the held one", "ms"),
    RegisterField(
        "raw_counts", _T.UINT32, "position as received; 4294967295 is a count too unless raw is missing"
    ),
    RegisterField("frames_received", _T.UINT32, "position frames received, wraps at 2^32", may_be_missing=False),
    RegisterField(
        "frames_lost", _T.UINT32, "position frames known to be lost, wraps at 2^32", may_be_missing=False
    ),
)

DETAIL_IDENTITY = (
    RegisterField("model_id", _T.BYTES8, "first 8 bytes of the SHA-256 of the model file"),
    RegisterField("calibration_date", _T.UINT32, "day of the calibration as YYYYMMDD"),
    RegisterField("calibration_due", _T.UINT32, "day on which the next calibration is due as YYYYMMDD"),
    RegisterField("vendor_id", _T.UINT32, "object 0x1018:1 of the encoder"),
    RegisterField("product_code", _T.UINT32, "object 0x1018:2 of the encoder"),
    RegisterField("revision_number", _T.UINT32, "object 0x1018:3 of the encoder"),
    RegisterField("serial_number", _T.UINT32, "object 0x1018:4 of the encoder"),
)

DETAIL_USER = (
    RegisterField(
        "user_zero",
        _T.INT32,
        "taken off corrected, 0 to 1295999999; 0: none",
        "arcsec",
        "0.001",
    ),
    RegisterField("reserved", _T.RESERVED_10, "zero", may_be_missing=False),
)

DETAIL_TAIL = (
    RegisterField("cycle_counter_tail", _T.UINT32, "cycle_counter again: torn reads show", may_be_missing=False),
)

DETAIL = DETAIL_LIVE + DETAIL_IDENTITY + DETAIL_USER + DETAIL_TAIL


def struct_format(fields: tuple[RegisterField, ...]) -> str:
    """Format for `struct`: big-endian, unpadded, one value per field that is not reserved."""
    return ">" + "".join(field.type.code for field in fields)


def register_count(fields: tuple[RegisterField, ...]) -> int:
    """Length of the fields in registers of 16 bits."""
    return sum(field.type.registers for field in fields)


FAST_REGISTERS = (
    register_count(FAST_HEADER) + SLOTS_PER_GROUP * register_count(FAST_SLOT) + register_count(FAST_TAIL)
)
"""84: one request reads a whole group."""
DETAIL_REGISTERS = register_count(DETAIL)
"""70: one request reads a whole detail block."""


def group_of(slot: int) -> int:
    """Fast group 0..5 of a slot 1..32."""
    return (slot - 1) // SLOTS_PER_GROUP


def fast_slot_offset(slot: int) -> int:
    """Register offset of a slot's entry from the start of its fast group."""
    return register_count(FAST_HEADER) + (slot - 1) % SLOTS_PER_GROUP * register_count(FAST_SLOT)


def detail_address(slot: int) -> int:
    """0-based address of a slot's detail block."""
    return BLOCK_STRIDE * (FIRST_DETAIL_BLOCK + slot - 1)


COMMAND_BLOCK_ADDRESS = 5000
"""0-based; behind the last detail block. Readable and writable only where the configuration enables commands."""

COMMAND_WRITABLE = (
    RegisterField("slot", _T.UINT16, "joint that the command is for, 1 to 32", may_be_missing=False),
    RegisterField(
        "angle",
        _T.INT32,
        "0 to 1295999999; preset: what this position shall read; reference angle: what the reference reads",
        "arcsec",
        "0.001",
        may_be_missing=False,
    ),
    RegisterField(
        "command", _T.UINT16, "a number written here is executed with slot and angle", may_be_missing=False
    ),
)

COMMAND_ANSWER = (
    RegisterField("result", _T.UINT16, "what became of this connection's last command", may_be_missing=False),
    RegisterField("armed_slot", _T.UINT16, "slot that this connection has armed; 0: none", may_be_missing=False),
    RegisterField("armed_left", _T.UINT16, "time left to confirm; 0: not armed", "ms", may_be_missing=False),
    RegisterField(
        "commands", _T.UINT16, "counts this connection's commands, refused ones too", may_be_missing=False
    ),
)
