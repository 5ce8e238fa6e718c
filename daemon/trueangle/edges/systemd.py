"""What systemd and the service tell one another: READY, RELOADING, STATUS, WATCHDOG (sd_notify(3)), the sockets
of socket units (sd_listen_fds(3)), and whether stderr is the journal.

The protocols are public and a few lines long; a library would add a dependency for them.
"""

import os
import socket
from collections.abc import Mapping, MutableMapping

MAX_STATUS = 1000
FIRST_HANDED_OVER = 3
"""SD_LISTEN_FDS_START: the first descriptor after stdin, stdout and stderr."""


class ServiceNotifier:
    """Sends notifications where `NOTIFY_SOCKET` is set; does nothing elsewhere."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._ready_unheard = False
        self._socket: socket.socket | None = None
        if self._address:
            # Not blocking: a manager that does not read (its queue may hold ten) must not freeze the registers.
            kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
            self._socket = socket.socket(socket.AF_UNIX, kind)
            # An abstract socket is written with a leading @ for its leading NUL.
            if self._address.startswith("@"):
                self._address = "\0" + self._address[1:]
        self.watchdog_interval_s = _watchdog_interval_s(environment)

    def _send(self, text: str) -> bool:
        """False where the manager did not take it."""
        if self._socket is not None:
            try:
                self._socket.sendto(text.encode(), self._address)
            except OSError:
                return False  # restarting, gone or behind: the watchdog then decides, nobody else can be told
        return True

    def ready(self, status: str) -> None:
        """The service serves every joint or has said why not; also ends what `reloading` began."""
        self._ready_unheard = not self._send(f"READY=1\nSTATUS={_one_line(status)}")

    def reloading(self, monotonic_us: int) -> None:
        """A reload has begun, at this CLOCK_MONOTONIC; systemd waits for READY."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={monotonic_us}")

    def status(self, status: str) -> None:
        """One line for `systemctl status`; with a READY that was not taken, said again."""
        if self._ready_unheard:
            self.ready(status)
        else:
            self._send(f"STATUS={_one_line(status)}")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """An orderly stop has begun."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _one_line(text: str) -> str:
    """As one line, so that a text of a file's making is no message of its own; cut where nobody reads on."""
    line = " ".join(text.split())
    return line if len(line) <= MAX_STATUS else f"{line[:MAX_STATUS]}..."


def _watchdog_interval_s(environment: Mapping[str, str]) -> float | None:
    """A third of the watchdog's time, None where none is set or it is meant for another process."""
    microseconds = environment.get("WATCHDOG_USEC", "")
    if not microseconds.isdigit() or int(microseconds) == 0:
        return None
    pid = environment.get("WATCHDOG_PID", "")
    if pid and pid != str(os.getpid()):
        return None
    return int(microseconds) / 3e6


def handed_over_sockets(environment: MutableMapping[str, str]) -> dict[str, socket.socket]:
    """The listening TCP sockets of systemd's socket units, by FileDescriptorName=; of two of one name the first.

    The variables are taken out of the environment: no child process shall take the sockets for its own. A socket
    that is no listening TCP socket is closed: nobody here would ever answer on it.
    """
    told = {name: environment.pop(name, "") for name in ("LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES")}
    if told["LISTEN_PID"] != str(os.getpid()) or not told["LISTEN_FDS"].isdecimal():
        return {}
    names = told["LISTEN_FDNAMES"].split(":")
    sockets: dict[str, socket.socket] = {}
    for number in range(int(told["LISTEN_FDS"])):
        name = names[number] if number < len(names) else "unknown"
        handed_over = _listening(FIRST_HANDED_OVER + number)
        if handed_over is not None and name not in sockets:
            sockets[name] = handed_over
        elif handed_over is not None:
            handed_over.close()
    return sockets


def _listening(descriptor: int) -> socket.socket | None:
    try:
        found = socket.socket(fileno=descriptor)
        if found.type == socket.SOCK_STREAM and found.family in (socket.AF_INET, socket.AF_INET6):
            found.set_inheritable(False)
            found.setblocking(False)
            if found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                return found
    except OSError:
        return None  # closed already, or no socket at all
    found.close()
    return None


def is_journal(environment: Mapping[str, str], descriptor: int) -> bool:
    """Whether this descriptor leads to the journal (systemd.exec(5), JOURNAL_STREAM: device and inode)."""
    told = environment.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return told == f"{status.st_dev}:{status.st_ino}"
