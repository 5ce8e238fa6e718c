"""The Modbus TCP server: sockets around `core.modbus_answer`, limits on what a client may take.

Rules of this file: pymodbus is met here and nowhere else in the daemon. Its listener (`ModbusProtocol` with
`CommParams`) opens the endpoint; its request handler is not used, because it answers only the first of several
pipelined requests, gives code 01 for every fault, never recovers from a bad header and limits nothing.
The image is swapped by reference: an answer is made of one image, whole.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from pymodbus.transport import CommParams, CommType, ModbusProtocol

from trueangle.core.modbus_answer import ModbusTcpStream, RegisterSource
from trueangle.errors import LinkError

_LOG = logging.getLogger(__name__)
_REPORT_INTERVAL_S = 60.0
"""A client that misbehaves again and again is logged once in that time, with the count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusLimits:
    """What clients may take of the server."""

    connections: int = 32
    connections_per_address: int = 8
    idle_timeout_s: float = 60.0
    """Time without a complete request after which a connection is closed; also ends one that stops reading."""
    unsent_bytes: int = 64 * 1024
    """Above, nothing more is read from the connection until the client has taken its answers. One read of 260
    bytes is answered with at most 5.4 KiB, so this and one answer are the most that a client can make wait."""

    image_age_s: float | None = None
    """Before an answer from an image older than this, `refresh` is called; if the image is still older, the answer
    is exception 06 (server device busy). None: served for ever."""

    def __post_init__(self) -> None:
        for name in ("connections", "connections_per_address", "idle_timeout_s", "unsent_bytes"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: expected more than 0, got {getattr(self, name)}")


@dataclass(slots=True, kw_only=True)
class ModbusCounters:
    """Plain integers since start, except `connections`: those open now."""

    requests: int = 0
    exceptions: int = 0
    connections: int = 0
    accepted: int = 0
    refused: int = 0
    """Closed at once, because of a limit on connections."""
    broken: int = 0
    """Closed because of a header that cannot be Modbus TCP."""
    idle_closed: int = 0


class ModbusTcpServer:
    """Serves the published register image, read-only, on one address."""

    def __init__(
        self,
        host: str,
        port: int,
        unit_id: int,
        limits: ModbusLimits | None = None,
        refresh: Callable[[], None] | None = None,
    ) -> None:
        """`port` 0 takes a free one; `unit_id` 1..247 is answered beside 0 and 255; `refresh` publishes anew."""
        if not 0 <= port <= 65535:
            raise ValueError(f"port: expected 0..65535, got {port}")
        if not 0 <= unit_id <= 255:
            raise ValueError(f"unit_id: expected 0..255, got {unit_id}")
        self._host = host
        self._port = port
        self.unit_id = unit_id
        self.limits = limits or ModbusLimits()
        self.counters = ModbusCounters()
        self._image: RegisterSource | None = None
        self._published_s = 0.0
        self._refresh = refresh
        self._endpoint: asyncio.Server | None = None
        self._open: set[_Connection] = set()
        self._all_closed = asyncio.Event()
        self._reports: dict[str, _Report] = {}

    @property
    def listening(self) -> bool:
        """True while clients can connect."""
        return self._endpoint is not None and self._endpoint.is_serving()

    def publish(self, image: RegisterSource) -> None:
        """Answer from this image from now on."""
        self._image = image
        self._published_s = time.monotonic()

    def image(self) -> RegisterSource | None:
        """What is answered from; None before the first publication and when the last one is too old.

        After a stall of the process the loop runs requests that waited before timers that are due: without the
        refresh they would be answered from the image of before the stall.
        """
        limit_s = self.limits.image_age_s
        if limit_s is None or time.monotonic() - self._published_s <= limit_s:
            return self._image
        if self._refresh is not None:
            self._refresh()
        return self._image if time.monotonic() - self._published_s <= limit_s else None

    async def start(self) -> int:
        """Listen; returns the bound port. Raises LinkError when the address cannot be had."""
        listener = _Listener(self, self._host, self._port)
        try:
            self._endpoint = cast("asyncio.Server", await listener.call_create())
        except OSError as error:
            raise LinkError(
                f"modbus listener: expected to bind {self._host}:{self._port}, got {error.strerror or error}; "
                "try another address or port, or stop the program that holds it"
            ) from error
        port: int = self._endpoint.sockets[0].getsockname()[1]
        _LOG.info("event=modbus_listening host=%s port=%d unit_id=%d", self._host, port, self.unit_id)
        return port

    async def close(self) -> None:
        """Stop listening and end all connections; answers that a client does not take are dropped."""
        if self._endpoint is None:
            return
        self._endpoint.close()
        self._all_closed.clear()
        for connection in tuple(self._open):
            connection.end()
        if self._open:
            await self._all_closed.wait()
        await self._endpoint.wait_closed()
        self._endpoint = None
        _LOG.info("event=modbus_closed requests=%d", self.counters.requests)

    def admit(self, connection: "_Connection") -> bool:
        """Count the connection in, unless a limit is reached."""
        address = connection.address
        same_address = sum(other.address == address for other in self._open)
        if len(self._open) >= self.limits.connections:
            reason = f"connections={len(self._open)}"
        elif same_address >= self.limits.connections_per_address:
            reason = f"connections_of_address={same_address}"
        else:
            self._open.add(connection)
            self.counters.accepted += 1
            self.counters.connections = len(self._open)
            return True
        self.counters.refused += 1
        self.report("modbus_refused", address, reason)
        return False

    def forget(self, connection: "_Connection") -> None:
        """The connection is gone."""
        self._open.discard(connection)
        self.counters.connections = len(self._open)
        if not self._open:
            self._all_closed.set()

    def report(self, event: str, address: str, reason: str) -> None:
        """Log trouble with a client, at most once a minute per kind of trouble."""
        now_s = asyncio.get_running_loop().time()
        report = self._reports.setdefault(event, _Report())
        report.count += 1
        if report.logged_s is None or now_s - report.logged_s >= _REPORT_INTERVAL_S:
            _LOG.warning("event=%s peer=%s count=%d reason=%r", event, address, report.count, reason)
            report.logged_s = now_s
            report.count = 0


@dataclass(slots=True)
class _Report:
    """One kind of trouble: when it was last logged, how often it came since."""

    logged_s: float | None = None
    count: int = 0


class _Listener(ModbusProtocol):
    """pymodbus' listener, handing each client to a connection of ours.

    `call_create` is awaited by the server itself: `listen()` would log the reason of a failure and return False.
    """

    def __init__(self, server: ModbusTcpServer, host: str, port: int) -> None:
        params = CommParams(comm_name="trueangled", comm_type=CommType.TCP, source_address=(host, port))
        super().__init__(params, is_server=True)
        self._server = server

    def handle_new_connection(self) -> "_Connection":  # pyright: ignore[reportIncompatibleMethodOverride]
        """The base lists connections before they are made, and one that fails in between never leaves the list."""
        return _Connection(self._server)

    def callback_new_connection(self) -> ModbusProtocol:
        raise RuntimeError("a listener of trueangle makes its connections itself")

    def callback_connected(self) -> None:
        """Only called for connections of the base class."""

    def callback_disconnected(self, exc: Exception | None) -> None:
        """Only called for connections of the base class."""

    def callback_data(self, data: bytes, addr: tuple[str, int] | None = None) -> int:
        raise RuntimeError("a listener receives no data")


class _Connection(asyncio.BufferedProtocol):
    """One client. Received bytes go straight into the stream's fixed buffer, answers out in the same callback."""

    __slots__ = ("_idle_check", "_last_request_s", "_loop", "_server", "_stream", "_transport", "address")

    def __init__(self, server: ModbusTcpServer) -> None:
        self._server = server
        self._stream = ModbusTcpStream(server.unit_id)
        self._loop = asyncio.get_running_loop()
        self._last_request_s = self._loop.time()
        self._transport: asyncio.Transport | None = None
        self._idle_check: asyncio.TimerHandle | None = None
        self.address = ""
        """The client's host address."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast("asyncio.Transport", transport)
        self._transport = transport
        peer = transport.get_extra_info("peername")
        self.address = str(peer[0]) if peer else "unknown"
        if not self._server.admit(self):
            transport.abort()
            return
        # low = 0: go on only when the client has taken everything.
        transport.set_write_buffer_limits(high=self._server.limits.unsent_bytes, low=0)
        self._idle_check = self._loop.call_later(self._server.limits.idle_timeout_s, self._close_if_idle)

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._stream.free_space()

    def buffer_updated(self, nbytes: int) -> None:
        stream, transport = self._stream, self._transport
        if transport is None or transport.is_closing():
            return
        requests, exceptions = stream.requests, stream.exceptions
        answers = stream.answer(nbytes, self._server.image())
        if answers:
            counters = self._server.counters
            counters.requests += stream.requests - requests
            counters.exceptions += stream.exceptions - exceptions
            self._last_request_s = self._loop.time()
            transport.write(answers)
        if stream.broken is not None:
            self._server.counters.broken += 1
            self._server.report("modbus_broken_stream", self.address, stream.broken)
            self.end()

    def pause_writing(self) -> None:
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        if self._transport is not None:
            self._transport.resume_reading()

    def eof_received(self) -> bool:
        """False: the transport sends what is waiting and closes."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if self._idle_check is not None:
            self._idle_check.cancel()
        self._server.forget(self)

    def end(self) -> None:
        """Close; at once, if the client has not taken its answers, because nobody knows whether it ever will."""
        if self._transport is None:
            return
        if self._transport.get_write_buffer_size():
            self._transport.abort()
        else:
            self._transport.close()

    def _close_if_idle(self) -> None:
        """The base of the time-out is the last whole request, so single bytes keep nothing open."""
        timeout_s = self._server.limits.idle_timeout_s
        left_s = self._last_request_s + timeout_s - self._loop.time()
        if left_s > 0:
            self._idle_check = self._loop.call_later(left_s, self._close_if_idle)
            return
        self._server.counters.idle_closed += 1
        self.end()
