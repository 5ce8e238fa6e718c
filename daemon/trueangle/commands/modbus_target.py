"""Where a command finds the running daemon: by the configuration or by host and port."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trueangle.config import load_config
from trueangle.contract.errors import ContractError, Fault


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusTarget:
    """A Modbus TCP server, and what the configuration calls its joints."""

    host: str
    port: int
    unit_id: int
    names: Mapping[int, str]
    """By slot; empty without a configuration."""


def add_target(parser: argparse.ArgumentParser) -> None:
    """The options."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="take host, port and names from it")
    parser.add_argument("--host", help="default 127.0.0.1, or that of the configuration")
    parser.add_argument("--port", type=int, help="default 5020, or that of the configuration")
    parser.add_argument("--unit-id", type=int, metavar="N", help="default 1, or that of the configuration")


def target_of(options: argparse.Namespace) -> ModbusTarget:
    """The server that the options name; ContractError for an impossible one."""
    config = None if options.config is None else load_config(options.config)
    host = options.host or ("127.0.0.1" if config is None else config.modbus.host)
    port = options.port if options.port is not None else 5020 if config is None else config.modbus.port
    unit_id = options.unit_id if options.unit_id is not None else 1 if config is None else config.modbus.unit_id
    faults: list[Fault] = []
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
    )
