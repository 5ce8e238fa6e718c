"""`trueangled` as a process of its own, found where this test run finds its packages."""

import subprocess
import sys


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "trueangle.cli", *arguments]


def environment() -> dict[str, str]:
    """Nothing but the import path: no NOTIFY_SOCKET, no home, no locale of the machine."""
    return {"PYTHONPATH": ":".join(entry for entry in sys.path if entry), "OMP_NUM_THREADS": "1"}


def trueangled(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, check=False, env=environment(), timeout=60
    )
