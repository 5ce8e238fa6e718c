"""A small Modbus TCP reader for our own commands: one connection, one request at a time, a deadline for each."""

import asyncio
import contextlib

from trueangle.core.modbus_request import EXCEPTION_MEANING, AnswerStream, ReadRequest, StreamFault
from trueangle.errors import LinkError, NodeFault

TIMEOUT_S = 2.0
ILLEGAL_ADDRESS = 2


class ModbusReader:
    """One connection; after LinkError it is closed, `connect` opens it anew."""

    def __init__(self, host: str, port: int, unit_id: int, *, timeout_s: float = TIMEOUT_S) -> None:
        self.host, self.port, self.unit_id = host, port, unit_id
        self._timeout_s = timeout_s
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._answers = AnswerStream()
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
                self._streams = await asyncio.open_connection(self.host, self.port)
        except (OSError, TimeoutError) as error:
            raise LinkError(f"{self.where}: cannot connect: {_words(error)}; is trueangled running?") from error
        self._answers = AnswerStream()

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
            raise LinkError(f"{self.where}: connection lost: {_words(error)}") from error
        if answer.exception == ILLEGAL_ADDRESS:
            return None
        if answer.exception is not None:
            meaning = EXCEPTION_MEANING.get(answer.exception, "unknown")
            raise NodeFault(
                f"{self.where}: exception {answer.exception:02d} ({meaning}) for {count} registers at {address}"
            )
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


def _words(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
