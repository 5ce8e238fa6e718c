"""Discrete inputs (FC 2) and coils (FC 1): bits for PLC programs that want no masks, map version 1.

Rules of this file: every bit is taken out of the register image, so bits and registers of one image agree; a bit
that would be good news is 0 where nothing is known. Addresses never move within a map version.
"""

from collections.abc import Sequence
from typing import Protocol

from trueangle.core.health import StatusBit
from trueangle.core.register_fields import (
    BLOCK_STRIDE,
    FAST_HEADER,
    FAST_REGISTERS,
    FAST_SLOT,
    SLOTS,
    SLOTS_PER_GROUP,
    register_count,
)

VALID_BITS_ADDRESS = 0
"""Bit s-1: VALID of slot s."""
CONFIGURED_BITS_ADDRESS = 32
"""Bit s-1: CONFIGURED of slot s."""
SERVICE_BITS_ADDRESS = 64
"""Bit n: bit n of service_status."""
SUMMARY_BITS = 80
"""Addresses 0 to 79 are one block."""
STATUS_BITS_ADDRESS = 100
"""From here 32 bits a slot: its status word, bit 0 first; all 32 slots are one block."""
CLEAR_FAULT_COILS_ADDRESS = 2000
"""Coil s-1: switched on, latched faults of slot s are acknowledged; always reads 0."""

STATUS_WORD_BITS = 32
SERVICE_WORD_BITS = 16
_STATUS_BITS_END = STATUS_BITS_ADDRESS + STATUS_WORD_BITS * SLOTS
_GROUPS = -(-SLOTS // SLOTS_PER_GROUP)
_SERVICE_OFFSET = register_count(FAST_HEADER[: [field.name for field in FAST_HEADER].index("service_status")])
_SLOTS_OFFSET = register_count(FAST_HEADER)
_SLOT_REGISTERS = register_count(FAST_SLOT)


class Registers(Protocol):
    """The image that bits are taken from."""

    def read(self, address: int, count: int) -> bytes | None:
        """Big-endian registers, or None if they cannot be read together."""
        ...


def status_bits_address(slot: int) -> int:
    """0-based address of bit 0 of a slot's status word."""
    return STATUS_BITS_ADDRESS + STATUS_WORD_BITS * (slot - 1)


def read_bits(image: Registers, address: int, count: int) -> bytes | None:
    """Packed bits as FC 1 and 2 answer them, the first in bit 0 of the first byte; None: not of one block."""
    if count < 1 or address < 0:
        return None
    if address + count <= SUMMARY_BITS:
        bits = _summary(image)
        start = 0
    elif address >= STATUS_BITS_ADDRESS and address + count <= _STATUS_BITS_END:
        words = _status_words(image)
        bits = sum(word << STATUS_WORD_BITS * i for i, word in enumerate(words))
        start = STATUS_BITS_ADDRESS
    else:
        return None
    return pack_bits(bits >> address - start, count)


def pack_bits(bits: int, count: int) -> bytes:
    """The lowest `count` bits in as few bytes as hold them; the rest of the last byte is 0."""
    return (bits & (1 << count) - 1).to_bytes((count + 7) // 8, "little")


def _summary(image: Registers) -> int:
    words = _status_words(image)
    valid = sum(bool(word & StatusBit.VALID) << i for i, word in enumerate(words))
    configured = sum(bool(word & StatusBit.CONFIGURED) << i for i, word in enumerate(words))
    service = valid << VALID_BITS_ADDRESS | configured << CONFIGURED_BITS_ADDRESS
    for group in range(_GROUPS):
        word = image.read(BLOCK_STRIDE * group + _SERVICE_OFFSET, 1)
        if word is not None:
            return service | int.from_bytes(word, "big") << SERVICE_BITS_ADDRESS
    return service


def _status_words(image: Registers) -> Sequence[int]:
    """Status word of each slot; 0 for a slot without a joint."""
    words: list[int] = []
    for group in range(_GROUPS):
        block = image.read(BLOCK_STRIDE * group, FAST_REGISTERS)
        for place in range(SLOTS_PER_GROUP):
            begin = 2 * (_SLOTS_OFFSET + _SLOT_REGISTERS * place)
            words.append(0 if block is None else int.from_bytes(block[begin : begin + 4], "big"))
    return words[:SLOTS]
