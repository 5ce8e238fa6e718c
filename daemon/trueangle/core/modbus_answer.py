"""Modbus TCP server without a socket: received bytes in, answered bytes out.

Rules of this file: whatever the bytes, nothing is raised. A frame is what its MBAP header says it is; a header
that cannot be right ends the stream, because the next frame's start is unknown then. Everything else gets an
answer, in order, and every answer comes from one image. What a PDU means is said in `modbus_pdu`. Clauses: [TCP]
MODBUS Messaging on TCP/IP Implementation Guide V1.0b.
"""

import struct
from dataclasses import dataclass

from trueangle.core.modbus_pdu import MAX_READ_COUNT, ExceptionCode, Function, PduResponder, RegisterSource

MAX_ADU_BYTES = 260
"""[TCP] 3.1.2: 7 bytes of MBAP header and a PDU of 253."""
TCP_UNIT_IDS = frozenset({0, 255})
"""[TCP] 4.4.2.1: a server addressed by its IP address gets unit id 0xFF; 0 is accepted as well."""

_MBAP = struct.Struct(">HHHB")
_READ_FRAME = struct.Struct(">HIHHH")
"""A frame of FC 3 or 4: transaction; protocol id and length; unit id and function; address; count."""
_READ_ANSWER = struct.Struct(">HIHB")
_READ_BYTES = _READ_FRAME.size
_READ_LENGTH = 6
"""Unit id, function, address and count; the protocol id before it is 0."""
_MIN_LENGTH = 2
"""Unit id and function code."""
_MAX_LENGTH = 254
_LENGTH_ENDS = 6
"""The MBAP length counts the bytes behind itself."""
_DIRECT = (Function.READ_INPUT_REGISTERS, Function.READ_HOLDING_REGISTERS)


@dataclass(slots=True, kw_only=True)
class RequestCounts:
    """Plain integers; connections may share them."""

    requests: int = 0
    exceptions: int = 0


class ModbusTcpStream:
    """One connection: a fixed receive buffer, from which whole requests are answered.

    The buffer holds one largest frame, so at most 21 read requests (12 bytes each) wait here; what a client sends
    beyond stays in the kernel until these are answered, and TCP slows the client down.
    """

    __slots__ = ("_buffer", "_direct", "_end", "_responder", "_unit_ids", "_view", "broken", "counts", "space")

    def __init__(self, unit_id: int, responder: PduResponder, counts: RequestCounts | None = None) -> None:
        self._buffer = bytearray(MAX_ADU_BYTES)
        self._view = memoryview(self._buffer)
        self._end = 0
        self._unit_ids = TCP_UNIT_IDS | {unit_id}
        self._responder = responder
        reads = _DIRECT if responder.may_read else ()
        self._direct = frozenset(unit << 8 | function for unit in self._unit_ids for function in reads)
        self.space = self._view
        """Where the next received bytes go; never empty, because every whole frame has been taken out."""
        self.broken: str | None = None
        """Why the stream cannot go on; None while it can."""
        self.counts = RequestCounts() if counts is None else counts

    def answer(self, received: int, image: RegisterSource | None, now_ns: int) -> bytes:
        """Take in `received` bytes of the space; the answers to all requests that are complete now.

        `image` is None before the first one is published: reads are answered with exception 06 then. `now_ns` is
        monotonic and only asked by commands.
        """
        if received == _READ_BYTES and not self._end and image is not None and self.broken is None:
            # One read and nothing else: what a PLC sends in every cycle.
            answer = self._read(0, image)
            if answer is not None:
                self.counts.requests += 1
                return answer
        return self._answer_all(received, image, now_ns)

    def _answer_all(self, received: int, image: RegisterSource | None, now_ns: int) -> bytes:
        if self.broken is not None:
            return b""
        end = self._end + received
        at = 0
        answers: list[bytes] = []
        while end - at >= _MBAP.size:
            answer = self._read(at, image) if end - at >= _READ_BYTES and image is not None else None
            if answer is not None:
                at += _READ_BYTES
            else:
                frame_end = self._frame_end(at, end)
                if frame_end is None:
                    break
                answer = self._answer(at, frame_end, image, now_ns)
                at = frame_end
            answers.append(answer)
        self.counts.requests += len(answers)
        # The beginning of an unfinished frame moves to the front of the buffer.
        self._buffer[: end - at] = self._buffer[at:end]
        self._end = end - at if self.broken is None else 0
        self.space = self._view[self._end :]
        return b"".join(answers)

    def _read(self, at: int, image: RegisterSource) -> bytes | None:
        """The short way: the answer to a good read of the image; None for whatever else begins here."""
        transaction_id, length, unit_function, address, count = _READ_FRAME.unpack_from(self._buffer, at)
        if length != _READ_LENGTH or unit_function not in self._direct or count > MAX_READ_COUNT:
            return None
        registers = image.read(address, count)
        if registers is None:
            return None
        size = 2 * count
        return _READ_ANSWER.pack(transaction_id, size + 3, unit_function, size) + registers

    def _frame_end(self, at: int, end: int) -> int | None:
        """Where the frame that begins here ends; None: it is not whole yet, or its header cannot be right."""
        _, protocol_id, length, _ = _MBAP.unpack_from(self._buffer, at)
        if protocol_id != 0 or not _MIN_LENGTH <= length <= _MAX_LENGTH:
            self.broken = f"MBAP header: expected protocol id 0 and length 2..254, got {protocol_id} and {length}"
            return None
        frame_end = at + _LENGTH_ENDS + length
        return frame_end if frame_end <= end else None

    def _answer(self, at: int, end: int, image: RegisterSource | None, now_ns: int) -> bytes:
        """The answer to the whole frame in [at, end) of the buffer."""
        transaction_id, _, _, unit_id = _MBAP.unpack_from(self._buffer, at)
        pdu = bytes(self._buffer[at + _MBAP.size : end])
        if unit_id not in self._unit_ids:
            pdu = bytes((pdu[0] | 0x80, ExceptionCode.GATEWAY_TARGET_FAILED))
        else:
            pdu = self._responder.answer(pdu, image, now_ns)
        if pdu[0] & 0x80:
            self.counts.exceptions += 1
        return _MBAP.pack(transaction_id, 0, len(pdu) + 1, unit_id) + pdu
