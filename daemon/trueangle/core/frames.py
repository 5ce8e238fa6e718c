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


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedObject:
    """One entry of a PDO mapping (CiA 301, 0x1A00 and following: index, subindex, length in bits)."""

    index: int
    subindex: int
    bits: int
    quantity: Quantity
    signed: bool = False

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
    """1..240: every that-many SYNC."""
    mapping: tuple[MappedObject, ...]

    @property
    def length(self) -> int:
        """Length of the frame in bytes."""
        return sum(entry.bits for entry in self.mapping) // 8


@dataclass(frozen=True, slots=True, kw_only=True)
class NodePlan:
    """All process data that one joint expects of its node."""

    slot: int
    """The joint's register slot, 1..32."""
    node_id: int
    tpdos: tuple[TpdoPlan, ...]
    heartbeat_ms: int


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

    slot: int
    length: int
    unpack: struct.Struct
    quantities: tuple[Quantity, ...]


def frame_layouts(plan: NodePlan) -> dict[int, FrameLayout]:
    """COB-ID to layout for one node; process data are little endian (CiA 301, 7.1.4)."""
    return {
        tpdo.cob_id: FrameLayout(
            slot=plan.slot,
            length=tpdo.length,
            unpack=struct.Struct("<" + "".join(_CODES[o.bits, o.signed] for o in tpdo.mapping)),
            quantities=tuple(o.quantity for o in tpdo.mapping),
        )
        for tpdo in plan.tpdos
    }
