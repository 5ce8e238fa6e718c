"""The documentation of the register map, made from the field list that builds the image."""

import csv
import enum
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields

from trueangle.core.bit_fields import (
    CLEAR_FAULT_COILS_ADDRESS,
    CONFIGURED_BITS_ADDRESS,
    SERVICE_BITS_ADDRESS,
    VALID_BITS_ADDRESS,
    status_bits_address,
)
from trueangle.core.commands import COMMAND_MEANING, RESULT_MEANING
from trueangle.core.health import SERVICE_MEANING, STATUS_MEANING, StatusBit
from trueangle.core.register_fields import (
    BLOCK_STRIDE,
    COMMAND_ANSWER,
    COMMAND_BLOCK_ADDRESS,
    COMMAND_WRITABLE,
    DETAIL,
    FAST_HEADER,
    FAST_REGISTERS,
    FAST_SLOT,
    FAST_TAIL,
    MAP_VERSION,
    SLOTS,
    RegisterField,
    RegisterType,
    detail_address,
    fast_slot_offset,
    group_of,
    register_count,
)

MAP_NOTES = (
    f"Register map version {MAP_VERSION}. Input registers (FC 04) and holding registers (FC 03) hold the same.",
    "Big-endian; the most significant register of a value comes first.",
    "A request must stay inside one block: a fast group has 84 registers, a detail block 70; else exception 02.",
    "Groups and slots without a configured joint answer with exception 02.",
    "Empty slots of a group with a configured joint hold status 0 and the markers.",
    "A value that is not known holds the marker of its type. Use a corrected angle only while VALID is set.",
    "HELD or RAW_SERVED without VALID: corrected holds what the configuration asked for in place of the marker.",
    "Discrete inputs (FC 02) and coils (FC 01) hold the same bits; a bit of a slot without a joint is 0.",
    "The command block and the clear_fault coils are there only where the configuration enables commands.",
    "Compare cycle_counter with cycle_counter_tail: unequal, if the block was read in pieces of different cycles.",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterRow:
    """One documented value; all texts as they are printed."""

    address_0based: int
    """As on the wire."""
    address_1based: int
    input_reference: str
    """Six-digit 3xxxxx form; of a bit 1xxxxx, empty for what is only a coil."""
    holding_reference: str
    """Six-digit 4xxxxx form; of a bit 0xxxxx."""
    name: str
    type: str
    registers: int
    """0 for a bit."""
    scale: str
    unit: str
    marker: str
    """Value that means missing; empty: never missing."""
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberRow:
    """One documented number of a register that holds a choice."""

    register: str
    number: int
    name: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BitRow:
    """One documented status bit."""

    word: str
    """Name of the register that holds it."""
    bit: int
    mask: str
    name: str
    meaning: str


_Row = RegisterRow | BitRow | NumberRow


def command_rows() -> tuple[RegisterRow, ...]:
    """The command block; its first four registers can be written (FC 06, 16, 22, 23)."""
    return tuple(_rows("command", COMMAND_BLOCK_ADDRESS, COMMAND_WRITABLE + COMMAND_ANSWER))


def input_rows(slots: Iterable[int]) -> tuple[RegisterRow, ...]:
    """The discrete inputs that mean something for joints in these slots, and the coils that can be written."""
    chosen = sorted(set(slots))
    rows = [
        _bit(VALID_BITS_ADDRESS + slot - 1, f"slot{slot}.valid", STATUS_MEANING[StatusBit.VALID])
        for slot in chosen
    ]
    for slot in chosen:
        address = CONFIGURED_BITS_ADDRESS + slot - 1
        rows.append(_bit(address, f"slot{slot}.configured", STATUS_MEANING[StatusBit.CONFIGURED]))
    for flag, meaning in SERVICE_MEANING.items():
        address = SERVICE_BITS_ADDRESS + flag.bit_length() - 1
        rows.append(_bit(address, f"service.{str(flag.name).lower()}", meaning))
    for slot in chosen:
        for flag, meaning in STATUS_MEANING.items():
            address = status_bits_address(slot) + flag.bit_length() - 1
            rows.append(_bit(address, f"slot{slot}.status.{str(flag.name).lower()}", meaning))
    meaning = "coil, can be written: on clears latched faults of the joint; reads 0"
    rows += [
        _bit(CLEAR_FAULT_COILS_ADDRESS + slot - 1, f"slot{slot}.clear_fault", meaning, coil_only=True)
        for slot in chosen
    ]
    return tuple(rows)


def number_rows() -> tuple[NumberRow, ...]:
    """What the numbers of the command and of the result register mean."""
    tables = (("command", COMMAND_MEANING), ("result", RESULT_MEANING))
    return tuple(
        NumberRow(register=f"command.{word}", number=int(number), name=number.name, meaning=meaning)
        for word, meanings in tables
        for number, meaning in meanings.items()
    )


def register_rows(slots: Iterable[int]) -> tuple[RegisterRow, ...]:
    """Every register that a daemon with joints in these slots (1..32) serves for them, by address.

    Raises ValueError for a slot outside 1..32.
    """
    chosen = sorted(set(slots))
    if outside := [slot for slot in chosen if not 1 <= slot <= SLOTS]:
        raise ValueError(f"slots: expected 1..{SLOTS}, got {outside}")
    rows: list[RegisterRow] = []
    for group in sorted({group_of(slot) for slot in chosen}):
        start = BLOCK_STRIDE * group
        rows += _rows(f"group{group}", start, FAST_HEADER)
        for slot in chosen:
            if group_of(slot) == group:
                rows += _rows(f"slot{slot}.fast", start + fast_slot_offset(slot), FAST_SLOT)
        rows += _rows(f"group{group}", start + FAST_REGISTERS - register_count(FAST_TAIL), FAST_TAIL)
    for slot in chosen:
        rows += _rows(f"slot{slot}.detail", detail_address(slot), DETAIL)
    return tuple(rows)


def bit_rows() -> tuple[BitRow, ...]:
    """The bits of the joints' status words and of the service status word."""
    return _bits("status", STATUS_MEANING.items()) + _bits("service_status", SERVICE_MEANING.items())


def render_markdown(slots: Iterable[int]) -> str:
    """Notes, register table and bit table as Markdown."""
    notes = "".join(f"- {note}\n" for note in MAP_NOTES)
    slots = tuple(slots)
    tables = (register_rows(slots), bit_rows(), command_rows(), number_rows(), input_rows(slots))
    return f"{notes}\n" + "\n".join(_markdown_table(rows) for rows in tables)


def render_csv(slots: Iterable[int]) -> str:
    """Registers, command block, discrete inputs and coils as comma-separated values with one header line.

    What the bits of a word and the numbers of a command mean is in the other renderings.
    """
    slots = tuple(slots)
    rows = (*register_rows(slots), *command_rows(), *input_rows(slots))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_column_names(RegisterRow))
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def render_text(slots: Iterable[int]) -> str:
    """Notes, register table and bit table in aligned columns."""
    notes = "".join(f"{note}\n" for note in MAP_NOTES)
    slots = tuple(slots)
    tables = (register_rows(slots), bit_rows(), command_rows(), number_rows(), input_rows(slots))
    return f"{notes}\n" + "\n".join(_text_table(rows) for rows in tables if rows)


def _rows(prefix: str, start: int, block: tuple[RegisterField, ...]) -> list[RegisterRow]:
    rows: list[RegisterRow] = []
    address = start
    for field in block:
        rows.append(
            RegisterRow(
                address_0based=address,
                address_1based=address + 1,
                input_reference=f"3{address + 1:05d}",
                holding_reference=f"4{address + 1:05d}",
                name=f"{prefix}.{field.name}",
                type=_TYPE_NAMES.get(field.type, field.type.name),
                registers=field.type.registers,
                scale=field.scale,
                unit=field.unit,
                marker=_marker(field),
                meaning=field.meaning,
            )
        )
        address += field.type.registers
    return rows


def _bit(address: int, name: str, meaning: str, *, coil_only: bool = False) -> RegisterRow:
    return RegisterRow(
        address_0based=address,
        address_1based=address + 1,
        input_reference="" if coil_only else f"1{address + 1:05d}",
        holding_reference=f"0{address + 1:05d}",
        name=name,
        type="BIT",
        registers=0,
        scale="1",
        unit="",
        marker="",
        meaning=meaning,
    )


_TYPE_NAMES = {
    RegisterType.BYTES8: "8 bytes",
    RegisterType.RESERVED_2: "reserved",
    RegisterType.RESERVED_10: "reserved",
}


def _marker(field: RegisterField) -> str:
    missing = field.type.missing
    if not field.may_be_missing or missing is None:
        return ""
    if isinstance(missing, bytes):
        return "0x" + missing.hex().upper()
    if isinstance(missing, int):
        # As the registers show it: two's complement for the signed types.
        digits = 4 * field.type.registers
        return f"0x{missing % (1 << 4 * digits):0{digits}X}"
    return "NaN"


def _bits(word: str, meanings: Iterable[tuple[enum.IntFlag, str]]) -> tuple[BitRow, ...]:
    return tuple(
        BitRow(word=word, bit=flag.bit_length() - 1, mask=f"0x{flag:08X}", name=str(flag.name), meaning=meaning)
        for flag, meaning in meanings
    )


def _column_names(row: type[_Row]) -> list[str]:
    return [field.name for field in fields(row)]


def _cells(rows: Sequence[_Row]) -> list[list[str]]:
    return [_column_names(type(rows[0])), *([str(cell) for cell in astuple(row)] for row in rows)] if rows else []


def _markdown_table(rows: Sequence[_Row]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in _cells(rows)]
    if lines:
        lines.insert(1, "|" + " --- |" * (lines[0].count("|") - 1))
    return "".join(f"{line}\n" for line in lines)


def _text_table(rows: Sequence[_Row]) -> str:
    cells = _cells(rows)
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() + "\n"
        for line in cells
    )
