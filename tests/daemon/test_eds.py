"""Electronic data sheets: read where they can be, refused by one clear fault where not, and never obeyed."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trueangle.contract.errors import ContractError
from trueangle.core.frames import MappedObject, NodePlan, PolledObject, Quantity, TpdoPlan
from trueangle.edges.can_master.eds import eds_objections, load_eds

GOOD = """\
[FileInfo]
FileName=unit.eds

[DeviceInfo]
VendorName=Unit

[MandatoryObjects]
SupportedObjects=1
1=0x1000

[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020196

[1A00]
ParameterName=Transmit PDO mapping
ObjectType=0x8
SubNumber=2

[1A00sub0]
ParameterName=Number of entries
DataType=0x0005
AccessType=rw

[1A00sub1]
ParameterName=Entry 1
DataType=0x0007
AccessType=rw

[6004]
ParameterName=Position value
ObjectType=0x7
DataType=0x0007
AccessType=ro
PDOMapping=1

[7130]
ParameterName=Temperature
ObjectType=0x8
SubNumber=2

[7130sub0]
ParameterName=Number of entries
DataType=0x0005
AccessType=ro

[7130sub1]
ParameterName=Temperature 1
DataType=0x0004
AccessType=ro
PDOMapping=0
"""
"""0x1A00 is declared an array, as several makers do."""
POSITION = MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)
TEMPERATURE = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE)
SEQUENCE = MappedObject(index=0x2100, subindex=0, bits=16, quantity=Quantity.SEQUENCE)


def plan(*mapped: MappedObject, polls: tuple[PolledObject, ...] = ()) -> NodePlan:
    tpdo = TpdoPlan(number=1, cob_id=0x181, transmission_type=1, mapping=mapped)
    return NodePlan(slot=1, node_id=1, heartbeat_ms=200, tpdos=(tpdo,), polls=polls)


def written(directory: Path, text: str) -> Path:
    path = directory / "unit.eds"
    path.write_text(text, encoding="latin-1")
    return path


def test_data_sheet_that_agrees_has_no_objection(tmp_path: Path) -> None:
    assert eds_objections(plan(POSITION), load_eds(written(tmp_path, GOOD), 1)) == []


def test_missing_unmappable_and_wrongly_sized_objects_are_named(tmp_path: Path) -> None:
    polled = PolledObject(value=TEMPERATURE, period_ms=100)
    sheet = load_eds(written(tmp_path, GOOD), 1)
    assert eds_objections(plan(POSITION, TEMPERATURE, SEQUENCE, polls=(polled,)), sheet) == [
        "0x7130:1 (temperature) cannot be mapped: poll it by SDO",
        "0x7130:1 (temperature) has 32 bits, configured are 16",
        "0x2100:0 (sequence) is not in the data sheet",
        "0x7130:1 (temperature) has 32 bits, configured are 16",
    ]


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("[DeviceInfo]", "[Device]"), "the section DeviceInfo"),
        (("[6004]", "[6004"), "an EDS as CiA 306 describes it"),
        (("[6004]\nParameterName=Position value", "[6004]"), "ParameterName"),
        (("DataType=0x0007", "DataType=many"), "an EDS as CiA 306 describes it"),
        (("[7130]", "[7130]\nNrOfEntries=1000000000"), "NrOfEntries of [7130] 0 to 254"),
        (("[6004]", "[6004]\n[6004]"), "already exists"),
        (("[1A00sub0]", "[1B00sub0]"), "an EDS as CiA 306 describes it"),
    ],
)
def test_broken_data_sheet_is_one_clear_fault(tmp_path: Path, change: tuple[str, str], found: str) -> None:
    assert change[0] in GOOD
    with pytest.raises(ContractError) as caught:
        load_eds(written(tmp_path, GOOD.replace(*change, 1)), 1)
    (fault,) = caught.value.faults
    assert "unit.eds" in str(fault)
    assert found in str(fault)


def test_absent_and_huge_files_are_faults(tmp_path: Path) -> None:
    with pytest.raises(ContractError, match="a readable file"):
        load_eds(tmp_path / "nowhere.eds", 1)
    with pytest.raises(ContractError, match="at most"):
        load_eds(written(tmp_path, ";" * (2**20 + 1)), 1)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    at=st.integers(0, len(GOOD)),
    cut=st.integers(0, 40),
    put=st.text(st.characters(max_codepoint=255), max_size=12),
)
def test_whatever_stands_in_the_file_it_is_read_or_refused(tmp_path: Path, at: int, cut: int, put: str) -> None:
    with contextlib.suppress(ContractError):
        sheet = load_eds(written(tmp_path, GOOD[:at] + put + GOOD[at + cut :]), 1)
        eds_objections(plan(POSITION, TEMPERATURE, SEQUENCE), sheet)
