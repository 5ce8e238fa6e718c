"""The role in a client certificate: extension 1.3.6.1.4.1.50316.802.1, a UTF8String (MODBUS/TCP Security V2.1).

Rules of this file: the bytes come from a stranger. Every length is checked against what encloses it, and whatever
is not exactly as expected gives no role. Encoding: ITU-T X.690 (DER); structure: RFC 5280, 4.1.
"""

from collections.abc import Iterator

MAX_ROLE_CHARACTERS = 64

_ROLE_OID = bytes.fromhex("2B06010401 83890C 8622 01")
"""1.3.6.1.4.1.50316.802.1 (X.690, 8.19)"""
_BOOLEAN, _OCTET_STRING, _OID, _UTF8_STRING, _SEQUENCE = 0x01, 0x04, 0x06, 0x0C, 0x30
_EXTENSIONS = 0xA3
"""[3] EXPLICIT in TBSCertificate."""
_MAX_LENGTH_BYTES = 4


class _DerError(ValueError):
    """Not the DER that was expected."""


def role_of_certificate(der: bytes) -> str | None:
    """The role, or None: no such extension, more than one, or not a UTF8String of 1 to 64 characters."""
    try:
        roles = [value for oid, value in _extensions(der) if oid == _ROLE_OID]
        if len(roles) != 1:
            return None
        role = _only(roles[0], _UTF8_STRING).decode("utf-8")
    except ValueError:
        return None
    return role if 1 <= len(role) <= MAX_ROLE_CHARACTERS and role.isprintable() else None


def _extensions(der: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Object identifier and content of each extension."""
    certificate = _only(der, _SEQUENCE)
    _, tbs_certificate, _ = _element(certificate, 0, _SEQUENCE)
    for tag, content in _elements(tbs_certificate):
        if tag != _EXTENSIONS:
            continue
        for extension_tag, extension in _elements(_only(content, _SEQUENCE)):
            if extension_tag != _SEQUENCE:
                raise _DerError("an extension is a sequence")
            parts = [part for part in _elements(extension) if part[0] != _BOOLEAN]
            if [part[0] for part in parts] != [_OID, _OCTET_STRING]:
                raise _DerError("an extension is an object identifier, a criticality and an octet string")
            yield parts[0][1], parts[1][1]


def _only(data: bytes, tag: int) -> bytes:
    """The content of the one element that these bytes are."""
    _, content, end = _element(data, 0, tag)
    if end != len(data):
        raise _DerError("bytes behind the element")
    return content


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of the elements that lie one behind the other."""
    at = 0
    while at < len(data):
        tag, content, at = _element(data, at)
        yield tag, content


def _element(data: bytes, at: int, expected: int | None = None) -> tuple[int, bytes, int]:
    """Tag, content and end of the element at this place; definite lengths and one-byte tags only."""
    if at + 2 > len(data):
        raise _DerError("ends in a header")
    tag, length = data[at], data[at + 1]
    at += 2
    if tag & 0x1F == 0x1F or (expected is not None and tag != expected):
        raise _DerError(f"unexpected tag 0x{tag:02X}")
    if length & 0x80:
        count = length & 0x7F
        if not 1 <= count <= _MAX_LENGTH_BYTES or at + count > len(data):
            raise _DerError("no definite length")
        length = int.from_bytes(data[at : at + count], "big")
        at += count
    if at + length > len(data):
        raise _DerError("longer than what encloses it")
    return tag, data[at : at + length], at + length
