"""A YAML or JSON document with its line numbers, turned into typed dataclasses with every fault at once.

Rules of this file: `read_document` keeps the line of each value; `structure` walks a dataclass's type hints and
collects faults instead of stopping at the first; unknown keys are faults; numbers are never made from text.
The YAML library comes in as an argument, so that this package needs none.
"""

import dataclasses
import difflib
import enum
import functools
import math
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar, Union, cast

from trueangle.contract.errors import ContractError, Fault

T = TypeVar("T")
Scalar = str | int | float | bool | None

MAX_NODES = 20_000
"""A document that grows beyond this by aliases is refused ("billion laughs")."""
MAX_DEPTH = 50
"""Of JSON-like data; no document of ours goes deeper than ten."""
MAX_INTEGER_BITS = 1000
"""Larger numbers fit no binary64, and Python refuses to print the largest."""

_UNWRITABLE = re.compile("[\0\ud800-\udfff]")
"""In no name of a file, host or device; the system's calls refuse them with an error of Python's own."""
_PLAIN_INTEGER = r"-?(0|[1-9][0-9]*)|0x[0-9a-fA-F]+"


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One value of a document with the place it was read from."""

    value: "Mapping[str, Node] | Sequence[Node] | Scalar"
    source: str
    """File name as the user gave it."""
    line: int | None = None
    """1-based; None where the format keeps no lines."""
    path: str = ""
    """Dotted path inside the document, as in `joints[1].node_id`."""

    @property
    def where(self) -> str:
        """The place as a person looks for it: file, line, path."""
        line = f" line {self.line}" if self.line is not None else ""
        path = f", {self.path}" if self.path else ""
        return f"{self.source}{line}{path}"

    def plain(self) -> Any:
        """The value without places."""
        if isinstance(self.value, Mapping):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, Sequence) and not isinstance(self.value, str):
            return [node.plain() for node in self.value]
        return self.value


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """Limits of a number, given in an `Annotated` type; both ends belong to it."""

    minimum: float | None = None
    maximum: float | None = None

    def __str__(self) -> str:
        if self.minimum is None:
            return f"at most {self.maximum:g}"
        if self.maximum is None:
            return f"at least {self.minimum:g}"
        if self.minimum == self.maximum:
            return f"exactly {self.minimum:g}"
        return f"{self.minimum:g} to {self.maximum:g}"

    def holds(self, number: float) -> bool:
        """Whether the number lies within the limits."""
        above = self.minimum is None or number >= self.minimum
        return above and (self.maximum is None or number <= self.maximum)


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """The form of a text, given in an `Annotated` type."""

    regex: str
    meaning: str


class YamlLoader(Protocol):
    """What is used of a PyYAML loader (`yaml.SafeLoader` or `yaml.CSafeLoader`)."""

    def get_single_node(self) -> Any:
        """Compose the only document of the stream, None when it is empty."""
        ...

    def construct_object(self, node: Any) -> Any:
        """The Python value of a scalar node."""
        ...

    def dispose(self) -> None:
        """Free the parser."""
        ...


def read_document(
    text: str, *, source: str, loader: Callable[[str], YamlLoader], syntax_error: type[Exception]
) -> Node:
    """Parse one YAML document, keeping lines; duplicate keys and non-text keys are faults.

    Raises ContractError with file and line.
    """
    try:
        reader = loader(text)
        try:
            root = reader.get_single_node()
            if root is None:
                raise ContractError([Fault(where=source, expected="a YAML mapping", found="an empty file")])
            faults: list[Fault] = []
            budget = [MAX_NODES]
            node = _convert(root, reader, Node(value=None, source=source, line=1), faults, budget)
        finally:
            reader.dispose()
    except (syntax_error, ValueError, RecursionError) as error:
        raise ContractError([_syntax_fault(error, source)]) from error
    if faults:
        raise ContractError(faults)
    return node


def _syntax_fault(error: Exception, source: str) -> Fault:
    mark = getattr(error, "problem_mark", None)
    where = f"{source} line {mark.line + 1}, column {mark.column + 1}" if mark else source
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    return Fault(where=where, expected="valid YAML", found=str(problem))


def _convert(raw: Any, reader: YamlLoader, at: Node, faults: list[Fault], budget: list[int]) -> Node:
    budget[0] -= 1
    if budget[0] < 0:
        raise ValueError(f"more than {MAX_NODES} values (aliases that multiply?)")
    here = dataclasses.replace(at, line=raw.start_mark.line + 1)
    if raw.id == "mapping":
        entries: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            place = dataclasses.replace(here, line=raw_key.start_mark.line + 1)
            key = _constructed(raw_key, reader, place, faults) if raw_key.id == "scalar" else None
            if not isinstance(key, str):
                faults.append(Fault(where=place.where, expected="a name as key", found=repr(key)))
                continue
            child = dataclasses.replace(place, path=f"{here.path}.{key}" if here.path else key)
            if key in entries:
                first = entries[key].line
                faults.append(Fault(where=child.where, expected="each key once", found=f"also on line {first}"))
            entries[key] = _convert(raw_value, reader, child, faults, budget)
        return dataclasses.replace(here, value=entries)
    if raw.id == "sequence":
        items = [
            _convert(item, reader, dataclasses.replace(here, path=f"{here.path}[{i}]"), faults, budget)
            for i, item in enumerate(raw.value)
        ]
        return dataclasses.replace(here, value=items)
    value = _constructed(raw, reader, here, faults)
    if type(value) is int and not re.fullmatch(_PLAIN_INTEGER, raw.value):
        # YAML 1.1 reads 010 as eight and 1:10 as seventy: nobody who writes a node number means that.
        faults.append(Fault(where=here.where, expected="a plain decimal or 0x number", found=raw.value))
    if value is not None and not isinstance(value, (str, int, float, bool)):
        value = raw.value  # dates and the like stay the text they were written as
    return dataclasses.replace(here, value=value)


def _constructed(raw: Any, reader: YamlLoader, at: Node, faults: list[Fault]) -> Any:
    """The value of a scalar; None, and a fault, where its tag does not fit its text (`!!int ""`, `!!bool x`)."""
    try:
        return reader.construct_object(raw)
    except (LookupError, AttributeError, TypeError, ArithmeticError, ValueError):
        # PyYAML's constructors take the text to be right: what they raise for one that is not is an accident.
        found = f"the text {raw.value[:40]!r}"
        faults.append(Fault(where=at.where, expected=f"a value of the type {raw.tag}", found=found))
        return None


def document_from_plain(value: Any, *, source: str, path: str = "", depth: int = 0) -> Node:
    """A document without lines from JSON-like data; ContractError where it is nested too deep."""
    at = Node(value=None, source=source, path=path)
    if depth > MAX_DEPTH:
        expected = f"at most {MAX_DEPTH} values in one another"
        raise ContractError([Fault(where=source, expected=expected, found=f"more, at {path[:40]}...")])
    if isinstance(value, Mapping):
        entries = {
            str(key): document_from_plain(
                item, source=source, path=f"{path}.{key}" if path else str(key), depth=depth + 1
            )
            for key, item in cast("Mapping[Any, Any]", value).items()
        }
        return dataclasses.replace(at, value=entries)
    if isinstance(value, (list, tuple)):
        items = [
            document_from_plain(item, source=source, path=f"{path}[{i}]", depth=depth + 1)
            for i, item in enumerate(cast("Sequence[Any]", value))
        ]
        return dataclasses.replace(at, value=items)
    return dataclasses.replace(at, value=value)


def structure(cls: type[T], node: Node) -> T:
    """The document as the dataclass `cls`; ContractError with every fault found.

    A `ContractError` raised by a `__post_init__` (fields that contradict each other) is reported at the place
    that its fault names: a field, or a path below it such as `joints[1].node_id`.
    """
    faults: list[Fault] = []
    value = _structure_dataclass(cls, node, faults)
    if faults:
        raise ContractError(faults)
    return cast("T", value)


def plain(value: Any) -> Any:
    """Dataclasses, enums and tuples as YAML/JSON data; fields that are None are left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        if isinstance(value, Node):
            return value.plain()
        pairs = ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value))
        return {name: plain(item) for name, item in pairs if item is not None}
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in cast("Sequence[Any]", value)]
    return value


def _descend(node: Node, path: str) -> Node:
    """The node at `key`, `key[2]` or `key[2].key` below this one, as far as the document goes."""
    for step in re.findall(r"[^.\[\]]+", path):
        value = node.value
        if isinstance(value, Mapping) and step in value:
            node = value[step]
        elif (
            isinstance(value, Sequence)
            and not isinstance(value, str)
            and step.isdigit()
            and int(step) < len(value)
        ):
            node = value[int(step)]
        else:
            break
    return node


@functools.cache
def _hints(cls: type[Any]) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _structure_dataclass(cls: type[Any], node: Node, faults: list[Fault]) -> Any:
    if not isinstance(node.value, Mapping):
        faults.append(Fault(where=node.where, expected="a mapping of keys", found=_shown(node)))
        return None
    entries = node.value
    known = {f.name: f for f in dataclasses.fields(cls)}
    for key in [key for key in entries if key not in known]:
        close = difflib.get_close_matches(key, known, n=1)
        advice = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(known)}"
        faults.append(
            Fault(where=entries[key].where, expected="a known key", found=f"unknown key {key}", advice=advice)
        )
    before = len(faults)
    values: dict[str, Any] = {}
    for name, field in known.items():
        if name in entries:
            values[name] = _structure(_hints(cls)[name], entries[name], faults)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            faults.append(Fault(where=node.where, expected=f"the key {name}", found="no such key"))
    if len(faults) > before:
        return None
    try:
        return cls(**values)
    except ContractError as error:
        faults += [dataclasses.replace(fault, where=_descend(node, fault.where).where) for fault in error.faults]
        return None


def _structure(hint: Any, node: Node, faults: list[Fault]) -> Any:
    limits: Sequence[Any] = ()
    if typing.get_origin(hint) is typing.Annotated:
        hint, *limits = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if origin in (Union, types.UnionType):
        members = [m for m in typing.get_args(hint) if m is not types.NoneType]
        if node.value is None and len(members) < len(typing.get_args(hint)):
            return None
        return _structure_scalar_union(members, node, faults, limits)
    if origin is tuple:
        return _structure_tuple(typing.get_args(hint), node, faults)
    if origin in (dict, Mapping) or hint is Mapping:
        return _structure_mapping(typing.get_args(hint), node, faults)
    if hint is Node:
        return node
    if dataclasses.is_dataclass(hint):
        return _structure_dataclass(cast("type[Any]", hint), node, faults)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return _structure_enum(hint, node, faults)
    return _structure_scalar(cast("type[Any]", hint), node, faults, limits)


def _structure_scalar_union(members: list[Any], node: Node, faults: list[Fault], limits: Sequence[Any]) -> Any:
    if len(members) == 1:
        member: Any = typing.Annotated[members[0], *limits] if limits else members[0]
        return _structure(member, node, faults)
    trials: list[list[Fault]] = []
    for member in members:
        trial: list[Fault] = []
        value = _structure(member, node, trial)
        if not trial:
            return value
        trials.append(trial)
    expected = " or ".join(fault.expected for trial in trials for fault in trial[:1])
    faults.append(Fault(where=node.where, expected=expected, found=_shown(node)))
    return None


def _structure_tuple(args: tuple[Any, ...], node: Node, faults: list[Fault]) -> Any:
    if not isinstance(node.value, Sequence) or isinstance(node.value, str):
        faults.append(Fault(where=node.where, expected="a list", found=_shown(node)))
        return None
    items = node.value
    if len(args) == 2 and args[1] is Ellipsis:
        return tuple(_structure(args[0], item, faults) for item in items)
    if len(items) != len(args):
        faults.append(Fault(where=node.where, expected=f"a list of {len(args)}", found=f"{len(items)} entries"))
        return None
    return tuple(_structure(arg, item, faults) for arg, item in zip(args, items, strict=True))


def _structure_mapping(args: tuple[Any, ...], node: Node, faults: list[Fault]) -> Any:
    if not isinstance(node.value, Mapping):
        faults.append(Fault(where=node.where, expected="a mapping of keys", found=_shown(node)))
        return None
    return {key: _structure(args[1], item, faults) for key, item in node.value.items()}


def _structure_enum(hint: type[enum.Enum], node: Node, faults: list[Fault]) -> Any:
    choices = [member.value for member in hint]
    if isinstance(node.value, bool) or node.value not in choices:
        expected = "one of " + ", ".join(str(c) for c in choices)
        faults.append(Fault(where=node.where, expected=expected, found=_shown(node)))
        return None
    return hint(node.value)


_SCALARS: dict[type[Any], str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
}


def _structure_scalar(hint: type[Any], node: Node, faults: list[Fault], limits: Sequence[Any]) -> Any:
    value = node.value
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    fits = number if hint is float else (isinstance(value, hint) and (hint is bool or type(value) is not bool))
    finite = math.isfinite(value) if isinstance(value, float) else not _is_huge(value)
    limit = next((x for x in limits if isinstance(x, Range)), None)
    pattern = next((x for x in limits if isinstance(x, Pattern)), None)
    expected = _SCALARS[hint] + (f", {limit}" if limit else "") + (f", {pattern.meaning}" if pattern else "")
    holds = fits and finite
    if holds and limit:
        holds = limit.holds(cast("float", value))
    if holds and isinstance(value, str) and _UNWRITABLE.search(value):
        holds, expected = False, "a text without NUL and half characters (surrogates)"
    elif holds and pattern:
        holds = re.fullmatch(pattern.regex, cast("str", value)) is not None
    if not holds:
        faults.append(Fault(where=node.where, expected=expected, found=_shown(node), advice=_advice(hint, value)))
        return None
    return float(cast("float", value)) if hint is float else value


def _advice(hint: type[Any], value: Any) -> str:
    """YAML 1.1 takes 1e-2 for a text: it wants a point."""
    if hint is float and isinstance(value, str) and re.fullmatch(r"[-+]?[0-9]+[eE][-+]?[0-9]+", value):
        return f"write {float(value)!r}"
    return ""


def _shown(node: Node) -> str:
    if isinstance(node.value, Mapping):
        return "a mapping of keys"
    if isinstance(node.value, str):
        return f"the text {node.value!r}"
    if isinstance(node.value, Sequence):
        return "a list"
    if _is_huge(node.value):
        return f"a number of more than {MAX_INTEGER_BITS} bits"
    return "nothing" if node.value is None else str(node.value)


def _is_huge(value: object) -> bool:
    return isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS
