"""Whole files or none."""

import os
import stat
from pathlib import Path

import pytest

from trueangle.contract.errors import ContractError
from trueangle_training import files


def test_data_arrive_whole_and_alone(tmp_path: Path) -> None:
    target = tmp_path / "model.onnx"
    files.write_whole(target, b"first")
    files.write_whole(target, b"second, longer")
    assert target.read_bytes() == b"second, longer"
    assert list(tmp_path.iterdir()) == [target]


def test_permissions_follow_the_umask_like_any_new_file(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    written = tmp_path / "written"
    files.write_whole(written, b"")
    assert stat.S_IMODE(written.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_half_way_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    target = tmp_path / "model.onnx"
    target.write_bytes(b"old")

    def full_disk(descriptor: int) -> None:
        raise failure

    monkeypatch.setattr(os, "fsync", full_disk)
    expected = KeyboardInterrupt if isinstance(failure, KeyboardInterrupt) else ContractError
    with pytest.raises(expected):
        files.write_whole(target, b"new")
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_missing_directory_is_named(tmp_path: Path) -> None:
    target = tmp_path / "nowhere" / "model.onnx"
    with pytest.raises(ContractError, match="no such directory") as caught:
        files.write_whole(target, b"")
    assert str(target) in str(caught.value)


def test_a_file_in_the_place_of_the_directory_is_named(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with pytest.raises(ContractError, match="no directory"):
        files.write_whole(tmp_path / "plain" / "model.onnx", b"")


def test_a_device_or_directory_is_never_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(ContractError, match="device or pipe"):
        files.write_whole(pipe, b"")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    with pytest.raises(ContractError, match="found a directory"):
        files.write_whole(tmp_path, b"")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_missing_permission_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(ContractError, match="no permission"):
            files.write_whole(tmp_path / "model.onnx", b"")
    finally:
        tmp_path.chmod(0o700)


def test_an_unreadable_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ContractError, match="No such file"):
        files.read_whole(tmp_path / "missing.yaml")
