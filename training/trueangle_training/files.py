"""Files in one piece: a reader sees the old file or the new one, never half of one."""

import contextlib
import os
import secrets
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path

from trueangle.contract.errors import ContractError, Fault


def read_whole(path: Path) -> bytes:
    """The bytes of a file; ContractError naming it where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise ContractError([Fault(where=str(path), expected="a file that can be read", found=found)]) from error


def check_writable(path: Path) -> None:
    """ContractError where `write_whole` would surely fail: asked before hours of work, not after them."""
    destination = _destination(path)
    temporary = _temporary(destination)
    try:
        # Some file systems (/proc, a full or read-only disk) tell only one who tries.
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        temporary.unlink()
    except OSError as error:
        raise _not_written(path, error) from error


def check_distinct(outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None]) -> None:
    """ContractError where two outputs are one file, or an output is an input: one would be lost by the other.

    The names say where each path was given; None: not given.
    """
    faults: list[Fault] = []
    before = {name: path for name, path in inputs.items() if path is not None}
    for name, path in outputs.items():
        if path is None:
            continue
        faults += [
            Fault(where=name, expected=f"another file than {other}", found=str(path))
            for other, taken in before.items()
            if _same_file(path, taken)
        ]
        before[name] = path
    if faults:
        raise ContractError(faults)


def _same_file(one: Path, other: Path) -> bool:
    """By name behind all links, and by the file itself where both are there: hard links, foreign file systems."""
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    return one.exists() and other.exists() and one.samefile(other)


def write_whole(path: Path, data: bytes) -> None:
    """`write_all` of one file."""
    write_all([(path, data)])


def write_all(files: Sequence[tuple[Path, bytes]]) -> None:
    """Write each under a temporary name beside its path, force it to the disk, then take all names over.

    A symbolic link stays one: the file that it leads to is written in this way. A file that was there keeps its
    permissions, and is refused where they do not allow writing: a model under 0444 is one that somebody released.
    No name is taken over before all data are on the disk, so that on nearly any failure, an interrupt included,
    all paths are as they were and nothing is left behind.
    """
    staged: list[tuple[Path, Path, Path]] = []
    path = Path()
    try:
        try:
            for path, data in files:
                destination = _destination(path)
                staged.append((path, _temporary(destination), destination))
                _write_forced(staged[-1][1], data, like=destination)
            for path, temporary, destination in staged:  # noqa: B007 - the failing one is named below
                temporary.replace(destination)
        except BaseException:
            for _, temporary, _ in staged:
                with contextlib.suppress(OSError):
                    temporary.unlink()
            raise
        for path, _, destination in staged:  # noqa: B007 - the failing one is named below
            _force_directory(destination.parent)
    except OSError as error:
        raise _not_written(path, error) from error


def _temporary(destination: Path) -> Path:
    return destination.with_name(f".{destination.name}.{secrets.token_hex(4)}.part")


def _not_written(path: Path, error: OSError) -> ContractError:
    found = error.strerror or type(error).__name__
    return ContractError([Fault(where=str(path), expected="a file that can be written", found=found)])


def _destination(path: Path) -> Path:
    """The file that `path` names, behind all symbolic links; ContractError where it cannot be written."""
    destination = Path(os.path.realpath(path)) if path.is_symlink() else path
    if destination.is_symlink():
        # realpath gives a circle up where it closes.
        raise ContractError([Fault(where=str(path), expected="a file's name", found="a circle of links")])
    directory = destination.parent
    if not directory.is_dir():
        found = "no such directory" if not directory.exists() else "something that is no directory"
        raise ContractError([Fault(where=str(path), expected=f"the directory {directory}", found=found)])
    if destination.exists() and not destination.is_file():
        # os.replace would put a file in the place of a device such as /dev/stdout.
        found = "a directory" if destination.is_dir() else "a device or pipe"
        raise ContractError([Fault(where=str(path), expected="a file's name", found=found)])
    if not os.access(directory, os.W_OK | os.X_OK):
        found = "no permission"
        expected = f"permission to write in {directory}"
        raise ContractError([Fault(where=str(path), expected=expected, found=found)])
    if destination.exists() and _write_protected(destination):
        expected, found = "a file that may be written, or a new one", "a write-protected file"
        advice = "choose another name, or take the protection off (chmod u+w)"
        raise ContractError([Fault(where=str(path), expected=expected, found=found, advice=advice)])
    return destination


def _write_protected(path: Path) -> bool:
    """Whether this user may not write it; a file that nobody may write is protected from root as well."""
    anybody = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
    return not path.stat().st_mode & anybody or not os.access(path, os.W_OK)


def _write_forced(path: Path, data: bytes, *, like: Path) -> None:
    """A new file with the permissions of `like`, where that is there."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(descriptor, "wb") as out:
        if like.exists():
            os.fchmod(out.fileno(), stat.S_IMODE(like.stat().st_mode) & 0o777)
        out.write(data)
        out.flush()
        os.fsync(out.fileno())


def _force_directory(directory: Path) -> None:
    """Without this the new name may be lost in a power cut although the data are on the disk (fsync(2))."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
