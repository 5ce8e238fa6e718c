"""One bus with its master, between what comes in by it and the arrangement in force.

A line outlives an arrangement as long as the bus has the same settings: frames, bus and nodes go on, only where
they are told changes.
"""

from contextlib import AsyncExitStack
from types import TracebackType
from typing import Self

from trueangle.config import BusConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import NodePlan, Quantity
from trueangle.core.health import ServiceBit
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.core.pipeline import Frame
from trueangle.edges.can_bus import BusCounters, CanBus
from trueangle.edges.can_master import CanMaster
from trueangle.service.arrangement import Arrangement


class BusLine:
    """See the module's docstring; `async with` opens the bus and runs its nodes."""

    def __init__(self, settings: BusConfig, arrangement: Arrangement) -> None:
        self.settings = settings
        self.up = False
        self._arrangement: Arrangement | None = arrangement
        """None: the bus is about to be closed, and nothing of it counts any more."""
        self._dropped = 0
        self._plans = {plan.node_id: plan for plan in arrangement.plans(settings.name)}
        self._bus = CanBus(
            settings, on_frames=self._on_frames, on_bus_state=self._on_bus_state, on_sync=self._on_sync
        )
        self._master = CanMaster(
            self._bus,
            list(self._plans.values()),
            on_node=self._on_node,
            accept=self._accept,
            accept_head=self._accept_head,
            on_sensor=self._on_sensor,
            on_value=self._on_value,
            on_alive=self._on_alive,
        )
        self._bus.listen_to(self._master.cob_ids | arrangement.process_data(settings.name))
        self._open = AsyncExitStack()

    async def __aenter__(self) -> Self:
        await self._open.enter_async_context(self._master)
        await self._open.enter_async_context(self._bus)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._open.__aexit__(kind, error, trace)

    @property
    def counters(self) -> BusCounters:
        """What happened on the bus since it was first opened."""
        return self._bus.counters

    def rearrange(self, arrangement: Arrangement, kept: frozenset[int]) -> None:
        """Tell this arrangement from now on; nodes that serve only slots in `kept` go on, others begin."""
        self._arrangement = arrangement
        plans = {plan.node_id: plan for plan in arrangement.plans(self.settings.name)}
        staying = {
            node_id for node_id, plan in plans.items() if self._plans.get(node_id) == plan and plan.slots <= kept
        }
        self._rearrange_nodes(plans, staying)
        self._bus.listen_to(self._master.cob_ids | arrangement.process_data(self.settings.name))
        for node_id in plans.keys() - staying:
            # Until it reports: of what it said to the arrangement before, nothing counts.
            unknown = NodeReport(state=NodeState.UNKNOWN, head=plans[node_id].head)
            arrangement.on_sensor(self.settings.name, node_id, unknown)
            slot = plans[node_id].slot
            if slot is not None:
                arrangement.on_node(slot, unknown)

    def detach(self) -> None:
        """Nothing that comes by this bus counts any more, its nodes are left alone; it stays to be closed."""
        self._arrangement = None
        self._rearrange_nodes({}, set())

    def _rearrange_nodes(self, plans: dict[int, NodePlan], staying: set[int]) -> None:
        self._master.rearrange(
            leaving=self._plans.keys() - staying,
            coming=[plan for node_id, plan in plans.items() if node_id not in staying],
        )
        self._plans = plans

    def distrust_node(self, node_id: int, reason: str) -> None:
        """Frames of this node cast doubt on it: it is identified again."""
        self._master.distrust_node(node_id, reason)

    def service_bits(self, now_ns: int) -> ServiceBit:
        """What speaks against the bus although it is open; asked from time to time."""
        return self._bus.service_bits(now_ns)

    def _on_frames(self, frames: list[Frame]) -> None:
        arrangement, master, name = self._arrangement, self._master, self.settings.name
        if arrangement is None:
            return
        dropped = self._bus.counters.frames_dropped
        if dropped > self._dropped:
            # Among them may have been the boot-up message of a node that now sends another mapping.
            master.distrust(f"{dropped - self._dropped} frames of the bus were dropped")
            self._dropped = dropped
        process_data = arrangement.process_data(name)
        for cob_id, data, _ in frames:
            if cob_id not in process_data:
                master.notify(cob_id, data)
        arrangement.on_frames(name, frames)

    def _on_sync(self, stamp_ns: int) -> None:
        if self._arrangement is not None:
            self._arrangement.on_sync(self.settings.name, stamp_ns)

    def _on_bus_state(self, up: bool, reason: str) -> None:
        self.up = up
        if self._arrangement is not None:
            self._master.on_bus_state(up, reason)
            self._arrangement.on_bus_state(self.settings.name, up=up, reason=reason)

    def _on_node(self, slot: int, report: NodeReport) -> None:
        if self._arrangement is not None:
            self._arrangement.on_node(slot, report)

    def _on_sensor(self, node_id: int, report: NodeReport) -> None:
        if self._arrangement is not None:
            self._arrangement.on_sensor(self.settings.name, node_id, report)

    def _on_value(self, slot: int, quantity: Quantity, value: int, stamp_ns: int) -> None:
        if self._arrangement is not None:
            self._arrangement.pipeline.on_value(slot, quantity, value, stamp_ns)

    def _on_alive(self, node_id: int, stamp_ns: int) -> None:
        if self._arrangement is not None:
            self._arrangement.pipeline.on_alive(self.settings.name, node_id, stamp_ns)

    def _accept(self, slot: int, settings: EncoderSettings) -> list[str]:
        if self._arrangement is None:
            return ["the bus is being closed"]
        return self._arrangement.accept(slot, settings)

    def _accept_head(self, slot: int, head: int, settings: EncoderSettings) -> list[str]:
        if self._arrangement is None:
            return ["the bus is being closed"]
        return self._arrangement.accept_head(slot, head, settings)
