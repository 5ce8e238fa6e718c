"""The life of one CANopen node: identify, configure, read back, start, watch, take out, bring back.

Rules of this file: a node is in service only after the mapping that it reads back was the planned one, and only
while it proves that it lives: by heartbeats that say OPERATIONAL or, where it has none, by its answers. Whatever
may have changed the node (boot-up, EMCY, silence, bus down, another master's write) takes it out of service first
and then brings it up from the beginning, identity included. Every deadline is on the monotonic clock.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.bus import backoff_s
from trueangle.core.clash import HeartbeatWatch
from trueangle.core.frames import NodePlan, PolledObject, Quantity, slot_of
from trueangle.core.node_setup import Address, NodeReport, NodeState, SdoWrite, shown
from trueangle.edges.can_master.bring_up import BringUp
from trueangle.edges.can_master.node_log import OTHER_MASTER, NodeLog
from trueangle.edges.can_master.sdo import (
    SDO_REPLY_BASE,
    SDO_REQUEST_BASE,
    FrameSender,
    MasterTiming,
    SdoPort,
)
from trueangle.errors import LinkError, NodeClash, NodeFault, NodeSilent

NMT_COB_ID, EMCY_BASE, HEARTBEAT_BASE = 0x000, 0x080, 0x700
NMT_START, NMT_PRE_OPERATIONAL = 0x01, 0x80
STATE_BOOT_UP, STATE_OPERATIONAL = 0x00, 0x05
CLASH_ADVICE = "give each unit an id of its own, or end the other master"


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeListener:
    """Whom a node's life is told to, on the loop."""

    on_report: Callable[[NodeReport], None]
    """At each change of state."""
    accept: Callable[[EncoderSettings], list[str]]
    """The differences for which its angle must not be corrected; empty accepts."""
    on_value: Callable[[int, Quantity, int, int], None]
    """Slot, quantity, value and monotonic time in ns of what was polled."""
    on_alive: Callable[[int], None]
    """Monotonic time in ns of a proof that the node in service lives."""


class NodeSupervisor:
    """The life cycle of one node, as one task."""

    def __init__(
        self, plan: NodePlan, sdo: SdoPort, bus: FrameSender, *, listener: NodeListener, timing: MasterTiming
    ) -> None:
        self._plan, self._sdo, self._bus = plan, sdo, bus
        self._listener, self._timing = listener, timing
        self._steps = BringUp(plan, self._upload, self._write)
        self._log = NodeLog(plan)
        self._bus_up = asyncio.Event()
        self._stirred = asyncio.Event()
        """A heartbeat came, or the present attempt is to end."""
        self._retry_now = asyncio.Event()
        """The node or its bus came back: no reason to wait any longer."""
        self._disturbance: LinkError | NodeFault | None = None
        self._remote_state: int | None = None
        self._heartbeat_s = 0.0
        """When the last heartbeat came, or began to be waited for."""
        self._heartbeats: HeartbeatWatch | None = None
        self._settings: EncoderSettings | None = None
        self._silent = False
        """It left service for silence, and has not answered since."""
        self._serving_since_s: float | None = None
        self._failures = 0
        self._reported: NodeReport | None = None

    def routes(self) -> dict[int, Callable[[bytes], None]]:
        """COB-ID to handler of what this node, or another master to it, sends beside process data."""
        node_id = self._plan.node_id
        return {
            EMCY_BASE + node_id: self._on_emergency,
            SDO_REPLY_BASE + node_id: self._on_sdo_reply,
            SDO_REQUEST_BASE + node_id: self._on_foreign_request,
            HEARTBEAT_BASE + node_id: self._on_heartbeat,
        }

    def on_bus_state(self, up: bool, reason: str) -> None:
        """The node is lost with its bus, and tried again when the bus is back."""
        if up:
            self._bus_up.set()
            self._retry_now.set()
        else:
            self._bus_up.clear()
            self._disturb(NodeSilent(f"bus down: {reason}"))

    def distrust(self, reason: str) -> None:
        """Something the node said may have been missed: take it out of service and identify it again."""
        self._retry_now.set()
        self._disturb(LinkError(reason))

    def close(self) -> None:
        """End the transfer that a worker thread waits for, and begin no other."""
        self._sdo.close()

    async def live(self) -> None:
        """Bring the node up, watch it, take it out, and begin again; until cancelled."""
        while True:
            await self._bus_up.wait()
            self._disturbance = self._remote_state = self._settings = self._serving_since_s = None
            self._heartbeats = None
            self._retry_now.clear()
            begun_s = time.monotonic()
            try:
                await self._bring_up()
                await self._watch(await self._start_polling())
            except (LinkError, NodeFault) as error:
                self._take_out(error)
            await self._pause(begun_s + self._timing.backoff_first_s)
            self._log.tick(time.monotonic(), self._timing.other_master_quiet_s)

    async def _bring_up(self) -> None:
        steps = self._steps
        self._report(NodeState.IDENTIFYING)
        self._sdo.begin()
        self._nmt(NMT_PRE_OPERATIONAL)
        settings = self._settings = await steps.identify()
        await steps.check_health()
        self._report(NodeState.CONFIGURING)
        await steps.configure()
        await steps.verify()
        self._report(NodeState.STARTING)
        self._remote_state = None
        self._nmt(NMT_START)
        if steps.heartbeat_ms is not None:
            await self._confirm_operational(steps.heartbeat_ms)
            self._heartbeats = HeartbeatWatch(steps.heartbeat_ms)
        differences = self._listener.accept(settings)
        self._serving_since_s = time.monotonic()
        self._report(NodeState.REFUSED if differences else NodeState.RUNNING, "; ".join(differences))

    async def _confirm_operational(self, heartbeat_ms: int) -> None:
        limit_s = self._heartbeat_limit_s(heartbeat_ms)
        try:
            async with asyncio.timeout(limit_s):
                while self._remote_state != STATE_OPERATIONAL:
                    await self._stir()
                self._raise_disturbance()
        except TimeoutError:
            if self._remote_state is None:
                raise LinkError(f"no heartbeat for {limit_s:g} s after NMT start") from None
            raise NodeFault(
                f"NMT start not obeyed: heartbeat says state 0x{self._remote_state:02X}, expected 0x05"
            ) from None
        self._heartbeat_s = time.monotonic()

    async def _start_polling(self) -> list[tuple[PolledObject, float]]:
        """Read every polled object once; those to be read again, with the monotonic time when they are due."""
        due: list[tuple[PolledObject, float]] = []
        for polled in self._plan.polls:
            await self._poll(polled)
            if polled.period_ms is not None:
                due.append((polled, time.monotonic() + polled.period_ms / 1000))
        return due

    async def _watch(self, polls: list[tuple[PolledObject, float]]) -> NoReturn:
        heartbeat_ms = self._steps.heartbeat_ms
        limit_s = None if heartbeat_ms is None else self._heartbeat_limit_s(heartbeat_ms)
        check_every_s = self._timing.phase_check_s if limit_s is not None else self._plan.heartbeat_ms / 1000
        check_s = time.monotonic() + check_every_s
        while True:
            due_s = min([check_s, *(at_s for _, at_s in polls)])
            if limit_s is not None:
                due_s = min(due_s, self._heartbeat_s + limit_s)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(0.0, due_s - time.monotonic())):
                    await self._stir()
            now_s = time.monotonic()
            self._log.tick(now_s, self._timing.other_master_quiet_s)
            if limit_s is not None and now_s >= self._heartbeat_s + limit_s:
                raise NodeSilent(f"no heartbeat for {limit_s:g} s")
            for i, (polled, at_s) in enumerate(polls):
                if now_s >= at_s and polled.period_ms is not None:
                    await self._poll(polled)
                    polls[i] = (polled, now_s + polled.period_ms / 1000)
            if now_s >= check_s:
                await self._check_unchanged()
                check_s = time.monotonic() + check_every_s

    async def _check_unchanged(self) -> None:
        assert self._settings is not None  # noqa: S101 - a node is watched after it was identified
        await self._steps.check_unchanged(self._settings)
        if self._steps.heartbeat_ms is None:
            await self._steps.check_health()
            self._listener.on_alive(time.monotonic_ns())

    async def _poll(self, polled: PolledObject) -> None:
        asked_ns = time.monotonic_ns()
        number = await self._steps.poll(polled)
        # As old as the question: the node sampled it at some time between the two.
        self._listener.on_value(slot_of(self._plan, polled.value), polled.value.quantity, number, asked_ns)

    async def _pause(self, earliest_s: float) -> None:
        """Wait before the next attempt; a boot-up message, an error reset or the bus's return cut it short.

        Not to less than `earliest_s`: a node that stirs all the time must not make the master flood the bus.
        """
        pause_s = backoff_s(self._failures, self._timing.backoff_first_s, self._timing.backoff_limit_s)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._retry_now.wait()
        await asyncio.sleep(max(0.0, earliest_s - time.monotonic()))

    def _heartbeat_limit_s(self, heartbeat_ms: int) -> float:
        return self._timing.heartbeat_periods * heartbeat_ms / 1000

    async def _stir(self) -> None:
        await self._stirred.wait()
        self._stirred.clear()
        self._raise_disturbance()

    async def _upload(self, address: Address) -> bytes | None:
        try:
            value = await self._sdo.upload(address)
        except (LinkError, NodeFault):
            self._raise_disturbance()
            raise
        self._raise_disturbance()
        return value

    async def _write(self, write: SdoWrite) -> None:
        try:
            await self._sdo.write(write)
        except (LinkError, NodeFault):
            self._raise_disturbance()
            raise
        self._raise_disturbance()

    def _raise_disturbance(self) -> None:
        if self._disturbance is not None:
            raise self._disturbance

    def _disturb(self, error: LinkError | NodeFault) -> None:
        """End the present attempt. A node in service is out of it before this returns: its next frame may lie."""
        if self._disturbance is None:
            self._disturbance = error
            if not isinstance(error, NodeSilent):
                self._silent = False
            if self._serving_since_s is not None:
                self._silent = isinstance(error, NodeSilent)
                self._report(_state_after(error), str(error))
        self._stirred.set()
        self._sdo.interrupt()

    def _nmt(self, command: int) -> None:
        self._bus.send(NMT_COB_ID, bytes((command, self._plan.node_id)))

    def _on_sdo_reply(self, data: bytes) -> None:
        if self._sdo.on_reply(data):
            reason = f"SDO answers that nobody asked for: two nodes have id {self._plan.node_id}"
            self._disturb(NodeClash(f"{reason}; {CLASH_ADVICE}"))

    def _on_foreign_request(self, data: bytes) -> None:
        """Another master, a service tool: what it reads harms nothing, what it writes may move the phase."""
        if not self._sdo.is_foreign(data):
            return
        address = shown((int.from_bytes(data[1:3], "little"), data[3]))
        self._log.other_master(address, time.monotonic())
        if self._sdo.on_request(data):
            # No reason to try again at once: it is seldom done after one object.
            self._disturb(LinkError(f"{OTHER_MASTER} writes to the node ({address})"))

    def _on_heartbeat(self, data: bytes) -> None:
        if len(data) != 1:
            return
        state = data[0] & 0x7F  # bit 7 is the toggle bit of node guarding
        if state == STATE_BOOT_UP:
            self._retry_now.set()
            self._disturb(LinkError("rebooted (boot-up message)"))
            return
        serving = self._serving_since_s is not None and self._disturbance is None
        if serving and state != STATE_OPERATIONAL:
            self._disturb(LinkError(f"left OPERATIONAL: heartbeat says state 0x{state:02X}"))
            return
        now_ns = time.monotonic_ns()
        if self._heartbeats is not None and self._heartbeats.on_heartbeat(now_ns):
            self._disturb(NodeClash(f"heartbeats come twice as often as 0x1017 says: two nodes; {CLASH_ADVICE}"))
            return
        self._remote_state = state
        self._heartbeat_s = now_ns * 1e-9
        self._stirred.set()
        if serving:
            self._listener.on_alive(now_ns)

    def _on_emergency(self, data: bytes) -> None:
        """EMCY (CiA 301, 7.2.7): error code UNSIGNED16, error register UNSIGNED8, 5 bytes of the maker's."""
        code = int.from_bytes(data[:2], "little") if len(data) >= 2 else None
        if code == 0:
            self._retry_now.set()
            return
        self._log.emergencies += 1
        self._disturb(NodeFault(f"EMCY {data.hex(' ')}" + ("" if code is None else f" (code 0x{code:04X})")))

    def _take_out(self, error: LinkError | NodeFault) -> None:
        now_s = time.monotonic()
        if self._serving_since_s is not None:
            self._silent = isinstance(error, NodeSilent)
            if now_s - self._serving_since_s > self._timing.stable_s:
                self._failures = 0
            self._serving_since_s = None
        self._failures += 1
        self._report(_state_after(error), str(error))

    def _report(self, state: NodeState, reason: str = "") -> None:
        if state not in (NodeState.LOST, NodeState.IDENTIFYING):
            self._silent = False
        report = NodeReport(
            state=state, settings=self._settings, reason=reason, silent=self._silent, head=self._plan.head
        )
        if report != self._reported:
            self._reported = report
            self._log.tell(report, self._failures)
            self._listener.on_report(report)


def _state_after(error: LinkError | NodeFault) -> NodeState:
    if isinstance(error, NodeClash):
        return NodeState.CLASH
    return NodeState.FAULT if isinstance(error, NodeFault) else NodeState.LOST
