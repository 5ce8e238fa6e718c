"""What systemd is to a service that notifies."""

import socket
from pathlib import Path


class Manager:
    """What systemd is to the service: the socket of NOTIFY_SOCKET, and WATCHDOG_USEC of 300 ms."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.setblocking(False)
        self.environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "300000"}
        self.told: list[str] = []

    def read(self) -> list[str]:
        """All that was told so far."""
        while True:
            try:
                self.told.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return self.told

    def heard(self, start: str) -> bool:
        return any(message.startswith(start) for message in self.read())

    def ready(self) -> str:
        """The one READY message."""
        (message,) = [message for message in self.read() if message.startswith("READY=1")]
        return message
