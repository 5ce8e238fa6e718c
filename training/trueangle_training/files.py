"""Files in one piece: a reader sees the old file or the new one, never half of one."""

import contextlib
import os
import secrets
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
    directory = path.parent
    if not directory.is_dir():
        found = "no such directory" if not directory.exists() else "something that is no directory"
        raise ContractError([Fault(where=str(path), expected=f"the directory {directory}", found=found)])
    if path.exists() and not path.is_file():
        # os.replace would put a file in the place of a device such as /dev/stdout.
        found = "a directory" if path.is_dir() else "a device or pipe"
        raise ContractError([Fault(where=str(path), expected="a file's name", found=found)])
    if not os.access(directory, os.W_OK | os.X_OK):
        found = "no permission"
        expected = f"permission to write in {directory}"
        raise ContractError([Fault(where=str(path), expected=expected, found=found)])


def write_whole(path: Path, data: bytes) -> None:
    """Write `data` under a temporary name beside `path`, force it to the disk, then take the name over.

    On any failure, an interrupt included, `path` is as it was and nothing is left behind.
    """
    check_writable(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        try:
            _write_forced(temporary, data)
            temporary.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        _force_directory(path.parent)
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise ContractError(
            [Fault(where=str(path), expected="a file that can be written", found=found)]
        ) from error


def _write_forced(path: Path, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    with os.fdopen(descriptor, "wb") as out:
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
