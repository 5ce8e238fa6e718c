"""Layer setting services (CiA 305): node-id and bit rate of units that do not have their own yet. No I/O here.

Rules of this file: a service is a generator that yields one `LssRequest` after the other and is sent all answers
that came in its time, so that two units that answer at once are seen as two. A silent unit, a second answer, a
wrong service code and an error code are each told apart; nothing counts as set because it was sent.
"""

import struct
from collections.abc import Generator
from dataclasses import dataclass

from trueangle.errors import LinkError, NodeFault

MASTER_COB_ID, SLAVE_COB_ID = 0x7E5, 0x7E4
WAITING, CONFIGURATION = 0, 1
"""Modes of 'switch mode global'."""

_SWITCH_GLOBAL = 0x04
_SWITCH_SELECTIVE = (0x40, 0x41, 0x42, 0x43)
_SELECTED = 0x44
_IDENTIFY = (0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B)
"""Vendor, product, revision low, revision high, serial low, serial high."""
_IDENTIFIED = 0x4F
_FASTSCAN = 0x51
_FASTSCAN_RESET = 128
_NODE_ID, _BIT_TIMING, _ACTIVATE, _STORE = 0x11, 0x13, 0x15, 0x17
_INQUIRE_IDENTITY = (0x5A, 0x5B, 0x5C, 0x5D)
_INQUIRE_NODE_ID = 0x5E

BIT_TIMING_INDEX = {
    1_000_000: 0,
    800_000: 1,
    500_000: 2,
    250_000: 3,
    125_000: 4,
    50_000: 6,
    20_000: 7,
    10_000: 8,
}
"""Bit rate to index of the standard table (selector 0); 5 is reserved."""

_REFUSALS = {
    _NODE_ID: {1: "the node-id is out of its range"},
    _BIT_TIMING: {1: "it does not support this bit rate"},
    _STORE: {1: "it does not support storing", 2: "its storage cannot be written"},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LssRequest:
    """One frame of the master, and whether units answer it."""

    data: bytes
    """8 bytes for MASTER_COB_ID."""
    service: str
    """For messages."""
    answered: bool


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class LssIdentity:
    """Object 0x1018 of one unit, UNSIGNED32 each: no two units in the world share all four."""

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int

    def __post_init__(self) -> None:
        if any(not 0 <= number <= 0xFFFF_FFFF for number in self.numbers):
            raise ValueError(f"identity: expected four UNSIGNED32, got {self.numbers}")

    @property
    def numbers(self) -> tuple[int, int, int, int]:
        """In the order of 0x1018."""
        return (self.vendor_id, self.product_code, self.revision_number, self.serial_number)

    def __str__(self) -> str:
        return ":".join(f"0x{number:X}" for number in self.numbers)


Answers = tuple[bytes, ...]
"""Data of all frames on SLAVE_COB_ID in the time of one request."""


def switch_global(mode: int) -> Generator[LssRequest, Answers, None]:
    """Put every unit of the bus into WAITING or CONFIGURATION; nobody answers."""
    yield LssRequest(data=_frame(_SWITCH_GLOBAL, mode), service="switch mode global", answered=False)


def select(identity: LssIdentity) -> Generator[LssRequest, Answers, None]:
    """Put exactly this unit into CONFIGURATION, all others into WAITING first; LinkError where it is silent."""
    yield from switch_global(WAITING)
    answers: Answers = ()
    for code, number in zip(_SWITCH_SELECTIVE, identity.numbers, strict=True):
        last = code == _SWITCH_SELECTIVE[-1]
        answers = yield LssRequest(data=_number(code, number), service=f"select {identity}", answered=last)
    _only(answers, _SELECTED, f"select {identity}")


def inquire_identity() -> Generator[LssRequest, Answers, LssIdentity]:
    """Who is in CONFIGURATION; NodeFault where several units answer differently."""
    numbers: list[int] = []
    for code, name in zip(_INQUIRE_IDENTITY, ("vendor", "product", "revision", "serial"), strict=True):
        service = f"inquire {name}"
        answers = yield LssRequest(data=_frame(code), service=service, answered=True)
        numbers.append(struct.unpack_from("<I", _only(answers, code, service), 1)[0])
    vendor, product, revision, serial = numbers
    return LssIdentity(vendor_id=vendor, product_code=product, revision_number=revision, serial_number=serial)


def inquire_node_id() -> Generator[LssRequest, Answers, int]:
    """The node-id of the unit in CONFIGURATION; 255: it has none yet."""
    answers = yield LssRequest(data=_frame(_INQUIRE_NODE_ID), service="inquire node-id", answered=True)
    return _only(answers, _INQUIRE_NODE_ID, "inquire node-id")[1]


def configure_node_id(node_id: int) -> Generator[LssRequest, Answers, None]:
    """Give the unit in CONFIGURATION this node-id (1..127), and read it back."""
    if not 1 <= node_id <= 127:
        raise ValueError(f"node_id: expected 1..127, got {node_id}")
    service = f"configure node-id {node_id}"
    answers = yield LssRequest(data=_frame(_NODE_ID, node_id), service=service, answered=True)
    _accepted(answers, _NODE_ID, service)
    found = yield from inquire_node_id()
    if found != node_id:
        raise NodeFault(f"LSS {service}: confirmed, but the unit reads back {found}")


def configure_bit_rate(bitrate: int) -> Generator[LssRequest, Answers, None]:
    """Set the bit rate of the unit in CONFIGURATION, in force after its next reset."""
    if bitrate not in BIT_TIMING_INDEX:
        raise ValueError(f"bitrate: expected one of {', '.join(map(str, BIT_TIMING_INDEX))}, got {bitrate}")
    service = f"configure bit rate {bitrate}"
    data = _frame(_BIT_TIMING, 0, BIT_TIMING_INDEX[bitrate])
    answers = yield LssRequest(data=data, service=service, answered=True)
    _accepted(answers, _BIT_TIMING, service)


def store() -> Generator[LssRequest, Answers, None]:
    """Make node-id and bit rate of the unit in CONFIGURATION permanent."""
    answers = yield LssRequest(data=_frame(_STORE), service="store", answered=True)
    _accepted(answers, _STORE, "store")


def fastscan() -> Generator[LssRequest, Answers, LssIdentity | None]:
    """The identity of one unit without a node-id, which is then in CONFIGURATION; None where there is none.

    CiA 305, Fastscan: bit by bit from the top, units that agree with the bits so far answer alike, so many may
    answer at once. A bit whose 0 nobody confirms is 1; each finished number is asked again as a whole.
    """
    answers = yield _scan(0, _FASTSCAN_RESET, 0, 0)
    if not _anybody(answers, "fastscan"):
        return None
    numbers: list[int] = []
    for part in range(4):
        number = 0
        for bit in range(31, -1, -1):
            answers = yield _scan(number, bit, part, part)
            if not _anybody(answers, "fastscan"):
                number |= 1 << bit
        answers = yield _scan(number, 0, part, (part + 1) % 4)
        if not _anybody(answers, "fastscan"):
            raise LinkError(f"LSS fastscan: a unit was lost on the way, nobody confirms 0x{number:X}")
        numbers.append(number)
    vendor, product, revision, serial = numbers
    return LssIdentity(vendor_id=vendor, product_code=product, revision_number=revision, serial_number=serial)


def find_serials(
    vendor_id: int, product_code: int, *, most: int = 32
) -> Generator[LssRequest, Answers, tuple[LssIdentity, ...]]:
    """All units of one product, those with a node-id (perhaps all the same one) included, by halving.

    'Identify remote slave' is answered alike by every unit in a range of revisions and serial numbers, so that
    units which share a node-id do not disturb each other as they would by SDO. About 32 questions for each unit
    and revision. NodeFault beyond `most` units.
    """
    found: list[LssIdentity] = []
    top = 0xFFFF_FFFF
    ranges = [(0, top, 0, top)]
    while ranges:
        revision_low, revision_high, serial_low, serial_high = ranges.pop()
        here = yield from _identify(
            vendor_id, product_code, (revision_low, revision_high), (serial_low, serial_high)
        )
        if not here:
            continue
        if serial_low < serial_high:
            middle = (serial_low + serial_high) // 2
            ranges.append((revision_low, revision_high, middle + 1, serial_high))
            ranges.append((revision_low, revision_high, serial_low, middle))
        elif revision_low < revision_high:
            middle = (revision_low + revision_high) // 2
            ranges.append((middle + 1, revision_high, serial_low, serial_high))
            ranges.append((revision_low, middle, serial_low, serial_high))
        else:
            if len(found) == most:
                raise NodeFault(f"LSS identify: more than {most} units answer; does one answer to everything?")
            found.append(
                LssIdentity(
                    vendor_id=vendor_id,
                    product_code=product_code,
                    revision_number=revision_low,
                    serial_number=serial_low,
                )
            )
    return tuple(found)


def _identify(
    vendor_id: int, product_code: int, revision: tuple[int, int], serial: tuple[int, int]
) -> Generator[LssRequest, Answers, bool]:
    numbers = (vendor_id, product_code, *revision, *serial)
    answers: Answers = ()
    for code, number in zip(_IDENTIFY, numbers, strict=True):
        last = code == _IDENTIFY[-1]
        answers = yield LssRequest(data=_number(code, number), service="identify", answered=last)
    return _anybody(answers, "identify")


def _scan(number: int, bit: int, part: int, next_part: int) -> LssRequest:
    data = struct.pack("<BIBBB", _FASTSCAN, number, bit, part, next_part)
    return LssRequest(data=data, service="fastscan", answered=True)


def _frame(*octets: int) -> bytes:
    return bytes(octets) + bytes(8 - len(octets))


def _number(code: int, number: int) -> bytes:
    return struct.pack("<BI3x", code, number)


def _anybody(answers: Answers, service: str) -> bool:
    """Whether at least one unit identified itself; anything else on the COB-ID is a fault."""
    for answer in answers:
        if len(answer) != 8 or answer[0] != _IDENTIFIED:
            raise NodeFault(f"LSS {service}: expected 8 bytes with code 0x{_IDENTIFIED:02X}, got {_shown(answer)}")
    return bool(answers)


def _only(answers: Answers, code: int, service: str) -> bytes:
    """The one answer; the same frame twice is two units as well: on a bus equal frames merge into one."""
    if not answers:
        raise LinkError(f"LSS {service}: no unit answers; is its supply on, the bit rate right, LSS supported?")
    answer, *others = answers
    if others:
        listed = ", ".join(_shown(answer) for answer in answers)
        raise NodeFault(
            f"LSS {service}: expected one unit, {len(answers)} answered ({listed}); "
            "select one by its identity, or connect one at a time"
        )
    if len(answer) != 8 or answer[0] != code:
        raise NodeFault(f"LSS {service}: expected 8 bytes with code 0x{code:02X}, got {_shown(answer)}")
    return answer


def _accepted(answers: Answers, code: int, service: str) -> None:
    answer = _only(answers, code, service)
    error = answer[1]
    if error:
        meaning = _REFUSALS[code].get(error, f"its own error {answer[2]}" if error == 255 else "an unknown error")
        raise NodeFault(f"LSS {service}: the unit refuses (error {error}): {meaning}")


def _shown(answer: bytes) -> str:
    return answer.hex(" ") or "no data"
