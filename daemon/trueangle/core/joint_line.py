"""One joint at run time: its reading heads, its correction, and what is served of it at one moment.

Rules of this file: `judge` decides what the status word is. Where nothing at all speaks against a joint with one
head, the same comparisons are made here first without gathering the evidence (`nothing_against`), because that is
nearly every cycle; whatever is unusual is left to `judge`.
"""

import datetime
from dataclasses import dataclass, field

from trueangle.core.clash import ClashLatch
from trueangle.core.correction import Correction, CorrectionModel, one_sample
from trueangle.core.frames import NodePlan
from trueangle.core.heads import HeadFusion
from trueangle.core.health import (
    GOOD,
    MAX_CORRECTION_ARCSEC,
    Evidence,
    Limits,
    NodeCondition,
    StatusBit,
    judge,
)
from trueangle.core.position import AngleSource
from trueangle.core.registers import JointState
from trueangle.core.sample import JointSample, SampleScale
from trueangle.core.serving import ServedJoint, ServingPolicy, in_quadrature_arcsec, moved_since_sample

FURTHER_HEAD = 64
"""Distance of the keys of a joint's heads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadChannel:
    """A further reading head of a joint, on the joint's bus."""

    plan: NodePlan
    scale: SampleScale
    mounting_deg: float
    """Its angle less that of the first head at the same place of the shaft."""


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
    """The node whose sensor it is; None: the encoder's own."""
    temperature_bus: str | None = None
    """The bus of that node; None: the joint's own."""
    temperature_has_status: bool = False
    """The sensor tells a status: until it did, its temperature counts for nothing."""
    policy: ServingPolicy = field(default_factory=ServingPolicy)
    user_zero_deg: float = 0.0
    further_heads: tuple[HeadChannel, ...] = ()
    max_head_difference_arcsec: float = 1800.0
    """Reading heads of one joint that lie further apart are not of one joint."""
    calibrated: datetime.date | None = None
    calibration_due: datetime.date | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class JointReading:
    """What was last read of one joint, for a person or a command. None: not known."""

    valid: bool
    raw_deg: float | None
    corrected_deg: float | None
    """By the model alone."""
    temperature_c: float | None
    velocity_deg_s: float | None


class ReadingHead:
    """One reading head at run time; that of most joints is their only one."""

    __slots__ = ("clash", "condition", "fresh", "key", "node_id", "sample", "synchronous")

    def __init__(self, scale: SampleScale, key: int, node_id: int) -> None:
        self.sample = JointSample(scale)
        self.synchronous = scale.synchronous
        self.clash = ClashLatch()
        self.condition = NodeCondition.NOT_READY
        self.fresh = False
        """It answered the last SYNC, so the cycle waits for it."""
        self.key = key
        """The slot for a first head, beyond all slots for a further one."""
        self.node_id = node_id

    @property
    def usable(self) -> bool:
        """Whether its angle may take part in a fused one."""
        position = self.sample.position
        trusted = position.referenced and not position.jumped and not self.clash.active
        return trusted and self.condition is NodeCondition.RUNNING


class JointLine(ReadingHead):
    """One joint at run time, its first reading head included."""

    __slots__ = (
        "_least_c",
        "_least_deg",
        "_model",
        "_most_c",
        "_most_deg",
        "angle",
        "channel",
        "corrected_at_c",
        "correction",
        "due",
        "fusion",
        "heads",
        "past_due",
        "served",
        "status",
        "unfused",
    )

    def __init__(self, channel: JointChannel) -> None:
        super().__init__(channel.scale, channel.slot, channel.plan.node_id)
        self.channel = channel
        further = [
            ReadingHead(head.scale, channel.slot + FURTHER_HEAD * number, head.plan.node_id)
            for number, head in enumerate(channel.further_heads, start=1)
        ]
        self.heads: tuple[ReadingHead, ...] = (self, *further)
        self.fusion: HeadFusion | None = None
        if further:
            mounting_deg = [0.0, *(head.mounting_deg for head in channel.further_heads)]
            self.fusion = HeadFusion([head.sample.position for head in self.heads], mounting_deg)
        self.angle: AngleSource = self.fusion or self.sample.position
        """Where the joint's angle is read."""
        self.correction: Correction | None = None
        self.corrected_at_c: float | None = None
        """The temperature that the correction was made for."""
        self._model = one_sample(channel.model)
        limits = channel.limits
        self._least_deg, self._most_deg = limits.model_angle_deg.minimum, limits.model_angle_deg.maximum
        sensor_c, model_c = limits.sensor_range_c, limits.model_temperature_c
        self._least_c = max(sensor_c.minimum, model_c.minimum)
        self._most_c = min(sensor_c.maximum, model_c.maximum)
        self.due = False
        """Its position has changed since the last model pass."""
        self.unfused = False
        """A head has moved since the last fusion."""
        self.served = ServedJoint(channel.policy, channel.user_zero_deg)
        self.past_due = False
        self.status = StatusBit.CONFIGURED | StatusBit.NODE_NOT_READY

    def moved(self) -> None:
        """A new position came."""
        if self.fusion is None:
            self.due = True
        else:
            self.unfused = True

    def fuse(self) -> None:
        """One angle from the heads of this cycle."""
        if self.fusion is not None and self.unfused:
            self.fusion.fuse([head.usable for head in self.heads])
            self.due, self.unfused = True, False

    def correct(self) -> None:
        """One model pass where the sample is newer than the correction.

        A temperature alone is a newer sample too: when a broken sensor is good again, a correction for what it
        said while it was broken must not be served for the rest of the cycle.
        """
        raw_deg, temperature_c = self.angle.raw_deg, self.sample.temperature_c
        if raw_deg is None or temperature_c is None:
            self.correction = None
        elif self.due or self.correction is None or self.corrected_at_c != temperature_c:
            self.correction = self._model(raw_deg, temperature_c).known
            self.corrected_at_c = temperature_c
        self.due = False

    def state(self, now_ns: int, *, bus_up: bool, last_sync_ns: int | None) -> JointState:
        """What is served of this joint at this moment."""
        sample, angle, correction, served = self.sample, self.angle, self.correction, self.served
        stamp_ns = angle.stamp_ns
        age_ms = None if stamp_ns is None else max(0.0, (now_ns - stamp_ns) * 1e-6)
        way = None
        if served.policy.latency_max_ms is not None:
            way = moved_since_sample(served.policy, angle, age_ms)
        if correction is not None and (way is not None or self.fusion is not None):
            correction = Correction(
                correction.correction_arcsec,
                in_quadrature_arcsec(
                    correction.uncertainty_arcsec,
                    0.0 if way is None else way.uncertainty_arcsec,
                    0.0 if self.fusion is None else self.fusion.uncertainty_arcsec,
                ),
            )
        status = (
            GOOD
            if bus_up and self.nothing_against(correction, age_ms, now_ns, last_sync_ns)
            else self.judged(correction, age_ms, now_ns, bus_up=bus_up, last_sync_ns=last_sync_ns)
        )
        shown = served.serve(
            status,
            raw_deg=angle.raw_deg,
            correction=correction,
            moved_deg=None if way is None else way.moved_deg,
            stamp_ns=stamp_ns,
            now_ns=now_ns,
            age_ms=age_ms,
        )
        return JointState(
            status=shown.bits,
            sequence=sample.sequence,
            corrected_deg=shown.corrected_deg,
            raw_deg=angle.raw_deg,
            correction_arcsec=shown.correction_arcsec,
            temperature_c=sample.temperature_c,
            age_ms=shown.age_ms,
            uncertainty_arcsec=shown.uncertainty_arcsec,
            velocity_deg_s=angle.velocity_deg_s,
            turns=angle.turns,
            raw_counts=sample.position.position_counts,
            frames_received=sample.frames_received & 0xFFFFFFFF,
            frames_lost=sample.frames_lost & 0xFFFFFFFF,
            user_zero_deg=served.user_zero_deg,
        )

    def nothing_against(
        self, correction: Correction | None, age_ms: float | None, now_ns: int, last_sync_ns: int | None
    ) -> bool:
        """Whether every reason that `judge` knows is absent, the bus apart; False where only `judge` can tell.

        Each comparison is made the way round that NaN and None fail.
        """
        if self.fusion is not None or correction is None or age_ms is None:
            return False
        sample, limits, position = self.sample, self.channel.limits, self.sample.position
        temperature_c, stamp_ns, raw_deg = sample.temperature_c, sample.temperature_stamp_ns, position.raw_deg
        if temperature_c is None or stamp_ns is None or raw_deg is None:
            return False
        status, most_arcsec = sample.temperature_status, limits.max_uncertainty_arcsec
        uncertainty_arcsec = correction.uncertainty_arcsec
        return (
            self.condition is NodeCondition.RUNNING
            and not self.clash.active
            and position.referenced
            and not position.jumped
            and self.served.user_zero_known
            and not self.past_due
            and age_ms <= limits.stale_ms
            and self._least_deg <= raw_deg <= self._most_deg
            and self._least_c <= temperature_c <= self._most_c
            and (now_ns - stamp_ns) * 1e-9 <= limits.temperature_stale_s
            and (not self.channel.temperature_has_status if status is None else status == 0)
            and sample.temperature_watch.plausible(now_ns)
            and -MAX_CORRECTION_ARCSEC <= correction.correction_arcsec <= MAX_CORRECTION_ARCSEC
            and (most_arcsec is None or (uncertainty_arcsec is not None and uncertainty_arcsec <= most_arcsec))
            and (
                not self.synchronous
                or (last_sync_ns is not None and (now_ns - last_sync_ns) * 1e-6 <= limits.stale_ms)
            )
        )

    def judged(
        self,
        correction: Correction | None,
        age_ms: float | None,
        now_ns: int,
        *,
        bus_up: bool,
        last_sync_ns: int | None,
    ) -> StatusBit:
        """The status word from all the evidence."""
        sample, channel, fusion = self.sample, self.channel, self.fusion
        told = sample.temperature_status is not None or not channel.temperature_has_status
        stamp_ns = sample.temperature_stamp_ns if told else None
        # A joint with several heads suffers from what befalls one of them only when no head is left.
        alone = fusion is None or not any(head.usable for head in self.heads)
        node = NodeCondition.ID_CLASH if self.clash.active else self.condition
        status = judge(
            Evidence(
                bus_up=bus_up,
                node=node if alone else NodeCondition.RUNNING,
                age_ms=age_ms,
                raw_deg=self.angle.raw_deg,
                temperature_c=sample.temperature_c,
                temperature_age_s=None if stamp_ns is None else max(0.0, (now_ns - stamp_ns) * 1e-9),
                correction_arcsec=None if correction is None else correction.correction_arcsec,
                uncertainty_arcsec=None if correction is None else correction.uncertainty_arcsec,
                uncertainty_needed=fusion is not None and fusion.uncertainty_arcsec is None,
                referenced=self.served.user_zero_known and (not alone or sample.position.referenced),
                jumped=alone and sample.position.jumped,
                past_due=self.past_due,
                temperature_fault=bool(sample.temperature_status),
                temperature_plausible=sample.temperature_watch.plausible(now_ns),
                sync_lost=self.synchronous
                and _sync_lost(channel.limits, age_ms, now_ns, bus_up=bus_up, last_sync_ns=last_sync_ns),
                heads_disagree=fusion is not None
                and fusion.disagreement_arcsec > channel.max_head_difference_arcsec,
            ),
            channel.limits,
        )
        return status | StatusBit.HEAD_LOST if fusion is not None and fusion.lost else status


def _sync_lost(
    limits: Limits, age_ms: float | None, now_ns: int, *, bus_up: bool, last_sync_ns: int | None
) -> bool:
    """SYNC has stopped, or never came and no position either."""
    if last_sync_ns is None:
        return bus_up and (age_ms is None or age_ms > limits.stale_ms)
    return (now_ns - last_sync_ns) * 1e-6 > limits.stale_ms
