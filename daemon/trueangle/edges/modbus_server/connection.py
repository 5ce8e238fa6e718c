"""One client of the plain server: received bytes go into the stream's fixed buffer, answers out at once."""

import asyncio
from time import monotonic_ns
from typing import Protocol, cast

from trueangle.core.commands import Peer
from trueangle.core.modbus_answer import ModbusTcpStream
from trueangle.core.modbus_pdu import PduResponder, RegisterSource
from trueangle.edges.modbus_server.limits import ModbusCounters, ModbusLimits, host_address


class ConnectionHost(Protocol):
    """What a connection needs of its server."""

    unit_id: int
    limits: ModbusLimits
    counters: ModbusCounters
    plain_commands: bool

    def image(self, now_ns: int) -> RegisterSource | None:
        """What is answered from; None: not ready."""
        ...

    def responder(self, peer: Peer) -> PduResponder:
        """The answers for one connection of this peer."""
        ...

    def admit(self, connection: "Connection") -> bool:
        """Count the connection in, unless a limit is reached."""
        ...

    def forget(self, connection: "Connection") -> None:
        """The connection is gone."""
        ...

    def report(self, event: str, address: str, reason: str) -> None:
        """Log trouble with a client, now and then."""
        ...


class Connection(asyncio.BufferedProtocol):
    """See the module's docstring."""

    __slots__ = (
        "_host",
        "_idle_check",
        "_last_request_ns",
        "_loop",
        "_responder",
        "_stream",
        "_transport",
        "address",
    )

    def __init__(self, host: ConnectionHost) -> None:
        self._host = host
        self._loop = asyncio.get_running_loop()
        self._last_request_ns = monotonic_ns()
        self._transport: asyncio.Transport | None = None
        self._idle_check: asyncio.TimerHandle | None = None
        self._responder: PduResponder | None = None
        self._stream: ModbusTcpStream | None = None
        self.address = ""
        """The client's host address."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast("asyncio.Transport", transport)
        self._transport = transport
        self.address = host_address(transport.get_extra_info("peername"))
        if not self._host.admit(self):
            transport.abort()
            return
        # low = 0: go on only when the client has taken everything.
        transport.set_write_buffer_limits(high=self._host.limits.unsent_bytes, low=0)
        self.begin()

    def begin(self) -> None:
        """The client is let in."""
        self.serve(Peer(address=self.address, may_command=self._host.plain_commands))

    def serve(self, peer: Peer) -> ModbusTcpStream:
        """Answer this peer from now on."""
        self._responder = self._host.responder(peer)
        self._stream = ModbusTcpStream(self._host.unit_id, self._responder, self._host.counters)
        self._last_request_ns = monotonic_ns()
        self._idle_check = self._loop.call_later(self._host.limits.idle_timeout_s, self._close_if_idle)
        return self._stream

    def get_buffer(self, sizehint: int) -> memoryview:
        # After a refusal nothing is read; the transport asks once before it knows.
        return self._stream.space if self._stream is not None else memoryview(bytearray(1))

    def buffer_updated(self, nbytes: int) -> None:
        # A transport that was told to close delivers nothing more.
        stream, transport = self._stream, self._transport
        if stream is None or transport is None:
            return
        now_ns = monotonic_ns()
        answers = stream.answer(nbytes, self._host.image(now_ns), now_ns)
        if answers:
            self._last_request_ns = now_ns
            transport.write(answers)
        if stream.broken is not None:
            self.break_off(stream.broken)

    def break_off(self, reason: str) -> None:
        """The client does not speak Modbus TCP."""
        self._host.counters.broken += 1
        self._host.report("modbus_broken_stream", self.address, reason)
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
        if self._responder is not None:
            self._responder.close()
        self._host.forget(self)

    def end(self) -> None:
        """Close; at once, if the client has not taken its answers, because nobody knows whether it ever will."""
        if self._transport is None:
            return
        if self._transport.get_write_buffer_size():
            self._transport.abort()
        else:
            self._transport.close()

    @property
    def unsent_bytes(self) -> int:
        """Answers that the client has not taken."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def _close_if_idle(self) -> None:
        """The base of the time-out is the last whole request, so single bytes keep nothing open."""
        silent_s = (monotonic_ns() - self._last_request_ns) * 1e-9
        left_s = self._host.limits.idle_timeout_s - silent_s
        if left_s > 0:
            self._idle_check = self._loop.call_later(left_s, self._close_if_idle)
            return
        self._host.counters.idle_closed += 1
        self._host.report("modbus_idle_closed", self.address, _idle_reason(self.unsent_bytes))
        self.end()


def _idle_reason(unsent_bytes: int) -> str:
    return f"{unsent_bytes} bytes of answers not taken" if unsent_bytes else "no whole request"
