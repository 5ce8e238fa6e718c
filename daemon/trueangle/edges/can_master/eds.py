"""The electronic data sheet of a node (EDS, CiA 306): read by the canopen library, believed in nothing.

It tells before the start which wanted objects a unit lacks, cannot map, or holds in another size. The node's own
read-back outranks it: what an EDS says is a warning, never a reason to do or to leave anything. So an EDS that
declares 0x1A00 as an array, whose total range is not the unit's, or that belongs to another revision does no harm.
A file that cannot be read as an EDS at all is the operator's to mend.
"""

import configparser
import io
import warnings
from pathlib import Path
from typing import cast

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, import_od

from trueangle.contract.errors import ContractError, Fault
from trueangle.core.frames import MappedObject, NodePlan
from trueangle.core.node_setup import shown

MAX_EDS_BYTES = 1 << 20
"""The largest of real units have a tenth of it."""
MAX_SECTIONS = 20_000
MAX_ENTRIES = 254
"""Of an array; a larger NrOfEntries would keep the library counting for hours."""


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary that the file describes; ContractError with one clear fault where there is none."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_EDS_BYTES + 1)
    except OSError as error:
        raise _unreadable(path, "a readable file", error.strerror or str(error)) from error
    if len(data) > MAX_EDS_BYTES:
        raise _unreadable(path, f"at most {MAX_EDS_BYTES} bytes", "a larger file")
    text = data.decode("latin-1")  # CiA 306 knows ASCII; makers write names in their own code page
    _check_shape(path, text)
    source = io.StringIO(text)
    source.name = "node.eds"  # the library chooses its reader by the ending
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_od(source, node_id)
    except Exception as error:  # the library raises what its conversions do
        found = f"{type(error).__name__}: {error}"
        raise _unreadable(path, "an EDS as CiA 306 describes it", found) from error


def _check_shape(path: Path, text: str) -> None:
    """What the library would not survive, or not in reasonable time."""
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise _unreadable(path, "an EDS as CiA 306 describes it", str(error).replace("\n", " ")) from error
    sections = parser.sections()
    if len(sections) > MAX_SECTIONS:
        raise _unreadable(path, f"at most {MAX_SECTIONS} sections", str(len(sections)))
    if "DeviceInfo" not in sections:
        raise _unreadable(path, "the section DeviceInfo", "none")
    for section in sections:
        entries = parser.get(section, "NrOfEntries", fallback="0")
        if not (entries.strip().isascii() and entries.strip().isdigit() and int(entries[:9]) <= MAX_ENTRIES):
            raise _unreadable(path, f"NrOfEntries of [{section}] 0 to {MAX_ENTRIES}", entries)


def eds_objections(plan: NodePlan, sheet: canopen.ObjectDictionary) -> list[str]:
    """What the data sheet says against this plan, one phrase an object; empty where it agrees."""
    objections: list[str] = []
    for tpdo in plan.tpdos:
        for mapped in tpdo.mapping:
            objections += _against(mapped, sheet, to_be_mapped=True)
    for polled in plan.polls:
        objections += _against(polled.value, sheet, to_be_mapped=False)
    return objections


def _against(wanted: MappedObject, sheet: canopen.ObjectDictionary, *, to_be_mapped: bool) -> list[str]:
    address = shown((wanted.index, wanted.subindex))
    variable = _variable(sheet, wanted.index, wanted.subindex)
    if variable is None:
        return [f"{address} ({wanted.quantity.value}) is not in the data sheet"]
    found: list[str] = []
    if to_be_mapped and not variable.pdo_mappable:
        found.append(f"{address} ({wanted.quantity.value}) cannot be mapped: poll it by SDO")
    bits = len(variable)
    if bits and bits != wanted.bits:
        found.append(f"{address} ({wanted.quantity.value}) has {bits} bits, configured are {wanted.bits}")
    return found


def _variable(sheet: canopen.ObjectDictionary, index: int, subindex: int) -> ODVariable | None:
    indices = cast("dict[int, ODVariable | ODArray | ODRecord]", sheet.indices)  # pyright: ignore[reportUnknownMemberType]
    found = indices.get(index)
    if found is None or isinstance(found, ODVariable):
        return found if subindex == 0 else None
    members = cast("dict[int, ODVariable]", found.subindices)  # pyright: ignore[reportUnknownMemberType]
    return members.get(subindex)


def _unreadable(path: Path, expected: str, found: str) -> ContractError:
    return ContractError([Fault(where=str(path), expected=expected, found=found)])
