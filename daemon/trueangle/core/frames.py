"""From COB-ID and bytes to numbers: the table of expected process data, built once, checked per frame.

Rules of this file: a frame is decoded only when its COB-ID is in the table and its length is exactly the mapped
one; anything else is counted by name and never decoded. Layouts come from the mapping that the master has
read back from the node, so table and node cannot disagree.
"""

import enum
import struct
from dataclasses import dataclass

POSITION_OBJECT = (0x6004, 0)
"""CiA 406 position value, UNSIGNED32."""


class Quantity(enum.Enum):
    """What a mapped object means to a joint."""

    POSITION = "position"
    TEMPERATURE = "temperature"
    SEQUENCE = "sequence"
    TEMPERATURE_STATUS = "temperature status"
    """What the sensor's electronics say of the temperature; 0 is good (CiA 404, 0x6150)."""
    REFERENCE = "reference"
    """Whether an encoder without an absolute zero has passed its reference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedObject:
    """One entry of a PDO mapping (CiA 301, 0x1A00 and following: index, subindex, length in bits)."""

    index: int
    subindex: int
    bits: int
    quantity: Quantity
    signed: bool = False
    slot: int | None = None
    """The joint that it belongs to; None: that of the node."""

    @property
    def entry(self) -> int:
        """The UNSIGNED32 of the mapping record."""
        return self.index << 16 | self.subindex << 8 | self.bits


@dataclass(frozen=True, slots=True, kw_only=True)
class TpdoPlan:
    """One transmit PDO as the master wants it: communication record 0x1800 + n-1, mapping 0x1A00 + n-1."""

    number: int
    """1..4"""
    cob_id: int
    transmission_type: int
    """1..240: every that-many SYNC; 254, 255: by the node's own event."""
    mapping: tuple[MappedObject, ...]
    event_timer_ms: int | None = None
    """0x1800:5, sent at the latest after so long; None: not set and not asked for."""

    @property
    def length(self) -> int:
        """Length of the frame in bytes."""
        return sum(entry.bits for entry in self.mapping) // 8

    @property
    def synchronous(self) -> bool:
        """Whether SYNC makes the node send it."""
        return self.transmission_type <= LAST_SYNCHRONOUS_TYPE


@dataclass(frozen=True, slots=True, kw_only=True)
class PolledObject:
    """One object that is read by SDO in service, because it cannot be mapped or seldom changes."""

    value: MappedObject
    period_ms: int | None
    """None: read once, when the node comes into service; from then on the node itself tells of changes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedValue:
    """An object that must read so, or be absent, for the numbers of a node to mean what the configuration says."""

    index: int
    subindex: int
    value: int
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NodePlan:
    """All that is expected of one node."""

    slot: int | None
    """The register slot, 1..32, of the joint whose encoder it is; None: it only measures temperature."""
    node_id: int
    tpdos: tuple[TpdoPlan, ...]
    heartbeat_ms: int
    """The heartbeat asked of it; where it has none (`polled`), how often it is asked for life by SDO."""
    polled: bool = False
    """It has no heartbeat: that it lives is known only because it answers."""
    as_found: bool = False
    """Never written to: what it is set to must already be right."""
    polls: tuple[PolledObject, ...] = ()
    expected: tuple[ExpectedValue, ...] = ()
    head: int = 0
    """Which reading head of its joint it is: 0 for the first."""


LAST_SYNCHRONOUS_TYPE = 240
"""Transmission types 1 to 240 are synchronous and cyclic (CiA 301, 7.5.2.35)."""
PROFILE_EVENT_TYPE = 255

_CODES = {
    (8, False): "B",
    (8, True): "b",
    (16, False): "H",
    (16, True): "h",
    (32, False): "I",
    (32, True): "i",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLayout:
    """How to read one COB-ID: struct of the whole frame and the meaning of each value."""

    slot: int | None
    """The joint that every value belongs to; None: see `slots`."""
    length: int
    unpack: struct.Struct
    quantities: tuple[Quantity, ...]
    slots: tuple[int, ...]
    """The joint of each value."""
    position_at: int | None
    """Which value is the position; None: none is."""
    sequence_at: int | None
    """Which value is the sequence number; None: none is."""
    others: tuple[tuple[int, Quantity], ...]
    """Which values are neither, each with its meaning."""


def frame_layouts(plan: NodePlan) -> dict[int, FrameLayout]:
    """COB-ID to layout for one node; process data are little endian (CiA 301, 7.1.4)."""
    layouts: dict[int, FrameLayout] = {}
    for tpdo in plan.tpdos:
        slots = tuple(slot_of(plan, mapped) for mapped in tpdo.mapping)
        quantities = tuple(o.quantity for o in tpdo.mapping)
        own = (Quantity.POSITION, Quantity.SEQUENCE)
        layouts[tpdo.cob_id] = FrameLayout(
            slot=plan.slot if set(slots) == {plan.slot} else None,
            length=tpdo.length,
            unpack=struct.Struct("<" + "".join(_CODES[o.bits, o.signed] for o in tpdo.mapping)),
            quantities=quantities,
            slots=slots,
            position_at=_last_place(quantities, Quantity.POSITION),
            sequence_at=_last_place(quantities, Quantity.SEQUENCE),
            others=tuple((place, quantity) for place, quantity in enumerate(quantities) if quantity not in own),
        )
    return layouts


def _last_place(quantities: tuple[Quantity, ...], quantity: Quantity) -> int | None:
    places = [place for place, one in enumerate(quantities) if one is quantity]
    return places[-1] if places else None


def slot_of(plan: NodePlan, mapped: MappedObject) -> int:
    """The joint that this object of the node belongs to."""
    slot = plan.slot if mapped.slot is None else mapped.slot
    if slot is None:
        raise ValueError(f"node {plan.node_id}: {mapped} belongs to no joint")
    return slot


def number_in(mapped: MappedObject, data: bytes) -> int | None:
    """The value of an object as SDO told it; None where it has not the expected length."""
    if len(data) * 8 != mapped.bits:
        return None
    return int.from_bytes(data, "little", signed=mapped.signed)
