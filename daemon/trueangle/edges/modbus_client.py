"""A small Modbus TCP reader for our own commands: one connection, one request at a time, a deadline for each."""

import asyncio
import contextlib
import os
import ssl
from pathlib import Path

from trueangle.contract.errors import ContractError, Fault
from trueangle.core.modbus_request import EXCEPTION_MEANING, AnswerStream, ReadRequest, StreamFault
from trueangle.errors import LinkError, NodeFault

TIMEOUT_S = 2.0
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS = 1, 2


class ModbusReader:
    """One connection; after LinkError it is closed, `connect` opens it anew."""

    def __init__(
        self,
        host: str,
        port: int,
        unit_id: int,
        *,
        timeout_s: float = TIMEOUT_S,
        tls: ssl.SSLContext | None = None,
        server_name: str | None = None,
    ) -> None:
        """`tls` is that of `client_tls`, None: plain TCP; `server_name`: in the certificate, if not the host."""
        self.host, self.port, self.unit_id = host, port, unit_id
        self._tls, self._server_name = tls, None if tls is None else server_name or host
        self._timeout_s = timeout_s
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._answers = AnswerStream()
        self._answered = False
        """Since the connection was opened."""
        self._transaction = 0

    @property
    def where(self) -> str:
        """For messages."""
        return f"{self.host}:{self.port} unit {self.unit_id}"

    async def connect(self) -> None:
        """LinkError where nobody listens."""
        await self.close()
        try:
            async with asyncio.timeout(self._timeout_s):
                self._streams = await asyncio.open_connection(
                    self.host, self.port, ssl=self._tls, server_hostname=self._server_name
                )
        except (OSError, TimeoutError) as error:
            advice = "" if isinstance(error, ssl.SSLError) else "; is trueangled running?"
            raise LinkError(f"{self.where}: cannot connect: {_words(error)}{advice}") from error
        self._answers, self._answered = AnswerStream(), False

    async def read(self, address: int, count: int) -> bytes | None:
        """`count` input registers as bytes; None where none are served there (exception 02).

        LinkError where the connection is gone or the peer does not answer in time or in form; NodeFault for any
        other Modbus exception.
        """
        if self._streams is None:
            raise LinkError(f"{self.where}: not connected")
        self._transaction = (self._transaction + 1) & 0xFFFF
        request = ReadRequest(transaction=self._transaction, unit_id=self.unit_id, address=address, count=count)
        reader, writer = self._streams
        try:
            async with asyncio.timeout(self._timeout_s):
                writer.write(bytes(request))
                await writer.drain()
                answer = None
                while answer is None:
                    data = await reader.read(4096)
                    if not data:
                        raise ConnectionResetError("closed by the peer")
                    answer = self._answers.feed(data, request)
        except (OSError, TimeoutError, StreamFault) as error:
            await self.close()
            # With TLS 1.3 a server looks at our certificate after our side of the handshake is done.
            unheard = self._tls is not None and not self._answered
            advice = "; is our certificate accepted there, with a role that may read?" if unheard else ""
            raise LinkError(f"{self.where}: connection lost: {_words(error)}{advice}") from error
        self._answered = True
        if answer.exception == ILLEGAL_ADDRESS:
            return None
        if answer.exception is not None:
            meaning = EXCEPTION_MEANING.get(answer.exception, "unknown")
            refused = self._tls is not None and answer.exception == ILLEGAL_FUNCTION
            advice = "; the role in our certificate may not read there" if refused else ""
            about = f"exception {answer.exception:02d} ({meaning}) for {count} registers at {address}"
            raise NodeFault(f"{self.where}: {about}{advice}")
        return answer.registers

    async def close(self) -> None:
        """Close the connection, where one is open."""
        if self._streams is not None:
            writer = self._streams[1]
            self._streams = None
            writer.close()
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(0.5):
                    await writer.wait_closed()


def client_tls(authority: Path, certificate: Path, key: Path) -> ssl.SSLContext:
    """Mutual TLS 1.2 or later; ContractError with every file that cannot be used."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    faults: list[Fault] = []
    try:
        context.load_verify_locations(cafile=authority)
    except OSError as error:
        expected = "PEM certificates of the server's authority"
        faults.append(Fault(where=f"--ca {authority}", expected=expected, found=_words(error)))
    try:
        # Without a password the library would ask for one on the terminal.
        context.load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:
        expected = "a PEM certificate and its own key, not encrypted"
        where = f"--certificate {certificate}, --key {key}"
        faults.append(Fault(where=where, expected=expected, found=_words(error)))
    if faults:
        raise ContractError(faults)
    return context


def _words(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the server's certificate is not accepted: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        # What is no PEM at all has no reason of its own.
        return f"TLS: {error.reason.lower().replace('_', ' ')}" if error.reason else "no PEM of it"
    if isinstance(error, OSError) and error.errno and error.errno > 0:
        # asyncio's own words repeat the address.
        return os.strerror(error.errno)
    return str(error) or type(error).__name__
