"""The Modbus TCP server, plain and TLS: listeners, limits on what a client may take, the image that is served.

pymodbus' listener (`ModbusProtocol` with `CommParams`) opens the endpoint; its request handler is not used: it
answers only the first of several pipelined requests, gives code 01 for every fault, never recovers from a bad
header and limits nothing.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from socket import socket
from typing import cast

from pymodbus.transport import CommParams, CommType, ModbusProtocol

from trueangle.core.commands import CommandDesk, Peer
from trueangle.core.modbus_pdu import Identification, PduResponder, RegisterSource
from trueangle.edges.modbus_server.connection import Connection
from trueangle.edges.modbus_server.limits import ModbusCounters, ModbusLimits, TroubleLog
from trueangle.edges.modbus_server.tls import TlsConnection, TlsSettings
from trueangle.errors import LinkError

PLAIN_SOCKET = "modbus"
TLS_SOCKET = "modbus-tls"
"""FileDescriptorName= of sockets that systemd hands over (sd_listen_fds_with_names)."""

_LOG = logging.getLogger(__name__)
_UNKNOWN_REVISION = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listener:
    """Where one of the servers listens."""

    host: str
    port: int
    """0 takes a free one."""
    tls: TlsSettings | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port: expected 0..65535, got {self.port}")


class ModbusTcpServer:
    """Serves the published register image on one or two addresses; commands only where a desk takes them."""

    def __init__(
        self,
        host: str,
        port: int,
        unit_id: int,
        limits: ModbusLimits | None = None,
        refresh: Callable[[], None] | None = None,
        *,
        plain: bool = True,
        tls: Listener | None = None,
        sockets: Mapping[str, socket] | None = None,
        desk: CommandDesk | None = None,
        plain_commands: bool = False,
        identification: Identification | None = None,
    ) -> None:
        """`port` 0 takes a free one; `unit_id` 1..247 is answered beside 0 and 255; `refresh` publishes anew.

        `sockets` are already bound, by the names PLAIN_SOCKET and TLS_SOCKET, and go before host and port;
        `plain_commands` lets everybody on the plain port give commands.
        """
        if not 0 <= unit_id <= 255:
            raise ValueError(f"unit_id: expected 0..255, got {unit_id}")
        self._listeners: dict[str, Listener] = {}
        if plain:
            self._listeners[PLAIN_SOCKET] = Listener(host=host, port=port)
        if tls is not None:
            self._listeners[TLS_SOCKET] = tls
        self._sockets = dict(sockets or {})
        self.unit_id = unit_id
        self.limits = limits or ModbusLimits()
        age_s = self.limits.image_age_s
        self._image_age_ns = None if age_s is None else round(age_s * 1e9)
        self.counters = ModbusCounters()
        self.desk = desk
        self.plain_commands = plain_commands
        self.identification = identification or Identification(revision=_UNKNOWN_REVISION)
        self.ports: dict[str, int] = {}
        """Bound ports by the name of the socket, while listening."""
        self._image: RegisterSource | None = None
        self._published_ns = 0
        self._refresh = refresh
        self._endpoints: list[asyncio.Server] = []
        self._open: set[Connection] = set()
        self._all_closed = asyncio.Event()
        self._trouble = TroubleLog()
        self._look: asyncio.TimerHandle | None = None
        """When to look next whether some trouble is over."""

    @property
    def listening(self) -> bool:
        """True while clients can connect, wherever they shall."""
        return bool(self._endpoints) and all(endpoint.is_serving() for endpoint in self._endpoints)

    def publish(self, image: RegisterSource) -> None:
        """Answer from this image from now on."""
        self._image = image
        self._published_ns = time.monotonic_ns()

    def image(self, now_ns: int) -> RegisterSource | None:
        """What is answered from; None before the first publication and when the last one is too old.

        After a stall of the process the loop runs requests that waited before timers that are due: without the
        refresh they would be answered from the image of before the stall.
        """
        limit_ns = self._image_age_ns
        if limit_ns is None or now_ns - self._published_ns <= limit_ns:
            return self._image
        if self._refresh is not None:
            self._refresh()
        return self._image if time.monotonic_ns() - self._published_ns <= limit_ns else None

    def renew_tls(self, settings: TlsSettings) -> None:
        """New key, certificates or roles, for connections from now on; those that are open stay as they are."""
        listener = self._listeners.get(TLS_SOCKET)
        if listener is not None:
            self._listeners[TLS_SOCKET] = Listener(host=listener.host, port=listener.port, tls=settings)

    async def start(self) -> int:
        """Listen; returns the first bound port. Raises LinkError when an address cannot be had."""
        try:
            for name in self._listeners:
                self._endpoints.append(await self._listen(name))
        except LinkError:
            await self._stop_listening()
            raise
        return next(iter(self.ports.values()), 0)

    async def _listen(self, name: str) -> asyncio.Server:
        listener = self._listeners[name]
        handed_over = self._sockets.get(name)

        def connect() -> Connection:
            settings = self._listeners[name].tls
            return Connection(self) if settings is None else TlsConnection(self, settings)

        try:
            if handed_over is not None:
                endpoint = await asyncio.get_running_loop().create_server(connect, sock=handed_over)
            else:
                opener = _Opener(connect, listener.host, listener.port)
                endpoint = cast("asyncio.Server", await opener.call_create())
        except OSError as error:
            below_1024 = "; a port below 1024 needs systemd's socket unit" if 0 < listener.port < 1024 else ""
            raise LinkError(
                f"modbus listener: expected to bind {listener.host}:{listener.port}, got "
                f"{error.strerror or error}; try another address or port, or stop the program that holds it"
                f"{below_1024}"
            ) from error
        host, port = endpoint.sockets[0].getsockname()[:2]
        self.ports[name] = port
        event = "modbus_listening" if listener.tls is None else "modbus_tls_listening"
        _LOG.info("event=%s host=%s port=%d unit_id=%d", event, host, port, self.unit_id)
        return endpoint

    async def close(self) -> None:
        """Stop listening and end all connections; answers that a client does not take are dropped."""
        if not self._endpoints:
            return
        for endpoint in self._endpoints:
            endpoint.close()
        self._all_closed.clear()
        for connection in tuple(self._open):
            connection.end()
        if self._open:
            await self._all_closed.wait()
        await self._stop_listening()
        if self._look is not None:
            self._look.cancel()
            self._look = None
        _LOG.info("event=modbus_closed requests=%d", self.counters.requests)

    async def _stop_listening(self) -> None:
        for endpoint in self._endpoints:
            endpoint.close()
            await endpoint.wait_closed()
        self._endpoints.clear()
        self.ports.clear()

    def responder(self, peer: Peer) -> PduResponder:
        """The answers for one connection of this peer."""
        session = self.desk.session(peer) if self.desk is not None and peer.may_command else None
        return PduResponder(self.identification, peer=peer, session=session)

    def admit(self, connection: Connection) -> bool:
        """Count the connection in, unless its address is not allowed or a limit is reached."""
        address = connection.address
        if not self.limits.allows(address):
            self.counters.not_allowed += 1
            self.report("modbus_not_allowed", address, "address outside modbus.allow")
            return False
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

    def forget(self, connection: Connection) -> None:
        """The connection is gone."""
        self._open.discard(connection)
        self.counters.connections = len(self._open)
        if not self._open:
            self._all_closed.set()

    def report(self, event: str, address: str, reason: str) -> None:
        """Log trouble with a client: its beginning, at most once a minute that it goes on, its end."""
        loop = asyncio.get_running_loop()
        self._trouble.report(event, address, reason, loop.time())
        if self._look is None:
            self._look = loop.call_later(self._trouble.interval_s, self._look_for_ends)

    def _look_for_ends(self) -> None:
        loop = asyncio.get_running_loop()
        stands = self._trouble.end_what_is_over(loop.time())
        self._look = loop.call_later(self._trouble.interval_s, self._look_for_ends) if stands else None


class _Opener(ModbusProtocol):
    """pymodbus' listener, handing each client to a connection of ours.

    `call_create` is awaited by the server itself: `listen()` would log the reason of a failure and return False.
    """

    def __init__(self, connect: Callable[[], Connection], host: str, port: int) -> None:
        params = CommParams(comm_name="trueangled", comm_type=CommType.TCP, source_address=(host, port))
        super().__init__(params, is_server=True)
        self._connect = connect

    def handle_new_connection(self) -> Connection:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The base lists connections before they are made, and one that fails in between never leaves the list."""
        return self._connect()

    def callback_new_connection(self) -> ModbusProtocol:
        raise RuntimeError("a listener of trueangle makes its connections itself")

    def callback_connected(self) -> None:
        """Only called for connections of the base class."""

    def callback_disconnected(self, exc: Exception | None) -> None:
        """Only called for connections of the base class."""

    def callback_data(self, data: bytes, addr: tuple[str, int] | None = None) -> int:
        raise RuntimeError("a listener receives no data")
