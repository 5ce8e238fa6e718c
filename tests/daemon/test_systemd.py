"""The notifications that systemd gets, as bytes on a real datagram socket."""

import logging
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from trueangle.edges.journal import LogFormatter
from trueangle.edges.modbus_server.server import PLAIN_SOCKET, TLS_SOCKET
from trueangle.edges.systemd import ServiceNotifier, handed_over_sockets, is_journal

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNIT = SYSTEMD / "trueangled.service"
DROP_INS = SYSTEMD / "trueangled.service.d"


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


def test_the_unit_is_notified_watched_reloaded_and_not_restarted_on_bad_input() -> None:
    lines = UNIT.read_text("utf-8").splitlines()
    for line in (
        "Type=notify",
        "WatchdogSec=2",
        "DynamicUser=yes",
        "ExecReload=/bin/kill -HUP $MAINPID",
        "RestartPreventExitStatus=2",
    ):
        assert line in lines


def numbers_of(unit: Path) -> dict[str, float]:
    pairs = (line.split("=", 1) for line in unit.read_text("utf-8").splitlines() if "=" in line)
    return {key: float(value) for key, value in pairs if value.replace(".", "").isdigit()}


def test_a_service_that_fails_again_and_again_is_started_for_ever() -> None:
    """systemd gives up on a unit that was started StartLimitBurst times within StartLimitIntervalSec. A port that
    is taken for a minute must not leave an arm without a service that nobody starts again."""
    told = numbers_of(UNIT)
    assert told["RestartSec"] * told["StartLimitBurst"] >= told["StartLimitIntervalSec"]
    # But a PLC that knocks at the socket of a service with a bad configuration does not start it without end.
    assert told["StartLimitIntervalSec"] > 0


def test_the_directory_of_recordings_in_the_example_is_made_by_the_unit() -> None:
    """As DynamicUser the service can make none beside its state directory, and root's it could not write to."""
    line = next(line for line in UNIT.read_text("utf-8").splitlines() if line.startswith("StateDirectory="))
    made = {f"/var/lib/{name}" for name in line.removeprefix("StateDirectory=").split()}
    example = (SYSTEMD.parent / "deploy" / "trueangled.yaml").read_text("utf-8")
    wanted = set(re.findall(r"irectory: (/var/lib/\S+)", example))
    assert wanted == {"/var/lib/trueangle", "/var/lib/trueangle/records"}
    assert wanted <= made


@pytest.mark.parametrize(
    ("unit", "name"), [("trueangled.socket", "modbus"), ("trueangled-tls.socket", "modbus-tls")]
)
def test_the_socket_units_hand_over_by_the_names_that_the_server_knows(unit: str, name: str) -> None:
    assert name in (PLAIN_SOCKET, TLS_SOCKET)
    lines = (SYSTEMD / unit).read_text("utf-8").splitlines()
    assert f"FileDescriptorName={name}" in lines
    assert "Service=trueangled.service" in lines


SECURITY = ["systemd-analyze", "security", "--offline=yes", "--no-pager"]
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
)


@needs_systemd
@pytest.mark.parametrize(
    ("drop_in", "limit"), [(None, 15), ("rtu.conf", 22), ("realtime.conf", 22), ("tls.conf", 15)]
)
def test_the_unit_is_sandboxed_to_the_promised_exposure(tmp_path: Path, drop_in: str | None, limit: int) -> None:
    """Exposure x 10; systemd reads a drop-in only where a unit of its own name has it beside it."""
    unit = tmp_path / "trueangled.service"
    shutil.copy(UNIT, unit)
    if drop_in is not None:
        # Offline, systemd-analyze reads the unit file alone: later lines of a section win, as with a drop-in.
        unit.write_text(UNIT.read_text("utf-8") + (DROP_INS / drop_in).read_text("utf-8"), "utf-8")
    command = [*SECURITY, f"--threshold={limit}", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr


@needs_systemd
def test_systemd_finds_no_fault_in_the_units(tmp_path: Path) -> None:
    """The program and the interface it names are not on this machine; nothing else may be said."""
    units = sorted(SYSTEMD.glob("*.service")) + sorted(SYSTEMD.glob("*.socket"))
    for unit in units:
        text = unit.read_text("utf-8").replace("/opt/trueangle/bin/trueangled", "/bin/true")
        (tmp_path / unit.name).write_text(text.replace("/usr/sbin/ip", "/bin/true"), "utf-8")
    environment = {"SYSTEMD_UNIT_PATH": f"{tmp_path}:", "PATH": "/usr/bin:/bin"}
    for unit in units:
        name = unit.name.replace("@.", "@can0.")
        path = tmp_path / name
        if path.name != unit.name:
            shutil.copy(tmp_path / unit.name, path)
        done = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(path)],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )
        said = [line for line in done.stderr.splitlines() if "trueangle" in line or name in line]
        assert said == []


# Sockets of socket units


def in_child(code: str, *, names: str, pid: str = "os.getpid()", count: int | None = None) -> str:
    """Run `code` in a process with these sockets from descriptor 3 on, as systemd starts it; its stdout."""
    with socket.create_server(("127.0.0.1", 0)) as first, socket.create_server(("127.0.0.1", 0)) as second:
        handed = [first.fileno(), second.fileno()]
        script = (
            "import os, socket, sys\n"
            f"kept = [os.dup(fd) for fd in {handed}]\n"
            "for place, fd in enumerate(kept): os.dup2(fd, 3 + place)\n"
            "from trueangle.edges.systemd import handed_over_sockets\n"
            f"told = {{'LISTEN_PID': str({pid}), 'LISTEN_FDS': '{2 if count is None else count}',"
            f" 'LISTEN_FDNAMES': '{names}', 'HOME': '/'}}\n"
            "found = handed_over_sockets(told)\n" + code
        )
        done = subprocess.run(
            [sys.executable, "-c", script],
            capture_output=True,
            text=True,
            check=False,
            pass_fds=handed,
            env={"PYTHONPATH": ":".join(entry for entry in sys.path if entry)},
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
        ports = {first.getsockname()[1]: "FIRST", second.getsockname()[1]: "SECOND"}
        text = done.stdout
        for port, name in ports.items():
            text = text.replace(str(port), name)
        return text


SHOW = "print({name: one.getsockname()[1] for name, one in found.items()}, sorted(told))"


def test_sockets_are_taken_by_name_and_the_variables_are_taken_away() -> None:
    told = in_child(SHOW, names="modbus:modbus-tls")
    assert told.strip() == "{'modbus': FIRST, 'modbus-tls': SECOND} ['HOME']"


def test_sockets_that_are_meant_for_another_process_are_left_alone() -> None:
    assert in_child(SHOW, names="modbus:modbus-tls", pid="1").strip() == "{} ['HOME']"


def test_of_two_sockets_of_one_name_the_first_is_taken_and_the_second_closed() -> None:
    """A unit with two ListenStream= gives both one name; a client of a socket left open would wait for ever."""
    code = SHOW + "\ntry:\n    os.fstat(4)\nexcept OSError:\n    print('closed')"
    assert in_child(code, names="modbus:modbus").split("\n")[:2] == ["{'modbus': FIRST} ['HOME']", "closed"]


def test_what_is_no_socket_is_passed_over() -> None:
    """More told than handed over, and a file in between."""
    plant = (
        "os.dup2(os.open('/dev/null', os.O_RDONLY), 4)\n"
        "told = {'LISTEN_PID': str(os.getpid()), 'LISTEN_FDS': '9', 'LISTEN_FDNAMES': 'modbus:x'}\n"
        "found = handed_over_sockets(told)\n"
    )
    assert in_child(plant + SHOW, names="", pid="1").strip() == "{'modbus': FIRST} []"


@pytest.mark.parametrize("count", ["", "two", "-1", "1.5", "0"])
def test_a_count_that_is_none_gives_no_sockets(count: str) -> None:
    told = {"LISTEN_PID": str(os.getpid()), "LISTEN_FDS": count, "LISTEN_FDNAMES": "modbus"}
    assert handed_over_sockets(told) == {}


# The journal


def record(text: str, level: int = logging.WARNING, *arguments: object) -> logging.LogRecord:
    return logging.LogRecord("trueangle", level, __file__, 1, text, arguments, None)


@pytest.mark.parametrize(
    ("level", "start"),
    [(logging.DEBUG, "<7>"), (logging.INFO, "<6>"), (logging.WARNING, "<4>"), (logging.ERROR, "<3>")],
)
def test_the_journal_reads_the_priority_from_the_line(level: int, start: str) -> None:
    assert LogFormatter(journal=True).format(record("event=x", level)) == f"{start}event=x"


def test_people_read_the_level_as_a_word() -> None:
    assert LogFormatter(journal=False).format(record("event=%s", logging.INFO, "x")) == "INFO event=x"


def test_what_a_file_says_can_neither_end_the_line_nor_steer_the_terminal() -> None:
    """A forged line with a priority of its own would be a line of ours."""
    line = LogFormatter(journal=True).format(record("reason=%s", logging.INFO, "a\n<0>event=forged\x1b[2J\r"))
    assert line == "<6>reason=a\\n<0>event=forged\\x1b[2J\\r"


def test_each_line_of_a_traceback_has_the_priority() -> None:
    made = record("event=failed", logging.ERROR)
    try:
        int("planted")
    except ValueError:
        made.exc_info = sys.exc_info()
    lines = LogFormatter(journal=True).format(made).splitlines()
    assert len(lines) >= 3
    assert all(line.startswith("<3>") for line in lines)


def test_stderr_is_the_journal_exactly_where_device_and_inode_are_told(tmp_path: Path) -> None:
    with (tmp_path / "stream").open("w") as stream:
        status = os.fstat(stream.fileno())
        told = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        assert is_journal(told, stream.fileno())
        assert not is_journal({"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + 1}"}, stream.fileno())
        assert not is_journal({}, stream.fileno())


def test_a_status_of_several_lines_is_one_message(manager: socket.socket) -> None:
    """Else a fault text of a configuration file could say READY, or stop the watchdog."""
    notifier = ServiceNotifier({"NOTIFY_SOCKET": manager.getsockname()})
    notifier.status("refused: a\nWATCHDOG=trigger\n" + "x" * 5000)
    notifier.reloading(12_345)
    notifier.close()
    told = manager.recv(10_000).decode()
    assert told.startswith("STATUS=refused: a WATCHDOG=trigger xxx")
    assert "\n" not in told
    assert len(told) < 1100
    assert manager.recv(1000).decode() == "RELOADING=1\nMONOTONIC_USEC=12345"
