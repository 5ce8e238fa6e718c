"""What clients may take of the servers, what is counted, and how trouble with them is logged."""

import ipaddress
import logging
from dataclasses import dataclass

from trueangle.core.modbus_answer import RequestCounts

_LOG = logging.getLogger(__name__)
_REPORT_INTERVAL_S = 60.0
"""A client that misbehaves again and again is logged once in that time, with the count."""

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusLimits:
    """What clients may take of the server."""

    connections: int = 32
    """Handshakes that have not ended are connections too."""
    connections_per_address: int = 8
    idle_timeout_s: float = 60.0
    """Time without a complete request after which a connection is closed; also ends one that stops reading."""
    handshake_timeout_s: float = 5.0
    """Time in which a TLS client must have shown its certificate."""
    unsent_bytes: int = 64 * 1024
    """Above, nothing more is read from the connection until the client has taken its answers. One read of 260
    bytes is answered with at most 6 KiB, so this and one answer are the most that a client can make wait."""

    image_age_s: float | None = None
    """Before an answer from an image older than this, `refresh` is called; if the image is still older, the answer
    is exception 06 (server device busy). None: served for ever."""

    allow: tuple[Network, ...] = ()
    """Networks that may connect; empty: all."""

    def __post_init__(self) -> None:
        names = ("connections", "connections_per_address", "idle_timeout_s", "handshake_timeout_s", "unsent_bytes")
        for name in names:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: expected more than 0, got {getattr(self, name)}")

    def allows(self, address: str) -> bool:
        """Whether a client from this host address may connect."""
        if not self.allow:
            return True
        try:
            host = ipaddress.ip_address(address)
        except ValueError:
            return False
        return any(host in network for network in self.allow)


def host_address(peername: object) -> str:
    """The host of a socket's peer name; an IPv4 client of an IPv6 socket has its IPv4 address."""
    if not isinstance(peername, tuple) or not peername:
        return "unknown"
    text = str(peername[0]).partition("%")[0]  # pyright: ignore[reportUnknownArgumentType]
    try:
        host = ipaddress.ip_address(text)
    except ValueError:
        return text
    mapped = host.ipv4_mapped if isinstance(host, ipaddress.IPv6Address) else None
    return str(mapped or host)


@dataclass(slots=True, kw_only=True)
class ModbusCounters(RequestCounts):
    """Plain integers since start, except `connections`: those open now."""

    connections: int = 0
    accepted: int = 0
    refused: int = 0
    """Closed at once, because of a limit on connections."""
    not_allowed: int = 0
    """Closed at once, because of the address."""
    broken: int = 0
    """Closed because of a header that cannot be Modbus TCP."""
    idle_closed: int = 0
    tls_refused: int = 0
    """Handshakes that failed or took too long."""


@dataclass(slots=True)
class _Trouble:
    """One kind of trouble that has not ended."""

    begun_s: float
    last_s: float
    logged_s: float
    unlogged: int = 0
    count: int = 1


class TroubleLog:
    """Trouble with clients: a line where a kind of it begins, one a minute while it goes on, one at its end."""

    def __init__(self) -> None:
        self.interval_s = _REPORT_INTERVAL_S
        """Trouble that did not come for so long is over."""
        self._troubles: dict[str, _Trouble] = {}

    def report(self, event: str, peer: str, reason: str, now_s: float) -> None:
        """Log, or count until the next time it may be logged."""
        trouble = self._troubles.get(event)
        if trouble is None:
            self._troubles[event] = _Trouble(now_s, now_s, now_s)
            _LOG.warning("event=%s peer=%s count=1 reason=%r", event, peer, reason)
            return
        trouble.last_s = now_s
        trouble.count += 1
        trouble.unlogged += 1
        if now_s - trouble.logged_s >= self.interval_s:
            _LOG.warning("event=%s peer=%s count=%d reason=%r", event, peer, trouble.unlogged, reason)
            trouble.logged_s, trouble.unlogged = now_s, 0

    def end_what_is_over(self, now_s: float) -> bool:
        """Log the end of what did not come for a minute; True where some trouble still stands."""
        for event, trouble in tuple(self._troubles.items()):
            if now_s - trouble.last_s >= self.interval_s:
                del self._troubles[event]
                lasted_s = trouble.last_s - trouble.begun_s
                _LOG.info("event=%s_over lasted_s=%.1f count=%d", event, lasted_s, trouble.count)
        return bool(self._troubles)
