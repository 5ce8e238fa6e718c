"""Expedited SDO transfers as bytes (CiA 301, 7.2.4.3), for commands that ask many nodes at once. No I/O here."""

import struct
from dataclasses import dataclass

from trueangle.core.node_setup import Address, SdoWrite, shown

REPLY_BASE, REQUEST_BASE = 0x580, 0x600
_UPLOAD, _UPLOADED, _DOWNLOAD, _DOWNLOADED, _ABORT = 0x40, 0x40, 0x20, 0x60, 0x80
_SPECIFIER = 0xE0
_EXPEDITED, _SIZED = 0x02, 0x01

ABSENT_CODES = frozenset({0x06010000, 0x06010001, 0x06020000, 0x06090011, 0x060A0023, 0x08000024})
"""Abort codes by which a unit says that it has no such object, or nothing in it (CiA 301, 7.2.4.3.17)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SdoAnswer:
    """What a node said to one request."""

    value: int | None = None
    """Uploaded, unsigned; None after a download, an abort or a value longer than 4 bytes."""
    size: int = 0
    """Bytes of the value."""
    abort_code: int | None = None
    segmented: bool = False
    """The value is longer than 4 bytes and was not transferred."""

    @property
    def absent(self) -> bool:
        """The node has no such object."""
        return self.abort_code in ABSENT_CODES


def upload_request(address: Address) -> bytes:
    """Ask for one object."""
    return struct.pack("<BHB4x", _UPLOAD, *address)


def download_request(write: SdoWrite) -> bytes:
    """Write one object of 1, 2 or 4 bytes."""
    command = _DOWNLOAD | (4 - write.size) << 2 | _EXPEDITED | _SIZED
    return struct.pack("<BHB", command, *write.address) + write.value.to_bytes(4, "little")


def abort_request(address: Address) -> bytes:
    """End a transfer that the node takes for begun (0x08000000, general error)."""
    return struct.pack("<BHBI", _ABORT, *address, 0x0800_0000)


def read_answer(data: bytes, address: Address, *, to_download: bool = False) -> SdoAnswer | None:
    """The node's answer about this object; None: not eight bytes, or about another object or service."""
    if len(data) != 8 or struct.unpack_from("<HB", data, 1) != address:
        return None
    command = data[0]
    if command == _ABORT:
        return SdoAnswer(abort_code=struct.unpack_from("<I", data, 4)[0])
    if to_download:
        return SdoAnswer() if command == _DOWNLOADED else None
    if command & _SPECIFIER != _UPLOADED:
        return None
    if not command & _EXPEDITED:
        return SdoAnswer(segmented=True)
    size = 4 - (command >> 2 & 3) if command & _SIZED else 4
    return SdoAnswer(value=int.from_bytes(data[4 : 4 + size], "little"), size=size)


def refusal(address: Address, answer: SdoAnswer) -> str:
    """An abort in words."""
    return f"{shown(address)}: SDO abort 0x{answer.abort_code or 0:08X}"
