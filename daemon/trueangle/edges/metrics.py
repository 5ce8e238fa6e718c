"""The metrics' HTTP port: GET /metrics and nothing else, one answer a connection (HTTP/1.0).

The prometheus-client library costs 56 ms and 5 MiB at the start; what is needed of it is a text and a status line.
Rules of this file: whoever connects can make it do nothing but answer or close; nothing here is in the way of an
angle, so a port that cannot be had is logged and the service goes on.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable

MAX_REQUEST_BYTES = 8192
TIMEOUT_S = 5.0
"""In which the request must have come and the answer been taken."""
MAX_CONNECTIONS = 4

_log = logging.getLogger(__name__)


class MetricsServer:
    """Serves what `render` gives; `async with` opens and closes the port."""

    def __init__(self, host: str, port: int, *, render: Callable[[], str], content_type: str) -> None:
        """`port` 0 takes a free one, found in `port` afterwards."""
        self._host, self.port = host, port
        self._render, self._content_type = render, content_type
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.Task[None]] = set()
        self.refused = 0

    async def open(self) -> None:
        """Listen; a port that cannot be had is logged."""
        try:
            self._server = await asyncio.start_server(
                self._accept, self._host, self.port, limit=MAX_REQUEST_BYTES, backlog=MAX_CONNECTIONS
            )
        except OSError as error:
            reason = error.strerror or str(error)
            _log.error("event=metrics_unavailable host=%s port=%d reason=%r", self._host, self.port, reason)
            return
        self.port = self._server.sockets[0].getsockname()[1]
        _log.info("event=metrics_listening host=%s port=%d", self._host, self.port)

    async def close(self) -> None:
        """Stop listening and end all connections at once."""
        if self._server is None:
            return
        self._server.close()
        for task in tuple(self._open):
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)
        await self._server.wait_closed()
        self._server = None

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._open) >= MAX_CONNECTIONS:
            self.refused += 1
            writer.transport.abort()
            return
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._open.add(task)
        task.add_done_callback(self._open.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                writer.write(self._answer(await _request(reader)))
                await writer.drain()
                writer.close()
                await writer.wait_closed()
        except (TimeoutError, OSError, asyncio.IncompleteReadError):
            pass  # whoever does not ask, or does not read, has gone
        finally:
            writer.transport.abort()

    def _answer(self, request: bytes | None) -> bytes:
        words = [] if request is None else request.split(b"\r\n", 1)[0].split(b" ")
        if len(words) != 3 or not words[2].startswith(b"HTTP/1."):
            return _response("400 Bad Request", "text/plain", "expected GET /metrics\n")
        if words[0] not in (b"GET", b"HEAD"):
            return _response("405 Method Not Allowed", "text/plain", "expected GET\n", "Allow: GET, HEAD\r\n")
        if words[1].split(b"?", 1)[0] != b"/metrics":
            return _response("404 Not Found", "text/plain", "expected /metrics\n")
        answer = _response("200 OK", self._content_type, self._render())
        return answer if words[0] == b"GET" else answer[: answer.index(b"\r\n\r\n") + 4]


async def _request(reader: asyncio.StreamReader) -> bytes | None:
    """The head of the request; None where it is too long."""
    with contextlib.suppress(asyncio.LimitOverrunError):
        return await reader.readuntil(b"\r\n\r\n")
    return None


def _response(status: str, content_type: str, text: str, more: str = "") -> bytes:
    body = text.encode()
    head = f"HTTP/1.0 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {len(body)}\r\n{more}"
    return f"{head}Connection: close\r\n\r\n".encode() + body
