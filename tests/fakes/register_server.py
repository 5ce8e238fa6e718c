"""A Modbus TCP server made of bytes that serves one image, and misbehaves as told."""

import asyncio
import ssl
from types import TracebackType
from typing import Self

from trueangle.core.registers import RegisterImage


class RegisterServer:
    """Answers FC 4 from `image`; everything else as the flags say."""

    def __init__(self, image: RegisterImage, tls: ssl.SSLContext | None = None) -> None:
        self._tls = tls
        self.image = image
        self.port = 0
        self.silent = False
        """Takes requests and answers nothing."""
        self.garbage = b""
        """Sent instead of an answer."""
        self.piecewise = False
        """Byte by byte."""
        self.exception = 0
        self.requests: list[tuple[int, int]] = []
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.StreamWriter] = set()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    async def start(self) -> None:
        """Listen, on the port of before if there was one."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port, ssl=self._tls)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        """Cut every connection and refuse new ones."""
        assert self._server is not None
        self._server.close()
        for writer in tuple(self._open):
            writer.transport.abort()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open.add(writer)
        try:
            while True:
                head = await reader.readexactly(7)
                pdu = await reader.readexactly(int.from_bytes(head[4:6], "big") - 1)
                await self._answer(head, pdu, writer)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            self._open.discard(writer)
            writer.close()

    async def _answer(self, head: bytes, pdu: bytes, writer: asyncio.StreamWriter) -> None:
        address, count = int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")
        self.requests.append((address, count))
        if self.silent:
            return
        if self.garbage:
            writer.write(self.garbage)
            return
        data = self.image.read(address, count) if pdu[0] == 4 else None
        body = bytes((4, len(data))) + data if data is not None else b"\x84\x02"
        if self.exception:
            body = bytes((0x84, self.exception))
        frame = head[:4] + (len(body) + 1).to_bytes(2, "big") + head[6:7] + body
        for piece in (frame[i : i + 1] for i in range(len(frame))) if self.piecewise else (frame,):
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0)
