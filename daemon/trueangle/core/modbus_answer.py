"""Modbus TCP server without a socket: received bytes in, answered bytes out.

Rules of this file: whatever the bytes, nothing is raised. A frame is what its MBAP header says it is; a header
that cannot be right ends the stream, because the next frame's start is unknown then. Everything else gets an
answer, in order, and every answer comes from one image. What a PDU means is said in `modbus_pdu`. Clauses: [TCP]
MODBUS Messaging on TCP/IP Implementation Guide V1.0b.
"""

import struct

from trueangle.core.modbus_pdu import MAX_READ_COUNT, ExceptionCode, Function, PduResponder, RegisterSource

MAX_ADU_BYTES = 260
"""[TCP] 3.1.2: 7 bytes of MBAP header and a PDU of 253."""
TCP_UNIT_IDS = frozenset({0, 255})
"""[TCP] 4.4.2.1: a server addressed by its IP address gets unit id 0xFF; 0 is accepted as well."""

_MBAP = struct.Struct(">HHHB")
_READ_REQUEST = struct.Struct(">BHH")
_READ_ANSWER = struct.Struct(">HHHBBB")
_MIN_LENGTH = 2
"""Unit id and function code."""
_MAX_LENGTH = 254
_LENGTH_ENDS = 6
"""The MBAP length counts the bytes behind itself."""
_DIRECT = frozenset({int(Function.READ_INPUT_REGISTERS), int(Function.READ_HOLDING_REGISTERS)})


class ModbusTcpStream:
    """One connection: a fixed receive buffer, from which whole requests are answered.

    The buffer holds one largest frame, so at most 21 read requests (12 bytes each) wait here; what a client sends
    beyond stays in the kernel until these are answered, and TCP slows the client down.
    """

    __slots__ = (
        "_buffer",
        "_direct",
        "_end",
        "_responder",
        "_unit_ids",
        "_view",
        "broken",
        "exceptions",
        "requests",
    )

    def __init__(self, unit_id: int, responder: PduResponder) -> None:
        self._buffer = bytearray(MAX_ADU_BYTES)
        self._view = memoryview(self._buffer)
        self._end = 0
        self._unit_ids = TCP_UNIT_IDS | {unit_id}
        self._responder = responder
        self._direct = _DIRECT if responder.may_read else frozenset[int]()
        self.broken: str | None = None
        """Why the stream cannot go on; None while it can."""
        self.requests = 0
        self.exceptions = 0

    def free_space(self) -> memoryview:
        """Where the next received bytes go; never empty, because every whole frame has been taken out."""
        return self._view[self._end :]

    def answer(self, received: int, image: RegisterSource | None, now_ns: int) -> bytes:
        """Take in `received` bytes of the free space; the answers to all requests that are complete now.

        `image` is None before the first one is published: reads are answered with exception 06 then. `now_ns` is
        monotonic and only asked by commands.
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
            answers.append(self._answer(transaction_id, unit_id, at + _MBAP.size, frame_end, image, now_ns))
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
        self, transaction_id: int, unit_id: int, begin: int, end: int, image: RegisterSource | None, now_ns: int
    ) -> bytes:
        """The answer to the PDU in [begin, end) of the buffer; good reads of the image take the short way."""
        self.requests += 1
        function = self._buffer[begin]
        if unit_id not in self._unit_ids:
            pdu = bytes((function | 0x80, ExceptionCode.GATEWAY_TARGET_FAILED))
        else:
            if image is not None and function in self._direct and end - begin == _READ_REQUEST.size:
                _, address, count = _READ_REQUEST.unpack_from(self._buffer, begin)
                if 1 <= count <= MAX_READ_COUNT:
                    registers = image.read(address, count)
                    if registers is not None:
                        size = len(registers)
                        return _READ_ANSWER.pack(transaction_id, 0, size + 3, unit_id, function, size) + registers
            pdu = self._responder.answer(bytes(self._buffer[begin:end]), image, now_ns)
        if pdu[0] & 0x80:
            self.exceptions += 1
        return _MBAP.pack(transaction_id, 0, len(pdu) + 1, unit_id) + pdu
