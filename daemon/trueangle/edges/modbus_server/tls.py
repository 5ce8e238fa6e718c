"""One client of the TLS server: mutual TLS over memory, so that a handshake is a connection like any other.

Rules of this file: until the client's certificate is verified nothing is answered; a handshake counts against the
limits from its first byte and has its own time-out; why one failed is logged. asyncio's own TLS would make a
connection known only after the handshake and would fail without a word.
"""

import contextlib
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic_ns
from typing import cast

from trueangle.config import Right, TlsConfig
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.certificate_role import role_of_certificate
from trueangle.core.commands import Peer
from trueangle.edges.modbus_server.connection import Connection, ConnectionHost

_CREDENTIAL = "credential:"
_READ_BYTES = 4096
"""One read of the socket; with one record of 16 KiB it is the most that waits undecrypted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsSettings:
    """What the TLS server shows, whom it accepts and what their roles may do."""

    context: ssl.SSLContext
    roles: Mapping[str, Right] = field(default_factory=dict[str, Right])

    def peer(self, address: str, certificate: bytes | None) -> Peer:
        """The client with this verified certificate (DER)."""
        role = None if certificate is None else role_of_certificate(certificate)
        right = self.roles.get(role) if role is not None else None
        return Peer(
            address=address,
            role=role or "",
            may_read=right is not None or not self.roles,
            may_command=right is Right.COMMAND,
        )


def is_credential(text: str) -> bool:
    """Whether this file is handed over by systemd (LoadCredential=)."""
    return text.startswith(_CREDENTIAL)


def load_tls(config: TlsConfig, *, base: Path, credentials: Path | None, source: str) -> TlsSettings:
    """Read key and certificates; ContractError with every file that cannot be used.

    `base` is the configuration file's directory, `credentials` systemd's $CREDENTIALS_DIRECTORY if it gave one.
    """
    faults: list[Fault] = []
    paths: dict[str, Path] = {}
    for key in ("certificate", "private_key", "client_ca"):
        where = f"{source}, modbus.tls.{key}"
        text: str = getattr(config, key)
        if not is_credential(text):
            paths[key] = base / text
        elif credentials is None:
            faults.append(
                Fault(
                    where=where, expected="LoadCredential= in the unit for it", found="no $CREDENTIALS_DIRECTORY"
                )
            )
            continue
        else:
            paths[key] = credentials / text.removeprefix(_CREDENTIAL)
        try:
            paths[key].read_bytes()
        except OSError as error:
            found = f"{paths[key]}: {error.strerror or error}"
            faults.append(Fault(where=where, expected="a readable file", found=found))
    if faults:
        raise ContractError(faults)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    context.options |= ssl.OP_NO_RENEGOTIATION | ssl.OP_NO_COMPRESSION
    try:
        # Without a password the library would ask for one on the terminal.
        context.load_cert_chain(paths["certificate"], paths["private_key"], password=lambda: "")
    except (ssl.SSLError, OSError) as error:
        expected = "a PEM certificate and its own key, not encrypted"
        faults.append(Fault(where=f"{source}, modbus.tls.certificate", expected=expected, found=_reason(error)))
    try:
        context.load_verify_locations(cafile=paths["client_ca"])
    except (ssl.SSLError, OSError) as error:
        expected = "PEM certificates of authorities"
        faults.append(Fault(where=f"{source}, modbus.tls.client_ca", expected=expected, found=_reason(error)))
    if faults:
        raise ContractError(faults)
    return TlsSettings(context=context, roles=config.roles)


def _reason(error: OSError) -> str:
    """OpenSSL's words, without its place in the library's source."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return str(error.verify_message)
    if isinstance(error, ssl.SSLError):
        # What is no PEM at all has no reason of its own.
        return error.reason.lower().replace("_", " ") if error.reason else "no PEM of it"
    return error.strerror or str(error)


class TlsConnection(Connection):
    """See the module's docstring."""

    __slots__ = ("_incoming", "_outgoing", "_paused", "_received", "_settings", "_tls")

    def __init__(self, host: ConnectionHost, settings: TlsSettings) -> None:
        super().__init__(host)
        self._settings = settings
        self._received = memoryview(bytearray(_READ_BYTES))
        self._incoming = ssl.MemoryBIO()
        self._outgoing = ssl.MemoryBIO()
        self._tls = settings.context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._paused = False

    def begin(self) -> None:
        """The client must show its certificate before anything is answered."""
        timeout_s = self._host.limits.handshake_timeout_s
        self._idle_check = self._loop.call_later(timeout_s, self._refuse, f"no handshake within {timeout_s:g} s")

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._received

    def buffer_updated(self, nbytes: int) -> None:
        if self._transport is None or self._transport.is_closing():
            return
        self._incoming.write(self._received[:nbytes])
        if self._stream is not None or self._shake_hands():
            self._answer_all()

    def pause_writing(self) -> None:
        self._paused = True
        super().pause_writing()

    def resume_writing(self) -> None:
        self._paused = False
        super().resume_writing()
        # What was received before the pause is not announced again.
        if self._stream is not None:
            self._answer_all()

    def end(self) -> None:
        """Say good-bye, where there is somebody who listens."""
        if self._stream is not None and not self._paused:
            with contextlib.suppress(ssl.SSLError, ValueError):
                self._tls.unwrap()
            self._flush()
        super().end()

    def _shake_hands(self) -> bool:
        """True once the client's certificate is verified."""
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            self._flush()
            return False
        except OSError as error:
            self._flush()
            self._refuse(_reason(error))
            return False
        self._flush()
        if self._idle_check is not None:
            self._idle_check.cancel()
        peer = self._settings.peer(self.address, self._tls.getpeercert(binary_form=True))
        if not peer.may_read:
            self._host.report("modbus_role_without_rights", self.address, peer.role or "no role")
        self.serve(peer)
        return True

    def _refuse(self, reason: str) -> None:
        self._host.counters.tls_refused += 1
        self._host.report("modbus_tls_refused", self.address, reason)
        self.end()

    def _answer_all(self) -> None:
        """Decrypt and answer until nothing is left, or until the client must first take what waits for it."""
        stream = self._stream
        while stream is not None and self._transport is not None and not self._transport.is_closing():
            if self._paused:
                return
            try:
                size = self._decrypt(stream.space)
                now_ns = monotonic_ns()
                answers = stream.answer(size, self._host.image(now_ns), now_ns) if size else b""
                if answers:
                    self._last_request_ns = now_ns
                    self._tls.write(answers)
            except ssl.SSLWantReadError:
                self._flush()
                return
            except OSError as error:
                self._host.report("modbus_tls_broken", self.address, _reason(error))
                self.end()
                return
            self._flush()
            if stream.broken is not None:
                self.break_off(stream.broken)
                return
            if not size:
                self.end()
                return
            # Reading on would raise SSLWantReadError, which costs as much as the answer.
            if not self._incoming.pending and not self._tls.pending():
                return

    def _decrypt(self, space: memoryview) -> int:
        """How many bytes were put into the space; 0: the client has said good-bye."""
        # With a buffer `read` gives the number of bytes, which its stub does not know.
        return cast("int", self._tls.read(len(space), space))  # pyright: ignore[reportArgumentType]

    def _flush(self) -> None:
        if self._outgoing.pending and self._transport is not None:
            self._transport.write(self._outgoing.read())
