"""The master against a CANopen device that the project did not write: durand, skipped where it is not installed.

durand declares its mapping 0x1A00 as an array, as several makers' data sheets do.
"""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from tests.fakes.master_bench import BRISK, LIMIT_S, NODE_ID, PLAN, SLOT

from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.edges.can_master import CanMaster

durand = pytest.importorskip("durand")
datatypes = pytest.importorskip("durand.datatypes").DatatypeEnum
objects = pytest.importorskip("durand.object_dictionary")
schedulers = pytest.importorskip("durand.scheduler")

COUNTS, SEQUENCE = 1_234_567, 42


class Wire:
    """What durand calls a network, and the master's bus: both ends in one loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._subscriptions: dict[int, Callable[[int, bytes], None]] = {}
        self.to_master: Callable[[int, bytes], None] = lambda _id, _data: None
        self.process_data: list[tuple[int, bytes]] = []

    def add_subscription(self, cob_id: int, callback: Callable[[int, bytes], None]) -> None:
        self._subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id: int) -> None:
        self._subscriptions.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        """The device's frames."""
        if 0x180 <= cob_id < 0x580:
            self.process_data.append((cob_id, bytes(msg)))
        else:
            self.to_master(cob_id, bytes(msg))

    def from_master(self, can_id: int, data: bytes) -> None:
        callback = self._subscriptions.get(can_id)
        if callback is not None:
            callback(can_id, data)


class MasterEnd:
    """The master sends from worker threads too."""

    def __init__(self, wire: Wire, loop: asyncio.AbstractEventLoop) -> None:
        self._wire, self._loop = wire, loop

    def send(self, can_id: int, data: bytes) -> None:
        self._loop.call_soon_threadsafe(self._wire.from_master, can_id, data)


def encoder(wire: Wire) -> Any:
    """A CiA 406 encoder made of durand's parts."""
    node = durand.Node(wire, node_id=NODE_ID)
    dictionary = node.object_dictionary
    values = {
        0x1001: (datatypes.UNSIGNED8, 0),
        0x2100: (datatypes.UNSIGNED16, SEQUENCE),
        0x6000: (datatypes.UNSIGNED16, 4),
        0x6001: (datatypes.UNSIGNED32, 1 << 20),
        0x6002: (datatypes.UNSIGNED32, 1 << 20),
        0x6003: (datatypes.UNSIGNED32, 77),
        0x6004: (datatypes.UNSIGNED32, COUNTS),
        0x6501: (datatypes.UNSIGNED32, 1 << 20),
        0x650B: (datatypes.UNSIGNED32, 4711),
    }
    for index, (kind, value) in values.items():
        if index != 0x1001:
            dictionary[index] = objects.Variable(kind, "rw", value, name=f"object {index:X}")
    node.nmt.set_state(127)
    return node


def test_device_that_we_did_not_write_is_set_up_started_and_answers_sync() -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        schedulers.set_scheduler(schedulers.AsyncScheduler(loop))
        wire = Wire(loop)
        node = encoder(wire)
        reports: asyncio.Queue[NodeReport] = asyncio.Queue()
        master = CanMaster(
            MasterEnd(wire, loop),
            [replace(PLAN, heartbeat_ms=500)],  # durand says nothing at NMT start: the next heartbeat does
            on_node=lambda slot, report: reports.put_nowait(report) if slot == SLOT else None,
            accept=lambda *_: [],
            timing=BRISK,
        )
        wire.to_master = master.notify
        async with asyncio.timeout(LIMIT_S), master:
            master.on_bus_state(True, "open")
            while (report := await reports.get()).state is not NodeState.RUNNING:
                assert report.state not in (NodeState.FAULT, NodeState.CLASH), report.reason
            assert report.settings is not None
            assert (report.settings.preset_value, report.settings.serial_number) == (77, 4711)
            wire.from_master(0x080, b"")
            assert wire.process_data == [
                (0x180 + NODE_ID, COUNTS.to_bytes(4, "little") + SEQUENCE.to_bytes(2, "little"))
            ]
            node.object_dictionary.write(0x6003, 0, 78)  # preset behind our back
            while (report := await reports.get()).state is not NodeState.FAULT:
                pass
            assert "preset_value was changed in service from 77 to 78" in report.reason
            node.object_dictionary.write(0x1017, 0, 0)  # its heartbeat holds a timer of the loop

    asyncio.run(scenario())
