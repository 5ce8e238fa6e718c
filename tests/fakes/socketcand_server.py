"""A socketcand made of bytes on TCP, with fake nodes behind it: a bus that another process can reach."""

import asyncio
import contextlib
from types import TracebackType
from typing import Self

from tests.fakes.canopen_device import FakeDevice


class SocketcandServer:
    """Greets, opens any channel, then carries `< send >` to the nodes and what they send as `< frame >`."""

    def __init__(self, *nodes: FakeDevice) -> None:
        self._nodes = nodes
        for node in nodes:
            node.send = self.send
        self._server: asyncio.Server | None = None
        self._raw: set[asyncio.StreamWriter] = set()
        self._open: set[asyncio.StreamWriter] = set()
        self.port = 0

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._server is not None
        self._server.close()
        for writer in tuple(self._open):
            writer.transport.abort()
        await self._server.wait_closed()

    def send(self, can_id: int, data: bytes) -> None:
        """A node's frame to every client in raw mode."""
        for writer in self._raw:
            writer.write(f"< frame {can_id:03X} 1.000000 {data.hex().upper()} >".encode())

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open.add(writer)
        writer.write(b"< hi >")
        try:
            while True:
                self._obey((await reader.readuntil(b">")).decode("ascii").strip("<> "), writer)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            self._raw.discard(writer)
            self._open.discard(writer)
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    def _obey(self, command: str, writer: asyncio.StreamWriter) -> None:
        word, *arguments = command.split()
        if word == "send":
            can_id, data = int(arguments[0], 16), bytes(int(byte, 16) for byte in arguments[2:])
            for node in self._nodes:
                node.handle(can_id, data)
            return
        writer.write(b"< ok >")
        if word == "rawmode":
            self._raw.add(writer)
