"""The role in a client certificate, read out of real certificates and out of whatever a stranger sends."""

import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.certificates import ROLE_OID, Authority

from trueangle.core.certificate_role import role_of_certificate

OID = bytes.fromhex("06 0b 2b 06 01 04 01 83 89 0c 86 22 01")


def der(tag: int, *contents: bytes) -> bytes:
    """One element, with the shortest length."""
    content = b"".join(contents)
    size = len(content)
    if size < 128:
        return bytes([tag, size]) + content
    length = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes([tag, 0x80 | len(length)]) + length + content


def certificate(*extensions: bytes) -> bytes:
    """No more of a certificate than the way to its extensions: [3], a sequence, the extensions."""
    before = der(0xA0, der(0x02, b"\x02")) + der(0x02, b"\x01") + der(0x30)
    return der(0x30, der(0x30, before, der(0xA3, der(0x30, *extensions))), der(0x30), der(0x03, b"\0"))


def extension(value: bytes, oid: bytes = OID, critical: bytes = b"") -> bytes:
    return der(0x30, oid, critical, der(0x04, value))


ROLE = extension(der(0x0C, b"setter"))


@pytest.mark.skipif(shutil.which("openssl") is None, reason="the openssl command is not installed")
def test_the_role_of_a_certificate_made_by_openssl(tmp_path: Path) -> None:
    authority = Authority(tmp_path, "plant")
    assert role_of_certificate(authority.with_role("plc", "Anlagen-Fahrer").der) == "Anlagen-Fahrer"
    others = (
        "basicConstraints=critical,CA:false",
        f"{ROLE_OID}=critical,ASN1:UTF8String:setter",
        "keyUsage=digitalSignature",
    )
    assert role_of_certificate(authority.issue("more", *others).der) == "setter"
    assert role_of_certificate(authority.issue("none", "keyUsage=digitalSignature").der) is None
    assert role_of_certificate(authority.issue("plain").der) is None
    assert role_of_certificate(authority.issue("printable", f"{ROLE_OID}=ASN1:PRINTABLESTRING:setter").der) is None


def test_the_role_of_the_smallest_certificate() -> None:
    assert role_of_certificate(certificate(ROLE)) == "setter"
    assert role_of_certificate(certificate(extension(b"x", b"\x06\x01\x55"), ROLE)) == "setter"
    assert role_of_certificate(certificate(extension(der(0x0C, b"setter"), critical=b"\x01\x01\xff"))) == "setter"
    assert role_of_certificate(certificate(extension(der(0x0C, "Prüfer".encode())))) == "Prüfer"


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(certificate(), id="no extension"),
        pytest.param(certificate(ROLE, ROLE), id="twice"),
        pytest.param(certificate(ROLE, extension(der(0x0C, b"reader"))), id="two roles"),
        pytest.param(certificate(extension(der(0x0C, b""))), id="empty"),
        pytest.param(certificate(extension(der(0x0C, b"x" * 65))), id="too long"),
        pytest.param(certificate(extension(der(0x0C, b"\xff"))), id="not UTF-8"),
        pytest.param(certificate(extension(der(0x0C, b"a\nevent=forged"))), id="a line break for the log"),
        pytest.param(certificate(extension(der(0x13, b"setter"))), id="printable string"),
        pytest.param(certificate(extension(der(0x0C, b"setter") + b"\0")), id="bytes behind the role"),
        pytest.param(certificate(extension(b"\x0c\x07setter")), id="longer than it is"),
        pytest.param(certificate(extension(b"\x0c\x80setter\0\0")), id="indefinite length"),
        pytest.param(certificate(extension(b"\x0c\x88" + bytes(7) + b"\x06setter")), id="length of eight bytes"),
        pytest.param(certificate(extension(b"\x1f\x0c\x06setter")), id="tag of several bytes"),
        pytest.param(certificate(der(0x30, der(0x04, der(0x0C, b"setter")), OID)), id="parts exchanged"),
        pytest.param(certificate(ROLE) + b"\0", id="bytes behind the certificate"),
        pytest.param(certificate(ROLE)[:-1], id="cut short"),
    ],
)
def test_what_is_not_exactly_as_expected_gives_no_role(data: bytes) -> None:
    assert role_of_certificate(data) is None


GOOD = certificate(ROLE)


@given(data=st.binary(max_size=300))
def test_any_bytes_are_survived(data: bytes) -> None:
    assert role_of_certificate(data) is None or b"setter" not in data


@given(at=st.integers(0, len(GOOD) - 1), insert=st.binary(max_size=3), cut=st.integers(0, 3))
def test_a_mutated_certificate_is_survived(at: int, insert: bytes, cut: int) -> None:
    role = role_of_certificate(GOOD[:at] + insert + GOOD[at + cut :])
    assert role is None or 1 <= len(role) <= 64
