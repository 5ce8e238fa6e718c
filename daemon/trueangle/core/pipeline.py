"""One sample pipeline for all joints: frames in, one model pass a cycle, one register image out.

Rules of this file: a cycle ends when every joint that answered the last SYNC has answered this one, at the
latest at the next SYNC; between cycles `tick` renews ages and marks what has gone stale. A position was sampled
at SYNC (CiA 301, synchronous PDO), so its age counts from the SYNC that it answers (`sync_time`); where no SYNC
is seen, from its arrival. Nothing here waits, sleeps or raises for a bad joint: a joint's trouble is its status
word, the others go on.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from trueangle.core.clash import ClashLatch
from trueangle.core.correction import Correction, CorrectionModel, correct_one
from trueangle.core.frames import FrameLayout, NodePlan, Quantity, frame_layouts
from trueangle.core.health import Evidence, Limits, NodeCondition, ServiceBit, StatusBit, judge
from trueangle.core.registers import JointState, RegisterImage, RegisterMap
from trueangle.core.sample import JointSample, SampleScale
from trueangle.core.sensor_nodes import IN_SERVICE, SensorNodes
from trueangle.core.sync_time import SyncHistory

Frame = tuple[int, bytes, int]
"""COB-ID, data, monotonic reception time in ns."""

SYNC_COB_ID = 0x080
_NO_SYNC = SyncHistory()
"""For nodes that send by themselves: their samples have the time of their arrival."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointChannel:
    """All that the pipeline needs to serve one joint."""

    slot: int
    bus: str
    plan: NodePlan
    scale: SampleScale
    limits: Limits
    model: CorrectionModel
    temperature_node: int | None = None
    """The node on the same bus whose sensor it is; None: the encoder's own."""
    temperature_has_status: bool = False
    """The sensor tells a status: until it did, its temperature counts for nothing."""


class _Joint:
    """One joint at run time."""

    __slots__ = ("channel", "clash", "condition", "correction", "due", "fresh", "sample", "status", "synchronous")

    def __init__(self, channel: JointChannel) -> None:
        self.channel = channel
        self.sample = JointSample(channel.scale)
        self.synchronous = channel.scale.synchronous
        self.clash = ClashLatch()
        self.condition = NodeCondition.NOT_READY
        self.correction: Correction | None = None
        self.due = False
        """Its position has changed since the last model pass."""
        self.fresh = False
        """It answered the last SYNC, so the cycle waits for it."""
        self.status = StatusBit.CONFIGURED | StatusBit.NODE_NOT_READY


@dataclass(slots=True)
class PipelineCounters:
    """Plain integers, counted in the hot path."""

    cycles: int = 0
    images: int = 0
    misfit_frames: int = 0
    """Expected COB-ID, wrong length: never decoded."""
    unready_frames: int = 0
    """From a node that is not, or not yet again, in service."""


class Pipeline:
    """See the module's docstring. All methods run on one thread; time comes in as monotonic ns."""

    def __init__(
        self,
        channels: Iterable[JointChannel],
        registers: RegisterMap,
        *,
        publish: Callable[[RegisterImage], None],
        on_status: Callable[[int, StatusBit, StatusBit], None],
        sensors: Iterable[tuple[str, NodePlan]] = (),
        on_clash: Callable[[int, str], None] | None = None,
    ) -> None:
        """`sensors`: nodes that send temperatures of other joints too, each with its bus.

        `on_clash(slot, reason)` asks for the joint's node to be identified anew: two nodes send its positions, or
        have just ceased to.
        """
        self._joints = {channel.slot: _Joint(channel) for channel in channels}
        self._registers = registers
        self._publish = publish
        self._on_status = on_status
        self._table: dict[tuple[str, int], tuple[_Joint, FrameLayout]] = {}
        for joint in self._joints.values():
            for cob_id, layout in frame_layouts(joint.channel.plan).items():
                if layout.slot is not None:
                    self._table[joint.channel.bus, cob_id] = (joint, layout)
        self._on_clash = on_clash
        self._sensors = SensorNodes(
            {slot: joint.sample for slot, joint in self._joints.items()},
            [
                (j.channel.bus, j.channel.temperature_node or j.channel.plan.node_id, slot)
                for slot, j in self._joints.items()
            ],
        )
        for bus, plan in sensors:
            self._sensors.add(bus, plan)
        self._bus_up = {joint.channel.bus: False for joint in self._joints.values()}
        self._syncs = {joint.channel.bus: SyncHistory() for joint in self._joints.values()}
        self._awaited: set[int] = set()
        self.counters = PipelineCounters()
        self.last_image_ns: int | None = None
        self.service_bits = ServiceBit(0)
        """What the service itself has to tell, served with the next image."""

    def process_data(self, bus: str) -> frozenset[int]:
        """The COB-IDs on this bus that are the pipeline's; every other frame is the master's."""
        own = frozenset(cob_id for name, cob_id in self._table if name == bus)
        return own | self._sensors.cob_ids(bus) | {SYNC_COB_ID}

    def on_frames(self, bus: str, frames: Iterable[Frame], now_ns: int) -> None:
        """A batch of received frames, in order; those of other COB-IDs are passed over.

        The master must have seen its frames of the batch first: a node that says in it that it has rebooted is
        then out of service before a frame of its unknown new mapping could be decoded by the old one.
        """
        moved = False
        for cob_id, data, stamp_ns in frames:
            if cob_id == SYNC_COB_ID:
                self.on_sync(bus, stamp_ns)
                continue
            entry = self._table.get((bus, cob_id))
            if entry is None:
                if not self._sensors.on_frame(bus, cob_id, data, stamp_ns):
                    self.counters.misfit_frames += 1
                continue
            joint, layout = entry
            if len(data) != layout.length:
                self.counters.misfit_frames += 1
            elif joint.condition not in IN_SERVICE:
                self.counters.unready_frames += 1
            elif joint.sample.take(layout, data, stamp_ns, self._syncs[bus] if joint.synchronous else _NO_SYNC):
                moved = joint.due = joint.fresh = True
                self._awaited.discard(joint.channel.slot)
            if joint.sample.two_senders:
                self._on_two_senders(joint, now_ns)
        if moved and not self._awaited:
            self._end_cycle(now_ns)

    def on_sync(self, bus: str, now_ns: int) -> None:
        """SYNC on this bus, sent by us or by another node: a cycle that has not ended yet ends here."""
        if self._awaited and any(joint.due for joint in self._joints.values()):
            self._end_cycle(now_ns)
        if bus not in self._syncs:
            return
        self._end_clashes(now_ns)
        self._syncs[bus].add(now_ns)
        for slot, joint in self._joints.items():
            if joint.channel.bus == bus and joint.synchronous:
                if joint.sample.watch.on_sync():
                    self._on_two_senders(joint, now_ns)
                if joint.fresh:
                    self._awaited.add(slot)
                else:
                    self._awaited.discard(slot)
                joint.fresh = False

    def on_bus(self, bus: str, *, up: bool, now_ns: int) -> None:
        """The bus was opened or lost."""
        if bus in self._bus_up and self._bus_up[bus] != up:
            self._bus_up[bus] = up
            self._end_cycle(now_ns)

    def on_node(self, slot: int, condition: NodeCondition, now_ns: int) -> None:
        """The node's life cycle moved on; a node out of service takes its samples with it."""
        joint = self._joints[slot]
        if condition not in IN_SERVICE or joint.condition not in IN_SERVICE:
            joint.sample.forget()
            joint.correction = None
            joint.due = joint.fresh = False
            self._awaited.discard(slot)
            joint.clash.on_service(now_ns if condition in IN_SERVICE else None)
        joint.condition = condition
        self._sensors.on_node(joint.channel.bus, joint.channel.plan.node_id, condition)
        self._serve(now_ns)

    def on_sensor(self, bus: str, node_id: int, condition: NodeCondition, now_ns: int) -> None:
        """The life cycle of a node without an encoder moved on."""
        self._sensors.on_node(bus, node_id, condition)
        self._serve(now_ns)

    def on_value(self, slot: int, quantity: Quantity, value: int, stamp_ns: int) -> None:
        """A value of this joint was read by SDO; it is served with the next image."""
        self._joints[slot].sample.take_value(quantity, value, stamp_ns)

    def on_alive(self, bus: str, node_id: int, stamp_ns: int) -> None:
        """A node in service proved that it lives."""
        self._sensors.on_alive(bus, node_id, stamp_ns)

    def tick(self, now_ns: int) -> None:
        """Renew ages and marks although no cycle ended."""
        self._end_clashes(now_ns)
        self._serve(now_ns)

    def _on_two_senders(self, joint: _Joint, now_ns: int) -> None:
        joint.sample.two_senders = False
        if joint.clash.on_evidence(now_ns):
            self._ask_again(joint.channel.slot, "two nodes send its positions")

    def _end_clashes(self, now_ns: int) -> None:
        """Which of the two nodes is left is known only when it was identified again."""
        for slot, joint in self._joints.items():
            if joint.clash.active and joint.clash.ends(now_ns):
                self._ask_again(slot, "two nodes sent its positions, one is left")

    def _ask_again(self, slot: int, reason: str) -> None:
        if self._on_clash is not None:
            self._on_clash(slot, reason)

    def _end_cycle(self, now_ns: int) -> None:
        self._awaited.clear()
        self.counters.cycles += 1
        self._serve(now_ns)

    def _correct(self) -> None:
        """One model pass over the joints whose sample is newer than their correction."""
        for joint in self._joints.values():
            raw_deg, temperature_c = joint.sample.raw_deg, joint.sample.temperature_c
            if raw_deg is None or temperature_c is None:
                joint.correction = None
            elif joint.due or joint.correction is None:
                joint.correction = correct_one(joint.channel.model, raw_deg, temperature_c)
            joint.due = False

    def _serve(self, now_ns: int) -> None:
        self._correct()
        states: dict[int, JointState] = {}
        service = ServiceBit.ALL_VALID
        for slot, joint in self._joints.items():
            states[slot] = state = self._state(joint, now_ns)
            if StatusBit.VALID not in state.status:
                service &= ~ServiceBit.ALL_VALID
            if state.status != joint.status:
                before, joint.status = joint.status, state.status
                self._on_status(slot, before, state.status)
        if not all(self._bus_up.values()):
            service |= ServiceBit.BUS_DOWN
        self.counters.images += 1
        self.last_image_ns = now_ns
        self._publish(
            self._registers.image(
                cycle=self.counters.images & 0xFFFFFFFF,
                heartbeat=self.counters.cycles & 0xFFFF,
                service_status=int(service | self.service_bits),
                states=states,
            )
        )

    def _state(self, joint: _Joint, now_ns: int) -> JointState:
        sample, correction = joint.sample, joint.correction
        age_ms = None if sample.stamp_ns is None else max(0.0, (now_ns - sample.stamp_ns) * 1e-6)
        channel = joint.channel
        told = sample.temperature_status is not None or not channel.temperature_has_status
        stamp_ns = sample.temperature_stamp_ns if told else None
        status = judge(
            Evidence(
                bus_up=self._bus_up[channel.bus],
                node=NodeCondition.ID_CLASH if joint.clash.active else joint.condition,
                age_ms=age_ms,
                raw_deg=sample.raw_deg,
                temperature_c=sample.temperature_c,
                temperature_age_s=None if stamp_ns is None else max(0.0, (now_ns - stamp_ns) * 1e-9),
                correction_arcsec=None if correction is None else correction.correction_arcsec,
                temperature_fault=bool(sample.temperature_status),
                sync_lost=joint.synchronous and self._sync_lost(channel, age_ms, now_ns),
            ),
            channel.limits,
        )
        if StatusBit.VALID not in status:
            correction = None
        corrected_deg = None
        if correction is not None and sample.raw_deg is not None:
            corrected_deg = correction.corrected_deg(sample.raw_deg)
        return JointState(
            status=status,
            sequence=sample.sequence,
            corrected_deg=corrected_deg,
            raw_deg=sample.raw_deg,
            correction_arcsec=correction.correction_arcsec if correction is not None else None,
            temperature_c=sample.temperature_c,
            age_ms=age_ms,
            uncertainty_arcsec=correction.uncertainty_arcsec if correction is not None else None,
            velocity_deg_s=sample.velocity_deg_s,
            turns=sample.turns,
            raw_counts=sample.position_counts,
            frames_received=sample.frames_received & 0xFFFFFFFF,
            frames_lost=sample.frames_lost & 0xFFFFFFFF,
        )

    def _sync_lost(self, channel: JointChannel, age_ms: float | None, now_ns: int) -> bool:
        """SYNC has stopped, or never came and no position either."""
        stale_ms = channel.limits.stale_ms
        last_ns = self._syncs[channel.bus].last_ns
        if last_ns is None:
            return self._bus_up[channel.bus] and (age_ms is None or age_ms > stale_ms)
        return (now_ns - last_ns) * 1e-6 > stale_ms

    @property
    def statuses(self) -> Mapping[int, StatusBit]:
        """The status word of each slot as last served."""
        return {slot: joint.status for slot, joint in self._joints.items()}
