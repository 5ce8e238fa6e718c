"""One Modbus request without its transport: PDU in, PDU out; the same for TCP, TLS and RTU.

Rules of this file: whatever the bytes, nothing is raised. The order of checks is that of the specification's
state diagrams: function code (01), length and quantity (03), address (02), then doing it (04, 06). A request that
asks for two things (FC 23) is checked whole before any of it is done. Who may not use a function gets 01, as
[SEC] 5 asks. Clauses: [MB] MODBUS Application Protocol V1.1b3, [SEC] MODBUS/TCP Security V2.1.
"""

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from trueangle.core.bit_fields import CLEAR_FAULT_COILS_ADDRESS, pack_bits, read_bits
from trueangle.core.commands import Command, CommandSession, Peer, Result
from trueangle.core.register_fields import (
    COMMAND_ANSWER,
    COMMAND_BLOCK_ADDRESS,
    COMMAND_WRITABLE,
    MAP_VERSION,
    SLOTS,
    register_count,
)

MAX_PDU_BYTES = 253
"""[MB] 4.1"""
MAX_READ_COUNT = 125
"""[MB] 6.3 and 6.4: quantity of registers 1 to 0x7D."""
MAX_READ_BITS = 2000
"""[MB] 6.1 and 6.2: quantity 1 to 0x7D0."""
MAX_WRITE_COUNT = 123
"""[MB] 6.12: 1 to 0x7B."""
MAX_WRITE_BITS = 1968
"""[MB] 6.11: 1 to 0x7B0."""
MAX_EXCHANGE_WRITE_COUNT = 121
"""[MB] 6.17: 1 to 0x79."""

_COMMAND_REGISTERS = register_count(COMMAND_WRITABLE + COMMAND_ANSWER)
_COMMAND_WRITABLE = register_count(COMMAND_WRITABLE)
_TWO = struct.Struct(">HH")
_READ_DEVICE_IDENTIFICATION = 0x0E
_BASIC, _REGULAR, _EXTENDED, _INDIVIDUAL = 1, 2, 3, 4
_CONFORMITY_REGULAR = 0x82
"""[MB] 6.21: regular identification, stream and individual access."""
_BASIC_OBJECTS = 3
_OBJECTS_AT = 7
"""Bytes before the first object, and two before each object's text."""
_MAX_OBJECT_BYTES = MAX_PDU_BYTES - _OBJECTS_AT - 2
_MORE_FOLLOWS = 0xFF
_COIL_ON, _COIL_OFF = 0xFF00, 0x0000


class Function(enum.IntEnum):
    """[MB] 5.1: the function codes that this server knows."""

    READ_COILS = 0x01
    READ_DISCRETE_INPUTS = 0x02
    READ_HOLDING_REGISTERS = 0x03
    READ_INPUT_REGISTERS = 0x04
    WRITE_SINGLE_COIL = 0x05
    WRITE_SINGLE_REGISTER = 0x06
    WRITE_MULTIPLE_COILS = 0x0F
    WRITE_MULTIPLE_REGISTERS = 0x10
    MASK_WRITE_REGISTER = 0x16
    READ_WRITE_MULTIPLE_REGISTERS = 0x17
    ENCAPSULATED_INTERFACE = 0x2B


class ExceptionCode(enum.IntEnum):
    """[MB] 7: the codes that this server gives."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_FAILURE = 0x04
    SERVER_DEVICE_BUSY = 0x06
    GATEWAY_TARGET_FAILED = 0x0B


_EXCEPTION_OF = {
    Result.NO_JOINT: ExceptionCode.ILLEGAL_DATA_VALUE,
    Result.ANGLE_RANGE: ExceptionCode.ILLEGAL_DATA_VALUE,
    Result.UNKNOWN_COMMAND: ExceptionCode.ILLEGAL_DATA_VALUE,
    Result.BUSY: ExceptionCode.SERVER_DEVICE_BUSY,
    Result.NOT_VALID: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.MOVING: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.NOT_ARMED: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.EXPIRED: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.TOO_EARLY: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.DIFFERS: ExceptionCode.SERVER_DEVICE_FAILURE,
    Result.STORAGE_FAILED: ExceptionCode.SERVER_DEVICE_FAILURE,
}


class RegisterSource(Protocol):
    """What is read from: an immutable register image."""

    def read(self, address: int, count: int) -> bytes | None:
        """Big-endian registers, or None if they cannot be read together."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """What FC 43/14 tells; each text ASCII, at most 244 characters: one object fits into one answer."""

    vendor_name: str = "trueangle"
    product_code: str = "trueangled"
    revision: str
    product_name: str = "corrected encoder angles"
    model_name: str = f"register map {MAP_VERSION}"

    def __post_init__(self) -> None:
        for text in self.texts:
            if not text.isascii() or len(text) > _MAX_OBJECT_BYTES:
                raise ValueError(
                    f"identification: expected at most {_MAX_OBJECT_BYTES} ASCII characters, got {text!r}"
                )

    @property
    def texts(self) -> tuple[str, ...]:
        """By object id: 0 to 2 basic, then regular; object 3 is the vendor's address, which is empty."""
        return (self.vendor_name, self.product_code, self.revision, "", self.product_name, self.model_name)


_Outcome = bytes | ExceptionCode


class PduResponder:
    """The answers for one connection: what its peer may do, and what it has written into the command block."""

    __slots__ = ("_handlers", "_identification", "may_read", "session")

    def __init__(
        self, identification: Identification, *, peer: Peer | None = None, session: CommandSession | None = None
    ) -> None:
        """Without a session, or where the peer may not command, there is no command block and nothing to write."""
        self._identification = identification
        self.may_read = peer is None or peer.may_read
        self.session = session if session is not None and session.peer.may_command else None
        handlers: dict[int, Callable[[bytes, RegisterSource | None, int], _Outcome]] = {}
        if self.may_read:
            handlers |= {
                Function.READ_COILS: self._read_coils,
                Function.READ_DISCRETE_INPUTS: self._read_discrete_inputs,
                Function.READ_HOLDING_REGISTERS: self._read_registers,
                Function.READ_INPUT_REGISTERS: self._read_registers,
                Function.ENCAPSULATED_INTERFACE: self._identify,
            }
        if self.session is not None:
            handlers |= {
                Function.WRITE_SINGLE_COIL: self._write_coil,
                Function.WRITE_SINGLE_REGISTER: self._write_register,
                Function.WRITE_MULTIPLE_COILS: self._write_coils,
                Function.WRITE_MULTIPLE_REGISTERS: self._write_registers,
                Function.MASK_WRITE_REGISTER: self._mask_write,
                Function.READ_WRITE_MULTIPLE_REGISTERS: self._exchange,
            }
        self._handlers = handlers

    def answer(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> bytes:
        """The answer to a PDU of at least one byte; `image` None: not ready."""
        function = pdu[0]
        handler = self._handlers.get(function)
        outcome = ExceptionCode.ILLEGAL_FUNCTION if handler is None else handler(pdu, image, now_ns)
        return bytes((function | 0x80, outcome)) if isinstance(outcome, ExceptionCode) else outcome

    def close(self) -> None:
        """The connection is gone."""
        if self.session is not None:
            self.session.close()

    def _read_registers(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if len(pdu) != 5:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, count = _TWO.unpack_from(pdu, 1)
        if not 1 <= count <= MAX_READ_COUNT:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        registers = self._registers(address, count, image, now_ns)
        if isinstance(registers, ExceptionCode):
            return registers
        return bytes((pdu[0], len(registers))) + registers

    def _registers(self, address: int, count: int, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if self.session is not None and address >= COMMAND_BLOCK_ADDRESS:
            offset = address - COMMAND_BLOCK_ADDRESS
            if offset + count > _COMMAND_REGISTERS:
                return ExceptionCode.ILLEGAL_DATA_ADDRESS
            numbers = self.session.registers(now_ns)[offset : offset + count]
            return b"".join(number.to_bytes(2, "big") for number in numbers)
        if image is None:
            return ExceptionCode.SERVER_DEVICE_BUSY
        registers = image.read(address, count)
        return ExceptionCode.ILLEGAL_DATA_ADDRESS if registers is None else registers

    def _read_coils(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        return self._read_bits(pdu, image, coils=self.session is not None)

    def _read_discrete_inputs(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        return self._read_bits(pdu, image, coils=False)

    def _read_bits(self, pdu: bytes, image: RegisterSource | None, *, coils: bool) -> _Outcome:
        if len(pdu) != 5:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, count = _TWO.unpack_from(pdu, 1)
        if not 1 <= count <= MAX_READ_BITS:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        if coils and _clear_fault_slots(address, count):
            bits: bytes | None = pack_bits(0, count)
        elif image is None:
            return ExceptionCode.SERVER_DEVICE_BUSY
        else:
            bits = read_bits(image, address, count)
        return ExceptionCode.ILLEGAL_DATA_ADDRESS if bits is None else bytes((pdu[0], len(bits))) + bits

    def _write_coil(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if len(pdu) != 5:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, value = _TWO.unpack_from(pdu, 1)
        if value not in (_COIL_ON, _COIL_OFF):
            return ExceptionCode.ILLEGAL_DATA_VALUE
        fault = self._clear_faults(address, 1, value == _COIL_ON, image, now_ns)
        return pdu if fault is None else fault

    def _write_coils(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if len(pdu) < 6:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, count = _TWO.unpack_from(pdu, 1)
        size = (count + 7) // 8
        if not 1 <= count <= MAX_WRITE_BITS or pdu[5] != size or len(pdu) != 6 + size:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        fault = self._clear_faults(address, count, int.from_bytes(pdu[6:], "little"), image, now_ns)
        return pdu[:5] if fault is None else fault

    def _clear_faults(
        self, address: int, count: int, bits: int, image: RegisterSource | None, now_ns: int
    ) -> ExceptionCode | None:
        session, slots = self.session, _clear_fault_slots(address, count)
        if session is None or not slots:
            return ExceptionCode.ILLEGAL_DATA_ADDRESS
        chosen = [slot for i, slot in enumerate(slots) if bits >> i & 1]
        if not all(session.has_joint(slot) for slot in chosen):
            return ExceptionCode.ILLEGAL_DATA_ADDRESS
        if image is None:
            return ExceptionCode.SERVER_DEVICE_BUSY
        for slot in chosen:
            session.execute(Command.CLEAR_FAULT, slot, 0, now_ns)
        return None

    def _write_register(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if len(pdu) != 5:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, _ = _TWO.unpack_from(pdu, 1)
        fault = self._write(address, pdu[3:5], image, now_ns)
        return pdu if fault is None else fault

    def _write_registers(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        if len(pdu) < 6:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, count = _TWO.unpack_from(pdu, 1)
        if not 1 <= count <= MAX_WRITE_COUNT or pdu[5] != 2 * count or len(pdu) != 6 + 2 * count:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        fault = self._write(address, pdu[6:], image, now_ns)
        return pdu[:5] if fault is None else fault

    def _mask_write(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        """[MB] 6.16: (current AND and_mask) OR (or_mask AND NOT and_mask)."""
        if len(pdu) != 7 or self.session is None:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        address, and_mask = int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")
        or_mask = int.from_bytes(pdu[5:7], "big")
        if not _writable(address, 1):
            return ExceptionCode.ILLEGAL_DATA_ADDRESS
        current = self.session.registers(now_ns)[address - COMMAND_BLOCK_ADDRESS]
        number = current & and_mask | or_mask & ~and_mask & 0xFFFF
        fault = self._write(address, number.to_bytes(2, "big"), image, now_ns)
        return pdu if fault is None else fault

    def _exchange(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        """[MB] 6.17: the write is done before the read."""
        if len(pdu) < 10:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        read_address, read_count = _TWO.unpack_from(pdu, 1)
        address, count = _TWO.unpack_from(pdu, 5)
        if not 1 <= read_count <= MAX_READ_COUNT or not 1 <= count <= MAX_EXCHANGE_WRITE_COUNT:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        if pdu[9] != 2 * count or len(pdu) != 10 + 2 * count:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        before = self._registers(read_address, read_count, image, now_ns)
        if isinstance(before, ExceptionCode):
            return before
        fault = self._write(address, pdu[10:], image, now_ns)
        if fault is not None:
            return fault
        registers = self._registers(read_address, read_count, image, now_ns)
        if isinstance(registers, ExceptionCode):
            return registers
        return bytes((pdu[0], len(registers))) + registers

    def _write(self, address: int, data: bytes, image: RegisterSource | None, now_ns: int) -> ExceptionCode | None:
        """Whole registers into the command block; what the command said, as an exception code."""
        if self.session is None or not _writable(address, len(data) // 2):
            return ExceptionCode.ILLEGAL_DATA_ADDRESS
        if image is None:
            return ExceptionCode.SERVER_DEVICE_BUSY
        numbers = struct.unpack(f">{len(data) // 2}H", data)
        return _EXCEPTION_OF.get(self.session.write(address - COMMAND_BLOCK_ADDRESS, numbers, now_ns))

    def _identify(self, pdu: bytes, image: RegisterSource | None, now_ns: int) -> _Outcome:
        """[MB] 6.21, figure 26; a level above ours gets ours, an unknown object of a stream starts at 0."""
        if len(pdu) < 2 or pdu[1] != _READ_DEVICE_IDENTIFICATION:
            return ExceptionCode.ILLEGAL_FUNCTION
        if len(pdu) != 4:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        access, object_id = pdu[2], pdu[3]
        texts = self._identification.texts
        if access == _INDIVIDUAL:
            if object_id >= len(texts):
                return ExceptionCode.ILLEGAL_DATA_ADDRESS
            chosen = range(object_id, object_id + 1)
        elif access in (_BASIC, _REGULAR, _EXTENDED):
            end = _BASIC_OBJECTS if access == _BASIC else len(texts)
            chosen = range(object_id if object_id < end else 0, end)
        else:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        objects, more, following = b"", 0, 0
        for i in chosen:
            one = bytes((i, len(texts[i]))) + texts[i].encode("ascii")
            if _OBJECTS_AT + len(objects) + len(one) > MAX_PDU_BYTES:
                chosen, more, following = range(chosen.start, i), _MORE_FOLLOWS, i
                break
            objects += one
        return bytes((*pdu[:3], _CONFORMITY_REGULAR, more, following, len(chosen))) + objects


def _writable(address: int, count: int) -> bool:
    offset = address - COMMAND_BLOCK_ADDRESS
    return offset >= 0 and offset + count <= _COMMAND_WRITABLE


def _clear_fault_slots(address: int, count: int) -> range:
    """The slots of these coils; empty where they are not all coils."""
    first = address - CLEAR_FAULT_COILS_ADDRESS
    return range(first + 1, first + 1 + count) if first >= 0 and first + count <= SLOTS else range(0)
