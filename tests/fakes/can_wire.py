"""A CAN bus inside one event loop: the daemon's end is a socket of `struct can_frame`s, as SocketCAN's is.

Everything that a node sends before the loop turns lies in the socket together, so a test can put several frames
into one batch on purpose.
"""

import asyncio
import contextlib
import errno
import os
import socket
import struct

import can
from tests.fakes.canopen_device import FakeDevice

from trueangle.config import BusConfig

CAN_FRAME = struct.Struct("=IB3x8s")
"""struct can_frame of linux/can.h."""


class _NearEnd(can.BusABC):
    """What python-can's SocketcanBus is to the daemon: something with a `socket`."""

    def __init__(self, near: socket.socket) -> None:
        self.socket = near
        super().__init__("wire")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("the daemon writes SocketCAN frames itself")

    def shutdown(self) -> None:
        super().shutdown()
        self.socket.close()


class CanWire:
    """The bus and its nodes; `open` is what the daemon calls instead of python-can."""

    def __init__(self) -> None:
        self.nodes: list[FakeDevice] = []
        self.absent = False
        """The interface does not exist: opening fails."""
        self._far: socket.socket | None = None

    def open(self, settings: BusConfig) -> can.BusABC:
        if self.absent:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV), settings.channel)
        self.cut()
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        far.setblocking(False)
        self._far = far
        asyncio.get_running_loop().add_reader(far.fileno(), self._take)
        return _NearEnd(near)

    def send(self, can_id: int, data: bytes) -> None:
        """A node's frame to the daemon; lost where nobody listens."""
        if self._far is not None:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                self._far.send(CAN_FRAME.pack(can_id, len(data), data))

    def cut(self) -> None:
        """End this opening of the bus: the daemon finds its socket closed."""
        if self._far is not None:
            asyncio.get_running_loop().remove_reader(self._far.fileno())
            self._far.close()
            self._far = None

    def _take(self) -> None:
        """One frame of the daemon, handed to every node."""
        assert self._far is not None
        try:
            raw = self._far.recv(CAN_FRAME.size)
        except ConnectionResetError:
            raw = b""
        if not raw:
            self.cut()
            return
        can_id, length, data = CAN_FRAME.unpack(raw)
        for node in self.nodes:
            node.handle(can_id, data[:length])
