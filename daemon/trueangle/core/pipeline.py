"""One sample pipeline for all joints: frames in, one model pass a cycle, one register image out.

Rules of this file: a cycle ends when every joint that answered the last SYNC has answered this one, at the
latest at the next SYNC; between cycles `tick` renews ages and marks what has gone stale. A position was sampled
at SYNC (CiA 301, synchronous PDO), so its age counts from the SYNC that it answers (`sync_time`); where no SYNC
is seen, from its arrival. Nothing here waits, sleeps or raises for a bad joint: a joint's trouble is its status
word, the others go on.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from trueangle.core.correction import Correction, CorrectionModel, correct_one
from trueangle.core.frames import FrameLayout, NodePlan, frame_layouts
from trueangle.core.health import Evidence, Limits, NodeCondition, ServiceBit, StatusBit, judge
from trueangle.core.registers import JointState, RegisterImage, RegisterMap
from trueangle.core.sample import JointSample, SampleScale
from trueangle.core.sync_time import SyncHistory

Frame = tuple[int, bytes, int]
"""COB-ID, data, monotonic reception time in ns."""

SYNC_COB_ID = 0x080
_IN_SERVICE = (NodeCondition.RUNNING, NodeCondition.DIFFERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointChannel:
    """All that the pipeline needs to serve one joint."""

    slot: int
    bus: str
    plan: NodePlan
    scale: SampleScale
    limits: Limits
    model: CorrectionModel


class _Joint:
    """One joint at run time."""

    __slots__ = ("channel", "condition", "correction", "due", "fresh", "sample", "status")

    def __init__(self, channel: JointChannel) -> None:
        self.channel = channel
        self.sample = JointSample(channel.scale)
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
    ) -> None:
        self._joints = {channel.slot: _Joint(channel) for channel in channels}
        self._registers = registers
        self._publish = publish
        self._on_status = on_status
        self._table: dict[tuple[str, int], tuple[_Joint, FrameLayout]] = {}
        for joint in self._joints.values():
            for cob_id, layout in frame_layouts(joint.channel.plan).items():
                self._table[joint.channel.bus, cob_id] = (joint, layout)
        self._bus_up = {joint.channel.bus: False for joint in self._joints.values()}
        self._syncs = {joint.channel.bus: SyncHistory() for joint in self._joints.values()}
        self._awaited: set[int] = set()
        self.counters = PipelineCounters()
        self.last_image_ns: int | None = None
        self.service_bits = ServiceBit(0)
        """What the service itself has to tell, served with the next image."""
        self.states: Mapping[int, JointState] = {}
        """Each slot as last served."""

    def process_data(self, bus: str) -> frozenset[int]:
        """The COB-IDs on this bus that are the pipeline's; every other frame is the master's."""
        return frozenset(cob_id for name, cob_id in self._table if name == bus) | {SYNC_COB_ID}

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
                continue
            joint, layout = entry
            if len(data) != layout.length:
                self.counters.misfit_frames += 1
            elif joint.condition not in _IN_SERVICE:
                self.counters.unready_frames += 1
            elif joint.sample.take(layout, data, stamp_ns, self._syncs[bus]):
                moved = joint.due = joint.fresh = True
                self._awaited.discard(joint.channel.slot)
        if moved and not self._awaited:
            self._end_cycle(now_ns)

    def on_sync(self, bus: str, now_ns: int) -> None:
        """SYNC on this bus, sent by us or by another node: a cycle that has not ended yet ends here."""
        if self._awaited and any(joint.due for joint in self._joints.values()):
            self._end_cycle(now_ns)
        if bus not in self._syncs:
            return
        self._syncs[bus].add(now_ns)
        for slot, joint in self._joints.items():
            if joint.channel.bus == bus:
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
        if condition not in _IN_SERVICE or joint.condition not in _IN_SERVICE:
            joint.sample.forget()
            joint.correction = None
            joint.due = joint.fresh = False
            self._awaited.discard(slot)
        joint.condition = condition
        self._serve(now_ns)

    def tick(self, now_ns: int) -> None:
        """Renew ages and marks although no cycle ended."""
        self._serve(now_ns)

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
        self.states = states
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
        stamp_ns = sample.temperature_stamp_ns
        status = judge(
            Evidence(
                bus_up=self._bus_up[joint.channel.bus],
                node=joint.condition,
                age_ms=age_ms,
                raw_deg=sample.raw_deg,
                temperature_c=sample.temperature_c,
                temperature_age_s=None if stamp_ns is None else max(0.0, (now_ns - stamp_ns) * 1e-9),
                correction_arcsec=None if correction is None else correction.correction_arcsec,
            ),
            joint.channel.limits,
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

    @property
    def statuses(self) -> Mapping[int, StatusBit]:
        """The status word of each slot as last served."""
        return {slot: joint.status for slot, joint in self._joints.items()}

    def hand_on(self) -> "PipelineState":
        """What the pipeline in this one's place goes on with; this one must not be called again."""
        return PipelineState(
            joints=self._joints,
            syncs=self._syncs,
            awaited=frozenset(self._awaited),
            counters=self.counters,
            last_image_ns=self.last_image_ns,
            service_bits=self.service_bits,
        )

    def take_over(self, state: "PipelineState", *, buses: Mapping[str, bool], slots: Collection[int]) -> None:
        """Go on where another ended: with the buses that stay open, each up or not, and the joints that stay.

        Samples, corrections and the place in the cycle of a joint that stays are moved, not copied.
        """
        self.counters, self.last_image_ns = state.counters, state.last_image_ns
        self.service_bits = state.service_bits
        for bus in self._bus_up.keys() & buses.keys():
            self._bus_up[bus] = buses[bus]
            self._syncs[bus] = state.syncs.get(bus, self._syncs[bus])
        for slot in slots:
            self._joints[slot] = state.joints[slot]
        self._awaited = set(state.awaited & set(slots))
        for place, (joint, layout) in self._table.items():
            self._table[place] = (self._joints[joint.channel.slot], layout)


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineState:
    """All that a pipeline knows beside its configuration."""

    joints: Mapping[int, _Joint]
    syncs: Mapping[str, SyncHistory]
    awaited: frozenset[int]
    counters: PipelineCounters
    last_image_ns: int | None
    service_bits: ServiceBit
