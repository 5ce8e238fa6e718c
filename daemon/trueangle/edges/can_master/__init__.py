"""The CANopen master of one bus: every node's life cycle, fed with what is not process data.

Of the canopen library only the SDO client is used: it has no heartbeat time-out, takes an NMT state for reached
because it was commanded, and its PdoMap.save() writes no mapping where an EDS declares 0x1A00 as an array.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
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
        timing: MasterTiming | None = None,
    ) -> None:
        timing = timing or MasterTiming()
        # canopen warns at each SDO time-out, twice a second while a node is away; the transition is logged here.
        logging.getLogger("canopen.sdo.client").setLevel(logging.CRITICAL)
        self._threads = ThreadPoolExecutor(max(1, min(len(plans), MAX_SDO_THREADS)), "sdo")
        self._network = SdoNetwork(bus)

        def listener(plan: NodePlan) -> NodeListener:
            slot, node_id = plan.slot, plan.node_id

            def on_report(report: NodeReport) -> None:
                if slot is not None:
                    on_node(slot, report)
                if on_sensor is not None:
                    on_sensor(node_id, report)

            return NodeListener(
                on_report=on_report,
                accept=lambda settings: [] if slot is None else accept(slot, settings),
                on_value=on_value or (lambda *_: None),
                on_alive=lambda stamp_ns: None if on_alive is None else on_alive(node_id, stamp_ns),
            )

        self._nodes = [
            NodeSupervisor(
                plan,
                SdoPort(plan.node_id, self._network, self._threads, timing),
                bus,
                listener=listener(plan),
                timing=timing,
            )
            for plan in plans
        ]
        self._by_id = dict(zip((plan.node_id for plan in plans), self._nodes, strict=True))
        self._routes: Mapping[int, Callable[[bytes], None]] = {
            cob_id: handler for node in self._nodes for cob_id, handler in node.routes().items()
        }
        self._tasks = asyncio.TaskGroup()
        self._lives: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        await self._tasks.__aenter__()
        self._lives = [self._tasks.create_task(node.live()) for node in self._nodes]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._network.closed = True
        for node, life in zip(self._nodes, self._lives, strict=True):
            node.interrupt_sdo()
            life.cancel()
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
        for node in self._nodes:
            node.on_bus_state(up, reason)

    def distrust(self, reason: str) -> None:
        """Frames of this bus were missed, perhaps a boot-up message: every node is identified again."""
        for node in self._nodes:
            node.distrust(reason)

    def distrust_node(self, node_id: int, reason: str) -> None:
        """Frames of this node cast doubt on it: it is identified again."""
        self._by_id[node_id].distrust(reason)

    @property
    def cob_ids(self) -> frozenset[int]:
        """The COB-IDs that the master listens to."""
        return frozenset(self._routes)
