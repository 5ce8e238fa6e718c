"""The life of one CANopen node: identify, configure, read back, start, watch, take out, bring back.

Rules of this file: a node is in service only while its own heartbeat says OPERATIONAL and after the mapping that
it reads back was the planned one. Whatever may have changed the node (boot-up, EMCY, silence, bus down) takes
it out of service first and then brings it up from the beginning, identity included.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from typing import NoReturn

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.bus import backoff_s
from trueangle.core.frames import NodePlan, TpdoPlan
from trueangle.core.node_setup import (
    ALARMS,
    COB_INVALID,
    ENCODER_OBJECTS,
    ERROR_REGISTER,
    HEARTBEAT_PRODUCER,
    PHASE_OBJECTS,
    PROFILE_SERIAL,
    STANDARD_TPDOS,
    Address,
    NodeReport,
    NodeState,
    SdoWrite,
    cob_address,
    readback_differences,
    settings_from,
    shown,
    tpdo_readback,
    tpdo_writes,
)
from trueangle.edges.can_master.sdo import SDO_REPLY_BASE, FrameSender, MasterTiming, SdoPort
from trueangle.errors import LinkError, NodeFault

NMT_COB_ID, EMCY_BASE, HEARTBEAT_BASE = 0x000, 0x080, 0x700
NMT_START, NMT_PRE_OPERATIONAL = 0x01, 0x80
STATE_BOOT_UP, STATE_OPERATIONAL = 0x00, 0x05

_log = logging.getLogger(__name__)


class NodeSupervisor:
    """The life cycle of one node, as one task."""

    def __init__(
        self,
        plan: NodePlan,
        sdo: SdoPort,
        bus: FrameSender,
        *,
        on_node: Callable[[int, NodeReport], None],
        accept: Callable[[int, EncoderSettings], list[str]],
        timing: MasterTiming,
    ) -> None:
        self._plan, self._sdo, self._bus = plan, sdo, bus
        self._on_node, self._accept, self._timing = on_node, accept, timing
        self._bus_up = asyncio.Event()
        self._stirred = asyncio.Event()
        """A heartbeat came, or the present attempt is to end."""
        self._retry_now = asyncio.Event()
        """The node or its bus came back: no reason to wait any longer."""
        self._disturbance: LinkError | NodeFault | None = None
        self._remote_state: int | None = None
        self._settings: EncoderSettings | None = None
        self._serving_since_s: float | None = None
        self._out_since_s = time.monotonic()
        self._failures = 0
        self._last_failure: str | None = None
        self._reported: NodeReport | None = None

    def routes(self) -> dict[int, Callable[[bytes], None]]:
        """COB-ID to handler of what this node sends beside process data."""
        node_id = self._plan.node_id
        return {
            EMCY_BASE + node_id: self._on_emergency,
            SDO_REPLY_BASE + node_id: self._sdo.on_reply,
            HEARTBEAT_BASE + node_id: self._on_heartbeat,
        }

    def on_bus_state(self, up: bool, reason: str) -> None:
        """The node is lost with its bus, and tried again when the bus is back."""
        if up:
            self._bus_up.set()
            self._retry_now.set()
        else:
            self._bus_up.clear()
            self._disturb(LinkError(f"bus down: {reason}"))

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
            self._retry_now.clear()
            try:
                await self._bring_up()
                self._serving_since_s = time.monotonic()
                await self._watch()
            except (LinkError, NodeFault) as error:
                self._take_out(error)
            await self._pause()

    async def _bring_up(self) -> None:
        plan = self._plan
        self._report(NodeState.IDENTIFYING)
        self._nmt(NMT_PRE_OPERATIONAL)
        settings = self._settings = await self._identify()
        await self._check_health()
        self._report(NodeState.CONFIGURING)
        for tpdo in plan.tpdos:
            await self._configure(tpdo)
        await self._silence_other_tpdos()
        await self._write(SdoWrite(address=HEARTBEAT_PRODUCER, value=plan.heartbeat_ms, size=2))
        await self._verify()
        self._report(NodeState.STARTING)
        self._remote_state = None
        self._nmt(NMT_START)
        await self._confirm_operational()
        differences = self._accept(plan.slot, settings)
        self._report(NodeState.REFUSED if differences else NodeState.RUNNING, "; ".join(differences))

    async def _identify(self) -> EncoderSettings:
        addresses = (*ENCODER_OBJECTS.values(), PROFILE_SERIAL)
        return settings_from({address: await self._read(address) for address in addresses})

    async def _check_health(self) -> None:
        for address, meaning in ((ERROR_REGISTER, "error register"), (ALARMS, "encoder alarms")):
            value = await self._read(address)
            if value:
                raise NodeFault(f"{meaning} {shown(address)} expected 0 found 0x{value:X}")

    async def _configure(self, tpdo: TpdoPlan) -> None:
        cob = await self._read(cob_address(tpdo.number))
        if cob is None:
            raise NodeFault(f"the node has no TPDO {tpdo.number} ({shown(cob_address(tpdo.number))} is absent)")
        for write in tpdo_writes(tpdo, cob):
            await self._write(write)

    async def _silence_other_tpdos(self) -> None:
        """A TPDO that is not planned may sit on a planned COB-ID: two senders, one of them decoded wrongly."""
        planned = {tpdo.number for tpdo in self._plan.tpdos}
        for number in STANDARD_TPDOS:
            address = cob_address(number)
            cob = None if number in planned else await self._read(address)
            if cob is not None and not cob & COB_INVALID:
                await self._write(SdoWrite(address=address, value=cob | COB_INVALID, size=4))
                if not (await self._read(address) or 0) & COB_INVALID:
                    raise NodeFault(f"unplanned TPDO {number} cannot be switched off ({shown(address)})")

    async def _verify(self) -> None:
        expected: dict[Address, int] = {HEARTBEAT_PRODUCER: self._plan.heartbeat_ms}
        for tpdo in self._plan.tpdos:
            expected |= tpdo_readback(tpdo)
        found = {address: await self._read(address) for address in expected}
        differences = readback_differences(expected, found)
        if differences:
            raise NodeFault(f"the node did not take its set-up: {'; '.join(differences)}")

    async def _confirm_operational(self) -> None:
        try:
            async with asyncio.timeout(self._heartbeat_limit_s):
                while self._remote_state != STATE_OPERATIONAL:
                    await self._stir()
                self._raise_disturbance()
        except TimeoutError:
            if self._remote_state is None:
                raise LinkError(f"no heartbeat for {self._heartbeat_limit_s:g} s after NMT start") from None
            raise NodeFault(
                f"NMT start not obeyed: heartbeat says state 0x{self._remote_state:02X}, expected 0x05"
            ) from None

    async def _watch(self) -> NoReturn:
        check_s = time.monotonic() + self._timing.phase_check_s
        while True:
            try:
                async with asyncio.timeout(self._heartbeat_limit_s):
                    await self._stir()
            except TimeoutError:
                raise LinkError(f"no heartbeat for {self._heartbeat_limit_s:g} s") from None
            if time.monotonic() >= check_s:
                await self._check_phase()
                check_s = time.monotonic() + self._timing.phase_check_s

    async def _check_phase(self) -> None:
        """Another tool may preset or rescale the encoder while it runs; no frame would tell."""
        assert self._settings is not None  # noqa: S101 - a node is watched after it was identified
        for name in PHASE_OBJECTS:
            before, now = getattr(self._settings, name), await self._read(ENCODER_OBJECTS[name])
            if now != before:
                raise NodeFault(f"{name} was changed in service from {before} to {now}")

    async def _pause(self) -> None:
        """Wait before the next attempt; a boot-up message, an error reset or the bus's return cut it short."""
        pause_s = backoff_s(self._failures, self._timing.backoff_first_s, self._timing.backoff_limit_s)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._retry_now.wait()

    @property
    def _heartbeat_limit_s(self) -> float:
        return self._timing.heartbeat_periods * self._plan.heartbeat_ms / 1000

    async def _stir(self) -> None:
        await self._stirred.wait()
        self._stirred.clear()
        self._raise_disturbance()

    async def _read(self, address: Address) -> int | None:
        try:
            value = await self._sdo.read(address)
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
            if self._serving_since_s is not None:
                self._report(_state_after(error), str(error))
        self._stirred.set()
        self._sdo.interrupt()

    def _nmt(self, command: int) -> None:
        self._bus.send(NMT_COB_ID, bytes((command, self._plan.node_id)))

    def _on_heartbeat(self, data: bytes) -> None:
        if len(data) != 1:
            return
        state = data[0] & 0x7F  # bit 7 is the toggle bit of node guarding
        if state == STATE_BOOT_UP:
            self._retry_now.set()
            self._disturb(LinkError("rebooted (boot-up message)"))
        elif self._serving_since_s is not None and state != STATE_OPERATIONAL:
            self._disturb(LinkError(f"left OPERATIONAL: heartbeat says state 0x{state:02X}"))
        else:
            self._remote_state = state
            self._stirred.set()

    def _on_emergency(self, data: bytes) -> None:
        """EMCY (CiA 301, 7.2.7): error code UNSIGNED16, error register UNSIGNED8, 5 bytes of the maker's."""
        code = int.from_bytes(data[:2], "little") if len(data) >= 2 else None
        if code == 0:
            self._retry_now.set()
        else:
            self._disturb(NodeFault(f"EMCY {data.hex(' ')}" + ("" if code is None else f" (code 0x{code:04X})")))

    def _take_out(self, error: LinkError | NodeFault) -> None:
        now_s = time.monotonic()
        if self._serving_since_s is not None:
            self._out_since_s = now_s
            if now_s - self._serving_since_s > self._timing.stable_s:
                self._failures = 0
            self._serving_since_s = None
        self._failures += 1
        self._report(_state_after(error), str(error))

    def _report(self, state: NodeState, reason: str = "") -> None:
        report = NodeReport(state=state, settings=self._settings, reason=reason)
        if report != self._reported:
            self._reported = report
            self._log(report)
            self._on_node(self._plan.slot, report)

    def _log(self, report: NodeReport) -> None:
        """One line a transition; a node that fails again in the same way is not logged again."""
        node = f"slot={self._plan.slot} node_id={self._plan.node_id} state={report.state.value}"
        if report.in_service:
            out_s = time.monotonic() - self._out_since_s
            _log.info("node %s attempts=%d out_s=%.1f reason=%r", node, self._failures + 1, out_s, report.reason)
            self._last_failure = None
        elif report.state in (NodeState.LOST, NodeState.FAULT):
            if report.reason != self._last_failure:
                _log.warning("node %s reason=%r", node, report.reason)
            self._last_failure = report.reason
        elif self._failures == 0:
            _log.info("node %s", node)


def _state_after(error: LinkError | NodeFault) -> NodeState:
    return NodeState.FAULT if isinstance(error, NodeFault) else NodeState.LOST
