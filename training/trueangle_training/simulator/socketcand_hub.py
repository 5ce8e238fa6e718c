"""A CAN bus without a kernel driver: socketcand's raw mode over TCP, for simulated nodes and python-can.

The protocol is that of the socketcand project: `< hi >` on connection, then `< open CHANNEL >` and `< rawmode >`,
each answered by `< ok >`; then `< send ID LENGTH B0 B1 ... >` from the client and
`< frame ID SECONDS.MICROSECONDS HEX >` to it. Nodes of this process attach as plain functions.

Limits: 11-bit data frames only; no arbitration, no bit rate: every frame arrives, in the order of sending.
"""

import asyncio
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

FrameListener = Callable[[int, bytes], None]
"""COB-ID (11 bit) and data (0 .. 8 bytes)."""

MAX_UNSENT_BYTES = 1 << 20
"""A client that does not read loses frames beyond this, as a full receive buffer of a CAN socket does."""
MAX_COMMAND_BYTES = 4096
HANDSHAKE_PAUSE_S = 0.05
"""python-can reads `< ok >` as one message: a frame in the same segment would be taken for a wrong answer."""


class SocketcandHub:
    """One CAN channel with any number of TCP clients; `async with` listens."""

    def __init__(self, *, host: str = "127.0.0.1", port: int = 0, channel: str = "can0") -> None:
        self.channel = channel
        self.frames_dropped = 0
        """Frames not given to a client that was too slow."""
        self.port = port
        """The port listened on, known once entered where 0 was asked for."""
        self._host = host
        self._listeners: list[FrameListener] = []
        self._clients: set[_Client] = set()
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self), self._host, self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
            self.disconnect_clients()
            await self._server.wait_closed()

    def attach(self, on_frame: FrameListener) -> None:
        """Let a node of this process hear what clients send. Attached nodes do not hear each other."""
        self._listeners.append(on_frame)

    def send(self, can_id: int, data: bytes) -> None:
        """A frame of an attached node, to every client."""
        self._broadcast(can_id, data, sender=None)

    def disconnect_clients(self) -> None:
        """Hang up on everybody, as a broken cable or a restarted gateway does."""
        for client in tuple(self._clients):
            client.hang_up()

    def join(self, client: "_Client") -> None:
        """A client is in raw mode."""
        self._clients.add(client)

    def leave(self, client: "_Client") -> None:
        """A client is gone."""
        self._clients.discard(client)

    def receive(self, can_id: int, data: bytes, sender: "_Client") -> None:
        """A frame of a client, to the attached nodes and to the other clients."""
        self._broadcast(can_id, data, sender=sender)
        for listener in self._listeners:
            listener(can_id, data)

    def _broadcast(self, can_id: int, data: bytes, sender: "_Client | None") -> None:
        if not self._clients:
            return
        line = frame_line(can_id, data, time.time_ns())
        for client in self._clients:
            if client is not sender and not client.put(line):
                self.frames_dropped += 1


class _Client(asyncio.Protocol):
    """One TCP client (asyncio itself sets TCP_NODELAY)."""

    def __init__(self, hub: SocketcandHub) -> None:
        self._hub = hub
        self._transport: asyncio.Transport | None = None
        self._received = b""
        self._is_open = False
        self._is_raw = False
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._flush_call: asyncio.Handle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - a stream server makes stream transports
        self._transport = transport
        transport.write(b"< hi >")

    def connection_lost(self, exc: Exception | None) -> None:
        self._hub.leave(self)
        self._transport = None
        if self._flush_call is not None:
            self._flush_call.cancel()

    def data_received(self, data: bytes) -> None:
        *commands, self._received = (self._received + data).split(b">")
        if self._is_raw and commands and isinstance(self._flush_call, asyncio.TimerHandle):
            self._flush_call.cancel()  # a client that speaks has read its `< ok >`
            self._flush()
        for command in commands:
            self._obey(command.decode("ascii", "replace").replace("<", " ").split())
        if len(self._received) > MAX_COMMAND_BYTES:
            self.hang_up()

    def put(self, line: bytes) -> bool:
        """Queue a line for this client; False where it has too much unread already."""
        if (
            self._transport is None
            or self._pending_bytes + self._transport.get_write_buffer_size() > MAX_UNSENT_BYTES
        ):
            return False
        self._pending.append(line)
        self._pending_bytes += len(line)
        if self._flush_call is None:
            self._flush_call = asyncio.get_running_loop().call_soon(self._flush)
        return True

    def hang_up(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def _flush(self) -> None:
        self._flush_call = None
        if self._transport is not None and self._pending:
            self._transport.write(b"".join(self._pending))
        self._pending.clear()
        self._pending_bytes = 0

    def _obey(self, words: list[str]) -> None:
        match words:
            case ["open", channel] if channel == self._hub.channel and not self._is_open:
                self._is_open = True
                self._answer("ok")
            case ["rawmode"] if self._is_open and not self._is_raw:
                self._is_raw = True
                self._answer("ok")
                self._hub.join(self)
                self._flush_call = asyncio.get_running_loop().call_later(HANDSHAKE_PAUSE_S, self._flush)
            case ["send", can_id, length, *data] if self._is_raw:
                self._pass_on(can_id, length, data)
            case ["echo"]:
                self._answer("echo")
            case _:
                self._answer(f"error unknown command {' '.join(words)[:80]}")

    def _pass_on(self, can_id: str, length: str, data: list[str]) -> None:
        try:
            frame = parse_send(can_id, length, data)
        except ValueError as error:
            self._answer(f"error {error}")
        else:
            self._hub.receive(*frame, sender=self)

    def _answer(self, text: str) -> None:
        if self._transport is not None:
            self._transport.write(f"< {text} >".encode("ascii", "replace"))


def frame_line(can_id: int, data: bytes, time_ns: int) -> bytes:
    """A received frame as socketcand writes it; without data two spaces stand before the bracket."""
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"< frame {can_id:03X} {seconds}.{rest_ns // 1000:06d} {data.hex().upper()} >".encode("ascii")


def parse_send(can_id: str, length: str, data: list[str]) -> tuple[int, bytes]:
    """COB-ID and data of a `send` command; ValueError says what is wrong with it."""
    number, count = int(can_id, 16), int(length, 16)
    if len(can_id) > 3 or not 0 <= number <= 0x7FF:
        raise ValueError(f"identifier {can_id}: expected 11 bits")
    if count > 8 or count != len(data):
        raise ValueError(f"length {length}: expected 0 to 8 and as many bytes, found {len(data)}")
    return number, bytes(int(byte, 16) for byte in data)
