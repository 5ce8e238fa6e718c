"""`trueangled`: run, check-config, check-model, registers, metrics, and the commands of `trueangle.commands`.

Exit codes: 0 done; 1 the service could not go on (port taken); 2 bad input, every fault on a line of its own.
"""

import argparse
import asyncio
import errno
import gc
import logging
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from trueangle.commands import Commands, commission, monitor, record, scan, verify
from trueangle.config import DaemonConfig, load_config
from trueangle.contract.errors import ContractError, TrueangleError
from trueangle.contract.metadata import ModelMetadata
from trueangle.core.metrics import render_metric_table
from trueangle.core.register_table import render_csv, render_markdown, render_text
from trueangle.edges.journal import LogFormatter, visible
from trueangle.edges.onnx_model import load_model
from trueangle.edges.systemd import ServiceNotifier, handed_over_sockets, is_journal
from trueangle.service import Loaded, Service, load, state_directory
from trueangle.service.modbus_side import TlsSettings, tls_settings, uses_credentials
from trueangle.version import own_version

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_RENDERERS = {"text": render_text, "markdown": render_markdown, "csv": render_csv}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.command(options)
        sys.stdout.flush()
    except ContractError as error:
        for fault in error.faults:
            _tell(str(fault))
        return 2
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; the interpreter must not try to write the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except TrueangleError as error:
        _tell(str(error))
        return 1
    except OSError as error:
        if error.errno not in _DISK_FULL or error.filename is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _tell(f"standard output: {error.strerror}")
        return 1
    except KeyboardInterrupt:
        # What a shell makes of SIGINT, without a traceback.
        return 130
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="trueangled", description="Serves corrected encoder angles over Modbus.")
    parser.add_argument("--version", action="version", version=f"trueangled {own_version()}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_service(commands)
    _add_checks(commands)
    _add_tables(commands)
    for module in (scan, commission, verify, monitor, record):
        module.add_parser(commands)
    return parser


def _add_service(commands: Commands) -> None:
    run = commands.add_parser(
        "run",
        help="read the nodes, correct, serve",
        description="Read the nodes, correct their angles, serve them over Modbus until SIGTERM. SIGHUP takes on "
        "a changed configuration and changed models; the log goes to stderr.",
        epilog="Example: trueangled run --config /etc/trueangle/trueangled.yaml",
    )
    run.add_argument("--config", type=Path, required=True, metavar="FILE")
    run.set_defaults(command=_run)


def _add_checks(commands: Commands) -> None:
    check_config = commands.add_parser(
        "check-config",
        help="check a configuration and its models, start nothing",
        description="Check a configuration, its models and its TLS keys, as run and a reload do. Opens no bus and "
        "no port. Every fault is a line with file and line number, and the exit code is then 2.",
        epilog="Example: trueangled check-config /etc/trueangle/trueangled.yaml",
    )
    check_config.add_argument("config", type=Path, metavar="FILE")
    check_config.set_defaults(command=_check_config)

    check_model = commands.add_parser(
        "check-model",
        help="check a model file and say what it is",
        description="Check a model file's seal, replay its probes, and say which joint, encoder and calibration "
        "it is for.",
        epilog="Example: trueangled check-model /etc/trueangle/models/base.onnx",
    )
    check_model.add_argument("model", type=Path, metavar="FILE")
    check_model.set_defaults(command=_check_model)


def _add_tables(commands: Commands) -> None:
    metrics = commands.add_parser(
        "metrics",
        help="print the table of metrics, as Markdown",
        description="Print the table of all metrics that Prometheus can read, as Markdown.",
        epilog="Example: trueangled metrics > metrics.md",
    )
    metrics.set_defaults(command=_metrics)

    registers = commands.add_parser(
        "registers",
        help="print the table of Modbus registers",
        description="Print the table of Modbus registers, with each address from 0 and as 3xxxx and 4xxxx.",
        epilog="Example: trueangled registers --config trueangled.yaml --format csv > registers.csv",
    )
    registers.add_argument(
        "--config", type=Path, metavar="FILE", help="the slots of this configuration (else the first six)"
    )
    registers.add_argument("--format", choices=list(_RENDERERS), default="text")
    registers.set_defaults(command=_registers)


def _run(options: argparse.Namespace) -> int:
    # A reload that is asked for before the service can hear it is one that finds the files as they are read now.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LogFormatter(journal=is_journal(os.environ, sys.stderr.fileno())))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    loaded = load(options.config)
    notifier = ServiceNotifier(os.environ)
    try:
        asyncio.run(_serve(options.config, loaded, notifier))
    finally:
        notifier.close()
    return 0


async def _serve(path: Path, loaded: Loaded, notifier: ServiceNotifier) -> None:
    sockets = handed_over_sockets(os.environ)
    # Modules live as long as the process: passed over, the collection after a reload is short.
    gc.freeze()
    await Service(
        loaded.config,
        loaded.joints,
        notifier,
        load_again=lambda: load(path),
        sockets=sockets,
        state_directory=state_directory(loaded.config, os.environ),
        load_tls=lambda: _tls(loaded.config, path),
    ).run()


def _tls(config: DaemonConfig, path: Path) -> TlsSettings | None:
    credentials = os.environ.get("CREDENTIALS_DIRECTORY")
    return tls_settings(
        config.modbus, base=path.parent, credentials=Path(credentials) if credentials else None, source=str(path)
    )


def _check_config(options: argparse.Namespace) -> int:
    loaded = load(options.config)
    config, joints = loaded.config, loaded.joints
    if uses_credentials(config.modbus) and "CREDENTIALS_DIRECTORY" not in os.environ:
        _say(f"{visible(str(options.config))}: TLS keys come from systemd's credentials and are not checked here")
    else:
        _tls(config, options.config)
    _say(f"{visible(str(options.config))}: good; {len(config.buses)} bus(es), {len(joints)} joint(s)")
    for joint in joints:
        entry = joint.config
        about = f"bus {entry.bus}, node {entry.node_id}, {entry.model}"
        _say(f"  slot {entry.slot:2d} {entry.name}: {about}; {_model_line(joint.model.metadata)}")
    return 0


def _check_model(options: argparse.Namespace) -> int:
    model = load_model(options.model)
    metadata = model.metadata
    _say(f"{visible(str(options.model))}: good; {len(metadata.probes.angle_deg)} probes replayed")
    _say(f"  SHA-256      {model.sha256}")
    _say(f"  joint        {metadata.joint}")
    _say(f"  model        {_model_line(metadata)}")
    encoder = metadata.encoder
    if encoder is None:
        _say("  encoder      not stated: the daemon cannot tell it from another's")
    else:
        _say(f"  encoder      {encoder.counts_per_rev} counts, {encoder.lines_per_rev} lines per revolution")
    for name, value in metadata.encoder_settings.known().items():
        _say(f"               {name} {value}")
    calibration = metadata.calibration
    due = calibration.due or "no due date"
    _say(f"  calibration  {calibration.id}, {calibration.readings} readings, {calibration.date}, due: {due}")
    reference = metadata.reference
    uncertainty = reference.standard_uncertainty_arcsec
    stated = "not stated" if uncertainty is None else f"{uncertainty:g} arcsec (k = 1)"
    _say(f"  reference    {reference.kind}, standard uncertainty {stated}")
    for note in metadata.notes:
        _say(f"  note         {note}")
    return 0


def _model_line(metadata: ModelMetadata) -> str:
    angle, temperature = metadata.valid_angle_deg, metadata.valid_temperature_c
    return (
        f"{metadata.method}, {angle.minimum:g} to {angle.maximum:g} deg, "
        f"{temperature.minimum:g} to {temperature.maximum:g} degC"
    )


def _registers(options: argparse.Namespace) -> int:
    slots = list(range(1, 7))
    if options.config is not None:
        slots = sorted(joint.slot for joint in load_config(options.config).joints)
    _say(_RENDERERS[options.format](slots))
    return 0


def _metrics(_: argparse.Namespace) -> int:
    _say(render_metric_table())
    return 0


def _tell(trouble: str) -> None:
    """One line on stderr, whatever a file's name or content is made of."""
    print(f"trueangled: {visible(trouble)}", file=sys.stderr)


def _say(text: str) -> None:
    print(text)


if __name__ == "__main__":
    sys.exit(main())
