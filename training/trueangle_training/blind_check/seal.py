"""The sealed set: cases under ids that say nothing, their truth in a manifest that is hashed before any diagnosis.

In the folder of a set: `cases/ID/measured.csv` and `joint.yaml`, all that is ever shown; `truth/manifest.jsonl`, a
line a case; `seal.json`, the manifest's SHA-256 with what the set was made from. Ids come from the set's seed, so
the same set has the same hash wherever it is made.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.blind_check.case_set import spares_of
from trueangle_training.files import read_whole, write_whole
from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.defect import CellTruth
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.truth import EffectTruth, Truth
from trueangle_training.plant.wish import Wish

Json = dict[str, Any]

SEAL, CASES, TRUTH = "seal.json", "cases", "truth"
MEASURED, JOINT, MANIFEST, DRAWN = "measured.csv", "joint.yaml", "manifest.jsonl", "drawn.jsonl"
TRIES = 2
"""Seeds tried of a wish; each is a dozen draws already."""
NEXT_SEED = 10_000_019
"""From one try to the next."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SealedCase:
    """One line of the manifest."""

    case_id: str
    wish: Wish
    truth: Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Seal:
    """What is known of a set while it is closed."""

    manifest_sha256: str
    case_ids: tuple[str, ...]
    """In their own order, which says nothing."""
    skipped: tuple[str, ...]
    """Wishes, as text, that no draw could fulfil under their plan."""


def sealed(
    folder: Path, wishes: Sequence[Wish], conditions: Json, *, processes: int, told: Callable[[int], None]
) -> Seal:
    """Make the set, or go on making it; one that is complete is checked and left as it is.

    `told` is called with the number of cases that are there. ContractError: another set lies in the folder.
    """
    path = folder / SEAL
    if path.exists():
        return _there(path, conditions)
    (folder / CASES).mkdir(parents=True, exist_ok=True)
    (folder / TRUTH).mkdir(exist_ok=True)
    drawn = folder / TRUTH / DRAWN
    lines = {line["key"]: line for line in whole_lines(drawn)}
    keys = {key_of(wish): wish for wish in wishes}
    lines = {key: line for key, line in lines.items() if key in keys}
    # Written anew, so that nothing is appended to a line that was cut off.
    drawn.write_text("".join(_line(line) for line in lines.values()), "utf-8")
    told(len(lines))
    with drawn.open("a", encoding="utf-8") as out:
        missing = [wish for key, wish in keys.items() if key not in lines]
        for line, files in _drawn(missing, conditions, processes):
            for name, text in files.items():
                place = folder / CASES / line["case_id"]
                place.mkdir(exist_ok=True)
                (place / name).write_text(text, "utf-8")
            lines[line["key"]] = line
            out.write(_line(line))
            out.flush()
            told(len(lines))
    return _closed(folder, list(lines.values()), conditions)


def _there(path: Path, conditions: Json) -> Seal:
    known = json.loads(read_whole(path))
    if known["conditions"] != conditions:
        here = ", ".join(f"{name} {value}" for name, value in known["conditions"].items())
        raise ContractError(
            [
                Fault(
                    where=str(path.parent),
                    expected="the set that is asked for, or none",
                    found=f"a set of {here}",
                    advice="choose another folder (-o), or remove this one",
                )
            ]
        )
    return Seal(
        manifest_sha256=known["manifest_sha256"],
        case_ids=tuple(known["case_ids"]),
        skipped=tuple(known["skipped"]),
    )


def _drawn(wishes: Sequence[Wish], conditions: Json, processes: int) -> Iterator[tuple[Json, dict[str, str]]]:
    tasks = [(wish, case_id_of(wish, conditions)) for wish in wishes]
    if processes <= 1 or len(tasks) < 2:
        yield from (draw_one(*task) for task in tasks)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        pending = [pool.submit(draw_one, *task) for task in tasks]
        try:
            for done in as_completed(pending):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def draw_one(wish: Wish, case_id: str) -> tuple[Json, dict[str, str]]:
    """The manifest's line and the case's files; no files where no draw is what it should be."""
    for tried in [
        replace(each, seed=each.seed + NEXT_SEED * i) for each in (wish, *spares_of(wish)) for i in range(TRIES)
    ]:
        try:
            case = draw_case(tried)
        except CaseNotFoundError:
            continue
        files = {MEASURED: case.measured_csv, JOINT: case.joint_yaml}
        return {
            "case_id": case_id,
            "key": key_of(wish),
            "wish": asdict(tried),
            "truth": replace(case.truth, case_id=case_id).to_plain(),
            "files": {name: hashlib.sha256(text.encode()).hexdigest() for name, text in files.items()},
        }, files
    return {"case_id": case_id, "key": key_of(wish), "skipped": True}, {}


def case_id_of(wish: Wish, conditions: Json) -> str:
    """16 hexadecimal digits of a hash over set and wish."""
    text = json.dumps(conditions, sort_keys=True) + key_of(wish)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def key_of(wish: Wish) -> str:
    """A wish as one line of text."""
    return json.dumps(asdict(wish), sort_keys=True)


def _closed(folder: Path, lines: list[Json], conditions: Json) -> Seal:
    """Manifest and seal written, in the order of the ids."""
    cases = sorted((line for line in lines if "skipped" not in line), key=lambda line: line["case_id"])
    manifest = "".join(_line(line) for line in cases).encode()
    seal = Seal(
        manifest_sha256=hashlib.sha256(manifest).hexdigest(),
        case_ids=tuple(line["case_id"] for line in cases),
        skipped=tuple(sorted(line["key"] for line in lines if "skipped" in line)),
    )
    write_whole(folder / TRUTH / MANIFEST, manifest)
    written = {"schema_version": 1, "conditions": conditions, **asdict(seal)}
    write_whole(folder / SEAL, (json.dumps(written, indent=1) + "\n").encode())
    (folder / TRUTH / DRAWN).unlink(missing_ok=True)
    return seal


def opened(folder: Path, seal: Seal) -> list[SealedCase]:
    """The truths; ContractError where the manifest or a case is not what was sealed, every one of them named."""
    path = folder / TRUTH / MANIFEST
    manifest = read_whole(path)
    found = hashlib.sha256(manifest).hexdigest()
    if found != seal.manifest_sha256:
        expected = f"SHA-256 {seal.manifest_sha256}, as it was sealed"
        raise ContractError([Fault(where=str(path), expected=expected, found=f"SHA-256 {found}")])
    lines = [json.loads(line) for line in manifest.decode().splitlines()]
    faults: list[Fault] = []
    for line in lines:
        for name, sealed_as in line["files"].items():
            place = folder / CASES / line["case_id"] / name
            if hashlib.sha256(read_whole(place)).hexdigest() != sealed_as:
                faults.append(Fault(where=str(place), expected="the file as it was sealed", found="another one"))
    if faults:
        raise ContractError(faults)
    return [
        SealedCase(case_id=line["case_id"], wish=_wish(line["wish"]), truth=truth_of_plain(line["truth"]))
        for line in lines
    ]


def _wish(plain: Json) -> Wish:
    names = {name: tuple(plain.get(name, ())) for name in ("names", "unlisted")}
    return Wish(**{**plain, **names})


def truth_of_plain(plain: Json) -> Truth:
    """The truth that `Truth.to_plain` wrote."""
    effects = [
        EffectTruth(
            **{
                **effect,
                "accepted_names": tuple(effect["accepted_names"]),
                "cells": tuple(CellTruth(**cell) for cell in effect["cells"]),
                "curve_arcsec": np.array(effect["curve_arcsec"], dtype=np.float64),
            }
        )
        for effect in plain["effects"]
    ]
    changed = {
        "effects": tuple(effects),
        "listed": tuple(plain["listed"]),
        "carried_together": tuple(plain["carried_together"]),
        "structure_arcsec": np.array(plain["structure_arcsec"], dtype=np.float64),
    }
    return Truth(**{**plain, **changed})


def whole_lines(path: Path) -> list[Json]:
    """JSON lines of a file, none where there is none; a last line that was cut off is left out."""
    if not path.exists():
        return []
    found: list[Json] = []
    for line in path.read_text("utf-8").splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def _line(plain: Json) -> str:
    return json.dumps(plain, sort_keys=True, separators=(",", ":")) + "\n"
