"""Which diagnosis was asked: the commit, and a hash of the code that answers depend on."""

import hashlib
import shutil
import subprocess
from pathlib import Path

import trueangle.contract
import trueangle_training

JUDGES = ("plant", "blind_check")
"""Of our own packages those that the diagnosis never imports."""
SHOWN_DIGITS = 12


def diagnosis_sha256() -> str:
    """Over path and bytes of every module of the laboratory but plants and this check, and of the contract."""
    digest = hashlib.sha256()
    for package in (trueangle_training, trueangle.contract):
        root = Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*.py")):
            inside = path.relative_to(root)
            if inside.parts[0] not in JUDGES:
                digest.update(f"{root.name}/{inside.as_posix()}\0".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def commit() -> str | None:
    """Of the repository that this package lies in, with `+` where files differ from it; None: there is none."""
    git, folder = shutil.which("git"), Path(str(trueangle_training.__file__)).parent
    if git is None:
        return None

    def said(*arguments: str) -> str | None:
        command = [git, "-C", str(folder), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - git, fixed words
        return done.stdout.strip() if done.returncode == 0 else None

    found = said("rev-parse", "HEAD")
    if found is None:
        return None
    return found[:SHOWN_DIGITS] + ("+" if said("status", "--porcelain", "--untracked-files=no") else "")
