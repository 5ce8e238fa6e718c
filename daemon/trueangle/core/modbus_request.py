"""The client's side of Modbus TCP as bytes: requests out, a stream in, whole answers back. No I/O here.

Source: Modbus Application Protocol V1.1b3, 6.3 and 6.4; Modbus Messaging on TCP/IP V1.0b, 3.1.3 (MBAP header).
"""

import struct
from dataclasses import dataclass

from trueangle.contract.errors import TrueangleError

_MBAP = struct.Struct(">HHHB")
LONGEST_ADU = 260
READ_HOLDING, READ_INPUT = 3, 4
EXCEPTION_MEANING = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    6: "server busy",
    11: "gateway target did not respond",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadRequest:
    """Read `count` registers from 0-based `address`."""

    transaction: int
    unit_id: int
    address: int
    count: int
    function: int = READ_INPUT

    def __bytes__(self) -> bytes:
        pdu = struct.pack(">BHH", self.function, self.address, self.count)
        return _MBAP.pack(self.transaction, 0, len(pdu) + 1, self.unit_id) + pdu


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadAnswer:
    """Registers, or the exception that came instead."""

    registers: bytes
    """Two bytes a register, big-endian; empty after an exception."""
    exception: int | None


class StreamFault(TrueangleError):
    """The peer does not speak Modbus as it must; the stream cannot be trusted any more."""


class AnswerStream:
    """Cuts a byte stream into answers to one request at a time."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes, request: ReadRequest) -> ReadAnswer | None:
        """The answer once it is whole, None until then; late answers to older requests are passed over.

        Raises StreamFault for a header, a function or a length that no answer to this request has.
        """
        self._buffer += data
        while len(self._buffer) >= _MBAP.size:
            transaction, protocol, length, unit_id = _MBAP.unpack_from(self._buffer)
            if protocol != 0 or not 3 <= length <= LONGEST_ADU - 6:
                raise StreamFault(f"no Modbus header: {bytes(self._buffer[:8]).hex(' ')}")
            if len(self._buffer) < 6 + length:
                return None
            pdu = bytes(self._buffer[_MBAP.size : 6 + length])
            del self._buffer[: 6 + length]
            if transaction == request.transaction:
                return _answer(pdu, unit_id, request)
        return None


def _answer(pdu: bytes, unit_id: int, request: ReadRequest) -> ReadAnswer:
    if unit_id != request.unit_id:
        raise StreamFault(f"expected an answer of unit {request.unit_id}, got one of unit {unit_id}")
    if pdu[0] == request.function | 0x80 and len(pdu) == 2:
        return ReadAnswer(registers=b"", exception=pdu[1])
    if pdu[0] != request.function or pdu[1] != 2 * request.count or len(pdu) != 2 + 2 * request.count:
        raise StreamFault(f"expected {request.count} registers, got {pdu[:16].hex(' ')} ({len(pdu)} bytes)")
    return ReadAnswer(registers=pdu[2:], exception=None)
