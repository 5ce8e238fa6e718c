"""What stands in the corrected registers when something is wrong: bytes in, registers out, by every policy.

The one rule of all of it: no image holds a corrected angle without VALID, HELD or RAW_SERVED.
"""

import datetime
import math
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.fakes.register_values import joint_identity

from trueangle.contract.metadata import Interval
from trueangle.core.correction import ModelAnswer
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.health import Limits, NodeCondition, StatusBit
from trueangle.core.pipeline import HeadChannel, JointChannel, Pipeline
from trueangle.core.position import Mechanics, MotionLimits
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.core.sample import SampleScale
from trueangle.core.serving import ServingPolicy, WhenNotValid
from trueangle.core.temperature_watch import TemperatureLimits

PER_REV = 3_600_000
"""One count is 0.36 arcsec, one degree 10,000 counts."""
MS = 1_000_000
MAS = 3_600_000
"""Milli-arcseconds in a degree."""
MARKER = -(2**31)
VALID, CONFIGURED = StatusBit.VALID, StatusBit.CONFIGURED
HOLD = ServingPolicy(when_not_valid=WhenNotValid.HOLD, hold_ms=200.0)
RAW = ServingPolicy(when_not_valid=WhenNotValid.RAW)
LIMITS = Limits(
    stale_ms=50,
    temperature_stale_s=2,
    sensor_range_c=Interval(minimum=-55, maximum=125),
    model_angle_deg=Interval(minimum=0, maximum=360),
    model_temperature_c=Interval(minimum=10, maximum=40),
)


@dataclass
class Model:
    """Corrects by 30 arcsec; keeps the angles that it was asked about."""

    uncertainty_arcsec: float | None = 2.0
    correction_arcsec: float = 30.0
    asked_deg: list[float] = field(default_factory=list[float])

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        self.asked_deg += angle_deg.tolist()
        told = None if self.uncertainty_arcsec is None else np.full(angle_deg.shape, self.uncertainty_arcsec)
        return ModelAnswer(
            correction_arcsec=np.full(angle_deg.shape, self.correction_arcsec), uncertainty_arcsec=told
        )


def plan(node_id: int, *, reference: bool = False, head: int = 0) -> NodePlan:
    position = [MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)]
    if reference:
        position.append(MappedObject(index=0x2200, subindex=0, bits=8, quantity=Quantity.REFERENCE))
    temperature = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE, signed=True)
    tpdos = [TpdoPlan(number=1, cob_id=0x180 + node_id, transmission_type=1, mapping=tuple(position))]
    if head == 0:
        tpdos.append(TpdoPlan(number=2, cob_id=0x280 + node_id, transmission_type=10, mapping=(temperature,)))
    return NodePlan(slot=1, node_id=node_id, heartbeat_ms=100, tpdos=tuple(tpdos), head=head)


class Rig:
    """One joint; nodes 1 and, as a second head at 180 deg, 2."""

    def __init__(
        self,
        policy: ServingPolicy | None = None,
        *,
        limits: Limits = LIMITS,
        mechanics: Mechanics | None = None,
        temperature: TemperatureLimits | None = None,
        second_head: bool = False,
        synchronous: bool = True,
        today: list[datetime.date] | None = None,
        **channel: Any,
    ) -> None:
        self.now_ns = 10**12
        self.images: list[RegisterImage] = []
        self.changes: list[tuple[StatusBit, StatusBit]] = []
        self.model = Model()
        self.reference = bool(mechanics and mechanics.reference_mask)
        scale = SampleScale(
            counts_per_rev=PER_REV,
            degc_per_unit=0.01,
            offset_c=0.0,
            sequence_modulus=None,
            synchronous=synchronous,
            mechanics=mechanics or Mechanics(),
            temperature=temperature or TemperatureLimits(),
        )
        head = HeadChannel(plan=plan(2, head=1), scale=scale, mounting_deg=180.0)
        joint = JointChannel(
            slot=1,
            bus="arm",
            plan=plan(1, reference=self.reference),
            scale=scale,
            limits=limits,
            model=self.model,
            policy=policy or ServingPolicy(),
            further_heads=(head,) if second_head else (),
            **channel,
        )
        self.pipeline = Pipeline(
            [joint],
            RegisterMap([joint_identity(1)]),
            publish=self.publish,
            on_status=lambda _, before, after: self.changes.append((before, after)),
            today=None if today is None else lambda: today[0],
        )
        self.heads = 2 if second_head else 1
        self.pipeline.on_bus("arm", up=True, now_ns=self.now_ns)
        self.run(NodeCondition.RUNNING)

    def publish(self, image: RegisterImage) -> None:
        """Every image of every test is held against the one rule."""
        self.images.append(image)
        check(image)

    def run(self, condition: NodeCondition) -> None:
        for head in range(self.heads):
            self.pipeline.on_node(1, condition, self.now_ns, head=head)
        if condition is NodeCondition.RUNNING:
            self.warm()

    def warm(self, temperature_c: float = 20.0) -> None:
        self.feed((0x281, struct.pack("<h", round(temperature_c * 100)), self.now_ns))

    def feed(self, *frames: tuple[int, bytes, int]) -> None:
        self.pipeline.on_frames("arm", frames, self.now_ns)

    def cycle(
        self, angle_deg: float = 90.0, *, referenced: int | None = None, heads: tuple[int, ...] = (0, 1)
    ) -> None:
        """SYNC, 1 ms later the answers; 4 ms pass before it returns."""
        self.pipeline.on_sync("arm", self.now_ns)
        self.now_ns += MS
        frames: list[tuple[int, bytes, int]] = []
        for head in (head for head in heads if head < self.heads):
            data = struct.pack("<I", round((angle_deg + 180.0 * head) * 10_000) % PER_REV)
            data += bytes([referenced or 0]) if self.reference else b""
            frames.append((0x181 + head, data, self.now_ns))
        self.feed(*frames)
        self.now_ns += 4 * MS

    def wait(self, ms: float) -> None:
        """Nothing comes; the daemon ticks every 5 ms."""
        end_ns = self.now_ns + round(ms * MS)
        while self.now_ns < end_ns:
            self.now_ns = min(end_ns, self.now_ns + 5 * MS)
            self.pipeline.tick(self.now_ns)

    @property
    def served(self) -> "Served":
        return read(self.images[-1])

    def running(self, **cycle: Any) -> "Rig":
        for _ in range(3):
            self.cycle(**cycle)
        assert VALID in self.served.status, self.served
        return self


@dataclass(frozen=True)
class Served:
    status: StatusBit
    corrected: int
    raw: int
    correction: int
    age_ms: int
    uncertainty: int
    corrected_deg: float
    user_zero: int


def read(image: RegisterImage) -> Served:
    fast, detail, zero = image.read(10, 12), image.read(1008, 4), image.read(1056, 2)
    assert fast is not None
    assert detail is not None
    assert zero is not None
    status, _, corrected, raw, correction, _, age_ms, uncertainty = struct.unpack(">IHiiihHH", fast)
    (corrected_deg,) = struct.unpack(">d", detail)
    (user_zero,) = struct.unpack(">i", zero)
    return Served(StatusBit(status), corrected, raw, correction, age_ms, uncertainty, corrected_deg, user_zero)


def check(image: RegisterImage) -> None:
    served = read(image)
    licensed = served.status & (VALID | StatusBit.HELD | StatusBit.RAW_SERVED)
    assert (served.corrected != MARKER) == bool(licensed) == (not math.isnan(served.corrected_deg)), served
    assert licensed in (StatusBit(0), VALID, StatusBit.HELD, StatusBit.RAW_SERVED), served


def test_the_marker_is_the_default_for_every_reason() -> None:
    rig = Rig().running()
    rig.wait(51)
    assert rig.served.status == CONFIGURED | StatusBit.STALE | StatusBit.SYNC_LOST
    assert (rig.served.corrected, rig.served.correction, rig.served.uncertainty) == (MARKER, MARKER, 0xFFFF)


def test_a_held_angle_has_its_own_age_correction_and_uncertainty_and_ends_at_its_limit() -> None:
    rig = Rig(HOLD).running()
    sampled_ns = rig.now_ns - 5 * MS
    rig.wait(100)
    served = rig.served
    assert served.status == CONFIGURED | StatusBit.STALE | StatusBit.SYNC_LOST | StatusBit.HELD
    assert served.corrected == 90 * MAS + 30_000
    assert (served.correction, served.uncertainty) == (30_000, 200)
    assert served.age_ms == (rig.now_ns - sampled_ns) // MS
    rig.now_ns = sampled_ns + 200 * MS
    rig.pipeline.tick(rig.now_ns)
    assert StatusBit.HELD in rig.served.status
    rig.now_ns += MS
    rig.pipeline.tick(rig.now_ns)
    assert (rig.served.corrected, StatusBit.HELD in rig.served.status) == (MARKER, False)


def test_a_held_angle_that_has_ended_does_not_come_back() -> None:
    rig = Rig(HOLD).running()
    rig.wait(250)
    rig.now_ns -= 100 * MS
    rig.pipeline.tick(rig.now_ns)
    assert rig.served.corrected == MARKER


@settings(deadline=None)
@given(st.floats(1, 1000), st.lists(st.floats(0.1, 100), max_size=20))
def test_no_held_angle_is_older_than_its_limit(hold_ms: float, pauses_ms: list[float]) -> None:
    rig = Rig(ServingPolicy(when_not_valid=WhenNotValid.HOLD, hold_ms=hold_ms)).running()
    sampled_ns = rig.now_ns - 5 * MS
    for pause_ms in pauses_ms:
        rig.now_ns += round(pause_ms * MS)
        rig.pipeline.tick(rig.now_ns)
        age_ms = (rig.now_ns - sampled_ns) / MS
        assert (StatusBit.HELD in rig.served.status) == (50 < age_ms <= hold_ms)


@pytest.mark.parametrize(
    "bus_first", [True, False], ids=["bus down before its nodes", "nodes silent before the bus is told"]
)
def test_an_angle_is_held_while_the_bus_is_down_and_its_node_silent(bus_first: bool) -> None:
    rig = Rig(HOLD).running()
    if bus_first:
        rig.pipeline.on_bus("arm", up=False, now_ns=rig.now_ns)
    rig.run(NodeCondition.SILENT)
    rig.pipeline.on_bus("arm", up=False, now_ns=rig.now_ns)
    assert rig.served.corrected == 90 * MAS + 30_000
    assert StatusBit.HELD | StatusBit.BUS_DOWN | StatusBit.NODE_NOT_READY in rig.served.status


def test_an_angle_is_held_through_a_stale_temperature_as_old_as_its_sample() -> None:
    rig = Rig(HOLD).running()
    for _ in range(410):
        rig.cycle(91.0)
    assert rig.served.status == CONFIGURED | StatusBit.TEMPERATURE_STALE | StatusBit.HELD
    assert rig.served.corrected == 91 * MAS + 30_000
    assert rig.served.raw == 91 * MAS
    for _ in range(50):
        rig.cycle(92.0)
    assert rig.served.corrected == MARKER


@pytest.mark.parametrize(
    "condition", [NodeCondition.NOT_READY, NodeCondition.DIFFERS, NodeCondition.FAULT, NodeCondition.ID_CLASH]
)
def test_no_angle_is_held_across_anything_that_may_have_moved_the_phase(condition: NodeCondition) -> None:
    rig = Rig(HOLD).running()
    rig.run(condition)
    assert rig.served.corrected == MARKER
    # Nor does silence afterwards bring it back.
    rig.run(NodeCondition.SILENT)
    assert rig.served.corrected == MARKER


def test_no_angle_is_held_across_a_jump() -> None:
    rig = Rig(HOLD, mechanics=Mechanics(motion=MotionLimits(max_speed_deg_s=100.0))).running()
    rig.cycle(150.0)
    assert rig.served.status == CONFIGURED | StatusBit.POSITION_JUMP | StatusBit.NOT_REFERENCED
    assert rig.served.corrected == MARKER
    rig.wait(60)
    assert rig.served.corrected == MARKER


def test_a_jump_is_cleared_by_command_and_by_identification_alone() -> None:
    for clear in ("command", "identified"):
        rig = Rig(mechanics=Mechanics(motion=MotionLimits(max_speed_deg_s=100.0))).running()
        for _ in range(50):
            rig.cycle(150.0)
        assert StatusBit.POSITION_JUMP in rig.served.status
        if clear == "command":
            rig.pipeline.clear_jump(1, rig.now_ns)
        else:
            rig.run(NodeCondition.SILENT)
            rig.run(NodeCondition.RUNNING)
        rig.cycle(150.0)
        assert rig.served.corrected == 150 * MAS + 30_000


def test_raw_stands_in_only_where_the_configuration_says_so_and_only_the_correction_is_missing() -> None:
    rig = Rig(RAW).running()
    rig.model.correction_arcsec = math.nan
    rig.cycle(91.0)
    assert rig.served.status == CONFIGURED | StatusBit.MODEL_REFUSED | StatusBit.RAW_SERVED
    assert (rig.served.corrected, rig.served.correction, rig.served.uncertainty) == (91 * MAS, MARKER, 0xFFFF)


@pytest.mark.parametrize(
    "trouble",
    [
        lambda rig: rig.wait(60),
        lambda rig: rig.run(NodeCondition.SILENT),
        lambda rig: (rig.run(NodeCondition.DIFFERS), rig.cycle()),
        lambda rig: rig.run(NodeCondition.FAULT),
        lambda rig: rig.pipeline.on_bus("arm", up=False, now_ns=rig.now_ns),
        lambda rig: rig.cycle(200.0),
    ],
    ids=["stale", "silent", "differs", "fault", "bus down", "jump"],
)
def test_raw_never_stands_in_for_a_position_that_is_not_good_itself(trouble: Any) -> None:
    rig = Rig(RAW, mechanics=Mechanics(motion=MotionLimits(max_speed_deg_s=100.0))).running()
    trouble(rig)
    assert VALID not in rig.served.status
    assert rig.served.corrected == MARKER


def test_an_uncertainty_above_its_limit_is_a_reason() -> None:
    limits = Limits(
        stale_ms=50,
        temperature_stale_s=2,
        sensor_range_c=LIMITS.sensor_range_c,
        model_angle_deg=LIMITS.model_angle_deg,
        model_temperature_c=LIMITS.model_temperature_c,
        max_uncertainty_arcsec=3.0,
    )
    rig = Rig(limits=limits).running()
    for uncertainty_arcsec in (3.5, None):
        rig.model.uncertainty_arcsec = uncertainty_arcsec
        rig.cycle()
        assert rig.served.status == CONFIGURED | StatusBit.UNCERTAINTY_HIGH


def test_a_calibration_ends_at_its_due_day_while_the_daemon_runs() -> None:
    day = [datetime.date(2026, 1, 10)]
    rig = Rig(
        today=day, calibrated=datetime.date(2025, 1, 1), calibration_due=datetime.date(2026, 1, 10)
    ).running()
    day[0] = datetime.date(2026, 1, 11)
    rig.warm()
    for _ in range(205):
        rig.cycle()
    assert rig.served.status == CONFIGURED | StatusBit.CALIBRATION_PAST_DUE


def test_an_encoder_without_absolute_zero_is_served_once_its_reference_was_seen() -> None:
    rig = Rig(mechanics=Mechanics(absolute=False, reference_mask=2))
    rig.cycle(referenced=1)
    assert rig.served.status == CONFIGURED | StatusBit.NOT_REFERENCED
    rig.cycle(referenced=2)
    assert VALID in rig.served.status
    rig.cycle(referenced=0)
    assert VALID in rig.served.status
    rig.run(NodeCondition.SILENT)
    rig.run(NodeCondition.RUNNING)
    rig.cycle(referenced=0)
    assert rig.served.status == CONFIGURED | StatusBit.NOT_REFERENCED
    rig.pipeline.set_referenced(1, rig.now_ns)
    rig.cycle(referenced=0)
    assert VALID in rig.served.status


def test_a_temperature_that_jumps_is_a_reason_of_its_own() -> None:
    rig = Rig(temperature=TemperatureLimits(max_rate_c_per_s=0.5)).running()
    rig.warm(35.0)
    rig.cycle()
    assert rig.served.status == CONFIGURED | StatusBit.TEMPERATURE_IMPLAUSIBLE


EVENTS = st.one_of(
    st.tuples(st.just("cycle"), st.floats(0, 359.99), st.sampled_from(((0, 1), (0,), (1,), ()))),
    st.tuples(st.just("node"), st.sampled_from(list(NodeCondition)), st.integers(0, 1)),
    st.tuples(st.just("bus"), st.booleans(), st.none()),
    st.tuples(st.just("warm"), st.floats(-60, 60), st.none()),
    st.tuples(st.just("wait"), st.floats(0, 300), st.none()),
    st.tuples(
        st.just("model"), st.sampled_from((30.0, math.nan, math.inf, 1e9)), st.sampled_from((2.0, None, math.nan))
    ),
    st.tuples(st.just("zero"), st.floats(-400, 400), st.none()),
    st.tuples(st.just("clear"), st.booleans(), st.none()),
    st.tuples(st.just("frame"), st.binary(max_size=8), st.sampled_from((0x181, 0x182, 0x281, 0x080))),
)


@settings(max_examples=150, deadline=None)
@given(
    policy=st.builds(
        ServingPolicy,
        when_not_valid=st.sampled_from(list(WhenNotValid)),
        hold_ms=st.floats(1, 500),
        latency_max_ms=st.none() | st.floats(0.1, 100),
    ),
    second_head=st.booleans(),
    absolute=st.booleans(),
    events=st.lists(EVENTS, max_size=40),
)
def test_whatever_happens_no_image_holds_a_corrected_angle_without_a_bit_that_licenses_it(
    policy: ServingPolicy, second_head: bool, absolute: bool, events: list[tuple[Any, Any, Any]]
) -> None:
    mechanics = Mechanics(absolute=absolute, motion=MotionLimits(max_speed_deg_s=3600.0))
    rig = Rig(policy, second_head=second_head, mechanics=mechanics)
    for kind, one, other in events:
        if kind == "cycle":
            rig.cycle(one, heads=other)
        elif kind == "node":
            rig.pipeline.on_node(1, one, rig.now_ns, head=other if second_head else 0)
        elif kind == "bus":
            rig.pipeline.on_bus("arm", up=one, now_ns=rig.now_ns)
        elif kind == "warm":
            rig.warm(one)
        elif kind == "wait":
            rig.wait(one)
        elif kind == "model":
            rig.model.correction_arcsec, rig.model.uncertainty_arcsec = one, other
        elif kind == "zero":
            rig.pipeline.set_user_zero(1, one, rig.now_ns)
        elif kind == "clear":
            rig.pipeline.set_referenced(1, rig.now_ns) if one else rig.pipeline.clear_jump(1, rig.now_ns)
        else:
            rig.feed((other, one, rig.now_ns))
        bus_down = not rig.pipeline._bus_up["arm"]
        if bus_down or rig.pipeline._joints[1].correction is None:
            assert VALID not in rig.served.status
