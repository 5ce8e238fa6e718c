"""Modbus RTU server without a serial line: received bytes and silences in, answered bytes out.

Rules of this file: whatever the bytes, nothing is raised. RTU carries no transaction number: a master takes any
answer of the right length for the answer to its last request, and may then show one joint's angle as another's.
So of several requests that wait together only the last is answered, and a frame that something follows before the
silence is not answered at all. A foreign unit's frames and broadcasts get no answer and do nothing. Clauses: [SL]
MODBUS over Serial Line V1.02.
"""

from trueangle.core.modbus_pdu import Function, PduResponder, RegisterSource

MAX_FRAME_BYTES = 256
"""[SL] 2.5.1: unit id, a PDU of 253 and two bytes of CRC."""
_MIN_FRAME_BYTES = 4
_MAX_BUFFERED_BYTES = 4 * MAX_FRAME_BYTES
_BITS_PER_CHARACTER = 11
"""[SL] 2.5.1: start, eight bits, parity or a second stop bit, stop."""
_FAST_BAUDRATE = 19_200
_FAST_SILENCE_NS = 1_750_000
"""[SL] 2.5.1.1: above 19200 Bd t3.5 is fixed."""
_ECHO_NS = 20_000_000
"""How long after its last bit an answer's echo may come back through an adapter that listens to itself."""

_REQUEST_BYTES = {
    Function.READ_COILS: 8,
    Function.READ_DISCRETE_INPUTS: 8,
    Function.READ_HOLDING_REGISTERS: 8,
    Function.READ_INPUT_REGISTERS: 8,
    Function.WRITE_SINGLE_COIL: 8,
    Function.WRITE_SINGLE_REGISTER: 8,
    Function.MASK_WRITE_REGISTER: 10,
    Function.ENCAPSULATED_INTERFACE: 7,
}
_BYTE_COUNT_AT = {
    Function.WRITE_MULTIPLE_COILS: 6,
    Function.WRITE_MULTIPLE_REGISTERS: 6,
    Function.READ_WRITE_MULTIPLE_REGISTERS: 10,
}


def silence_ns(baudrate: int) -> int:
    """The silence that ends a frame, t3.5 ([SL] 2.5.1.1)."""
    if baudrate > _FAST_BAUDRATE:
        return _FAST_SILENCE_NS
    return 35 * _BITS_PER_CHARACTER * 100_000_000 // baudrate


def crc16(data: bytes) -> int:
    """[SL] 6.2.2: polynomial 0xA001 reflected, start 0xFFFF; 0 over a frame with its CRC, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


class ModbusRtuStream:
    """One serial line: bytes collect until the line is silent, then the frame is judged."""

    __slots__ = (
        "_buffer",
        "_echo",
        "_echo_until_ns",
        "_last_ns",
        "_ns_per_byte",
        "_responder",
        "_unit_id",
        "damaged",
        "exceptions",
        "requests",
        "silence_ns",
    )

    def __init__(
        self, unit_id: int, responder: PduResponder, *, baudrate: int, longer_silence_ns: int | None = None
    ) -> None:
        """`longer_silence_ns`: for adapters that hand over a frame in pieces further apart than t3.5."""
        self._unit_id = unit_id
        self._responder = responder
        self._buffer = bytearray()
        self._last_ns = 0
        self._ns_per_byte = _BITS_PER_CHARACTER * 1_000_000_000 // baudrate
        self._echo = b""
        self._echo_until_ns = 0
        self.silence_ns = max(silence_ns(baudrate), longer_silence_ns or 0)
        self.requests = 0
        """Good frames for this unit."""
        self.exceptions = 0
        self.damaged = 0
        """Frames with a wrong CRC or of no possible length, other units' answers without a silence included."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take in bytes; a finished frame that was not judged in time is dropped, its master has given it up."""
        if self._buffer and now_ns - self._last_ns >= self.silence_ns:
            self._buffer.clear()
        if len(self._buffer) <= _MAX_BUFFERED_BYTES:
            # One that never falls silent fills no memory, and is damaged whatever follows.
            self._buffer += data
        self._last_ns = now_ns

    def silent(self, image: RegisterSource | None, now_ns: int) -> bytes:
        """The line is silent: the answer to send now, or nothing."""
        if not self._buffer or now_ns - self._last_ns < self.silence_ns:
            return b""
        data = bytes(self._buffer)
        self._buffer.clear()
        echo, self._echo = self._echo, b""
        if echo and now_ns <= self._echo_until_ns and data.startswith(echo):
            # The answers to FC 5 and 6 are their requests: taken for one, an echo would be done again and again.
            data = data[len(echo) :]
            if not data:
                return b""
        frame = _last_frame(data)
        if frame is None:
            self.damaged += 1
            return b""
        if frame[0] != self._unit_id:
            return b""
        self.requests += 1
        pdu = self._responder.answer(frame[1:-2], image, now_ns)
        if pdu[0] & 0x80:
            self.exceptions += 1
        answer = frame[:1] + pdu
        answer += crc16(answer).to_bytes(2, "little")
        self._echo = answer
        self._echo_until_ns = now_ns + len(answer) * self._ns_per_byte + self.silence_ns + _ECHO_NS
        return answer


def _last_frame(data: bytes) -> bytes | None:
    """The only frame, or the last of several whole requests without a silence between them; None: damaged."""
    if _MIN_FRAME_BYTES <= len(data) <= MAX_FRAME_BYTES and crc16(data) == 0:
        return data
    if len(data) > _MAX_BUFFERED_BYTES:
        return None
    frame = None
    while data:
        length = _request_bytes(data)
        if length is None or length > len(data) or crc16(data[:length]) != 0:
            return None
        frame, data = data[:length], data[length:]
    return frame


def _request_bytes(data: bytes) -> int | None:
    """Length of the request that these bytes begin with; None: not known."""
    if len(data) < _MIN_FRAME_BYTES or data[1] not in tuple(Function):
        return None
    function = Function(data[1])
    fixed = _REQUEST_BYTES.get(function)
    if fixed is not None:
        return fixed
    at = _BYTE_COUNT_AT[function]
    return at + 3 + data[at] if at < len(data) else None
