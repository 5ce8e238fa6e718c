"""JOINT.yaml and PLAN.yaml as files: the only place of the laboratory that touches the YAML library."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from trueangle.contract.document import Node, read_document
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import (
    Joint,
    Plan,
    joint_from_document,
    joint_to_plain,
    plan_from_document,
    plan_to_plain,
)
from trueangle_training.effects import joint_settings
from trueangle_training.files import read_whole

_KEY = re.compile(r"""["']?\w+["']?[ \t]*:""")
"""At the start of a line: a key of the outermost mapping."""
_EFFECTS_KEY = re.compile(r"""["']?effects["']?[ \t]*:""")


def load_joint(path: Path) -> Joint:
    """The joint in a JOINT.yaml; ContractError with file and line of every fault, its effects included."""
    joint = joint_from_document(_read(path))
    # Whatever a command does with the joint: settings that contradict themselves or the reference mean another.
    joint_settings(joint)
    return joint


def load_plan(path: Path) -> Plan:
    """The plan in a PLAN.yaml; ContractError with file and line of every fault."""
    return plan_from_document(_read(path))


def dump_joint(joint: Joint) -> str:
    """The joint as YAML text; loading it gives an equal joint."""
    return yaml.safe_dump(joint_to_plain(joint), sort_keys=False)


def joint_text_with_effects(
    text: str, *, source: str, effects: Mapping[str, Mapping[str, Any]], comments: Mapping[str, str], heading: str
) -> str:
    """A JOINT.yaml whose key `effects` is replaced; all other lines stay as their author wrote them.

    `heading` and the comment of each effect become YAML comments. Where the other keys cannot be kept line by line
    (a document in braces) the whole is written anew.
    """
    document = read_document(text, source=source, loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)
    block = _effects_block(effects, comments, heading)
    assert isinstance(document.value, Mapping)  # noqa: S101 - whoever calls has read a joint from it
    others = {key: node.plain() for key, node in document.value.items() if key != "effects"}
    kept = _lines_without_effects(text)
    if kept is not None:
        before, after = kept
        joined = "".join([*before, block, *after])
        if _holds(joined, {**others, "effects": {name: dict(each) for name, each in effects.items()}}):
            return joined
    return yaml.safe_dump(others, sort_keys=False, allow_unicode=True) + block


def _holds(text: str, expected: Mapping[str, Any]) -> bool:
    try:
        document = read_document(text, source="", loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)
    except ContractError:
        return False
    return document.plain() == expected


def _lines_without_effects(text: str) -> tuple[list[str], list[str]] | None:
    """The lines before and after the key `effects`; None: it does not begin a line."""
    lines = text.splitlines(keepends=True)
    keys = [place for place, line in enumerate(lines) if _KEY.match(line)]
    first = next((place for place in keys if _EFFECTS_KEY.match(lines[place])), None)
    if first is None:
        return None
    last = min((place for place in keys if place > first), default=len(lines))
    while last > first + 1 and last < len(lines) and lines[last - 1].startswith(("#", "\n", "\r")):
        last -= 1  # comments above the next key are about it
    return lines[:first], lines[last:]


def _effects_block(effects: Mapping[str, Mapping[str, Any]], comments: Mapping[str, str], heading: str) -> str:
    lines = [f"# {line}" for line in heading.splitlines()]
    lines.append("effects:" if effects else "effects: {}")
    for name, settings in effects.items():
        if name in comments:
            lines += [f"  # {line}" for line in comments[name].splitlines()]
        written = yaml.safe_dump({name: dict(settings)}, sort_keys=False, default_flow_style=None, width=110)
        lines += [f"  {line}" for line in written.splitlines()]
    return "\n".join(lines) + "\n"


def dump_plan(plan: Plan) -> str:
    """The plan as YAML text; loading it gives an equal plan."""
    return yaml.safe_dump(plan_to_plain(plan), sort_keys=False)


def _read(path: Path) -> Node:
    data = read_whole(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        where = f"{path} line {line}"
        found = f"byte 0x{data[error.start]:02x}"
        raise ContractError([Fault(where=where, expected="UTF-8 text", found=found)]) from error
    return read_document(text, source=str(path), loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)
