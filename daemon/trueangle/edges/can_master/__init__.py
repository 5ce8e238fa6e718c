"""The CANopen master of one bus: every node's life cycle, fed with what is not process data.

Of the canopen library only the SDO client is used: it has no heartbeat time-out, takes an NMT state for reached
because it was commanded, and its PdoMap.save() writes no mapping where an EDS declares 0x1A00 as an array.
"""

import asyncio
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Self

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import NodePlan, Quantity
from trueangle.core.node_setup import NodeReport
from trueangle.edges.can_master.node import NodeListener, NodeSupervisor
from trueangle.edges.can_master.sdo import FrameSender, MasterTiming, SdoNetwork, SdoPort

__all__ = ["CanMaster", "FrameSender", "MasterTiming"]

MAX_SDO_THREADS = 8


class CanMaster:
    """All nodes of one bus; `async with` runs their life cycles.

    Feed it every frame that is not process data by `notify`, and the bus state by `on_bus_state`; both on
    the loop's thread. `on_node(slot, report)` is called on the loop at each change of state. `accept(slot,
    settings)` gives the differences for which the node's angle must not be corrected; empty accepts.
    `on_sensor(node_id, report)` is the same for every node, by its id; `on_value(slot, quantity, value, stamp_ns)`
    tells what was read by SDO, `on_alive(node_id, stamp_ns)` that a node in service lives.
    `accept_head(slot, head, settings)` is `accept` for a joint's further heads; without it they are refused.
    """

    def __init__(
        self,
        bus: FrameSender,
        plans: Sequence[NodePlan],
        *,
        on_node: Callable[[int, NodeReport], None],
        accept: Callable[[int, EncoderSettings], list[str]],
        on_sensor: Callable[[int, NodeReport], None] | None = None,
        on_value: Callable[[int, Quantity, int, int], None] | None = None,
        on_alive: Callable[[int, int], None] | None = None,
        accept_head: Callable[[int, int, EncoderSettings], list[str]] | None = None,
        timing: MasterTiming | None = None,
    ) -> None:
        self._bus, self._on_node, self._accept = bus, on_node, accept
        self._on_sensor, self._on_value, self._on_alive = on_sensor, on_value, on_alive
        self._accept_head = accept_head
        self._timing = timing or MasterTiming()
        # canopen warns at each SDO time-out, twice a second while a node is away; the transition is logged here.
        logging.getLogger("canopen.sdo.client").setLevel(logging.CRITICAL)
        self._threads = ThreadPoolExecutor(MAX_SDO_THREADS, "sdo")
        self._bus_up: tuple[bool, str] = (False, "not open yet")
        self._nodes = {plan.node_id: self._supervisor(plan) for plan in plans}
        self._routes: Mapping[int, Callable[[bytes], None]] = {}
        self._lay_routes()
        self._tasks = asyncio.TaskGroup()
        self._lives: dict[int, asyncio.Task[None]] = {}

    def _supervisor(self, plan: NodePlan) -> NodeSupervisor:
        # A network of its own: the transfers of one node can be ended for good while those of the others go on.
        sdo = SdoPort(plan.node_id, SdoNetwork(self._bus), self._threads, self._timing)
        return NodeSupervisor(plan, sdo, self._bus, listener=self._listener(plan), timing=self._timing)

    def _listener(self, plan: NodePlan) -> NodeListener:
        slot, node_id = plan.slot, plan.node_id

        def on_report(report: NodeReport) -> None:
            if slot is not None:
                self._on_node(slot, report)
            if self._on_sensor is not None:
                self._on_sensor(node_id, report)

        def accept(settings: EncoderSettings) -> list[str]:
            if slot is None:
                return []
            if plan.head == 0:
                return self._accept(slot, settings)
            if self._accept_head is None:
                return ["nobody knows this head"]
            return self._accept_head(slot, plan.head, settings)

        def on_value(value_slot: int, quantity: Quantity, value: int, stamp_ns: int) -> None:
            if self._on_value is not None:
                self._on_value(value_slot, quantity, value, stamp_ns)

        return NodeListener(
            on_report=on_report,
            accept=accept,
            on_value=on_value,
            on_alive=lambda stamp_ns: None if self._on_alive is None else self._on_alive(node_id, stamp_ns),
        )

    def _lay_routes(self) -> None:
        self._routes = {
            cob_id: handler for node in self._nodes.values() for cob_id, handler in node.routes().items()
        }

    def rearrange(self, *, leaving: Collection[int], coming: Sequence[NodePlan]) -> None:
        """End the lives of the node-ids that leave, begin those that come, between two frames; the others go on.

        What a leaving node says is not heard any more when this returns, and nothing is reported of it.
        """
        for node_id in leaving:
            self._nodes.pop(node_id).close()
            self._lives.pop(node_id).cancel()
        for plan in coming:
            node = self._nodes[plan.node_id] = self._supervisor(plan)
            up, reason = self._bus_up
            if up:
                node.on_bus_state(up, reason)
            self._lives[plan.node_id] = self._tasks.create_task(node.live())
        self._lay_routes()

    async def __aenter__(self) -> Self:
        await self._tasks.__aenter__()
        self._lives = {node_id: self._tasks.create_task(node.live()) for node_id, node in self._nodes.items()}
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for node_id, node in self._nodes.items():
            node.close()
            self._lives[node_id].cancel()
        try:
            # The group needs to see its own cancellation of the body; the body's errors stay the body's.
            if isinstance(error, asyncio.CancelledError):
                await self._tasks.__aexit__(kind, error, trace)
            else:
                await self._tasks.__aexit__(None, None, None)
        finally:
            self._threads.shutdown(wait=True, cancel_futures=True)

    def notify(self, can_id: int, data: bytes) -> None:
        """One frame that is not process data; frames of no known node are passed over."""
        handler = self._routes.get(can_id)
        if handler is not None:
            handler(data)

    def on_bus_state(self, up: bool, reason: str) -> None:
        """The bus came up or went down: every node on it is lost with it."""
        self._bus_up = (up, reason)
        for node in self._nodes.values():
            node.on_bus_state(up, reason)

    def distrust(self, reason: str) -> None:
        """Frames of this bus were missed, perhaps a boot-up message: every node is identified again."""
        for node in self._nodes.values():
            node.distrust(reason)

    def distrust_node(self, node_id: int, reason: str) -> None:
        """Frames of this node cast doubt on it: it is identified again."""
        if node_id in self._nodes:
            self._nodes[node_id].distrust(reason)

    @property
    def cob_ids(self) -> frozenset[int]:
        """The COB-IDs that the master listens to."""
        return frozenset(self._routes)
