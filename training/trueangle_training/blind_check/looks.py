"""Every look at a set, one JSON line each, in a file that is kept with the code.

A set that was seen is no blind set for whoever changed the diagnosis after it. The same diagnosis asked the same
set again learns nothing new and is not counted again.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.files import read_whole

Json = dict[str, Any]

SET_KEYS = ("plant", "plan", "seed", "cases", "withhold")
"""Of a check's conditions: what makes two sets the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """How often a set was looked at."""

    before: int
    """Looks with other states of the diagnosis."""
    same_diagnosis: bool
    """This very diagnosis has been asked this very set before."""
    number: int
    """Of this look: 1 for a set that nobody has seen."""
    logged: bool
    """Somebody keeps count."""


def looks_in(path: Path) -> list[Json]:
    """All that are written down; none where there is no file. ContractError naming a line that is none."""
    if not path.exists():
        return []
    found: list[Json] = []
    for number, line in enumerate(read_whole(path).decode().splitlines(), start=1):
        if not line.strip():
            continue
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError as error:
            where = f"{path}, line {number}"
            raise ContractError([Fault(where=where, expected="one look as JSON", found=line[:60])]) from error
    return found


def seen_in(looks: Sequence[Json] | None, conditions: Mapping[str, Any], *, diagnosis: str, quick: bool) -> Seen:
    """How often this set was seen; None: nobody keeps count. The quick way sees less, so is a look of its own."""
    same = [each for each in looks or () if _shares_cases(each["set"], conditions)]
    states = {each["diagnosis_sha256"] for each in same}
    again = any(each["diagnosis_sha256"] == diagnosis and each["quick"] == quick for each in same)
    before = len(states - {diagnosis})
    return Seen(before=before, same_diagnosis=again, number=before + 1, logged=looks is not None)


def _shares_cases(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """The same set; of withheld effects one among all is the same set, too."""
    if any(one[key] != other[key] for key in ("plant", "plan", "seed")):
        return False
    if "all" in (one["withhold"], other["withhold"]):
        return None not in (one["withhold"], other["withhold"])
    return one["withhold"] == other["withhold"] and one["cases"] == other["cases"]


def look_of(result: Json) -> Json:
    """What is written down of a result."""
    conditions = result["conditions"]
    return {
        "set": {key: conditions[key] for key in SET_KEYS},
        "manifest_sha256": result["seal"]["manifest_sha256"],
        "commit": result["commit"],
        "diagnosis_sha256": result["diagnosis_sha256"],
        "on": result["on"],
        "quick": conditions["quick"],
        "figures": {row["name"]: _figure(row) for row in result["figures"] if row["value"] is not None},
        "by_plant": {
            plant: {row["name"]: _figure(row) for row in rows if row["value"] is not None}
            for plant, rows in result.get("by_plant", {}).items()
        },
    }


def _figure(row: Json) -> Json:
    return {
        "value": _rounded(row["value"]),
        "hits": row["hits"],
        "cases": row["cases"],
        "at_most": row["at_most"],
    }


def _rounded(value: float) -> float:
    return round(value, 4)


def append(path: Path, look: Json) -> None:
    """One line more; the file and its lines are never written anew."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(look, sort_keys=True) + "\n")
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise ContractError(
            [Fault(where=str(path), expected="a file that can be written", found=found)]
        ) from error


def worse_than(look: Json, before: Json, *, slack: float) -> list[str]:
    """Figures that an earlier look at the same set had better, in words.

    Counts may not lose a single case; other figures may move by the slack.
    """
    found: list[str] = []
    for name, old in before["figures"].items():
        new = look["figures"].get(name)
        if new is None:
            found.append(f"{name}: was {old['value']:g}, now there is no case")
            continue
        allowed = 1e-9 if old["hits"] is not None else slack
        lost = (new["value"] - old["value"]) * (1.0 if old["at_most"] else -1.0)
        if lost > allowed:
            found.append(f"{name}: was {_shown(old)}, is {_shown(new)}")
    return found


def _shown(figure: Json) -> str:
    return f"{figure['value']:g}" if figure["hits"] is None else f"{figure['hits']} of {figure['cases']}"
