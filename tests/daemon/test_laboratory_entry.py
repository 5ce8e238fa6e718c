"""The command `trueangle` on an install with and without the laboratory."""

import subprocess
import sys

import pytest

from trueangle import laboratory


def test_without_the_extra_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(laboratory, "LIBRARIES", ("numpy", "no_such_library_of_the_extra"))
    assert laboratory.main(["train"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("trueangle: ")
    assert "no_such_library_of_the_extra missing" in captured.err
    assert "numpy" not in captured.err
    assert "pip install 'trueangle[training]'" in captured.err


def test_a_controller_without_torch_is_told_so_by_a_fresh_interpreter() -> None:
    # torch is hidden where the entry point looks for it, as on an install without the extra.
    program = """
import importlib.util
import sys
real = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name == "torch" else real(name)
from trueangle.laboratory import main
code = main(["simulate"])
assert not {"torch", "onnx", "trueangle_training"} & set(sys.modules), "the check must not import"
sys.exit(code)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": ":".join(entry for entry in sys.path if entry)},
        timeout=60,
    )
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "torch missing" in done.stderr


def test_importing_the_entry_point_draws_in_no_laboratory() -> None:
    program = "import sys, trueangle.laboratory; print({'torch', 'onnx', 'trueangle_training'} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": ":".join(entry for entry in sys.path if entry)},
        timeout=60,
    )
    assert done.stdout.strip() == "set()"


def test_what_is_present_is_not_reported_missing() -> None:
    assert laboratory.missing_libraries(("numpy", "json")) == []
