"""Which joints and nodes go on as if nothing had happened when one set of plans takes another's place.

Rules of this file: a node goes on only if it is to send exactly what it sends, and every joint that it serves goes
on; a joint goes on only if it is what it was and every node that serves it goes on. So what is shared is renewed
with each of its sharers, and nothing old is ever combined with anything new.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass

from trueangle.core.frames import NodePlan

NodeKey = tuple[str, int]
"""Bus and node-id."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedOver:
    """What goes on."""

    slots: frozenset[int]
    nodes: frozenset[NodeKey]


def served_slots(plan: NodePlan) -> frozenset[int]:
    """The joints that need this node."""
    slots = {plan.slot} | {mapped.slot for tpdo in plan.tpdos for mapped in tpdo.mapping}
    slots |= {polled.value.slot for polled in plan.polls}
    return frozenset(slot for slot in slots if slot is not None)


def carried_over(
    unchanged: Set[int], before: Mapping[NodeKey, NodePlan], now: Mapping[NodeKey, NodePlan]
) -> CarriedOver:
    """What goes on of the joints in `unchanged`; `before` and `now` hold the nodes of buses that stay open."""
    slots = set(unchanged)
    nodes = {key for key, plan in now.items() if before.get(key) == plan}
    served = {key: served_slots(plan) for key, plan in now.items()}
    while True:
        ending = {key for key in nodes if not served[key] <= slots}
        nodes -= ending
        renewed = {slot for key in now.keys() - nodes for slot in served[key]} & slots
        slots -= renewed
        if not ending and not renewed:
            return CarriedOver(slots=frozenset(slots), nodes=frozenset(nodes))
