"""Modbus TCP server without a socket: received bytes in, answered bytes out.

Rules of this file: whatever the bytes, nothing is raised. A frame is what its MBAP header says it is; a header
that cannot be right ends the stream, because the next frame's start is unknown then. Everything else gets an
answer, in order, and every answer comes from one image. Clauses: [MB] MODBUS Application Protocol V1.1b3, [TCP]
MODBUS Messaging on TCP/IP Implementation Guide V1.0b.
"""

import enum
import struct
from typing import Protocol

READ_HOLDING_REGISTERS = 0x03
READ_INPUT_REGISTERS = 0x04
MAX_READ_COUNT = 125
"""[MB] 6.3 and 6.4: quantity of registers 1 to 0x7D."""
MAX_ADU_BYTES = 260
"""[TCP] 3.1.2: 7 bytes of MBAP header and a PDU of 253."""
TCP_UNIT_IDS = frozenset({0, 255})
"""[TCP] 4.4.2.1: a server addressed by its IP address gets unit id 0xFF; 0 is accepted as well."""

_MBAP = struct.Struct(">HHHB")
_READ_REQUEST = struct.Struct(">BHH")
_READ_ANSWER = struct.Struct(">HHHBBB")
_EXCEPTION = struct.Struct(">HHHBBB")
_MIN_LENGTH = 2
"""Unit id and function code."""
_MAX_LENGTH = 254
_LENGTH_ENDS = 6
"""The MBAP length counts the bytes behind itself."""


class ExceptionCode(enum.IntEnum):
    """[MB] 7: the codes that this server gives."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_BUSY = 0x06
    GATEWAY_TARGET_FAILED = 0x0B


class RegisterSource(Protocol):
    """What is read from: an immutable register image."""

    def read(self, address: int, count: int) -> bytes | None:
        """Big-endian registers, or None if they cannot be read together."""
        ...


class ModbusTcpStream:
    """One connection: a fixed receive buffer, from which whole requests are answered.

    The buffer holds one largest frame, so at most 21 read requests (12 bytes each) wait here; what a client sends
    beyond stays in the kernel until these are answered, and TCP slows the client down.
    """

    __slots__ = ("_buffer", "_end", "_unit_ids", "_view", "broken", "exceptions", "requests")

    def __init__(self, unit_id: int) -> None:
        self._buffer = bytearray(MAX_ADU_BYTES)
        self._view = memoryview(self._buffer)
        self._end = 0
        self._unit_ids = TCP_UNIT_IDS | {unit_id}
        self.broken: str | None = None
        """Why the stream cannot go on; None while it can."""
        self.requests = 0
        self.exceptions = 0

    def free_space(self) -> memoryview:
        """Where the next received bytes go; never empty, because every whole frame has been taken out."""
        return self._view[self._end :]

    def answer(self, received: int, image: RegisterSource | None) -> bytes:
        """Take in `received` bytes of the free space; the answers to all requests that are complete now.

        `image` is None before the first one is published: reads are answered with exception 06 then.
        """
        if self.broken is not None:
            return b""
        end = self._end + received
        buffer = self._buffer
        at = 0
        answers: list[bytes] = []
        while end - at >= _MBAP.size:
            transaction_id, protocol_id, length, unit_id = _MBAP.unpack_from(buffer, at)
            if protocol_id != 0 or not _MIN_LENGTH <= length <= _MAX_LENGTH:
                self.broken = (
                    f"MBAP header: expected protocol id 0 and length 2..254, got {protocol_id} and {length}"
                )
                break
            frame_end = at + _LENGTH_ENDS + length
            if frame_end > end:
                break
            answers.append(self._answer(transaction_id, unit_id, at + _MBAP.size, frame_end, image))
            at = frame_end
        self._keep(at, end)
        return answers[0] if len(answers) == 1 else b"".join(answers)

    def _keep(self, at: int, end: int) -> None:
        """Move the beginning of an unfinished frame to the front of the buffer."""
        if self.broken is not None:
            self._end = 0
        else:
            if at:
                self._buffer[: end - at] = self._buffer[at:end]
            self._end = end - at

    def _answer(
        self, transaction_id: int, unit_id: int, begin: int, end: int, image: RegisterSource | None
    ) -> bytes:
        """The answer to the PDU in [begin, end) of the buffer."""
        self.requests += 1
        function = self._buffer[begin]
        registers = self._read(unit_id, function, begin, end, image)
        if isinstance(registers, bytes):
            size = len(registers)
            return _READ_ANSWER.pack(transaction_id, 0, size + 3, unit_id, function, size) + registers
        self.exceptions += 1
        return _EXCEPTION.pack(transaction_id, 0, 3, unit_id, function | 0x80, registers)

    def _read(
        self, unit_id: int, function: int, begin: int, end: int, image: RegisterSource | None
    ) -> bytes | ExceptionCode:
        """The registers asked for, or why not; checked in the order of [MB] 6.3, figure 13."""
        if unit_id not in self._unit_ids:
            return ExceptionCode.GATEWAY_TARGET_FAILED
        if function not in (READ_INPUT_REGISTERS, READ_HOLDING_REGISTERS):
            return ExceptionCode.ILLEGAL_FUNCTION
        if end - begin != _READ_REQUEST.size:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        _, address, count = _READ_REQUEST.unpack_from(self._buffer, begin)
        if not 1 <= count <= MAX_READ_COUNT:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        if image is None:
            return ExceptionCode.SERVER_DEVICE_BUSY
        registers = image.read(address, count)
        return ExceptionCode.ILLEGAL_DATA_ADDRESS if registers is None else registers
