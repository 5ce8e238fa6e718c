"""The register table against a frozen copy of version 1: an address, once given, never moves."""

import csv
import io
import struct
from pathlib import Path

import pytest
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.register_table import (
    RegisterRow,
    bit_rows,
    command_rows,
    input_rows,
    number_rows,
    register_rows,
    render_csv,
    render_markdown,
    render_text,
)
from trueangle.core.registers import RegisterMap

FROZEN_GROUP_0_SLOT_2 = [
    (0, "group0.map_version", "UINT16", "1", "", ""),
    (1, "group0.joints_configured", "UINT16", "1", "", ""),
    (2, "group0.cycle_counter", "UINT32", "1", "", ""),
    (4, "group0.heartbeat", "UINT16", "1", "", ""),
    (5, "group0.not_valid", "UINT32", "1", "", ""),
    (7, "group0.service_status", "UINT16", "1", "", ""),
    (8, "group0.reserved", "reserved", "1", "", ""),
    (22, "slot2.fast.status", "UINT32", "1", "", ""),
    (24, "slot2.fast.sequence", "UINT16", "1", "", "0xFFFF"),
    (25, "slot2.fast.corrected", "INT32", "0.001", "arcsec", "0x80000000"),
    (27, "slot2.fast.raw", "INT32", "0.001", "arcsec", "0x80000000"),
    (29, "slot2.fast.correction", "INT32", "0.001", "arcsec", "0x80000000"),
    (31, "slot2.fast.temperature", "INT16", "0.01", "degC", "0x8000"),
    (32, "slot2.fast.age", "UINT16", "1", "ms", "0xFFFF"),
    (33, "slot2.fast.uncertainty", "UINT16", "0.01", "arcsec", "0xFFFF"),
    (82, "group0.cycle_counter_tail", "UINT32", "1", "", ""),
    (1100, "slot2.detail.cycle_counter", "UINT32", "1", "", ""),
    (1102, "slot2.detail.status", "UINT32", "1", "", ""),
    (1104, "slot2.detail.sequence", "UINT16", "1", "", "0xFFFF"),
    (1105, "slot2.detail.node_id", "UINT16", "1", "", ""),
    (1106, "slot2.detail.corrected", "INT32", "0.001", "arcsec", "0x80000000"),
    (1108, "slot2.detail.corrected_float64", "FLOAT64", "1", "deg", "NaN"),
    (1112, "slot2.detail.corrected_float32", "FLOAT32", "1", "deg", "NaN"),
    (1114, "slot2.detail.raw", "INT32", "0.001", "arcsec", "0x80000000"),
    (1116, "slot2.detail.raw_float64", "FLOAT64", "1", "deg", "NaN"),
    (1120, "slot2.detail.raw_float32", "FLOAT32", "1", "deg", "NaN"),
    (1122, "slot2.detail.velocity", "FLOAT32", "1", "deg/s", "NaN"),
    (1124, "slot2.detail.turns", "INT32", "1", "turn", "0x80000000"),
    (1126, "slot2.detail.temperature", "FLOAT32", "1", "degC", "NaN"),
    (1128, "slot2.detail.correction", "FLOAT32", "1", "arcsec", "NaN"),
    (1130, "slot2.detail.uncertainty", "FLOAT32", "1", "arcsec", "NaN"),
    (1132, "slot2.detail.age", "UINT32", "1", "ms", "0xFFFFFFFF"),
    (1134, "slot2.detail.raw_counts", "UINT32", "1", "", "0xFFFFFFFF"),
    (1136, "slot2.detail.frames_received", "UINT32", "1", "", ""),
    (1138, "slot2.detail.frames_lost", "UINT32", "1", "", ""),
    (1140, "slot2.detail.model_id", "8 bytes", "1", "", "0xFFFFFFFFFFFFFFFF"),
    (1144, "slot2.detail.calibration_date", "UINT32", "1", "", "0xFFFFFFFF"),
    (1146, "slot2.detail.calibration_due", "UINT32", "1", "", "0xFFFFFFFF"),
    (1148, "slot2.detail.vendor_id", "UINT32", "1", "", "0xFFFFFFFF"),
    (1150, "slot2.detail.product_code", "UINT32", "1", "", "0xFFFFFFFF"),
    (1152, "slot2.detail.revision_number", "UINT32", "1", "", "0xFFFFFFFF"),
    (1154, "slot2.detail.serial_number", "UINT32", "1", "", "0xFFFFFFFF"),
    (1156, "slot2.detail.user_zero", "INT32", "0.001", "arcsec", "0x80000000"),
    (1158, "slot2.detail.reserved", "reserved", "1", "", ""),
    (1168, "slot2.detail.cycle_counter_tail", "UINT32", "1", "", ""),
]


def test_addresses_types_scales_and_markers_of_version_1_have_not_moved() -> None:
    rows = [
        (row.address_0based, row.name, row.type, row.scale, row.unit, row.marker) for row in register_rows([2])
    ]
    assert rows == FROZEN_GROUP_0_SLOT_2


def test_every_slot_repeats_the_layout_at_its_own_place() -> None:
    by_name = {row.name: row.address_0based for row in register_rows(range(1, 33))}
    for slot in range(1, 33):
        group, place = divmod(slot - 1, 6)
        assert by_name[f"slot{slot}.fast.status"] == 100 * group + 10 + 12 * place
        assert by_name[f"slot{slot}.detail.cycle_counter"] == 1000 + 100 * (slot - 1)
        assert by_name[f"group{group}.map_version"] == 100 * group


def test_the_four_forms_of_an_address_agree() -> None:
    row = next(row for row in register_rows([1]) if row.name == "slot1.detail.corrected_float64")
    forms = (row.address_0based, row.address_1based, row.input_reference, row.holding_reference)
    assert forms == (1008, 1009, "301009", "401009")


def test_the_detail_block_leaves_no_register_undocumented() -> None:
    rows = [row for row in register_rows([5]) if row.name.startswith("slot5.detail")]
    ends = [row.address_0based + row.registers for row in rows]
    assert [row.address_0based for row in rows[1:]] == ends[:-1]
    assert (rows[0].address_0based, ends[-1]) == (1400, 1470)


GOLDEN = Path(__file__).parents[1] / "data" / "register_map_1.csv"
"""What PLC programs for version 1 rely on, of slots at the edges of groups and of the map. Rows are only added."""


def test_no_address_of_version_1_has_moved_or_changed_its_type() -> None:
    slots = (1, 6, 7, 32)
    now = {
        (row.type == "BIT", row.address_0based): (
            row.name,
            row.type,
            str(row.registers),
            row.scale,
            row.unit,
            row.marker,
        )
        for row in register_rows(slots) + command_rows() + input_rows(slots)
    }
    with GOLDEN.open(encoding="ascii", newline="") as file:
        golden = list(csv.DictReader(file))
    assert len(golden) > 250
    moved = [
        line
        for line in golden
        if not line["name"].endswith(".reserved")
        and now.get((line["type"] == "BIT", int(line["address_0based"])))
        != tuple(line[key] for key in ("name", "type", "registers", "scale", "unit", "marker"))
    ]
    assert moved == []


def test_what_version_1_gains_lies_where_nothing_was() -> None:
    """A new value on an old one would be read as the old one by a program that knows only that."""
    slots = (1, 6, 7, 32)
    with GOLDEN.open(encoding="ascii", newline="") as file:
        golden = list(csv.DictReader(file))
    names = {line["name"] for line in golden}
    taken = {
        int(line["address_0based"]) + offset
        for line in golden
        if line["type"] not in ("BIT", "reserved")
        for offset in range(int(line["registers"]))
    }
    added = [row for row in register_rows(slots) + command_rows() if row.name not in names]
    assert [
        row.name for row in added if taken & set(range(row.address_0based, row.address_0based + row.registers))
    ] == []


def test_the_command_block_lies_behind_every_joint() -> None:
    rows = command_rows()
    assert [(row.address_0based, row.name, row.type) for row in rows] == [
        (5000, "command.slot", "UINT16"),
        (5001, "command.angle", "INT32"),
        (5003, "command.command", "UINT16"),
        (5004, "command.result", "UINT16"),
        (5005, "command.armed_slot", "UINT16"),
        (5006, "command.armed_left", "UINT16"),
        (5007, "command.commands", "UINT16"),
    ]
    assert max(row.address_0based for row in register_rows([32])) < 5000


def test_bits_have_the_forms_that_plc_programs_write() -> None:
    rows = {row.name: row for row in input_rows([1, 32])}
    assert (rows["slot32.valid"].address_0based, rows["slot32.valid"].input_reference) == (31, "100032")
    assert rows["slot32.configured"].address_0based == 63
    assert rows["service.all_valid"].address_0based == 64
    assert rows["slot32.status.stale"].address_0based == 100 + 31 * 32 + 2
    coil = rows["slot1.clear_fault"]
    assert (coil.address_0based, coil.input_reference, coil.holding_reference) == (2000, "", "002001")


CODES = {"UINT16": "H", "INT16": "h", "UINT32": "I", "INT32": "i", "FLOAT32": "f", "FLOAT64": "d"}


def test_what_the_table_says_is_what_the_image_holds() -> None:
    """A reader who knows only the table finds each value of a joint, scaled, in the image."""
    image = RegisterMap([joint_identity(9)]).image(
        cycle=77, heartbeat=5, service_status=1, states={9: joint_state()}
    )

    def read(row: RegisterRow) -> float:
        data = image.read(row.address_0based, row.registers)
        assert data is not None
        return struct.unpack(">" + CODES[row.type], data)[0] * float(row.scale)

    found = {row.name: read(row) for row in register_rows([9]) if row.type in CODES}
    expected = {
        "group1.map_version": 1,
        "group1.joints_configured": 1,
        "group1.heartbeat": 5,
        "group1.not_valid": 0,
        "group1.cycle_counter_tail": 77,
        "slot9.fast.status": 3,
        "slot9.fast.corrected": 123.4567891 * 3600,
        "slot9.fast.raw": 123.4512345 * 3600,
        "slot9.fast.correction": 19.99656,
        "slot9.fast.temperature": 23.456,
        "slot9.fast.age": 1.7,
        "slot9.fast.uncertainty": 2.348,
        "slot9.detail.corrected": 123.4567891 * 3600,
        "slot9.detail.corrected_float64": 123.4567891,
        "slot9.detail.velocity": -45.5,
        "slot9.detail.turns": -3,
        "slot9.detail.calibration_date": 20260309,
        "slot9.detail.serial_number": 0xCAFE_0009,
        "slot9.detail.frames_lost": 7,
        "slot9.detail.cycle_counter_tail": 77,
    }
    # Half a count of the register's scale.
    scales = {row.name: float(row.scale) for row in register_rows([9])}
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=0.5 * scales[name] + 1e-9), name


def test_every_status_bit_is_documented_once_under_its_number() -> None:
    rows = bit_rows()
    assert {row.bit for row in rows if row.word == "status"} == {bit.bit_length() - 1 for bit in StatusBit}
    assert {row.bit for row in rows if row.word == "service_status"} == {
        bit.bit_length() - 1 for bit in ServiceBit
    }
    assert len({(row.word, row.bit) for row in rows}) == len(rows)
    valid = rows[0]
    assert (valid.bit, valid.mask, valid.name) == (0, "0x00000001", "VALID")


def test_csv_holds_every_row_under_the_column_names() -> None:
    read = list(csv.DictReader(io.StringIO(render_csv([1, 8]))))
    rows = register_rows([1, 8]) + command_rows() + input_rows([1, 8])
    assert [line["name"] for line in read] == [row.name for row in rows]
    assert [int(line["address_0based"]) for line in read] == [row.address_0based for row in rows]
    assert [line["meaning"] for line in read] == [row.meaning for row in rows]


def test_markdown_has_as_many_columns_in_every_line_of_a_table() -> None:
    lines = [line for line in render_markdown([1]).splitlines() if line.startswith("|")]
    tables = (
        (register_rows([1]), 12),
        (bit_rows(), 6),
        (command_rows(), 12),
        (number_rows(), 5),
        (input_rows([1]), 12),
    )
    assert [line.count("|") for line in lines] == [bars for rows, bars in tables for _ in range(len(rows) + 2)]


def test_plain_text_names_every_register_and_bit() -> None:
    text = render_text([3])
    assert all(f"  {row.name} " in text for row in register_rows([3]))
    assert all(f"  {row.name} " in text for row in bit_rows() + command_rows() + number_rows() + input_rows([3]))
    assert not any(line.endswith(" ") for line in text.splitlines())


def test_no_configured_slot_gives_no_register() -> None:
    assert register_rows([]) == ()


@pytest.mark.parametrize("slot", [0, 33])
def test_a_slot_outside_the_map_is_refused(slot: int) -> None:
    with pytest.raises(ValueError, match="slots"):
        register_rows([slot])
