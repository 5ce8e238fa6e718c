"""Temperatures that reach a joint by another way than its encoder's own frames.

A sensor may sit on another node than the encoder, its node may serve several joints at once, and its value may be
polled. Whatever the way, a value counts only while its node is in service, and dies with it.

"Unchanged" and "dead" are told apart so: a sensor that sends only on change is alive, and its last value fresh, as
long as its node's heartbeat says OPERATIONAL or a poll is answered; the value itself was read once by SDO when the
node came into service, so that silence never means "not yet". A sensor that freezes behind a living node can only
be told by its own status object, or by its value standing still where it never should.
"""

from collections.abc import Iterable, Mapping

from trueangle.core.frames import FrameLayout, NodePlan, frame_layouts
from trueangle.core.health import NodeCondition
from trueangle.core.sample import JointSample

IN_SERVICE = (NodeCondition.RUNNING, NodeCondition.DIFFERS)


class SensorNodes:
    """Which joints' temperatures come from which node of which bus."""

    def __init__(self, samples: Mapping[int, JointSample], served: Iterable[tuple[str, int, int]]) -> None:
        self._samples = samples
        self._slots: dict[tuple[str, int], list[int]] = {}
        for bus, node_id, slot in served:
            self._slots.setdefault((bus, node_id), []).append(slot)
        self._alive: set[tuple[str, int]] = set()
        self._table: dict[tuple[str, int], tuple[tuple[str, int], FrameLayout]] = {}

    def add(self, bus: str, plan: NodePlan) -> None:
        """A node with frames that hold values of joints whose encoder it is not."""
        for cob_id, layout in frame_layouts(plan).items():
            if layout.slot is None:
                self._table[bus, cob_id] = ((bus, plan.node_id), layout)

    def cob_ids(self, bus: str) -> frozenset[int]:
        """The COB-IDs on this bus that are for `on_frame`."""
        return frozenset(cob_id for name, cob_id in self._table if name == bus)

    def on_frame(self, bus: str, cob_id: int, data: bytes, stamp_ns: int) -> bool:
        """A frame that is no encoder's; False where its length is wrong."""
        entry = self._table.get((bus, cob_id))
        if entry is None:
            return True
        node, layout = entry
        if len(data) != layout.length:
            return False
        if node in self._alive:
            values = layout.unpack.unpack(data)
            for slot, quantity, value in zip(layout.slots, layout.quantities, values, strict=True):
                self._samples[slot].take_value(quantity, value, stamp_ns)
        return True

    def on_node(self, bus: str, node_id: int, condition: NodeCondition) -> None:
        """The node's life cycle moved on: out of service it takes its temperatures with it."""
        node = (bus, node_id)
        if condition in IN_SERVICE:
            if node in self._alive:
                return
            self._alive.add(node)
        else:
            self._alive.discard(node)
        for slot in self._slots.get(node, ()):
            self._samples[slot].forget_temperature()

    def on_alive(self, bus: str, node_id: int, stamp_ns: int) -> None:
        """The node proved that it lives: what it would have told of a change still holds."""
        if (bus, node_id) in self._alive:
            for slot in self._slots.get((bus, node_id), ()):
                self._samples[slot].confirm_temperature(stamp_ns)

    @property
    def alive(self) -> frozenset[tuple[str, int]]:
        """The nodes in service, each with its bus."""
        return frozenset(self._alive)

    def go_on_with(self, nodes: Iterable[tuple[str, int]]) -> None:
        """These are in service, and what they have told still counts."""
        self._alive.update(nodes)
