"""Rules about imports that only a running interpreter can hold."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAVY = ("trueangle_training", "torch", "scipy", "onnx", "matplotlib", "rich")
PURE = ("can", "canopen", "pymodbus", "onnxruntime", "yaml", "asyncio", "socket")


def imported(statement: str, names: tuple[str, ...]) -> list[str]:
    """Which of the packages a fresh interpreter holds after the statement."""
    code = f"import sys; {statement}; print(*[n for n in {names!r} if n in sys.modules])"
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'daemon'}{os.pathsep}{ROOT / 'training'}"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    return done.stdout.split()


def test_the_daemon_draws_in_nothing_of_the_laboratory() -> None:
    assert imported("import trueangle.cli", HEAVY) == []


def test_the_contract_is_numpy_and_the_standard_library() -> None:
    modules = "calibration, document, encoder, errors, joint, metadata, number_table, units"
    assert imported(f"from trueangle.contract import {modules}", PURE) == []


def test_the_core_needs_no_library_no_loop_and_no_socket() -> None:
    modules = (
        "bus, correction, frames, health, modbus_answer, node_setup, pipeline, register_table, registers, sample, "
        "bus_survey, commissioning, lss, modbus_request, monitor_view, recording, register_reading, sdo_frames, "
        "verification"
    )
    assert imported(f"from trueangle.core import {modules}", PURE) == []


def test_the_linear_tools_start_without_torch() -> None:
    assert imported("import trueangle_training.cli", ("torch", "onnx", "matplotlib")) == []


def test_every_package_module_opens_with_a_docstring() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for package in ("daemon/trueangle", "training/trueangle_training")
        for path in (ROOT / package).rglob("*.py")
        if not path.read_text("utf-8").lstrip().startswith('"""')
    ]
    assert silent == []


DATED = {
    "commands/commission.py": 1,
    "commands/monitor.py": 2,
    "commands/record.py": 1,
    "edges/can_bus/socketcan.py": 2,
    "edges/recorder.py": 1,
    "service/running.py": 2,
}
"""How often a file reads the wall clock: to write a date for people, to see whether a calibration is past due; in
`socketcan.py` to read the kernel's stamps, which are its own, and to notice that it was set meanwhile."""


def test_nothing_but_dates_is_read_from_a_clock_that_may_be_set_back() -> None:
    daemon = ROOT / "daemon" / "trueangle"
    wall = re.compile(r"\btime\.time(?:_ns)?\(|\.(?:now|today|utcnow|localtime)\(|CLOCK_REALTIME")
    reads = {
        str(path.relative_to(daemon)): len(wall.findall(path.read_text("utf-8"))) for path in daemon.rglob("*.py")
    }
    assert {path: count for path, count in reads.items() if count} == DATED
