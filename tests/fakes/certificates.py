"""Certificates made by the openssl command when a test needs them: nothing with a key lies in the repository."""

import subprocess
from dataclasses import dataclass
from pathlib import Path

ROLE_OID = "1.3.6.1.4.1.50316.802.1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """A certificate and its key, both PEM."""

    certificate: Path
    key: Path

    @property
    def der(self) -> bytes:
        """The certificate alone."""
        return openssl("x509", "-in", str(self.certificate), "-outform", "der")


class Authority:
    """One certificate authority in a directory."""

    def __init__(self, directory: Path, name: str) -> None:
        self._directory, self._name = directory, name
        self.certificate = directory / f"{name}.pem"
        self._key = _key(directory / f"{name}.key")
        subject = ("-subj", f"/CN={name}", "-days", "2", "-out", str(self.certificate))
        openssl("req", "-x509", "-new", "-key", str(self._key), *subject)

    def issue(self, name: str, *extensions: str, days: int = 2) -> Identity:
        """A certificate with these lines of an OpenSSL extension section; negative days: expired."""
        key = _key(self._directory / f"{self._name}.{name}.key")
        request, certificate = key.with_suffix(".csr"), key.with_suffix(".pem")
        openssl("req", "-new", "-key", str(key), "-subj", f"/CN={name}", "-out", str(request))
        section = key.with_suffix(".ext")
        section.write_text("\n".join(extensions), "ascii")
        openssl(
            *("x509", "-req", "-in", str(request), "-CA", str(self.certificate), "-CAkey", str(self._key)),
            *("-CAcreateserial", "-days", str(days), "-extfile", str(section), "-out", str(certificate)),
        )
        return Identity(certificate=certificate, key=key)

    def with_role(self, name: str, role: str) -> Identity:
        """A certificate with this role, as MODBUS/TCP Security wants it."""
        return self.issue(name, f"{ROLE_OID}=ASN1:UTF8String:{role}")


def openssl(*arguments: str) -> bytes:
    """What the openssl command prints."""
    return subprocess.run(["openssl", *arguments], check=True, capture_output=True, timeout=30).stdout


def _key(path: Path) -> Path:
    openssl("ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", str(path))
    return path
