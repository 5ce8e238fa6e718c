"""From registers back to values: what a careful PLC program does with the served blocks.

Written by the same field list as the image, so that the two cannot drift apart. A marker comes back as None, and
a block that was read in pieces of two cycles is `torn`: nothing of it counts.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.register_fields import (
    BLOCK_STRIDE,
    DETAIL,
    DETAIL_REGISTERS,
    FAST_HEADER,
    FAST_REGISTERS,
    FAST_SLOT,
    FAST_TAIL,
    SLOTS,
    SLOTS_PER_GROUP,
    RegisterField,
    detail_address,
    fast_slot_offset,
    register_count,
    struct_format,
)

GROUPS = -(-SLOTS // SLOTS_PER_GROUP)
Values = Mapping[str, int | float | bytes | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Where one whole block lies."""

    address: int
    """0-based."""
    count: int


def fast_block(group: int) -> Block:
    """The fast block of a group 0..5."""
    return Block(address=BLOCK_STRIDE * group, count=FAST_REGISTERS)


def detail_block(slot: int) -> Block:
    """The detail block of a slot 1..32."""
    return Block(address=detail_address(slot), count=DETAIL_REGISTERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotReading:
    """One joint as the fast block tells it. None: the marker stood there."""

    slot: int
    status: StatusBit
    sequence: int | None
    corrected_deg: float | None
    """[0, 360); None unless VALID."""
    raw_deg: float | None
    correction_arcsec: float | None
    temperature_c: float | None
    age_ms: int | None
    uncertainty_arcsec: float | None
    """k = 1"""

    @property
    def valid(self) -> bool:
        """Whether the corrected angle may be used."""
        return StatusBit.VALID in self.status and self.corrected_deg is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupReading:
    """One fast block."""

    map_version: int
    joints_configured: int
    cycle: int
    heartbeat: int
    service: ServiceBit
    slots: tuple[SlotReading, ...]
    """Those with a joint."""
    torn: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class DetailReading:
    """One joint as its detail block tells it, with full resolution. None: the marker stood there."""

    slot: int
    cycle: int
    status: StatusBit
    sequence: int | None
    node_id: int
    corrected_deg: float | None
    raw_deg: float | None
    velocity_deg_s: float | None
    turns: int | None
    temperature_c: float | None
    correction_arcsec: float | None
    uncertainty_arcsec: float | None
    age_ms: int | None
    raw_counts: int | None
    model_id: bytes | None
    calibration_date: int | None
    """YYYYMMDD"""
    serial_number: int | None
    user_zero_arcsec: float | None
    """Taken off `corrected_deg`: corrected = raw + correction - user zero."""
    torn: bool

    @property
    def valid(self) -> bool:
        """Whether the corrected angle may be used."""
        return StatusBit.VALID in self.status and self.corrected_deg is not None


def read_group(data: bytes, group: int) -> GroupReading:
    """The fast block of this group; ValueError where it has another length."""
    _expect_length(data, FAST_REGISTERS)
    header = _values(FAST_HEADER, data, 0)
    tail = _values(FAST_TAIL, data, FAST_REGISTERS - register_count(FAST_TAIL))
    slots: list[SlotReading] = []
    for slot in range(group * SLOTS_PER_GROUP + 1, min(SLOTS, (group + 1) * SLOTS_PER_GROUP) + 1):
        values = _values(FAST_SLOT, data, fast_slot_offset(slot))
        if values["status"]:
            slots.append(_slot(slot, values))
    return GroupReading(
        map_version=_whole(header["map_version"]),
        joints_configured=_whole(header["joints_configured"]),
        cycle=_whole(header["cycle_counter"]),
        heartbeat=_whole(header["heartbeat"]),
        service=ServiceBit(_whole(header["service_status"])),
        slots=tuple(slots),
        torn=header["cycle_counter"] != tail["cycle_counter_tail"],
    )


def read_detail(data: bytes, slot: int) -> DetailReading:
    """The detail block of this slot; ValueError where it has another length."""
    _expect_length(data, DETAIL_REGISTERS)
    values = _values(DETAIL, data, 0)
    status = StatusBit(_whole(values["status"]))
    model_id = values["model_id"]
    return DetailReading(
        slot=slot,
        cycle=_whole(values["cycle_counter"]),
        status=status,
        sequence=_optional_whole(values["sequence"]),
        node_id=_whole(values["node_id"]),
        corrected_deg=_number(values["corrected_float64"]) if StatusBit.VALID in status else None,
        raw_deg=_number(values["raw_float64"]),
        velocity_deg_s=_number(values["velocity"]),
        turns=_optional_whole(values["turns"]),
        temperature_c=_number(values["temperature"]),
        correction_arcsec=_number(values["correction"]),
        uncertainty_arcsec=_number(values["uncertainty"]),
        age_ms=_optional_whole(values["age"]),
        raw_counts=_optional_whole(values["raw_counts"]),
        model_id=model_id if isinstance(model_id, bytes) else None,
        calibration_date=_optional_whole(values["calibration_date"]),
        serial_number=_optional_whole(values["serial_number"]),
        user_zero_arcsec=_scaled(values.get("user_zero"), 1000),
        torn=values["cycle_counter"] != values["cycle_counter_tail"],
    )


def status_words(status: StatusBit) -> tuple[str, ...]:
    """The names of the bits but CONFIGURED, bits that this version does not know as numbers."""
    names = [bit.name for bit in StatusBit if bit in status and bit is not StatusBit.CONFIGURED and bit.name]
    unknown = int(status) & ~sum(int(bit) for bit in StatusBit)
    names += [f"BIT_{bit}" for bit in range(32) if unknown >> bit & 1]
    return tuple(names)


def _slot(slot: int, values: Values) -> SlotReading:
    status = StatusBit(_whole(values["status"]))
    return SlotReading(
        slot=slot,
        status=status,
        sequence=_optional_whole(values["sequence"]),
        corrected_deg=_scaled(values["corrected"], 3_600_000) if StatusBit.VALID in status else None,
        raw_deg=_scaled(values["raw"], 3_600_000),
        correction_arcsec=_scaled(values["correction"], 1000),
        temperature_c=_scaled(values["temperature"], 100),
        age_ms=_optional_whole(values["age"]),
        uncertainty_arcsec=_scaled(values["uncertainty"], 100),
    )


def _values(fields: tuple[RegisterField, ...], data: bytes, first_register: int) -> Values:
    """By name, reserved registers left out; None for a marker."""
    unpacked = struct.unpack_from(struct_format(fields), data, 2 * first_register)
    held = [field for field in fields if "x" not in field.type.code]
    return {
        field.name: None if field.may_be_missing and _is_marker(field, value) else value
        for field, value in zip(held, unpacked, strict=True)
    }


def _is_marker(field: RegisterField, value: float | bytes) -> bool:
    return value == field.type.missing or (isinstance(value, float) and math.isnan(value))


def _expect_length(data: bytes, registers: int) -> None:
    if len(data) != 2 * registers:
        raise ValueError(f"block: expected {2 * registers} bytes, got {len(data)}")


def _whole(value: float | bytes | None) -> int:
    if not isinstance(value, int):
        raise TypeError(f"register: expected a whole number, got {value!r}")
    return value


def _optional_whole(value: float | bytes | None) -> int | None:
    return value if isinstance(value, int) else None


def _number(value: float | bytes | None) -> float | None:
    return float(value) if isinstance(value, (int, float)) else None


def _scaled(value: float | bytes | None, counts_per_unit: int) -> float | None:
    """Divided, not multiplied: 1/1000 is no binary number."""
    number = _number(value)
    return None if number is None else number / counts_per_unit
