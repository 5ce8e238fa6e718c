"""A document becomes a dataclass or a list of every fault with its line."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

import pytest
import yaml

from trueangle.contract.document import (
    Node,
    Pattern,
    Range,
    document_from_plain,
    plain,
    read_document,
    structure,
)
from trueangle.contract.errors import ContractError, Fault


class Colour(Enum):
    RED = "red"
    GREEN = "green"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    size_mm: Annotated[float, Range(minimum=1, maximum=10)]
    colour: Colour = Colour.RED


@dataclass(frozen=True, slots=True, kw_only=True)
class Cart:
    wheels: tuple[Wheel, ...]
    name: Annotated[str, Pattern(regex="[a-z]+", meaning="small letters")] = "cart"
    load: int | None = None
    tags: Mapping[str, int] = field(default_factory=dict[str, int])

    def __post_init__(self) -> None:
        if len(self.wheels) == 3:
            raise ContractError([Fault(where="wheels[2].size_mm", expected="no third wheel", found="one")])


def read(text: str) -> Node:
    return read_document(text, source="cart.yaml", loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)


def faults_of(text: str) -> list[str]:
    with pytest.raises(ContractError) as caught:
        structure(Cart, read(text))
    return [str(fault) for fault in caught.value.faults]


def test_a_legal_document_becomes_the_dataclass() -> None:
    cart = structure(Cart, read("wheels:\n- {size_mm: 2}\n- {size_mm: 3.5, colour: green}\ntags: {a: 1}\n"))
    assert cart == Cart(wheels=(Wheel(size_mm=2.0), Wheel(size_mm=3.5, colour=Colour.GREEN)), tags={"a": 1})


def test_plain_and_structure_are_inverse() -> None:
    cart = Cart(wheels=(Wheel(size_mm=2.0, colour=Colour.GREEN),), load=4)
    assert structure(Cart, document_from_plain(plain(cart), source="x")) == cart


def test_every_fault_is_reported_with_its_line() -> None:
    found = faults_of("wheels:\n- size_mm: 20\n- sise_mm: 2\nname: Cart\nload: heavy\n")
    assert found == [
        "cart.yaml line 2, wheels[0].size_mm: expected a number, 1 to 10, found 20",
        (
            "cart.yaml line 3, wheels[1].sise_mm: expected a known key, found unknown key sise_mm; "
            "did you mean size_mm?"
        ),
        "cart.yaml line 3, wheels[1]: expected the key size_mm, found no such key",
        "cart.yaml line 4, name: expected a text, small letters, found the text 'Cart'",
        "cart.yaml line 5, load: expected a whole number, found the text 'heavy'",
    ]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("wheels: 3", "line 1, wheels: expected a list, found 3"),
        ("wheels: []\nload: true", "line 2, load: expected a whole number, found True"),
        ("wheels: []\nload: 1.5", "line 2, load: expected a whole number, found 1.5"),
        ("wheels: []\ntags: [1]", "line 2, tags: expected a mapping of keys, found a list"),
        ("wheels: []\nname: 7", "line 2, name: expected a text, small letters, found 7"),
        ("wheels: [{size_mm: .nan}]", "expected a number, 1 to 10, found nan"),
        ("wheels: [{size_mm: 2, colour: blue}]", "expected one of red, green, found the text 'blue'"),
        ("- 1", "line 1: expected a mapping of keys, found a list"),
    ],
)
def test_wrong_types_are_named(text: str, found: str) -> None:
    assert any(found in fault for fault in faults_of(text))


def test_fields_that_contradict_each_other_are_found_at_the_place_they_name() -> None:
    text = "wheels:\n- size_mm: 1\n- size_mm: 2\n- size_mm: 3\n"
    assert faults_of(text) == ["cart.yaml line 4, wheels[2].size_mm: expected no third wheel, found one"]


def test_a_key_given_twice_is_a_fault() -> None:
    with pytest.raises(ContractError, match=r"line 2, a: expected each key once, found also on line 1"):
        read("a: 1\na: 2\n")


def test_broken_yaml_names_line_and_column() -> None:
    with pytest.raises(ContractError, match=r"cart\.yaml line 3, column 1: expected valid YAML"):
        read("a: 1\nb: [\n")  # the list is still open where the file ends


def test_aliases_that_multiply_are_refused() -> None:
    text = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for level in range(1, 8):
        text += f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n"
    with pytest.raises(ContractError, match="more than 20000 values"):
        read(text)


def test_an_empty_file_is_a_fault() -> None:
    with pytest.raises(ContractError, match="found an empty file"):
        read("# nothing\n")


@pytest.mark.parametrize("value", ['!!int ""', '!!float ""', "!!bool x", "!!timestamp x", "!!int x"])
def test_a_value_that_its_tag_does_not_fit_is_a_fault_of_its_line(value: str) -> None:
    with pytest.raises(ContractError, match=r"cart\.yaml line 2, a: expected a value of the type"):
        read(f"b: 1\na: {value}\n")


@pytest.mark.parametrize("number", ["9" * 400, "-" + "9" * 400, "0x" + "f" * 5000])
def test_numbers_that_no_computation_could_hold_are_faults_like_any_other(number: str) -> None:
    (fault,) = faults_of(f"wheels: [{{size_mm: {number}}}]")
    assert "found a number of more than 1000 bits" in fault
    (fault,) = faults_of(f"wheels: []\nload: {number}")
    assert "expected a whole number, found a number of more than 1000 bits" in fault


def test_plain_data_nested_too_deep_are_refused_before_they_exhaust_the_stack() -> None:
    value: object = 1
    for _ in range(900):
        value = [value]
    with pytest.raises(ContractError, match=r"presets\.json: expected at most 50 values in one another"):
        document_from_plain(value, source="presets.json")
