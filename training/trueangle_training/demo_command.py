"""`trueangle demo`: the whole path on this machine, judged against the truth."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.command import Surroundings

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers

DURATION_LIMITS_S = (2.0, 300.0)
"""Above, the 16-bit sample number of the nodes would wrap more often than the demo needs to follow."""
RATE_LIMITS_HZ = (10.0, 500.0)


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "demo",
        allow_abbrev=False,
        help="the whole path on this machine, judged against the truth",
        description="Simulates the calibration campaigns of six joints, trains a model for each, starts six "
        "CANopen encoder nodes and trueangled as processes of their own, reads the Modbus registers as a PLC, "
        "and compares raw and corrected angles with the true ones. Loopback only; it ends all that it starts.",
    )
    parser.add_argument("--out", type=Path, default=Path("build/demo"), metavar="DIR", help="files, logs, summary")
    parser.add_argument(
        "--duration", type=float, default=12.0, metavar="S", help="live part in seconds (default 12)"
    )
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="SYNC rate (default 200)")
    parser.add_argument("--can", metavar="NAME", help="a SocketCAN interface such as vcan0 instead of socketcand")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    # Rich, pymodbus and the simulator only when the demo begins.
    from rich.console import Console

    from trueangle_training.demo.run import DemoOptions, run_demo

    faults = [
        Fault(where=name, expected=f"{low:g} to {high:g}", found=f"{value:g}")
        for name, value, (low, high) in (
            ("--duration", arguments.duration, DURATION_LIMITS_S),
            ("--rate", arguments.rate, RATE_LIMITS_HZ),
        )
        if not low <= value <= high
    ]
    if faults:
        raise ContractError(faults)
    options = DemoOptions(
        out=arguments.out,
        duration_s=arguments.duration,
        rate_hz=arguments.rate,
        can=arguments.can,
    )
    # A log file has no width of its own; rich would take 80 columns and break the lines.
    width = None if surroundings.out.isatty() else 120
    return run_demo(options, Console(file=surroundings.out, width=width))
