"""Layer setting services against units made of bytes: the right unit is set, and every other outcome is told."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fakes.lss_unit import Identity, LssUnit, converse

from trueangle.core import lss
from trueangle.errors import LinkError, NodeFault

UNSIGNED32 = st.integers(0, 2**32 - 1)
FIRST: Identity = (0x159, 0x1234, 0x1_0002, 4711)
SECOND: Identity = (0x159, 0x1234, 0x1_0002, 4712)


def identity(numbers: Identity) -> lss.LssIdentity:
    vendor, product, revision, serial = numbers
    return lss.LssIdentity(vendor_id=vendor, product_code=product, revision_number=revision, serial_number=serial)


def test_one_of_several_units_with_one_node_id_is_set_by_its_identity_and_no_other() -> None:
    units = [LssUnit(FIRST, node_id=32), LssUnit(SECOND, node_id=32)]
    converse(lss.select(identity(SECOND)), units)
    converse(lss.configure_node_id(5), units)
    converse(lss.configure_bit_rate(500_000), units)
    converse(lss.store(), units)
    assert [unit.node_id for unit in units] == [32, 5]
    assert [unit.stored for unit in units] == [None, (5, 2)]


def test_two_units_in_configuration_are_never_taken_for_one() -> None:
    units = [LssUnit(FIRST, node_id=32), LssUnit(SECOND, node_id=32)]
    converse(lss.switch_global(lss.CONFIGURATION), units)
    for service in (lss.inquire_identity, lss.inquire_node_id, lss.store):
        with pytest.raises(NodeFault, match="expected one unit, 2 answered"):
            converse(service(), units)


def test_a_lone_unit_tells_its_identity_and_node_id() -> None:
    units = [LssUnit(FIRST, node_id=32)]
    converse(lss.switch_global(lss.CONFIGURATION), units)
    assert converse(lss.inquire_identity(), units) == identity(FIRST)
    assert converse(lss.inquire_node_id(), units) == 32


def test_a_unit_that_does_not_answer_is_a_broken_link_and_nothing_is_taken_for_set() -> None:
    for service in (lss.select(identity(SECOND)), lss.configure_node_id(5), lss.store()):
        with pytest.raises(LinkError, match="no unit answers"):
            converse(service, [LssUnit(FIRST, node_id=32)])


@pytest.mark.parametrize(
    "answer", [b"", b"\x44" + bytes(6), b"\x45" + bytes(7), bytes(8)], ids=["empty", "short", "code", "zeros"]
)
def test_a_wrong_answer_is_a_fault_that_shows_it(answer: bytes) -> None:
    with pytest.raises(NodeFault, match="expected 8 bytes with code 0x44"):
        converse(lss.select(identity(FIRST)), [LssUnit(FIRST, answers_with=answer)])


def test_a_refusal_says_why() -> None:
    cases = (
        (0x11, (1, 0), lss.configure_node_id(5), "the node-id is out of its range"),
        (0x13, (1, 0), lss.configure_bit_rate(10_000), "does not support this bit rate"),
        (0x17, (2, 0), lss.store(), "its storage cannot be written"),
        (0x17, (255, 9), lss.store(), "its own error 9"),
    )
    for code, error, service, text in cases:
        with pytest.raises(NodeFault, match=text):
            converse(service, [LssUnit(FIRST, configuring=True, refuses={code: error})])


def test_a_node_id_that_is_confirmed_but_not_taken_is_found_by_reading_it_back() -> None:
    with pytest.raises(NodeFault, match="reads back 32"):
        converse(lss.configure_node_id(5), [LssUnit(FIRST, node_id=32, configuring=True, forgets_node_id=True)])


@given(numbers=st.tuples(UNSIGNED32, UNSIGNED32, UNSIGNED32, UNSIGNED32))
@settings(max_examples=25, deadline=None)
def test_fastscan_finds_any_identity(numbers: Identity) -> None:
    unit = LssUnit(numbers)
    assert converse(lss.fastscan(), [unit]) == identity(numbers)
    assert unit.configuring


def test_fastscan_takes_units_without_node_id_one_by_one_and_passes_over_those_that_have_one() -> None:
    units = [LssUnit(SECOND), LssUnit(FIRST), LssUnit((1, 2, 3, 4), node_id=9)]
    found = []
    for node_id in (21, 22):
        found.append(converse(lss.fastscan(), units))
        converse(lss.configure_node_id(node_id), units)
        converse(lss.switch_global(lss.WAITING), units)
    assert converse(lss.fastscan(), units) is None
    assert set(found) == {identity(FIRST), identity(SECOND)}
    assert sorted(unit.node_id for unit in units) == [9, 21, 22]


@given(
    others=st.sets(st.tuples(UNSIGNED32, UNSIGNED32), min_size=1, max_size=4),
)
@settings(max_examples=25, deadline=None)
def test_units_that_share_a_node_id_are_all_found_by_halving(others: set[tuple[int, int]]) -> None:
    units = [LssUnit((7, 8, revision, serial), node_id=1) for revision, serial in others]
    found = converse(lss.find_serials(7, 8), [*units, LssUnit((7, 9, 1, 1), node_id=1)])
    assert set(found) == {identity((7, 8, *other)) for other in others}
    assert len(found) == len(others)


def test_a_unit_that_answers_to_everything_ends_the_search() -> None:
    class Parrot(LssUnit):
        def handle(self, data: bytes) -> bytes | None:
            return bytes((0x4F,)) + bytes(7) if data[0] == 0x4B else None

    with pytest.raises(NodeFault, match="more than 4 units"):
        converse(lss.find_serials(7, 8, most=4), [Parrot(FIRST)])


def test_only_bit_rates_of_the_standard_table_and_node_ids_of_the_standard_are_sent() -> None:
    with pytest.raises(ValueError, match="bitrate: expected one of 1000000"):
        next(lss.configure_bit_rate(100_000))
    for node_id in (0, 128, 255):
        with pytest.raises(ValueError, match=r"node_id: expected 1\.\.127"):
            next(lss.configure_node_id(node_id))
