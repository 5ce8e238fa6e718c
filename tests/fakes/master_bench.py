"""A CANopen master with one device made of bytes, over a bus that is a function call."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace

from tests.fakes.canopen_device import FakeDevice

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.edges.can_master import CanMaster, MasterTiming
from trueangle.errors import LinkError

NODE_ID, SLOT = 5, 3
PLAN = NodePlan(
    slot=SLOT,
    node_id=NODE_ID,
    heartbeat_ms=10_000,
    tpdos=(
        TpdoPlan(
            number=1,
            cob_id=0x185,
            transmission_type=1,
            mapping=(
                MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION),
                MappedObject(index=0x2100, subindex=0, bits=16, quantity=Quantity.SEQUENCE),
            ),
        ),
    ),
)
BRISK = MasterTiming(sdo_timeout_s=5.0, sdo_attempts=2, backoff_first_s=0.01, backoff_limit_s=0.02)
"""Nothing times out on a loaded machine while the device answers ..."""
HASTY = replace(BRISK, sdo_timeout_s=0.05)
"""... and this is for devices that do not."""
LIMIT_S = 10.0


@dataclass
class Bench:
    """A bus with one device and the master's reports."""

    device: FakeDevice
    master: CanMaster
    reports: asyncio.Queue[tuple[int, NodeReport]]
    seen: list[NodeReport] = field(default_factory=list[NodeReport])
    values: list[tuple[int, Quantity, int]] = field(default_factory=list[tuple[int, Quantity, int]])
    """Slot, quantity and value of what was polled."""
    alive: list[int] = field(default_factory=list[int])
    """Node ids that proved their life."""

    async def until_true(self, true: Callable[[], bool]) -> None:
        """Wait for something that no report tells."""
        async with asyncio.timeout(LIMIT_S):
            while True:
                if true():
                    return
                await asyncio.sleep(0.001)

    async def until(self, state: NodeState) -> NodeReport:
        """The next report of this state; those passed over are kept in `seen`."""
        async with asyncio.timeout(LIMIT_S):
            while True:
                slot, report = await self.reports.get()
                assert slot == SLOT
                self.seen.append(report)
                if report.state is state:
                    return report


class LoopBus:
    """Carries the master's frames to the device, and the device's back on the loop, in order."""

    def __init__(self) -> None:
        self.device: FakeDevice | None = None
        self.broken = False

    def send(self, can_id: int, data: bytes) -> None:
        if self.broken:
            raise LinkError("bus test: down")
        assert self.device is not None
        self.device.handle(can_id, data)


@asynccontextmanager
async def bench(
    *,
    plan: NodePlan = PLAN,
    accept: Callable[[int, EncoderSettings], list[str]] = lambda slot, settings: [],
    timing: MasterTiming = BRISK,
    device: dict[str, object],
) -> AsyncIterator[Bench]:
    loop = asyncio.get_running_loop()
    bus = LoopBus()
    reports: asyncio.Queue[tuple[int, NodeReport]] = asyncio.Queue()
    values: list[tuple[int, Quantity, int]] = []
    alive: list[int] = []
    master = CanMaster(
        bus,
        [plan],
        on_node=lambda slot, report: reports.put_nowait((slot, report)),
        accept=accept,
        on_sensor=lambda _, report: None if plan.slot else reports.put_nowait((SLOT, report)),
        on_value=lambda slot, quantity, value, _: values.append((slot, quantity, value)),
        on_alive=lambda node_id, _: alive.append(node_id),
        timing=timing,
    )
    bus.device = FakeDevice(
        NODE_ID,
        lambda can_id, data: loop.call_soon_threadsafe(master.notify, can_id, data) and None,
        **device,  # pyright: ignore[reportArgumentType] - keyword arguments of FakeDevice
    )
    async with master:
        master.on_bus_state(True, "open")
        yield Bench(bus.device, master, reports, values=values, alive=alive)


def run(scenario: Callable[[], object]) -> None:
    asyncio.run(scenario())  # pyright: ignore[reportArgumentType]
    assert not [t.name for t in threading.enumerate() if t.name.startswith("sdo")]


def with_sequence_object(**more: object) -> dict[str, object]:
    return {"objects": {(0x2100, 0): (0, 2)}, **more}
