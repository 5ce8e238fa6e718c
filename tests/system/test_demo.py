"""The demo as a person starts it: every part in its own process, nothing left behind."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE_S = 240.0


def start_demo(out: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "trueangle.laboratory", "demo", "--out", str(out), *options]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def processes_of(out: Path) -> list[str]:
    """Command lines of processes that name the demo's folder."""
    lines: list[str] = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
            except OSError:
                continue  # it ended meanwhile
            if str(out) in line:
                lines.append(line)
    return lines


@pytest.mark.timeout(300)
def test_six_joints_are_corrected_to_an_arcsecond_and_nothing_is_torn_or_lost(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    with start_demo(out, "--duration", "4") as demo:
        output, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 0, output
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["joints"] == 6
    assert summary["raw_rms_arcsec"] > 30
    assert summary["corrected_rms_arcsec"] <= 1.0
    assert summary["torn_reads"] == 0
    assert summary["lost_frames"] == 0
    assert summary["frames"] > 6 * 100
    assert summary["reads"] > 100
    assert summary["datum_drift_arcsec"] > 0
    assert "raw RMS" in output
    assert processes_of(out) == []


@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_ends_all_that_it_started(tmp_path: Path, number: signal.Signals) -> None:
    out = tmp_path / "demo"
    wanted = "trueangled.log" if number is signal.SIGINT else "train-1.log"
    with start_demo(out, "--duration", "60") as demo:
        deadline_s = time.monotonic() + PATIENCE_S
        while not (out / "logs" / wanted).exists() and demo.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.1)
        assert len(processes_of(out)) > 1
        demo.send_signal(number)
        demo.communicate(timeout=30)
    assert demo.returncode == 130
    assert not (out / "summary.json").exists()
    assert processes_of(out) == []
