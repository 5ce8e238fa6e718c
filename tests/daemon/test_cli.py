"""The command `trueangled` as a process: exit codes, what stands on which stream, one line a fault."""

import csv
import io
import re
import shutil
import socket
import subprocess
from pathlib import Path

import pytest
from tests.fakes.running_service import MODELS, config_yaml, joint_yaml
from tests.fakes.trueangled_process import command, environment, trueangled

GOOD_JOINTS = joint_yaml(1, "base") + joint_yaml(4, "wrist", model="partial.onnx")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A directory with models and a good configuration, as on a controller."""
    for name in ("good", "partial", "probe-disagrees"):
        shutil.copy(MODELS / f"{name}.onnx", tmp_path)
    (tmp_path / "good.yaml").write_text(config_yaml(GOOD_JOINTS), "utf-8")
    return tmp_path


def faults(stderr: str) -> list[str]:
    """The lines of stderr: each a fault of trueangled, none a traceback."""
    lines = stderr.splitlines()
    assert all(line.startswith("trueangled: ") for line in lines), stderr
    return lines


def test_check_config_tells_joints_and_models_of_a_good_one(site: Path) -> None:
    done = trueangled("check-config", str(site / "good.yaml"))
    assert (done.returncode, done.stderr) == (0, "")
    first, base, wrist = done.stdout.splitlines()
    assert first.endswith("good.yaml: good; 1 bus(es), 2 joint(s)")
    assert "slot  1 base: bus arm, node 1, good.onnx" in base
    assert "slot  4 wrist" in wrist
    assert "0 to 180 deg" in wrist


def test_check_config_names_file_and_line_of_every_fault(site: Path) -> None:
    text = config_yaml(GOOD_JOINTS).replace("node_id: 1", "node_id: 128").replace("stale_ms", "stale_mm", 1)
    path = site / "bad.yaml"
    path.write_text(text, "utf-8")
    done = trueangled("check-config", str(path))
    assert (done.returncode, done.stdout) == (2, "")
    lines = faults(done.stderr)
    for wrong in ("node_id", "stale_mm"):
        number = next(n for n, line in enumerate(text.splitlines(), start=1) if wrong in line)
        assert any(f"{path} line {number}" in line and wrong in line for line in lines), lines


def test_check_config_says_which_model_is_missing_or_refused(site: Path) -> None:
    path = site / "bad.yaml"
    joints = joint_yaml(1, "base", model="nowhere.onnx") + joint_yaml(2, "elbow", model="probe-disagrees.onnx")
    path.write_text(config_yaml(joints), "utf-8")
    done = trueangled("check-config", str(path))
    assert (done.returncode, done.stdout) == (2, "")
    missing, refused = faults(done.stderr)
    assert "nowhere.onnx: expected a readable model file, found No such file or directory" in missing
    assert "probe-disagrees.onnx: expected probes that come out as they were written" in refused


@pytest.mark.parametrize("kind", ["absent", "directory", "binary", "empty", "syntax"])
def test_check_config_of_no_configuration_at_all_is_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "x.yaml"
    if kind == "directory":
        path.mkdir()
    elif kind != "absent":
        path.write_bytes({"binary": b"\xff\xfe\x00", "empty": b"", "syntax": b"a: [1,\nb: }"}[kind])
    done = trueangled("check-config", str(path))
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = faults(done.stderr)
    assert str(path) in line


def test_check_model_says_what_a_good_model_is(site: Path) -> None:
    done = trueangled("check-model", str(site / "good.onnx"))
    assert (done.returncode, done.stderr) == (0, "")
    for text in ("good.onnx: good; ", "probes replayed", "fe-gabpnn", "serial_number 4711", "due: 2027-11-22"):
        assert text in done.stdout


def test_check_model_refuses_a_damaged_and_a_disagreeing_file(site: Path) -> None:
    whole = (site / "good.onnx").read_bytes()
    (site / "damaged.onnx").write_bytes(whole[:4000])
    for name, expected in (
        ("damaged.onnx", "expected an ONNX model that ONNX Runtime can load"),
        ("probe-disagrees.onnx", "expected probes that come out as they were written, found probe 8"),
    ):
        done = trueangled("check-model", str(site / name))
        assert (done.returncode, done.stdout) == (2, "")
        (line,) = faults(done.stderr)
        assert name in line
        assert expected in line


def test_registers_tell_the_same_addresses_in_three_forms(site: Path) -> None:
    forms = {
        form: trueangled("registers", "--config", str(site / "good.yaml"), "--format", form)
        for form in ("text", "markdown", "csv")
    }
    assert all((done.returncode, done.stderr) == (0, "") for done in forms.values())
    rows = list(csv.reader(io.StringIO(forms["csv"].stdout)))
    assert len({len(row) for row in rows if row}) == 1
    for done in forms.values():
        # Slot 4: fast image from 10 + 3 * 12, detail block from 1300; slot 2 is in no table.
        for address in ("13", "49", "1012", "1312"):
            assert address in done.stdout
        assert "1112" not in done.stdout
    assert any(line.startswith("|") for line in forms["markdown"].stdout.splitlines())


def test_run_with_bad_input_never_touches_the_port(site: Path) -> None:
    """The port is taken: had the daemon tried to listen before it checked, the fault would be the port's."""
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = holder.getsockname()[1]
        bad = {
            "unknown key": config_yaml(GOOD_JOINTS, port=port) + "speed: 3\n",
            "refused model": config_yaml(joint_yaml(1, "base", model="probe-disagrees.onnx"), port=port),
            "other encoder": config_yaml(GOOD_JOINTS, port=port).replace("rev: 3276800", "rev: 65536", 1),
        }
        for about, text in bad.items():
            (site / "bad.yaml").write_text(text, "utf-8")
            done = trueangled("run", "--config", str(site / "bad.yaml"))
            assert (done.returncode, done.stdout) == (2, ""), about
            assert len(faults(done.stderr)) == 1, about
            assert "bind" not in done.stderr


def test_run_on_a_port_that_is_taken_says_so_and_exits_1(site: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = holder.getsockname()[1]
        (site / "taken.yaml").write_text(config_yaml(GOOD_JOINTS, port=port), "utf-8")
        done = trueangled("run", "--config", str(site / "taken.yaml"))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"trueangled: modbus listener: expected to bind 127.0.0.1:{port}, got ")


@pytest.mark.parametrize("arguments", [[], ["serve"], ["run"], ["registers", "--format", "xml"]])
def test_what_is_no_command_gets_the_usage_and_exit_2(arguments: list[str]) -> None:
    done = trueangled(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: trueangled")


COMMANDS = (
    *("run", "check-config", "check-model", "registers", "metrics"),
    *("scan", "commission", "verify", "monitor", "record"),
)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_every_command_says_what_it_does_and_ends_with_an_example(name: str) -> None:
    done = trueangled(name, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    usage, description, *_, last = done.stdout.strip().split("\n\n")
    assert usage.startswith(f"usage: trueangled {name}")
    assert len(description.split()) >= 5
    assert last.startswith("Example: trueangled " + name)


def test_the_version_is_told() -> None:
    done = trueangled("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"trueangled \S+\n", done.stdout)


def test_an_output_that_cannot_be_written_is_one_line_and_exit_1(site: Path) -> None:
    for arguments in (["registers"], ["check-config", str(site / "good.yaml")]):
        with Path("/dev/full").open("w") as full:
            done = subprocess.run(
                command(*arguments), stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment()
            )
        assert done.returncode == 1
        assert faults(done.stderr) == ["trueangled: standard output: No space left on device"]


def test_a_file_name_that_is_no_text_is_shown_by_its_bytes(site: Path) -> None:
    odd = site / "odd\udcff\n\x1b[31m.yaml"
    shutil.copy(site / "good.yaml", odd)
    done = trueangled("check-config", str(odd))
    assert (done.returncode, done.stderr) == (0, "")
    assert "\x1b" not in done.stdout
    assert len(done.stdout.splitlines()) == 3
    odd.unlink()
    (line,) = faults(trueangled("check-config", str(odd)).stderr)
    assert line.isprintable()
    assert line.endswith(": expected a readable file, found No such file or directory")
