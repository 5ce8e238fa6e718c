"""One sample pipeline for all joints: frames in, one model pass a cycle, one register image out.

Rules of this file: a cycle ends when every joint that answered the last SYNC has answered this one, at the
latest at the next SYNC; between cycles `tick` renews ages and marks what has gone stale. A position was sampled
at SYNC (CiA 301, synchronous PDO), so its age counts from the SYNC that it answers (`sync_time`); where no SYNC
is seen, from its arrival. Nothing here waits, sleeps or raises for a bad joint: a joint's trouble is its status
word, the others go on.
"""

import datetime
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from trueangle.core.calendar_day import is_past_due
from trueangle.core.frames import FrameLayout, NodePlan, Quantity, frame_layouts
from trueangle.core.health import GOOD, NodeCondition, ServiceBit, StatusBit
from trueangle.core.joint_line import HeadChannel, JointChannel, JointLine, JointReading, ReadingHead
from trueangle.core.registers import JointState, RegisterImage, RegisterMap
from trueangle.core.sensor_nodes import IN_SERVICE, SensorNodes
from trueangle.core.sync_time import SyncHistory

__all__ = [
    "Frame",
    "HeadChannel",
    "JointChannel",
    "JointReading",
    "Pipeline",
    "PipelineCounters",
    "PipelineState",
]

Frame = tuple[int, bytes, int]
"""COB-ID, data, monotonic reception time in ns."""

SYNC_COB_ID = 0x080
_NO_SYNC = SyncHistory()
"""For nodes that send by themselves: their samples have the time of their arrival."""
_VALID = int(StatusBit.VALID)
_ALL_VALID, _BUS_DOWN = int(ServiceBit.ALL_VALID), int(ServiceBit.BUS_DOWN)
DAY_CHECK_NS = 1_000_000_000
_NOT_LOGGED = StatusBit.LATENCY_COMPENSATED
"""Comes and goes with the age of a sample: a register tells it, the log does not."""


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
        on_clash: Callable[[str, int, str], None] | None = None,
        today: Callable[[], datetime.date] | None = None,
    ) -> None:
        """`sensors`: nodes that send temperatures of other joints too, each with its bus.

        `on_clash(bus, node_id, reason)` asks for a node to be identified anew: two nodes send its positions, or
        have just ceased to. `today` must never go back (`LatestDay`); without it nothing is past due.
        """
        self._joints = {channel.slot: JointLine(channel) for channel in channels}
        self._registers = registers
        self._publish = publish
        self._on_status = on_status
        self._today = today
        self._day_checked_ns: int | None = None
        self._on_clash = on_clash
        self._sensor_plans = tuple(sensors)
        self._lay_table()
        self._bus_up = dict.fromkeys((bus for bus, _ in self._sensor_plans), False)
        self._bus_up |= {joint.channel.bus: False for joint in self._joints.values()}
        self._syncs = {joint.channel.bus: SyncHistory() for joint in self._joints.values()}
        self._awaited: set[int] = set()
        self.counters = PipelineCounters()
        self.last_image_ns: int | None = None
        self.service_bits = ServiceBit(0)
        """What the service itself has to tell, served with the next image."""
        self.states: Mapping[int, JointState] = {}
        """Each slot as last served."""

    def _lay_table(self) -> None:
        """Where each COB-ID leads, from the joints as they are."""
        self._table: dict[tuple[str, int], tuple[JointLine, ReadingHead, FrameLayout]] = {}
        for joint in self._joints.values():
            plans = (joint.channel.plan, *(head.plan for head in joint.channel.further_heads))
            for head, plan in zip(joint.heads, plans, strict=True):
                for cob_id, layout in frame_layouts(plan).items():
                    if layout.slot is not None:
                        self._table[joint.channel.bus, cob_id] = (joint, head, layout)
        self._fused = [joint for joint in self._joints.values() if joint.fusion is not None]
        self._sensors = SensorNodes(
            {slot: joint.sample for slot, joint in self._joints.items()},
            [
                (
                    j.channel.temperature_bus or j.channel.bus,
                    j.channel.temperature_node or j.channel.plan.node_id,
                    slot,
                )
                for slot, j in self._joints.items()
            ],
        )
        for bus, plan in self._sensor_plans:
            self._sensors.add(bus, plan)

    def process_data(self, bus: str) -> frozenset[int]:
        """The COB-IDs on this bus that are the pipeline's; every other frame is the master's."""
        own = frozenset(cob_id for name, cob_id in self._table if name == bus)
        return own | self._sensors.cob_ids(bus) | {SYNC_COB_ID}

    def on_frames(self, bus: str, frames: Sequence[Frame], now_ns: int) -> None:
        """A batch of received frames, in order; those of other COB-IDs are passed over.

        The master must have seen its frames of the batch first: a node that says in it that it has rebooted is
        then out of service before a frame of its unknown new mapping could be decoded by the old one.
        """
        moved = False
        for place, (cob_id, data, stamp_ns) in enumerate(frames):
            if cob_id == SYNC_COB_ID:
                if moved and not self._awaited and not self._ends_again(bus, frames, place):
                    self._end_cycle(now_ns)
                self.on_sync(bus, stamp_ns)
                continue
            entry = self._table.get((bus, cob_id))
            if entry is None:
                if not self._sensors.on_frame(bus, cob_id, data, stamp_ns):
                    self.counters.misfit_frames += 1
                continue
            joint, head, layout = entry
            if len(data) != layout.length:
                self.counters.misfit_frames += 1
            elif head.condition not in IN_SERVICE:
                self.counters.unready_frames += 1
            elif head.sample.take(layout, data, stamp_ns, self._syncs[bus] if head.synchronous else _NO_SYNC):
                moved = head.fresh = True
                joint.moved()
                self._awaited.discard(head.key)
            if head.sample.two_senders:
                self._on_two_senders(joint, head, now_ns)
        if moved and not self._awaited:
            self._end_cycle(now_ns)

    def _ends_again(self, bus: str, frames: Sequence[Frame], sync_at: int) -> bool:
        """Whether another cycle ends in these frames behind this SYNC: nobody could read the one before it."""
        answered: set[int] = set()
        for place in range(sync_at + 1, len(frames)):
            cob_id = frames[place][0]
            if cob_id == SYNC_COB_ID:
                return True
            entry = self._table.get((bus, cob_id))
            if entry is not None and entry[2].position_at is not None:
                answered.add(entry[1].key)
        return all(
            head.key in answered
            for joint in self._joints.values()
            for head in joint.heads
            if joint.channel.bus == bus and head.synchronous and head.fresh
        )

    def on_sync(self, bus: str, now_ns: int) -> None:
        """SYNC on this bus, sent by us or by another node: a cycle that has not ended yet ends here."""
        if self._awaited and any(joint.due or joint.unfused for joint in self._joints.values()):
            self._end_cycle(now_ns, bus)
        if bus not in self._syncs:
            return
        self._end_clashes(now_ns)
        self._syncs[bus].add(now_ns)
        for joint in self._joints.values():
            if joint.channel.bus == bus:
                for head in joint.heads:
                    if head.synchronous:
                        self._await(joint, head, now_ns)

    def _await(self, joint: JointLine, head: ReadingHead, now_ns: int) -> None:
        """At SYNC: the cycle waits for the heads that answered the last one."""
        if head.sample.watch.on_sync():
            self._on_two_senders(joint, head, now_ns)
        if head.fresh:
            self._awaited.add(head.key)
        else:
            self._awaited.discard(head.key)
        head.fresh = False

    def on_bus(self, bus: str, *, up: bool, now_ns: int) -> None:
        """The bus was opened or lost."""
        if bus in self._bus_up and self._bus_up[bus] != up:
            self._bus_up[bus] = up
            self._end_cycle(now_ns, bus)

    def on_node(
        self, slot: int, condition: NodeCondition, now_ns: int, *, head: int = 0, range_counts: int | None = None
    ) -> None:
        """The node's life cycle moved on; a node out of service takes its samples with it.

        `head`: 0 for the joint's own node, 1 to 3 for its further ones. `range_counts`: the total range that the
        node told (0x6002), where it told one.
        """
        joint = self._joints[slot]
        reader = joint.heads[head]
        if condition not in IN_SERVICE or reader.condition not in IN_SERVICE:
            reader.sample.forget()
            reader.sample.position.set_range(range_counts or reader.sample.scale.mechanics.range_counts)
            reader.fresh = False
            self._awaited.discard(reader.key)
            reader.clash.on_service(now_ns if condition in IN_SERVICE else None)
            if joint.fusion is None or not any(other.usable for other in joint.heads if other is not reader):
                self._forget_angle(joint)
        reader.condition = condition
        if condition not in (NodeCondition.SILENT, NodeCondition.RUNNING):
            joint.served.drop_held()
        if head == 0:
            self._sensors.on_node(joint.channel.bus, joint.channel.plan.node_id, condition)
        self._serve(now_ns)

    def _forget_angle(self, joint: JointLine) -> None:
        joint.correction = None
        joint.due = joint.unfused = False
        if joint.fusion is not None:
            joint.fusion.forget()

    def set_user_zero(self, slot: int, zero_deg: float | None, now_ns: int) -> None:
        """From now on this is taken off what is served, before it is reduced to one turn; 0: nothing is.

        None: nobody knows what the user's zero is; the joint is not referenced.
        """
        served = self._joints[slot].served
        served.user_zero_deg = zero_deg or 0.0
        served.user_zero_known = zero_deg is not None
        self._serve(now_ns)

    def reading(self, slot: int) -> "JointReading":
        """The last reading of this joint, before the user's zero and before latency compensation."""
        joint = self._joints[slot]
        raw_deg, correction = joint.angle.raw_deg, joint.correction
        corrected_deg = None
        if raw_deg is not None and correction is not None:
            corrected_deg = correction.corrected_deg(raw_deg)
        return JointReading(
            valid=StatusBit.VALID in joint.status,
            raw_deg=raw_deg,
            corrected_deg=corrected_deg,
            temperature_c=joint.sample.temperature_c,
            velocity_deg_s=joint.angle.velocity_deg_s,
        )

    def user_zero_deg(self, slot: int) -> float:
        """The user zero in force; 0: none."""
        return self._joints[slot].served.user_zero_deg

    def set_referenced(self, slot: int, now_ns: int) -> None:
        """A person says that the encoder's zero is where it was at calibration."""
        for head in self._joints[slot].heads:
            head.sample.position.set_referenced()
        self._serve(now_ns)

    def clear_jump(self, slot: int, now_ns: int) -> None:
        """A person says that the position is right in spite of its jump; a lost reference stays lost."""
        for head in self._joints[slot].heads:
            head.sample.position.clear_jump()
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

    def _on_two_senders(self, joint: JointLine, head: ReadingHead, now_ns: int) -> None:
        head.sample.two_senders = False
        if head.clash.on_evidence(now_ns):
            self._ask_again(joint, head, "two nodes send its positions")

    def _end_clashes(self, now_ns: int) -> None:
        """Which of the two nodes is left is known only when it was identified again."""
        for joint in self._joints.values():
            for head in joint.heads:
                if head.clash.active and head.clash.ends(now_ns):
                    self._ask_again(joint, head, "two nodes sent its positions, one is left")

    def _ask_again(self, joint: JointLine, head: ReadingHead, reason: str) -> None:
        if self._on_clash is not None:
            self._on_clash(joint.channel.bus, head.node_id, reason)

    def _end_cycle(self, now_ns: int, bus: str | None = None) -> None:
        """Serve what there is; on `bus`, None: on any, nobody is waited for any longer."""
        kept: set[int] = set()
        for joint in self._fused:
            awaited = self._awaited.intersection(head.key for head in joint.heads)
            if awaited and bus not in (None, joint.channel.bus) and self._may_answer(joint, now_ns):
                kept |= awaited  # half a sample is none, and another bus says nothing of its other half
            else:
                joint.fuse()
        self._awaited = kept
        self.counters.cycles += 1
        self._serve(now_ns)

    def _may_answer(self, joint: JointLine, now_ns: int) -> bool:
        """Whether its bus's last SYNC is so young that its heads may still answer it."""
        last_ns = self._syncs[joint.channel.bus].last_ns
        return last_ns is not None and now_ns - last_ns <= joint.channel.limits.stale_ms * 1e6

    def _check_day(self, now_ns: int) -> None:
        if self._today is None or (
            self._day_checked_ns is not None and now_ns - self._day_checked_ns < DAY_CHECK_NS
        ):
            return
        self._day_checked_ns, today = now_ns, self._today()
        for joint in self._joints.values():
            joint.past_due = is_past_due(today, joint.channel.calibrated, joint.channel.calibration_due)

    def _serve(self, now_ns: int) -> None:
        self._check_day(now_ns)
        states: dict[int, JointState] = {}
        service = int(self.service_bits)
        all_valid = True
        for slot, joint in self._joints.items():
            joint.correct()
            bus = joint.channel.bus
            states[slot] = state = joint.state(
                now_ns, bus_up=self._bus_up[bus], last_sync_ns=self._syncs[bus].last_ns
            )
            before, joint.status = joint.status, state.status
            if before is not state.status and before != state.status and (before ^ state.status) & ~_NOT_LOGGED:
                self._on_status(slot, before, state.status)
            all_valid = all_valid and (state.status is GOOD or int(state.status) & _VALID != 0)
        if all_valid:
            service |= _ALL_VALID
        if not all(self._bus_up.values()):
            service |= _BUS_DOWN
        self.counters.images += 1
        self.last_image_ns = now_ns
        self.states = states
        self._publish(
            self._registers.image(
                cycle=self.counters.images & 0xFFFFFFFF,
                heartbeat=self.counters.cycles & 0xFFFF,
                service_status=service,
                states=states,
            )
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
            sensors=self._sensors.alive,
            counters=self.counters,
            last_image_ns=self.last_image_ns,
            service_bits=self.service_bits,
        )

    def take_over(
        self,
        state: "PipelineState",
        *,
        buses: Mapping[str, bool],
        slots: Collection[int],
        nodes: Collection[tuple[str, int]],
    ) -> None:
        """Go on where another ended: buses that stay open, each up or not, and joints and nodes that stay.

        Samples, corrections and the place in the cycle of a joint that stays are moved, not copied.
        """
        self.counters, self.last_image_ns = state.counters, state.last_image_ns
        self.service_bits = state.service_bits
        for bus in self._bus_up.keys() & buses.keys():
            self._bus_up[bus] = buses[bus]
            self._syncs[bus] = state.syncs.get(bus, self._syncs[bus])
        for slot in slots:
            self._joints[slot] = state.joints[slot]
        keys = {head.key for slot in slots for head in self._joints[slot].heads}
        self._awaited = set(state.awaited & keys)
        self._lay_table()
        self._sensors.go_on_with(state.sensors & frozenset(nodes))


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineState:
    """All that a pipeline knows beside its configuration."""

    joints: Mapping[int, JointLine]
    syncs: Mapping[str, SyncHistory]
    awaited: frozenset[int]
    """Keys of reading heads."""
    sensors: frozenset[tuple[str, int]]
    """Nodes in service that tell a temperature."""
    counters: PipelineCounters
    last_image_ns: int | None
    service_bits: ServiceBit
