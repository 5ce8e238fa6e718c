"""A CANopen encoder made of bytes alone (no canopen library, no python-can): what a node's far end may do.

It answers expedited SDO, obeys NMT and keeps CiA 301's rules for mappings, or misbehaves as told.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

Address = tuple[int, int]
Reply = tuple[int, bytes]

ABSENT = 0x06020000
NO_SUBINDEX = 0x06090011
UNMAPPABLE = 0x06040041
DEVICE_STATE = 0x08000022


def encoder_objects(node_id: int) -> dict[Address, tuple[int, int]]:
    """Object to (value, size in bytes) of a plain single-turn encoder, silent as from the factory."""
    return {
        (0x1000, 0): (0x0002_0196, 4),
        (0x1001, 0): (0, 1),
        (0x1017, 0): (0, 2),
        (0x1018, 1): (0x1234, 4),
        (0x1018, 2): (0x5678, 4),
        (0x1018, 3): (0x0001_0002, 4),
        (0x1018, 4): (0, 4),
        (0x1800, 1): (0x4000_0180 + node_id, 4),
        (0x1800, 2): (255, 1),
        (0x1801, 1): (0x4000_0280 + node_id, 4),
        (0x1801, 2): (255, 1),
        (0x1A00, 0): (1, 1),
        (0x1A00, 1): (0x6004_0020, 4),
        (0x1A00, 2): (0, 4),
        (0x1A01, 0): (1, 1),
        (0x1A01, 1): (0x6004_0020, 4),
        (0x1A01, 2): (0, 4),
        (0x6000, 0): (4, 2),
        (0x6001, 0): (1 << 20, 4),
        (0x6002, 0): (1 << 20, 4),
        (0x6003, 0): (77, 4),
        (0x6501, 0): (1 << 20, 4),
        (0x6502, 0): (1, 2),
        (0x6503, 0): (0, 2),
        (0x6509, 0): (5, 4),
        (0x650B, 0): (4711, 4),
    }


@dataclass
class FakeDevice:
    """One node. `handle` takes a frame of the bus and sends by `send`."""

    node_id: int
    send: Callable[[int, bytes], None]
    objects: dict[Address, tuple[int, int]] = field(default_factory=dict[Address, tuple[int, int]])
    state: int = 0x7F
    deaf: bool = False
    """Takes no frame at all: switched off, or its cable is out."""
    ignores_mapping: bool = False
    """Confirms every write to a mapping and keeps the old one."""
    ignores_nmt: bool = False
    refuses: dict[Address, int] = field(default_factory=dict[Address, int])
    """Abort code for writes to these objects."""
    answers_wrong_object: bool = False
    answers_twice: bool = False
    """A second unit with the same node-id hears every request too."""
    forgets: set[Address] = field(default_factory=set[Address])
    """Writes to these are confirmed and change nothing."""
    writes: list[tuple[int, int, int]] = field(default_factory=list[tuple[int, int, int]])
    """Index, subindex, value of each SDO download, in order."""
    nmt: list[int] = field(default_factory=list[int])

    def __post_init__(self) -> None:
        self.objects = encoder_objects(self.node_id) | self.objects

    def handle(self, can_id: int, data: bytes) -> None:
        if self.deaf:
            return
        if can_id == 0x000 and data[1] in (0, self.node_id):
            self._obey(data[0])
        elif can_id == 0x600 + self.node_id:
            self._serve(data)

    def heartbeat(self) -> None:
        self.send(0x700 + self.node_id, bytes((self.state,)))

    def boot_up(self, changed: dict[Address, tuple[int, int]] | None = None) -> None:
        """What a node sends when its supply came back: its objects are the factory's again, but for `changed`."""
        self.objects |= encoder_objects(self.node_id) | (changed or {})
        self.state = 0x7F
        self.send(0x700 + self.node_id, b"\x00")

    def emergency(self, code: int) -> None:
        self.send(0x080 + self.node_id, struct.pack("<HB5x", code, 1 if code else 0))

    def _obey(self, command: int) -> None:
        self.nmt.append(command)
        wanted = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}[command]
        if not self.ignores_nmt:
            self.state = wanted
        self.heartbeat()

    def _serve(self, data: bytes) -> None:
        command, index, subindex = struct.unpack_from("<BHB", data)
        address = (index, subindex)
        if command == 0x80:
            return
        if address not in self.objects:
            known = any(i == index for i, _ in self.objects)
            self._abort(address, NO_SUBINDEX if known else ABSENT)
        elif command == 0x40:
            value, size = self.objects[address]
            told = (index, subindex + 1) if self.answers_wrong_object else address
            self._reply(0x43 | (4 - size) << 2, told, value)
        elif command & 0xE3 == 0x23:
            self._download(address, int.from_bytes(data[4 : 8 - (command >> 2 & 3)], "little"))
        else:
            self._abort(address, 0x05040001)

    def _download(self, address: Address, value: int) -> None:
        index, subindex = address
        self.writes.append((index, subindex, value))
        abort = self.refuses.get(address) or self._mapping_fault(index, subindex)
        if abort:
            self._abort(address, abort)
            return
        if not (self.ignores_mapping and 0x1A00 <= index <= 0x1A03) and address not in self.forgets:
            self.objects[address] = (value, self.objects[address][1])
        self._reply(0x60, address, 0)

    def _mapping_fault(self, index: int, subindex: int) -> int:
        """A mapping changes only while its PDO is invalid, its entries only while their count is 0."""
        if not 0x1A00 <= index <= 0x1A03 or self.ignores_mapping:
            return 0
        if not self.objects[index - 0x200, 1][0] >> 31:
            return DEVICE_STATE
        return DEVICE_STATE if subindex and self.objects[index, 0][0] else 0

    def _reply(self, command: int, address: Address, value: int) -> None:
        for _ in range(2 if self.answers_twice else 1):
            self.send(0x580 + self.node_id, struct.pack("<BHBI", command, *address, value))

    def _abort(self, address: Address, code: int) -> None:
        self._reply(0x80, address, code)
