"""The Modbus servers: TCP, TLS, RTU, and who may do what."""

import enum
import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from trueangle.contract.document import Range
from trueangle.contract.errors import ContractError, Fault

BAUDRATES = (1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600)
"""What serial lines and adapters run at."""


class Right(enum.Enum):
    """What a role may do over Modbus."""

    READ = "read"
    COMMAND = "command"
    """Read as well."""


class Parity(enum.Enum):
    """Parity of a serial line."""

    NONE = "none"
    EVEN = "even"
    ODD = "odd"


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsConfig:
    """Modbus/TCP Security: TLS 1.2 or later, and every client shows a certificate of `client_ca`.

    Files are relative to the configuration file; `credential:NAME` is taken from systemd ($CREDENTIALS_DIRECTORY).
    """

    certificate: str
    """PEM, with the intermediate certificates behind it."""
    private_key: str
    """PEM, not encrypted."""
    client_ca: str
    """PEM: the authorities whose client certificates are accepted."""
    host: str | None = None
    """Left out: that of the plain server."""
    port: Annotated[int, Range(minimum=0, maximum=65535)] = 802
    """Below 1024 a socket unit of systemd opens it, as the daemon has no capability."""
    roles: Mapping[str, Right] = field(default_factory=dict[str, Right])
    """Role in the certificate (OID 1.3.6.1.4.1.50316.802.1) to right. Empty: every accepted certificate may read.
    Otherwise a certificate without one of these roles may do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RtuConfig:
    """Modbus RTU on a serial line, beside TCP."""

    device: str
    baudrate: int = 19_200
    parity: Parity = Parity.EVEN
    stop_bits: Annotated[int, Range(minimum=1, maximum=2)] = 1
    unit_id: Annotated[int, Range(minimum=1, maximum=247)] = 1
    silence_ms: Annotated[float, Range(minimum=0.1, maximum=100)] | None = None
    """Longer than t3.5, for adapters that hand over a frame in pieces."""

    def __post_init__(self) -> None:
        if self.baudrate not in BAUDRATES:
            expected = f"one of {', '.join(str(rate) for rate in BAUDRATES)}"
            raise ContractError([Fault(where="baudrate", expected=expected, found=str(self.baudrate))])


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusConfig:
    """The Modbus servers. They only read unless `commands` is true; bind them to the PLC's network by choice."""

    host: str = "127.0.0.1"
    port: Annotated[int, Range(minimum=0, maximum=65535)] = 5020
    """0 takes a free port and logs it."""
    unit_id: Annotated[int, Range(minimum=1, maximum=247)] = 1
    """Answered beside 0 and 255."""
    max_connections: Annotated[int, Range(minimum=1, maximum=1000)] = 32
    max_connections_per_address: Annotated[int, Range(minimum=1, maximum=1000)] = 8
    idle_timeout_s: Annotated[float, Range(minimum=1, maximum=86400)] = 60.0
    allow: tuple[str, ...] = ()
    """Networks (192.0.2.0/24) and addresses that may connect; empty: all. It keeps out mistakes, not attackers."""
    plain_tcp: bool = True
    """False: no server without TLS."""
    tls: TlsConfig | None = None
    rtu: RtuConfig | None = None
    commands: bool = False
    """Preset, clear fault and reference angle, for peers whose role is mapped to command."""
    insecure_commands: bool = False
    """Commands also over plain TCP and RTU, from anybody who reaches them."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        for i, network in enumerate(self.allow):
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                expected = "an address or a network such as 192.0.2.0/24"
                faults.append(Fault(where=f"allow[{i}]", expected=expected, found=str(error)))
        if not self.plain_tcp and self.tls is None and self.rtu is None:
            faults.append(Fault(where="plain_tcp", expected="tls or rtu where it is false", found="no server"))
        if self.insecure_commands and not self.commands:
            faults.append(Fault(where="insecure_commands", expected="commands: true with it", found="false"))
        secure = self.tls is not None and Right.COMMAND in self.tls.roles.values()
        if self.commands and not secure and not self.insecure_commands:
            expected = "a role of tls.roles mapped to command, or insecure_commands: true"
            faults.append(Fault(where="commands", expected=expected, found="nobody who may command"))
        if faults:
            raise ContractError(faults)

    @property
    def networks(self) -> "tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]":
        """`allow`, parsed."""
        return tuple(ipaddress.ip_network(network) for network in self.allow)
