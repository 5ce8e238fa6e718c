"""The notifications that systemd gets, as bytes on a real datagram socket."""

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from trueangle.edges.systemd import ServiceNotifier

UNIT = Path(__file__).parents[2] / "systemd" / "trueangled.service"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(tmp_path / "notify"))
    listener.settimeout(5)
    yield listener
    listener.close()


def test_each_message_is_one_datagram(manager: socket.socket) -> None:
    notifier = ServiceNotifier({"NOTIFY_SOCKET": manager.getsockname()})
    notifier.ready("6 of 6 joints valid")
    notifier.alive()
    notifier.status("5 of 6 joints valid")
    notifier.stopping()
    notifier.close()
    got = [manager.recv(1000).decode() for _ in range(4)]
    assert got == ["READY=1\nSTATUS=6 of 6 joints valid", "WATCHDOG=1", "STATUS=5 of 6 joints valid", "STOPPING=1"]


def test_an_abstract_socket_is_reached() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0trueangle-test-{os.getpid()}")
        listener.settimeout(5)
        notifier = ServiceNotifier({"NOTIFY_SOCKET": f"@trueangle-test-{os.getpid()}"})
        notifier.alive()
        assert listener.recv(100) == b"WATCHDOG=1"
        notifier.close()


def test_without_systemd_nothing_happens() -> None:
    notifier = ServiceNotifier({})
    notifier.ready("x")
    assert notifier.watchdog_interval_s is None
    notifier.close()


def test_a_manager_that_is_gone_does_not_stop_the_service(manager: socket.socket) -> None:
    notifier = ServiceNotifier({"NOTIFY_SOCKET": manager.getsockname()})
    manager.close()
    notifier.alive()
    notifier.close()


def test_the_watchdog_is_fed_three_times_in_its_time() -> None:
    assert ServiceNotifier({"WATCHDOG_USEC": "3000000"}).watchdog_interval_s == 1.0
    assert ServiceNotifier({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}).watchdog_interval_s is None
    assert ServiceNotifier({"WATCHDOG_USEC": "0"}).watchdog_interval_s is None
    assert ServiceNotifier({"WATCHDOG_USEC": "soon"}).watchdog_interval_s is None


def test_the_unit_is_notified_watched_and_not_restarted_on_bad_input() -> None:
    lines = UNIT.read_text("utf-8").splitlines()
    for line in ("Type=notify", "WatchdogSec=2", "DynamicUser=yes", "RestartPreventExitStatus=2"):
        assert line in lines


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_unit_is_sandboxed_to_an_exposure_of_at_most_1_5() -> None:
    command = ["systemd-analyze", "security", "--offline=yes", "--threshold=15", "--no-pager", str(UNIT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
