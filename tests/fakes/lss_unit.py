"""CANopen units with layer setting services, made of bytes alone: as CiA 305 has them, or misbehaving."""

import struct
from collections.abc import Generator, Iterable
from dataclasses import dataclass, field
from typing import Any

Identity = tuple[int, int, int, int]


@dataclass
class LssUnit:
    """One unit; `handle` returns its answer to a frame on 0x7E5, None for silence."""

    identity: Identity
    node_id: int = 255
    bit_timing: int | None = None
    stored: tuple[int, int | None] | None = None
    configuring: bool = False
    deaf: bool = False
    refuses: dict[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    """Service code to error code and specific error."""
    forgets_node_id: bool = False
    """Confirms a node-id and keeps the old one."""
    answers_with: bytes | None = None
    """Sent instead of every answer."""
    _matched: int = 0
    _scan_at: int = 0

    def handle(self, data: bytes) -> bytes | None:
        if self.deaf:
            return None
        answer = self._served(data)
        return answer if answer is None or self.answers_with is None else self.answers_with

    def _served(self, data: bytes) -> bytes | None:
        code = data[0]
        number = struct.unpack_from("<I", data, 1)[0]
        if code == 0x04:
            self.configuring = data[1] == 1
            return None
        if 0x40 <= code <= 0x43:
            return self._selected(code - 0x40, number)
        if 0x46 <= code <= 0x4B:
            return self._identified(code - 0x46, number)
        if code == 0x51:
            return self._scanned(number, *data[5:8])
        return self._configured(code, data) if self.configuring else None

    def _selected(self, part: int, number: int) -> bytes | None:
        self._matched = self._matched + 1 if self._matched == part and number == self.identity[part] else 0
        if part == 3 and self._matched == 4:
            self._matched, self.configuring = 0, True
            return bytes((0x44,)) + bytes(7)
        return None

    def _identified(self, part: int, number: int) -> bytes | None:
        vendor, product, revision, serial = self.identity
        fits = (
            number == vendor,
            number == product,
            number <= revision,
            number >= revision,
            number <= serial,
            number >= serial,
        )
        self._matched = self._matched + 1 if self._matched == part and fits[part] else 0
        if part == 5 and self._matched == 6:
            self._matched = 0
            return bytes((0x4F,)) + bytes(7)
        return None

    def _scanned(self, number: int, bit: int, part: int, following: int) -> bytes | None:
        if self.node_id != 255:
            return None
        if bit == 128:
            self._scan_at = 0
            return bytes((0x4F,)) + bytes(7)
        if part != self._scan_at or number >> bit != self.identity[part] >> bit:
            return None
        if bit == 0 and number == self.identity[part] and following != part:
            self._scan_at = following
            if part == 3:
                self.configuring = True
        return bytes((0x4F,)) + bytes(7)

    def _configured(self, code: int, data: bytes) -> bytes | None:
        if 0x5A <= code <= 0x5D:
            return struct.pack("<BI3x", code, self.identity[code - 0x5A])
        if code == 0x5E:
            return bytes((code, self.node_id)) + bytes(6)
        if code not in (0x11, 0x13, 0x17):
            return None
        error, specific = self.refuses.get(code, (0, 0))
        if not error:
            if code == 0x11 and not self.forgets_node_id:
                self.node_id = data[1]
            elif code == 0x13:
                self.bit_timing = data[2]
            elif code == 0x17:
                self.stored = (self.node_id, self.bit_timing)
        return bytes((code, error, specific)) + bytes(5)


def converse(service: Generator[Any, tuple[bytes, ...], Any], units: Iterable[LssUnit]) -> Any:
    """Run a service of the master against these units; what it returns."""
    answers: tuple[bytes, ...] | None = None
    units = list(units)
    while True:
        try:
            request = next(service) if answers is None else service.send(answers)
        except StopIteration as end:
            return end.value
        assert len(request.data) == 8
        answers = tuple(answer for unit in units if (answer := unit.handle(request.data)) is not None)
        if not request.answered:
            assert answers == ()
