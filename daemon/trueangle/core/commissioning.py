"""Setting a node up by hand: what to propose, what to write, and how to put everything back. No I/O here.

Rules of this file: nothing that moves the encoder's phase or scale (0x6000 to 0x6003) is ever written; the old
value of every object is known before the first is changed, or nothing is changed.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from trueangle.contract.document import Range, document_from_plain, plain, structure
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.frames import NodePlan
from trueangle.core.node_setup import (
    COB_INVALID,
    CYCLIC_TIMER,
    HEARTBEAT_PRODUCER,
    Address,
    SdoWrite,
    cob_address,
    event_timer_addresses,
    shown,
    tpdo_readback,
    tpdo_writes,
)

SCHEMA_VERSION = 1
STORE: Address = (0x1010, 1)
STORE_SIGNATURE = int.from_bytes(b"save", "little")
"""0x1010:1, CiA 301, 7.5.2.13: any other value stores nothing."""
_COMMUNICATION, _MAPPING = range(0x1800, 0x1A00), range(0x1A00, 0x1C00)
_IDENTITY = ("vendor_id", "product_code", "serial_number")
_NOT_PROPOSED = ("offset_value",)

Unsigned32 = Annotated[int, Range(minimum=0, maximum=2**32 - 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class OldObject:
    """One object as it was."""

    index: Annotated[int, Range(minimum=0x1000, maximum=0xFFFF)]
    """Of the communication profile, or 0x6200."""
    subindex: Annotated[int, Range(minimum=0, maximum=254)]
    size: Annotated[int, Range(minimum=1, maximum=4)]
    value: Unsigned32

    def __post_init__(self) -> None:
        # A file that was edited must not move the encoder's phase.
        if not (0x1000 <= self.index <= 0x1FFF or self.address == CYCLIC_TIMER):
            found = shown(self.address)
            raise ContractError([Fault(where="index", expected="0x1000 to 0x1FFF, or 0x6200:0", found=found)])
        if self.size == 3 or self.value >> 8 * self.size:
            found = f"{self.value} in {self.size} bytes"
            raise ContractError([Fault(where="value", expected="a value of 1, 2 or 4 bytes", found=found)])

    @property
    def address(self) -> Address:
        """Index and subindex."""
        return (self.index, self.subindex)


@dataclass(frozen=True, slots=True, kw_only=True)
class OldNode:
    """What was changed by SDO on one node."""

    node_id: Annotated[int, Range(minimum=1, maximum=127)]
    identity: Mapping[str, int]
    """Of the unit: another one on this node-id is not touched."""
    objects: tuple[OldObject, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class OldLayer:
    """What was changed by layer setting services on one unit."""

    vendor_id: Unsigned32
    product_code: Unsigned32
    revision_number: Unsigned32
    serial_number: Unsigned32
    node_id: Annotated[int, Range(minimum=1, maximum=255)]
    """255: it had none."""
    bitrate: int | None
    """None: not changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UndoRecord:
    """All that a commissioning changed, as it was before."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)] = SCHEMA_VERSION
    made: str = ""
    bus: str = ""
    nodes: tuple[OldNode, ...] = ()
    layers: tuple[OldLayer, ...] = ()


def undo_to_json(record: UndoRecord) -> str:
    """Text for a file."""
    return json.dumps(plain(record), indent=2) + "\n"


def undo_from_json(text: str, *, source: str) -> UndoRecord:
    """Back again; ContractError with every fault."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ContractError([Fault(where=source, expected="an undo file in JSON", found=str(error))]) from error
    return structure(UndoRecord, document_from_plain(document, source=source))


def identity_of(settings: EncoderSettings) -> dict[str, int]:
    """What tells this unit from another of its kind."""
    return {name: value for name, value in settings.known().items() if name in _IDENTITY}


def setup_addresses(plan: NodePlan) -> tuple[Address, ...]:
    """Every object that `setup_writes` may change, and those that tell how to put them back."""
    addresses: list[Address] = [HEARTBEAT_PRODUCER]
    for tpdo in plan.tpdos:
        mapping = 0x1A00 + tpdo.number - 1
        addresses += [cob_address(tpdo.number), (0x1800 + tpdo.number - 1, 2), (mapping, 0)]
        addresses += [(mapping, place) for place in range(1, 9)]
        addresses += event_timer_addresses(tpdo)
    return tuple(addresses)


def setup_writes(plan: NodePlan, found: Mapping[Address, OldObject]) -> tuple[SdoWrite, ...]:
    """Heartbeat and TPDOs as the daemon sets them, given what the node has now.

    Raises ContractError where the node lacks an object that is needed.
    """
    writes = [SdoWrite(address=HEARTBEAT_PRODUCER, value=plan.heartbeat_ms, size=2)]
    needed = [HEARTBEAT_PRODUCER]
    for tpdo in plan.tpdos:
        needed += tpdo_readback(tpdo).keys() - {(0x1A00 + tpdo.number - 1, place) for place in range(1, 9)}
    missing = sorted({address for address in needed if address not in found})
    if missing:
        names = ", ".join(shown(address) for address in missing)
        where = f"node {plan.node_id}"
        raise ContractError([Fault(where=where, expected=f"the objects {names}", found="no such objects")])
    for tpdo in plan.tpdos:
        timer = next((a for a in event_timer_addresses(tpdo) if a in found), None)
        event_timer = None if timer is None else (timer, found[timer].size)
        writes += tpdo_writes(tpdo, found[cob_address(tpdo.number)].value, event_timer)
    return tuple(writes)


def setup_expected(plan: NodePlan) -> dict[Address, int]:
    """What must read back after `setup_writes`."""
    expected: dict[Address, int] = {HEARTBEAT_PRODUCER: plan.heartbeat_ms}
    for tpdo in plan.tpdos:
        expected |= tpdo_readback(tpdo)
    return expected


def changed_objects(writes: Sequence[SdoWrite], found: Mapping[Address, OldObject]) -> tuple[OldObject, ...]:
    """The old values behind these writes, whole mappings included."""
    mappings = {address[0] for write in writes if (address := write.address)[0] in _MAPPING}
    touched = {write.address for write in writes}
    kept = [old for address, old in found.items() if address in touched or address[0] in mappings]
    return tuple(sorted(kept, key=lambda old: old.address))


def undo_writes(objects: Sequence[OldObject]) -> tuple[SdoWrite, ...]:
    """The downloads that put these objects back: a TPDO is switched off first and on, if it was, last."""
    by_address = {old.address: old for old in objects}
    writes: list[SdoWrite] = []
    pdo: list[SdoWrite] = []
    done: set[Address] = set()

    def put(address: Address, into: list[SdoWrite], value: int | None = None) -> None:
        old = by_address[address]
        into.append(SdoWrite(address=address, value=old.value if value is None else value, size=old.size))
        done.add(address)

    for index in sorted({address[0] for address in by_address if address[0] in _COMMUNICATION}):
        mapping = index + 0x200
        if (index, 1) in by_address:
            put((index, 1), pdo, by_address[index, 1].value | COB_INVALID)
        if (mapping, 0) in by_address:
            count = by_address[mapping, 0].value
            put((mapping, 0), pdo, 0)
            for place in range(1, 65):
                if (mapping, place) in by_address:
                    done.add((mapping, place))
                    if place <= count:
                        put((mapping, place), pdo)
            put((mapping, 0), pdo)
        for address in sorted(by_address):
            if address[0] == index and address[1] != 1:
                put(address, pdo)
        if (index, 1) in by_address:
            put((index, 1), pdo)
    for address in sorted(by_address):
        if address not in done:
            put(address, writes)
    return (*writes, *pdo)


def undo_expected(objects: Sequence[OldObject]) -> dict[Address, int]:
    """What must read back after `undo_writes`; unused places of a mapping are left out."""
    counts = {old.index: old.value for old in objects if old.index in _MAPPING and old.subindex == 0}
    return {
        old.address: old.value
        for old in objects
        if old.index not in _MAPPING or old.subindex <= counts.get(old.index, 64)
    }


def exact_differences(expected: Mapping[Address, int], found: Mapping[Address, int | None]) -> list[str]:
    """One phrase for each object that is not bit by bit as it was."""
    return [
        f"{shown(address)} expected 0x{want:X} found {'nothing' if got is None else f'0x{got:X}'}"
        for address, want in expected.items()
        if (got := found.get(address)) != want
    ]


def settings_yaml(settings: EncoderSettings) -> str:
    """The `encoder` block of the configuration for the unit as it is set now."""
    lines = ["encoder:", f"  counts_per_rev: {settings.counts_per_rev or '?  # the unit does not tell it'}"]
    lines.append("  settings:")
    for name, value in settings.known().items():
        if name not in _NOT_PROPOSED:
            hexadecimal = name in ("device_type", "vendor_id", "product_code", "revision_number")
            lines.append(f"    {name}: {f'0x{value:08X}' if hexadecimal else value}")
    return "\n".join(lines)
