"""Shafts that turn, nodes that read them well or badly, and a pipeline held to the shafts' own angle.

Nothing that is served as VALID may be an angle that the joint has not had since the sample of which the age is
told. The truth is kept here and never asked of the daemon; what happens to frames, nodes, temperatures, models,
zeros, SYNC and the daemon's own time is drawn at random.
"""

import datetime
import math
import random
import struct
from collections import Counter
from collections.abc import Callable

from tests.fakes.register_values import joint_identity
from tests.fuzz.true_joints import (
    ARCSEC,
    ECCENTRICITY_ARCSEC,
    FASTEST_DEG_S,
    MS,
    PER_REV,
    PERIOD_NS,
    Head,
    Joint,
    Shaft,
    correction_arcsec,
)

from trueangle.contract.metadata import Interval
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.health import Limits, NodeCondition, StatusBit
from trueangle.core.pipeline import Frame, HeadChannel, JointChannel, Pipeline
from trueangle.core.position import Mechanics, MotionLimits
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.core.sample import SampleScale
from trueangle.core.serving import ServingPolicy, WhenNotValid
from trueangle.core.temperature_watch import TemperatureLimits

MOTION = MotionLimits(max_speed_deg_s=360.0)
STALE_MS, HOLD_MS, TEMPERATURE_STALE_S = 50.0, 200.0, 2.0
TOLERANCE_DEG = 2 * ARCSEC
"""A count or two, the rounding of registers, what the temperature drifts within its own limit of age."""
TRANSIT_NS = 300_000
"""Sampling to arrival of a node that sends by itself."""
MARKER = -(2**31)
CALIBRATED = datetime.date(2028, 1, 1)
DUE = datetime.date(2030, 1, 1)
_FAST = struct.Struct(">IHiiihHH")
_LICENCES = StatusBit.VALID | StatusBit.HELD | StatusBit.RAW_SERVED
_OUT = (NodeCondition.NOT_READY, NodeCondition.SILENT, NodeCondition.FAULT, NodeCondition.ID_CLASH)


class TruthFuzz:
    """A pipeline for ever; `some_time` is one period and whatever else happens in it."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._now_ns = self._start_ns = 10**12
        self.joints = [self._joint(slot) for slot in (1, 2, 3)]
        self._today, self._day_changed_ns = datetime.date(2029, 1, 1), 0
        self._waiting: list[tuple[int, int, bytes]] = []
        """Arrival, COB-ID and data of what the daemon has not read."""
        self._until: dict[str, int] = {}
        """What holds for a while, and how long."""
        self._bus_up = True
        self._periods = 0
        self.served: Counter[str] = Counter()
        self._valid_since_ns = dict.fromkeys((joint.slot for joint in self.joints), 0)
        self.pipeline = self._new_pipeline()
        self._in_service(self.joints)

    def _joint(self, slot: int) -> Joint:
        rng = self._rng
        way = rng.choice(list(WhenNotValid))
        policy = ServingPolicy(
            when_not_valid=way,
            hold_ms=HOLD_MS if way is WhenNotValid.HOLD else 0.0,
            latency_max_ms=rng.choice((None, 10.0)),
        )
        gear = (
            rng.choice(((1, 1, PER_REV), (1, 1, 16 * PER_REV), (5, 2, 20 * PER_REV)))
            if slot == 2
            else (1, 1, PER_REV)
        )
        mechanics = Mechanics(
            direction=rng.choice((1, -1)),
            motor_turns=gear[0],
            joint_turns=gear[1],
            range_counts=gear[2],
            motion=MOTION,
        )
        heads = [Head(10 * slot, 0, 0.0)]
        if slot == 1:
            heads += [Head(10 * slot + k, k, 360.0 * k / 2) for k in range(1, 2)]
        shaft = Shaft(rng, self._start_ns)
        return Joint(slot, shaft, heads, policy, mechanics, by_timer=slot == 3, with_sequence=slot == 2)

    def _plan(self, joint: Joint, head: Head) -> NodePlan:
        mapping = [MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)]
        if joint.with_sequence:
            mapping.append(MappedObject(index=0x2100, subindex=0, bits=8, quantity=Quantity.SEQUENCE))
        kind = 255 if joint.by_timer else 1
        tpdos = [TpdoPlan(number=1, cob_id=0x180 + head.node_id, transmission_type=kind, mapping=tuple(mapping))]
        if head.number == 0:
            warm = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE, signed=True)
            tpdos.append(TpdoPlan(number=2, cob_id=0x280 + head.node_id, transmission_type=10, mapping=(warm,)))
        return NodePlan(
            slot=joint.slot, node_id=head.node_id, heartbeat_ms=100, tpdos=tuple(tpdos), head=head.number
        )

    def _channel(self, joint: Joint) -> JointChannel:
        scale = SampleScale(
            counts_per_rev=PER_REV,
            degc_per_unit=0.01,
            offset_c=0.0,
            sequence_modulus=256 if joint.with_sequence else None,
            synchronous=not joint.by_timer,
            mechanics=joint.mechanics,
            temperature=TemperatureLimits(max_rate_c_per_s=1.0),
        )
        return JointChannel(
            slot=joint.slot,
            bus="arm",
            plan=self._plan(joint, joint.heads[0]),
            scale=scale,
            limits=Limits(
                stale_ms=STALE_MS,
                temperature_stale_s=TEMPERATURE_STALE_S,
                sensor_range_c=Interval(minimum=-55, maximum=125),
                model_angle_deg=Interval(minimum=0, maximum=360),
                model_temperature_c=Interval(minimum=10, maximum=60),
                max_uncertainty_arcsec=200.0,
            ),
            model=joint.model,
            policy=joint.policy,
            further_heads=tuple(
                HeadChannel(plan=self._plan(joint, head), scale=scale, mounting_deg=head.mounting_deg)
                for head in joint.heads[1:]
            ),
            calibrated=CALIBRATED,
            calibration_due=DUE,
        )

    def _new_pipeline(self) -> Pipeline:
        return Pipeline(
            [self._channel(joint) for joint in self.joints],
            RegisterMap([joint_identity(joint.slot) for joint in self.joints]),
            publish=self._check,
            on_status=lambda slot, before, after: None,
            on_clash=lambda bus, node_id, reason: None,
            today=lambda: self._today,
        )

    def _in_service(self, joints: list[Joint]) -> None:
        self.pipeline.on_bus("arm", up=self._bus_up, now_ns=self._now_ns)
        for joint in joints:
            for head in joint.heads:
                self.pipeline.on_node(joint.slot, head.condition, self._now_ns, head=head.number)
            self.pipeline.set_user_zero(joint.slot, joint.zero_deg, self._now_ns)

    def some_time(self) -> int:
        """One period; 1."""
        for joint in self.joints:
            joint.shaft.turn()
            joint.temperature_c += self._rng.uniform(-2e-4, 2e-4)
        stalled = self._holds("stall")
        if not stalled:
            self._drain()
            self._happening()
            if not self._holds("no SYNC"):
                self.pipeline.on_sync("arm", self._now_ns)
                self._sample(by_timer=False)
        self._sample(by_timer=True)
        for part_ms in (1, 2, 2):
            self._now_ns += part_ms * MS
            if not stalled:
                if self._rng.random() < 0.3:
                    self.pipeline.tick(self._now_ns)
                self._drain()
        self._periods += 1
        return 1

    def _holds(self, name: str) -> bool:
        return self._until.get(name, 0) > self._now_ns

    def _drain(self) -> None:
        """Read what has arrived: a frame's stamp is that of its arrival, but for those that answer a SYNC."""
        here = sorted((one for one in self._waiting if one[0] <= self._now_ns), key=lambda one: one[0])
        self._waiting = [one for one in self._waiting if one[0] > self._now_ns]
        frames: list[Frame] = [
            (cob_id, data, arrived_ns if cob_id == 0x180 + 30 else self._now_ns)
            for arrived_ns, cob_id, data in here
        ]
        if frames:
            self.pipeline.on_frames("arm", frames, self._now_ns)

    def _sample(self, *, by_timer: bool) -> None:
        rng = self._rng
        for joint in self.joints:
            if joint.by_timer is not by_timer:
                continue
            for head in joint.heads:
                if not self._holds(f"dead {head.node_id}"):
                    self._send_position(joint, head)
            if self._periods % 10 == joint.slot and not self._holds(f"cold {joint.slot}"):
                value_c = joint.temperature_c if joint.glitch_c is None else joint.glitch_c
                joint.warm_values += 1
                if joint.glitch_c is not None and (joint.warm_values >= 3 or rng.random() < 0.4):
                    joint.glitch_c, joint.warm_values = None, 0
                arrives_ns = self._now_ns + 400_000
                data = struct.pack("<h", max(-32768, min(32767, round(value_c * 100))))
                self._waiting.append((arrives_ns, 0x280 + joint.heads[0].node_id, data))

    def _send_position(self, joint: Joint, head: Head) -> None:
        rng = self._rng
        data = joint.read(head, self._now_ns)
        if head.frozen is not None and joint.with_sequence:
            data = head.frozen
        head.last, kind = data, rng.random()
        arrives_ns = self._now_ns + rng.randrange(50_000, TRANSIT_NS)
        if kind < 0.01:
            return
        late = kind < 0.02 and not joint.by_timer and self._now_ns - head.since_ns > 4 * PERIOD_NS
        if late:
            arrives_ns += rng.randrange(1, 4) * PERIOD_NS
        elif kind < 0.025:
            self._waiting.append((arrives_ns, 0x180 + head.node_id, data[: rng.randrange(len(data))]))
            return
        elif kind < 0.03:
            self._waiting.append((arrives_ns, 0x180 + head.node_id, data))
        elif kind < 0.033 and self._believed(head):
            spike = (joint.counts(head, self._now_ns) + rng.randrange(PER_REV // 5, PER_REV * 4 // 5)) % PER_REV
            data = struct.pack("<I", spike) + data[4:]
        else:
            head.good_frames = 0 if head.frozen is not None else head.good_frames + 1
        head.last_frame_ns = self._now_ns
        if not joint.with_sequence:
            # One COB-ID's frames overtake each other on no bus; where they could, only a sequence number tells.
            head.arrived_ns = arrives_ns = max(arrives_ns, head.arrived_ns + 1000)
        self._waiting.append((arrives_ns, 0x180 + head.node_id, data))

    def _believed(self, head: Head) -> bool:
        """Its last samples were good and are young: what lies further off than the joint can go shows."""
        return head.good_frames > 3 and self._now_ns - head.last_frame_ns < 15 * MS

    def _happening(self) -> None:
        """Now and then something; mostly things are well."""
        rng = self._rng
        if rng.random() < 0.85:
            return
        joint = rng.choice(self.joints)
        head = rng.choice(joint.heads)
        happenings: tuple[Callable[[Joint, Head], None], ...] = (
            self._change_node,
            self._change_node,
            self._move_zero_of_node,
            self._preset,
            self._reload,
            self._spoil_model,
            self._disturb_time,
            self._disturb_temperature,
            self._change_bus,
            self._change_day,
            self._freeze,
            self._mend,
            self._mend,
            self._mend,
        )
        rng.choice(happenings)(joint, head)

    def _of(self, head: Head) -> Joint:
        return next(joint for joint in self.joints if head in joint.heads)

    def _change_node(self, joint: Joint, head: Head) -> None:
        head.condition = self._rng.choice(_OUT)
        self._tell(joint, head)

    def _tell(self, joint: Joint, head: Head) -> None:
        self.pipeline.on_node(joint.slot, head.condition, self._now_ns, head=head.number)

    def _move_zero_of_node(self, joint: Joint, head: Head) -> None:
        """By more than the joint can have moved, or with a boot-up after which it is refused."""
        if self._rng.random() < 0.5:
            head.condition = NodeCondition.NOT_READY
            self._tell(joint, head)
            head.moved_deg = self._rng.uniform(-180, 180)
            head.condition = NodeCondition.DIFFERS
            self._tell(joint, head)
        elif self._believed(head) and head.condition is NodeCondition.RUNNING:
            head.moved_deg = self._rng.choice((-1, 1)) * self._rng.uniform(60, 180)

    def _preset(self, joint: Joint, head: Head) -> None:
        del head
        joint.zero_deg = self._rng.choice((None, 0.0, self._rng.uniform(-360, 360)))
        # The truth changes with the call: images from now on are in the new frame.
        self.pipeline.set_user_zero(joint.slot, joint.zero_deg, self._now_ns)

    def _reload(self, joint: Joint, head: Head) -> None:
        """Some joints go on, others begin anew."""
        del joint, head
        kept = [one for one in self.joints if self._rng.random() < 0.6]
        anew = [one for one in self.joints if one not in kept]
        slots = {one.slot for one in kept}
        old, self.pipeline = self.pipeline, self._new_pipeline()
        nodes = [("arm", head.node_id) for one in kept for head in one.heads]
        self.pipeline.take_over(old.hand_on(), buses={"arm": self._bus_up}, slots=slots, nodes=nodes)
        for one in anew:
            for head in one.heads:
                self._forget_frames(head)
                head.condition = NodeCondition.DIFFERS if head.moved_deg else NodeCondition.RUNNING
        self._in_service(anew)

    def _forget_frames(self, head: Head) -> None:
        """What it sent before has been read when it is identified at last."""
        self._waiting = [one for one in self._waiting if one[1] & 0x7F != head.node_id]
        head.since_ns, head.good_frames = self._now_ns, 0
        joint = self._of(head)
        joint.warm_values, joint.glitch_c = 0, None

    def _spoil_model(self, joint: Joint, head: Head) -> None:
        del head
        bad = ((math.nan, 1.0), (math.inf, 1.0), (-1e9, 1.0), (5.0, 1e9), (math.nan, None), (5.0, math.nan))
        joint.model.spoilt = self._rng.choice((*bad, (5.0, -1.0), (5.0, None)))

    def _disturb_time(self, joint: Joint, head: Head) -> None:
        del joint
        name = self._rng.choice(("stall", "no SYNC", f"dead {head.node_id}"))
        self._until[name] = self._now_ns + self._rng.choice((10, 30, 60, 200, 700)) * MS

    def _disturb_temperature(self, joint: Joint, head: Head) -> None:
        del head
        if self._rng.random() < 0.5:
            joint.warm_values = 0
            self._until[f"cold {joint.slot}"] = self._now_ns + self._rng.choice((500, 1500, 2500, 4000)) * MS
        elif joint.warm_values >= 2 and joint.glitch_c is None and not self._holds(f"cold {joint.slot}"):
            # At most three values: those that lie within the rate of each other are believed again from the fifth.
            joint.warm_values = 0
            joint.glitch_c = joint.temperature_c + self._rng.choice((-90, -8, 3, 12, 30, 150, 300))

    def _change_bus(self, joint: Joint, head: Head) -> None:
        del joint, head
        up, self._bus_up = not self._bus_up, True
        for one in self.joints:
            for every in one.heads:
                every.condition = NodeCondition.SILENT
                self._tell(one, every)
        self._bus_up = up
        self.pipeline.on_bus("arm", up=self._bus_up, now_ns=self._now_ns)

    def _change_day(self, joint: Joint, head: Head) -> None:
        del joint, head
        days = (datetime.date(2027, 12, 31), datetime.date(2029, 1, 1), DUE, datetime.date(2030, 1, 2))
        self._today, self._day_changed_ns = self._rng.choice(days), self._now_ns

    def _freeze(self, joint: Joint, head: Head) -> None:
        head.frozen = head.last if joint.with_sequence and head.last else None

    def _mend(self, joint: Joint, head: Head) -> None:
        """All is well again, by the way of a node that was identified anew."""
        del head
        joint.model.spoilt = joint.glitch_c = None
        joint.zero_deg = 10.0 if joint.zero_deg is None else joint.zero_deg
        self._today, self._bus_up = datetime.date(2029, 1, 1), True
        for head in joint.heads:
            if head.condition is NodeCondition.RUNNING and not head.moved_deg and self._rng.random() < 0.8:
                head.frozen = None
                continue
            head.condition, head.moved_deg, head.frozen = NodeCondition.NOT_READY, 0.0, None
            self._tell(joint, head)
            self._forget_frames(head)
            head.condition = NodeCondition.RUNNING
        self._in_service([joint])

    def _check(self, image: RegisterImage) -> None:
        for joint in self.joints:
            self._check_joint(joint, image)

    def _check_joint(self, joint: Joint, image: RegisterImage) -> None:
        fast, detail = image.read(10 + 12 * (joint.slot - 1), 12), image.read(1000 + 100 * (joint.slot - 1), 20)
        assert fast is not None
        assert detail is not None
        bits, _, corrected_mas, *_ = _FAST.unpack(fast)
        (corrected_deg,) = struct.unpack(">d", detail[16:24])
        status, state = StatusBit(bits), self.pipeline.states[joint.slot]
        told = f"slot {joint.slot} at {(self._now_ns - self._start_ns) / MS} ms: {status!r} {state}"
        assert (corrected_mas != MARKER) == bool(status & _LICENCES), told
        licence = status & _LICENCES
        self.served[licence.name or "marker"] += 1
        if corrected_mas == MARKER:
            return
        assert state.age_ms is not None
        assert joint.zero_deg is not None, told
        age_ms = state.age_ms
        if StatusBit.VALID in status:
            assert age_ms <= STALE_MS, told
            assert self._bus_up, told
            good_day = CALIBRATED <= self._today <= DUE
            assert good_day or self._now_ns - self._day_changed_ns <= 10**9, told
            assert joint.model.spoilt is None or state.uncertainty_arcsec is not None, told
            self._hold_to_truth(joint, status, corrected_deg + joint.zero_deg, age_ms, told)
        elif StatusBit.HELD in status:
            assert joint.policy.when_not_valid is WhenNotValid.HOLD, told
            assert age_ms <= HOLD_MS, told
            self._hold_to_truth(joint, status, corrected_deg + joint.zero_deg, age_ms, told)
        else:
            assert joint.policy.when_not_valid is WhenNotValid.RAW, told

    def _hold_to_truth(self, joint: Joint, status: StatusBit, served_deg: float, age_ms: float, told: str) -> None:
        """The angle is one that the joint has had since the sample, or near where it has moved on to."""
        from_ns = self._now_ns - round(age_ms * MS) - (TRANSIT_NS if joint.by_timer else 1000)
        passed = joint.shaft.between(from_ns, self._now_ns)
        began = passed[0]
        true_deg = began + ARCSEC * correction_arcsec(began, joint.temperature_c)
        off_deg = math.remainder(served_deg - true_deg, 360.0)
        ways = [deg - began for deg in passed]
        allowed = TOLERANCE_DEG + 1e-4 * (max(ways) - min(ways))
        state = self.pipeline.states[joint.slot]
        if StatusBit.HEAD_LOST in status or StatusBit.HELD in status:
            assert state.uncertainty_arcsec is not None, told
            # A sector of 10 deg that was seen in part has more of the harmonic than is known of it.
            allowed += (state.uncertainty_arcsec + ECCENTRICITY_ARCSEC * math.radians(10)) * ARCSEC
        if StatusBit.LATENCY_COMPENSATED in status:
            allowed += 2 * FASTEST_DEG_S * age_ms * 1e-3
            self.served["compensated"] += 1
        if StatusBit.HEAD_LOST in status:
            self.served["head lost"] += 1
        assert min(ways) - allowed <= off_deg <= max(ways) + allowed, f"off {off_deg * 3600:.1f} arcsec; {told}"
