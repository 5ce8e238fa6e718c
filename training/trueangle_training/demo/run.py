"""The main job on real input, every part in its own process, judged against the truth.

simulate -> train -> nodes on a bus -> `trueangled run` -> Modbus client -> comparison -> summary.

The bus is a socketcand served by the process of the nodes: python-can speaks it, it needs no kernel module, no
root and no multicast route, TCP on loopback keeps order and loses nothing, and it is a bus that exists in the
field (the same daemon configuration reaches a remote CAN adapter). slcan over a pty would put a serial line's
text parser and its unbounded buffers in between, and a remote-bus plug-in would be one more library to trust.
"""

import contextlib
import json
import re
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from trueangle.contract.errors import ContractError, Fault, TrueangleError
from trueangle.contract.joint import Joint, Plan
from trueangle_training.demo.joints import JOINTS, NAMES, demo_joint, example_path, live_joint
from trueangle_training.demo.judge import JointJudge, rms
from trueangle_training.demo.plc import Plc, parse_table
from trueangle_training.demo.processes import Child, ChildError, run_all
from trueangle_training.demo.screen import Screen, live_table
from trueangle_training.documents import dump_joint, load_plan
from trueangle_training.files import write_whole

SLOTS = tuple(range(1, JOINTS + 1))
HOST = "127.0.0.1"
READ_INTERVAL_S = 0.02
DRAW_INTERVAL_S = 0.2
START_TIMEOUT_S = 30.0
GOAL_ARCSEC = 1.0
"""RMS of the corrected angle that the demo has to reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """What a person may choose."""

    out: Path
    duration_s: float
    rate_hz: float
    can: str | None
    """Name of a SocketCAN interface; None: a socketcand on loopback."""


@dataclass(slots=True)
class Observation:
    """What the PLC saw."""

    judges: list[JointJudge]
    torn_reads: int = 0
    frames: dict[int, int] | None = None
    lost: dict[int, int] | None = None


def run_demo(options: DemoOptions, console: Console) -> int:
    """The whole demo; exit code 0 when every promise was kept."""
    started_s = time.monotonic()
    logs = options.out / "logs"
    try:
        logs.mkdir(parents=True, exist_ok=True)
        (options.out / "summary.json").unlink(missing_ok=True)
    except OSError as error:
        found = error.strerror or str(error)
        raise ContractError(
            [Fault(where=f"--out {options.out}", expected="a folder to write to", found=found)]
        ) from error
    if options.can is not None and not Path("/sys/class/net", options.can).exists():
        fault = Fault(where="--can", expected="a CAN interface of this machine", found=options.can)
        raise ContractError([fault])
    joints = [demo_joint(number) for number in SLOTS]
    plan = load_plan(example_path("plan.yaml"))
    with _terminate_as_interrupt():
        _make_models(options.out, joints, console)
        _write_daemon_config(options, joints, port=None)
        table = parse_table(_registers(options.out))
        trained_s = time.monotonic() - started_s
        with Child("the encoder nodes", _nodes_command(options), logs / "nodes.log") as nodes:
            address = nodes.wait_for_line("listening", START_TIMEOUT_S).split()[-1]
            _write_daemon_config(options, joints, port=address)
            with Child("trueangled", _daemon_command(options.out), logs / "trueangled.log") as daemon:
                line = daemon.wait_for_line("modbus_listening", START_TIMEOUT_S)
                plc = Plc(HOST, _port_in(line), table, SLOTS)
                try:
                    seen = _observe(options, joints, plc, (nodes, daemon), console)
                    summary = _summary(seen, plc, plan)
                finally:
                    plc.close()
    summary["seconds"] = {"prepare": round(trained_s, 1), "all": round(time.monotonic() - started_s, 1)}
    summary["rate_hz"], summary["duration_s"] = options.rate_hz, options.duration_s
    write_whole(options.out / "summary.json", (json.dumps(summary, indent=1) + "\n").encode())
    return _conclude(options, seen, summary, console)


def _port_in(line: str) -> int:
    """The port in the daemon's log line `event=modbus_listening host=... port=...`."""
    found = re.search(r"\bport=(\d+)", line)
    if found is None:
        raise ChildError(f"no port in the daemon's line: {line}")
    return int(found[1])


@contextlib.contextmanager
def _terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM ends the demo as Ctrl-C does: the children are stopped on the way out."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _make_models(out: Path, joints: Sequence[Joint], console: Console) -> None:
    """Campaigns and models of all joints by the same commands that a person types."""
    trueangle = [_script("trueangle")]
    simulations: list[tuple[str, list[str], Path]] = []
    trainings: list[tuple[str, list[str], Path]] = []
    for number, joint in zip(SLOTS, joints, strict=True):
        stem = out / f"joint-{number}"
        write_whole(stem.with_suffix(".yaml"), dump_joint(joint).encode())
        files = [str(stem.with_suffix(suffix)) for suffix in (".yaml", ".csv", ".onnx")]
        plan = str(example_path("plan.yaml"))
        simulate = ["simulate", "--joint", files[0], "--plan", plan, "--seed", str(number), "-o", files[1]]
        train = [
            "train",
            files[1],
            "--joint",
            files[0],
            "-o",
            files[2],
            "--seed",
            str(number),
            "--held-out",
            "none",
        ]
        logs = out / "logs"
        simulations.append((f"simulating {joint.name}", trueangle + simulate, logs / f"simulate-{number}.log"))
        trainings.append((f"training {joint.name}", trueangle + train, logs / f"train-{number}.log"))
    for title, commands in (
        (f"six calibration campaigns of 483 readings: {out}/joint-*.csv", simulations),
        (f"six FE-GABPNN models: {out}/joint-*.onnx", trainings),
    ):
        with console.status(f"{title}, 0 of {JOINTS}") as status:
            run_all(
                commands,
                at_once=2,
                on_done=lambda done, title=title, status=status: status.update(f"{title}, {done} of {JOINTS}"),
            )
        console.print(title)


def _script(name: str) -> str:
    """A command of this installation."""
    return str(Path(sysconfig.get_path("scripts")) / name)


def _registers(out: Path) -> str:
    command = [_script("trueangled"), "registers", "--config", str(out / "trueangled.yaml"), "--format", "csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own command
    if done.returncode != 0:
        raise ChildError(f"trueangled registers ended with code {done.returncode}:\n{done.stderr}")
    write_whole(out / "registers.csv", done.stdout.encode())
    return done.stdout


def _nodes_command(options: DemoOptions) -> list[str]:
    command = [sys.executable, "-m", "trueangle_training.demo.nodes", str(options.out)]
    command += ["--rate", f"{options.rate_hz:g}"]
    return command + (["--can", options.can] if options.can else [])


def _daemon_command(out: Path) -> list[str]:
    return [_script("trueangled"), "run", "--config", str(out / "trueangled.yaml")]


def _write_daemon_config(options: DemoOptions, joints: Sequence[Joint], *, port: str | None) -> None:
    """The daemon's own YAML file, as a commissioning engineer would write it."""
    bus: dict[str, Any] = {"name": "arm", "sync_period_ms": 1000.0 / options.rate_hz}
    if options.can:
        bus |= {"interface": "socketcan", "channel": options.can}
    else:
        tcp_port = int(port.rsplit(":", 1)[1]) if port else 0
        bus |= {"interface": "socketcand", "channel": "can0", "options": {"host": HOST, "port": tcp_port}}
    entries = [
        {
            "slot": slot,
            "name": joint.name,
            "bus": "arm",
            "node_id": slot,
            "model": f"joint-{slot}.onnx",
            "encoder": {"counts_per_rev": joint.encoder.counts_per_rev},
            "temperature": {"index": 0x7130, "subindex": 1, "degc_per_unit": 0.01, "every_syncs": 10},
            "sequence": {"index": 0x2100, "subindex": 0},
        }
        for slot, joint in zip(SLOTS, joints, strict=True)
    ]
    config = {
        "schema_version": 1,
        "modbus": {"host": HOST, "port": 0},
        "buses": [bus],
        "joints": entries,
    }
    text = yaml.safe_dump(config, sort_keys=False)
    write_whole(options.out / "trueangled.yaml", text.encode())


def _observe(
    options: DemoOptions, joints: Sequence[Joint], plc: Plc, children: Sequence[Child], console: Console
) -> Observation:
    """Read for the chosen time, as fast as a busy PLC would, and judge every answer."""
    period_s = 1.0 / options.rate_hz
    judges = [
        JointJudge(name=NAMES[slot - 1], live=live_joint(joint, slot, period_s))
        for slot, joint in zip(SLOTS, joints, strict=True)
    ]
    seen = Observation(judges=judges)
    if not plc.connect():
        raise TrueangleError(f"no Modbus server answers on {HOST}")
    _wait_until_valid(plc, judges, children)
    started_s = next_read_s = time.monotonic()
    drawn_s = 0.0
    with Screen(console, options.duration_s) as screen:
        while (elapsed_s := time.monotonic() - started_s) < options.duration_s:
            seen.torn_reads += _read_once(plc, judges, seen)
            if elapsed_s - drawn_s >= DRAW_INTERVAL_S:
                drawn_s = elapsed_s
                screen.show(judges, elapsed_s)
                for child in children:
                    if child.finished():
                        raise ChildError(f"{child.name} ended by itself:\n{child.tail()}")
            next_read_s = max(next_read_s + READ_INTERVAL_S, time.monotonic() - READ_INTERVAL_S)
            time.sleep(max(0.0, next_read_s - time.monotonic()))
    return seen


def _read_once(plc: Plc, judges: Sequence[JointJudge], seen: Observation) -> int:
    """The fast image and every joint's detail block; the number of torn answers."""
    image = plc.fast()
    for judge, reading in zip(judges, image.readings, strict=True):
        judge.take(reading)
    details = [plc.detail(slot) for slot in SLOTS]
    seen.frames = {detail.slot: detail.frames_received for detail in details}
    seen.lost = {detail.slot: detail.frames_lost for detail in details}
    return int(image.torn) + sum(detail.torn for detail in details)


def _wait_until_valid(plc: Plc, judges: Sequence[JointJudge], children: Sequence[Child]) -> None:
    deadline_s = time.monotonic() + START_TIMEOUT_S
    while True:
        image = plc.fast()
        silent = [judges[i].name for i, reading in enumerate(image.readings) if not reading.valid]
        if not silent:
            return
        if time.monotonic() > deadline_s:
            lines = "\n".join(child.tail() for child in children)
            raise TrueangleError(f"no valid angle from {', '.join(silent)} within {START_TIMEOUT_S:g} s:\n{lines}")
        time.sleep(0.05)


def _summary(seen: Observation, plc: Plc, plan: Plan) -> dict[str, Any]:
    judges = seen.judges
    drifts = [judge.datum_drift_arcsec(plan.temperatures_c) for judge in judges]
    return {
        "joints": len(judges),
        "raw_rms_arcsec": rms([e for judge in judges for e in judge.raw_arcsec]),
        "corrected_rms_arcsec": rms([e for judge in judges for e in judge.corrected_arcsec]),
        "datum_drift_arcsec": rms(drifts),
        "reads": plc.reads,
        "torn_reads": seen.torn_reads,
        "frames": sum((seen.frames or {}).values()),
        "lost_frames": sum((seen.lost or {}).values()),
        "not_valid_reads": sum(judge.not_valid for judge in judges),
        "per_joint": [
            {
                "name": judge.name,
                "samples": len(judge.raw_arcsec),
                "raw_rms_arcsec": rms(judge.raw_arcsec),
                "corrected_rms_arcsec": rms(judge.corrected_arcsec),
                "corrected_max_arcsec": max((abs(e) for e in judge.corrected_arcsec), default=0.0),
                "datum_drift_arcsec": drift,
            }
            for judge, drift in zip(judges, drifts, strict=True)
        ],
    }


def _conclude(options: DemoOptions, seen: Observation, summary: dict[str, Any], console: Console) -> int:
    if not console.is_terminal:
        console.print(live_table(seen.judges, options.duration_s, options.duration_s))
    raw, corrected, drift = (
        summary[key] for key in ("raw_rms_arcsec", "corrected_rms_arcsec", "datum_drift_arcsec")
    )
    console.print(f"raw RMS {raw:.2f} arcsec -> corrected RMS {corrected:.2f} arcsec, from each joint's datum")
    console.print(
        f"drift of the datum itself, which no campaign zeroed at its first face can see: {drift:.2f} arcsec"
    )
    console.print(
        f"{summary['reads']} Modbus reads, {summary['torn_reads']} torn; "
        f"{summary['frames']} position frames, {summary['lost_frames']} lost; {summary['seconds']['all']} s in all"
    )
    broken = [
        f"{what} {found:g}, expected {expected}"
        for what, found, expected, kept in (
            ("corrected RMS", corrected, f"at most {GOAL_ARCSEC:g} arcsec", corrected <= GOAL_ARCSEC),
            ("torn reads", summary["torn_reads"], "0", summary["torn_reads"] == 0),
            ("lost frames", summary["lost_frames"], "0", summary["lost_frames"] == 0),
            ("frames", summary["frames"], "more than 0", summary["frames"] > 0),
        )
        if not kept
    ]
    for line in broken:
        console.print(f"promise broken: {line}", style="bold red")
    console.print(f"summary: {options.out / 'summary.json'}; logs: {options.out / 'logs'}")
    return 1 if broken else 0
