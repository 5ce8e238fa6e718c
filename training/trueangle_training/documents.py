"""JOINT.yaml and PLAN.yaml as files: the only place of the laboratory that touches the YAML library."""

from pathlib import Path

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
from trueangle_training.files import read_whole


def load_joint(path: Path) -> Joint:
    """The joint in a JOINT.yaml; ContractError with file and line of every fault."""
    return joint_from_document(_read(path))


def load_plan(path: Path) -> Plan:
    """The plan in a PLAN.yaml; ContractError with file and line of every fault."""
    return plan_from_document(_read(path))


def dump_joint(joint: Joint) -> str:
    """The joint as YAML text; loading it gives an equal joint."""
    return yaml.safe_dump(joint_to_plain(joint), sort_keys=False)


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
