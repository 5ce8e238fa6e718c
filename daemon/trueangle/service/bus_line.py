"""One bus with its master, between what comes in by it and the arrangement in force.

A line outlives an arrangement as long as the bus has the same settings: frames, bus and nodes go on, only where
they are told changes.
"""

from contextlib import AsyncExitStack
from types import TracebackType
from typing import Self

from trueangle.config import BusConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.core.carry_over import NodeKey
from trueangle.core.frames import Quantity
from trueangle.core.health import ServiceBit
from trueangle.core.node_setup import NodeReport
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
        plans = arrangement.plans(settings.name)
        self._node_ids = frozenset(plan.node_id for plan in plans)
        self._bus = CanBus(
            settings, on_frames=self._on_frames, on_bus_state=self._on_bus_state, on_sync=self._on_sync
        )
        self._master = CanMaster(
            self._bus,
            plans,
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

    def service_bits(self, now_ns: int) -> ServiceBit:
        """What speaks against the bus although it is open; asked from time to time, logs beginning and end."""
        return self._bus.service_bits(now_ns)

    def rearrange(self, arrangement: Arrangement, kept: frozenset[NodeKey]) -> None:
        """Tell this arrangement from now on; the nodes in `kept` go on, others leave or begin anew."""
        self._arrangement = arrangement
        name = self.settings.name
        staying = {node_id for bus, node_id in kept if bus == name}
        plans = arrangement.plans(name)
        coming = [plan for plan in plans if plan.node_id not in staying]
        self._master.rearrange(leaving=self._node_ids - staying, coming=coming)
        self._node_ids = frozenset(plan.node_id for plan in plans)
        self._bus.listen_to(self._master.cob_ids | arrangement.process_data(name))

    def detach(self) -> None:
        """Nothing that comes by this bus counts any more, its nodes are left alone; it stays to be closed."""
        self._arrangement = None
        self._master.rearrange(leaving=self._node_ids, coming=())
        self._node_ids = frozenset[int]()

    def distrust_node(self, node_id: int, reason: str) -> None:
        """Frames of this node cast doubt on it: it is identified again."""
        self._master.distrust_node(node_id, reason)

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
