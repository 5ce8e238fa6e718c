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


def test_the_file_behind_a_link_is_written_and_the_link_kept(tmp_path: Path) -> None:
    (tmp_path / "archive").mkdir()
    target, link = tmp_path / "archive" / "model-7.onnx", tmp_path / "model.onnx"
    target.write_bytes(b"old")
    link.symlink_to("archive/model-7.onnx")
    files.write_whole(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert list(target.parent.iterdir()) == [target]
    assert sorted(tmp_path.iterdir()) == [target.parent, link]


def test_a_link_to_a_file_that_is_yet_to_be_makes_it(tmp_path: Path) -> None:
    link = tmp_path / "model.onnx"
    link.symlink_to(tmp_path / "later.onnx")
    files.write_whole(link, b"new")
    assert link.is_symlink()
    assert (tmp_path / "later.onnx").read_bytes() == b"new"


def test_a_link_that_leads_nowhere_is_named(tmp_path: Path) -> None:
    link, lost = tmp_path / "model.onnx", tmp_path / "lost.onnx"
    link.symlink_to(link)
    with pytest.raises(ContractError, match="a circle of links"):
        files.check_writable(link)
    lost.symlink_to(tmp_path / "nowhere" / "model.onnx")
    with pytest.raises(ContractError, match="no such directory") as caught:
        files.check_writable(lost)
    assert str(lost) in str(caught.value)
    assert str(tmp_path / "nowhere") in str(caught.value)


def test_a_write_protected_file_is_refused_and_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "model.onnx", tmp_path / "link.onnx"
    target.write_bytes(b"released")
    target.chmod(0o444)
    link.symlink_to(target)
    for path in (target, link):
        with pytest.raises(ContractError, match="found a write-protected file") as caught:
            files.write_whole(path, b"new")
        assert len(caught.value.faults) == 1
        assert str(path) in str(caught.value)
    assert target.read_bytes() == b"released"
    assert sorted(tmp_path.iterdir()) == [link, target]


def test_a_file_that_is_there_keeps_its_permissions(tmp_path: Path) -> None:
    target = tmp_path / "model.onnx"
    target.touch()
    target.chmod(0o640)
    files.write_whole(target, b"new")
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


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


def test_files_of_one_command_are_written_together_or_not_at_all(tmp_path: Path) -> None:
    kept, new = tmp_path / "model.onnx", tmp_path / "report.html"
    kept.write_bytes(b"old")
    with pytest.raises(ContractError, match="no such directory"):
        files.write_all([(kept, b"model"), (tmp_path / "nowhere" / "report.html", b"report")])
    assert kept.read_bytes() == b"old"
    files.write_all([(kept, b"model"), (new, b"report")])
    assert (kept.read_bytes(), new.read_bytes()) == (b"model", b"report")
    assert sorted(tmp_path.iterdir()) == [kept, new]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no file system that refuses new files")
def test_a_file_system_that_takes_no_files_is_named_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ContractError, match=r"/proc/report\.html"):
        files.check_writable(Path("/proc/report.html"))
    files.check_writable(tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_are_one_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    same, roundabout, link = tmp_path / "a", tmp_path / "sub" / ".." / "a", tmp_path / "link"
    link.symlink_to("a")
    for other in (same, roundabout, link):
        with pytest.raises(ContractError, match="--report: expected another file than --output"):
            files.check_distinct({"--output": same, "--report": other}, {})
    same.write_bytes(b"campaign")
    hard = tmp_path / "hard"
    hard.hardlink_to(same)
    with pytest.raises(ContractError, match=r"expected another file than CALIBRATION\.csv"):
        files.check_distinct({"--output": tmp_path / "b", "--report": hard}, {"CALIBRATION.csv": same})
    files.check_distinct({"--output": same, "--report": None}, {"--joint": tmp_path / "c", "--plan": None})
