"""Where a command finds the running daemon: by the configuration or by host and port; plain or with TLS."""

import argparse
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trueangle.config import DaemonConfig, ModbusConfig, load_config
from trueangle.contract.errors import ContractError, Fault
from trueangle.edges.modbus_client import ModbusReader, client_tls

_TLS_OPTIONS = ("ca", "certificate", "key")


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusTarget:
    """A Modbus TCP server, and what the configuration calls its joints."""

    host: str
    port: int
    unit_id: int
    names: Mapping[int, str]
    """By slot; empty without a configuration."""
    tls: ssl.SSLContext | None = None
    """None: plain TCP."""
    server_name: str | None = None
    """Expected in the server's certificate; None: the host."""

    def reader(self) -> ModbusReader:
        """A reader of this server, not connected yet."""
        return ModbusReader(self.host, self.port, self.unit_id, tls=self.tls, server_name=self.server_name)


def add_target(parser: argparse.ArgumentParser, *, config_required: bool = False) -> None:
    """The options."""
    text = "take host, port and names from it"
    parser.add_argument("--config", type=Path, required=config_required, metavar="FILE", help=text)
    parser.add_argument("--host", help="default 127.0.0.1, or that of the configuration")
    parser.add_argument("--port", type=int, help="default 5020 (TLS 802), or that of the configuration")
    parser.add_argument("--unit-id", type=int, metavar="N", help="default 1, or that of the configuration")
    tls = parser.add_argument_group("TLS (Modbus/TCP Security)")
    tls.add_argument("--ca", type=Path, metavar="FILE", help="authority of the server's certificate, PEM")
    tls.add_argument("--certificate", type=Path, metavar="FILE", help="our own, with a role that may read")
    tls.add_argument("--key", type=Path, metavar="FILE", help="its private key")
    tls.add_argument("--server-name", metavar="NAME", help="in the server's certificate (default: the host)")


def target_of(options: argparse.Namespace) -> ModbusTarget:
    """The server that the options name; ContractError for an impossible one."""
    config = None if options.config is None else load_config(options.config)
    modbus = ModbusConfig() if config is None else config.modbus
    files = [getattr(options, name) for name in _TLS_OPTIONS]
    secure = any(files)
    faults = _faults(options, config, missing=[n for n, f in zip(_TLS_OPTIONS, files, strict=True) if not f])
    host, port = modbus.host, modbus.port
    if secure:
        host = (modbus.tls and modbus.tls.host) or host
        port = 802 if modbus.tls is None else modbus.tls.port
    host = options.host or host
    port = options.port if options.port is not None else port
    unit_id = options.unit_id if options.unit_id is not None else modbus.unit_id
    if not 1 <= port <= 65535:
        advice = "the configuration takes a free port: the daemon's log names it" if port == 0 else ""
        faults.append(Fault(where="--port", expected="1 to 65535", found=str(port), advice=advice))
    if not 0 <= unit_id <= 255:
        faults.append(Fault(where="--unit-id", expected="0 to 255", found=str(unit_id)))
    if faults:
        raise ContractError(faults)
    return ModbusTarget(
        # Where the daemon listens on every address, this machine finds it on its own.
        host={"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host),  # noqa: S104 - compared, not bound
        port=port,
        unit_id=unit_id,
        names={} if config is None else {joint.slot: joint.name for joint in config.joints},
        tls=client_tls(*files) if secure else None,
        server_name=options.server_name,
    )


def _faults(options: argparse.Namespace, config: DaemonConfig | None, *, missing: list[str]) -> list[Fault]:
    """Of the TLS options: all three or none, and all where the service has no plain server on TCP."""
    if not missing:
        return []
    absent = ", ".join(f"--{name}" for name in missing)
    if len(missing) < len(_TLS_OPTIONS):
        return [
            Fault(where="command line", expected="--ca, --certificate and --key together", found=f"no {absent}")
        ]
    if config is not None and not config.modbus.plain_tcp and options.port is None:
        where = f"{options.config}, modbus.plain_tcp"
        if config.modbus.tls is None:
            return [Fault(where=where, expected="a server on TCP to read from", found="Modbus RTU alone")]
        return [Fault(where=where, expected=f"{absent} for a service that answers TLS alone", found="none")]
    if options.server_name is not None:
        return [Fault(where="--server-name", expected=f"{absent} with it", found="none")]
    return []
