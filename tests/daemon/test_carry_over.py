"""What goes on through a reload: joints and nodes that share anything with what changed are renewed with it."""

import dataclasses

from trueangle.core.carry_over import carried_over, served_slots
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan

POSITION = MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)


def plan(node_id: int, slot: int | None, *warm: int, heartbeat_ms: int = 200) -> NodePlan:
    """A node with the encoder of `slot` (None: no encoder) and temperatures of the joints `warm`."""
    first = () if slot is None else (POSITION,)
    mapping = first + tuple(
        MappedObject(index=0x7130, subindex=i, bits=16, quantity=Quantity.TEMPERATURE, slot=other)
        for i, other in enumerate(warm, start=1)
    )
    tpdo = TpdoPlan(number=1, cob_id=0x180 + node_id, transmission_type=1, mapping=mapping)
    return NodePlan(slot=slot, node_id=node_id, tpdos=(tpdo,), heartbeat_ms=heartbeat_ms)


def plans(*made: NodePlan) -> dict[tuple[str, int], NodePlan]:
    return {("arm", one.node_id): one for one in made}


def test_a_node_serves_its_encoder_and_every_joint_whose_temperature_it_tells() -> None:
    assert served_slots(plan(5, 1, 2, 3)) == {1, 2, 3}
    assert served_slots(plan(5, None, 2)) == {2}


def test_what_is_as_it_was_goes_on() -> None:
    now = plans(plan(1, 1), plan(2, 2), plan(9, None, 1, 2))
    kept = carried_over({1, 2}, now, now)
    assert (kept.slots, kept.nodes) == ({1, 2}, now.keys())


def test_a_changed_joint_takes_its_own_node_with_it_and_no_other() -> None:
    now = plans(plan(1, 1), plan(2, 2))
    kept = carried_over({2}, now, now)
    assert (kept.slots, kept.nodes) == ({2}, {("arm", 2)})


def test_joints_that_share_a_sensor_node_with_a_changed_one_are_renewed_with_it() -> None:
    """Else the node would be set up anew under a joint that takes its last temperature for good."""
    now = plans(plan(1, 1), plan(2, 2), plan(3, 3), plan(9, None, 1, 2))
    kept = carried_over({2, 3}, now, now)
    assert (kept.slots, kept.nodes) == ({3}, {("arm", 3)})


def test_renewal_goes_on_along_a_chain_of_shared_nodes() -> None:
    now = plans(plan(1, 1, 2), plan(2, 2, 3), plan(3, 3, 4), plan(4, 4), plan(5, 5))
    kept = carried_over({2, 3, 4, 5}, now, now)
    assert (kept.slots, kept.nodes) == ({5}, {("arm", 5)})


def test_a_node_that_is_to_send_anything_else_is_renewed_with_its_joints() -> None:
    before = plans(plan(1, 1), plan(2, 2))
    now = plans(plan(1, 1, heartbeat_ms=500), plan(2, 2))
    assert carried_over({1, 2}, before, now).slots == {2}
    moved = plans(dataclasses.replace(before["arm", 1], node_id=7), plan(2, 2))
    assert carried_over({1, 2}, before, moved).slots == {2}


def test_a_sensor_node_that_loses_a_joint_is_renewed() -> None:
    kept = carried_over({1}, plans(plan(1, 1), plan(9, None, 1, 2)), plans(plan(1, 1), plan(9, None, 1)))
    assert (kept.slots, kept.nodes) == (frozenset(), frozenset())
