"""CAN frames, states and times against the sample pipeline; every image is held to what was sent.

The joints differ in their policy, so that each way of serving an angle is reached. The model is a formula, so that
a served correction tells which temperature it was made for.
"""

import random
import struct
from collections import deque

import numpy as np
from numpy.typing import NDArray
from tests.fakes.register_values import joint_identity
from tests.fuzz.mutation import Mutator, corpus_bytes

from trueangle.contract.metadata import Interval
from trueangle.core.correction import ModelAnswer
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.health import Limits, NodeCondition, StatusBit
from trueangle.core.pipeline import Frame, JointChannel, Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.core.sample import SampleScale
from trueangle.core.serving import ServingPolicy, WhenNotValid

COUNTS_PER_REV = 3_600_000
MARKER = -(2**31)
NO_UINT32 = 0xFFFF_FFFF
MAS_PER_TURN = 1_296_000_000
HOLD_MS, STALE_MS, TEMPERATURE_STALE_S = 120.0, 50.0, 2.0
ROUNDED_MS = 1
MS = 1_000_000
NO_SEQUENCE_SLOT = 4
POLICIES = {
    1: ServingPolicy(),
    2: ServingPolicy(when_not_valid=WhenNotValid.HOLD, hold_ms=HOLD_MS),
    3: ServingPolicy(when_not_valid=WhenNotValid.RAW),
    NO_SEQUENCE_SLOT: ServingPolicy(latency_max_ms=10.0),
}
_FAST = struct.Struct(">IHiiihHH")
_LICENCES = StatusBit.VALID | StatusBit.HELD | StatusBit.RAW_SERVED
_RECENT = 64
"""A position counts as sent so many frames back: samples that went backwards are passed over."""


class FormulaModel:
    """10 arcsec and 1 arcsec per degC."""

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        return ModelAnswer(correction_arcsec=10.0 + temperature_c, uncertainty_arcsec=None)


def plan(slot: int) -> NodePlan:
    """Position, and but for one a counter, on TPDO 1; temperature on TPDO 2."""
    mapping = [MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)]
    if slot != NO_SEQUENCE_SLOT:
        mapping.append(MappedObject(index=0x2100, subindex=0, bits=16, quantity=Quantity.SEQUENCE))
    warm = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE, signed=True)
    tpdos = (
        TpdoPlan(number=1, cob_id=0x180 + slot, transmission_type=1, mapping=tuple(mapping)),
        TpdoPlan(number=2, cob_id=0x280 + slot, transmission_type=10, mapping=(warm,)),
    )
    return NodePlan(slot=slot, node_id=slot, heartbeat_ms=100, tpdos=tpdos)


def _channel(slot: int) -> JointChannel:
    return JointChannel(
        slot=slot,
        bus="arm",
        plan=plan(slot),
        scale=SampleScale(
            counts_per_rev=COUNTS_PER_REV,
            degc_per_unit=0.01,
            offset_c=0.0,
            sequence_modulus=None if slot == NO_SEQUENCE_SLOT else 2**16,
        ),
        limits=Limits(
            stale_ms=STALE_MS,
            temperature_stale_s=TEMPERATURE_STALE_S,
            sensor_range_c=Interval(minimum=-55, maximum=125),
            model_angle_deg=Interval(minimum=0, maximum=300),
            model_temperature_c=Interval(minimum=10, maximum=40),
        ),
        model=FormulaModel(),
        policy=POLICIES[slot],
    )


class PipelineFuzz:
    """A pipeline for ever; `some_frames` is one batch and whatever else happens then."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._mutated = Mutator(rng, corpus_bytes("can.txt"))
        self._now_ns = 10**12
        self._in_service = dict.fromkeys(POLICIES, False)
        self._sent: dict[int, deque[int]] = {slot: deque(maxlen=_RECENT) for slot in POLICIES}
        self._last_ns: dict[int, int | None] = dict.fromkeys(POLICIES)
        """When a position of the right length last came in service."""
        self._sequence = 0
        self.served = dict.fromkeys((StatusBit.VALID, StatusBit.HELD, StatusBit.RAW_SERVED), 0)
        """Images in which some joint was served so: zero would mean that nothing was tried."""
        self.pipeline = Pipeline(
            [_channel(slot) for slot in POLICIES],
            RegisterMap([joint_identity(slot) for slot in POLICIES]),
            publish=self._check,
            on_status=lambda slot, before, after: None,
            on_clash=lambda bus, node_id, reason: None,
        )

    def some_frames(self) -> int:
        """One batch and its surroundings; the number of frames in it."""
        rng = self._rng
        self._now_ns += rng.choice((0, 1, 1, 2, 5, 5, 5, 20, 80, 400)) * MS
        self._happening()
        frames = self._good_cycle() if rng.random() < 0.7 else []
        while rng.random() < 0.6:
            frames.insert(rng.randrange(len(frames) + 1), self._bad_frame())
        for cob_id, data, stamp_ns in frames:
            self._note(cob_id, data, stamp_ns)
        self.pipeline.on_frames("arm", frames, self._now_ns)
        if rng.random() < 0.3:
            self.pipeline.tick(self._now_ns)
        return len(frames)

    def _happening(self) -> None:
        """Now and then a node or the bus comes or goes, or a value comes by SDO; mostly things are well."""
        rng = self._rng
        kind = rng.randrange(40)
        slot = rng.choice(list(POLICIES))
        if kind == 0:
            self._condition(slot, rng.choice(list(NodeCondition)))
        elif kind == 1:
            self.pipeline.on_bus("arm", up=rng.random() < 0.5, now_ns=self._now_ns)
        elif kind == 2:
            value = rng.choice((0, 2500, -1, 2**31, -(2**15), 12_500))
            self.pipeline.on_value(slot, rng.choice(list(Quantity)), value, self._now_ns)
        elif kind == 3:
            self.pipeline.on_alive("arm", rng.randrange(128), self._now_ns)
        elif kind == 4:
            rng.choice((self.pipeline.set_referenced, self.pipeline.clear_jump))(slot, self._now_ns)
        elif kind <= 8:
            self.pipeline.on_bus("arm", up=True, now_ns=self._now_ns)
            for one in POLICIES:
                self._condition(one, NodeCondition.RUNNING)

    def _condition(self, slot: int, condition: NodeCondition) -> None:
        in_service = condition in (NodeCondition.RUNNING, NodeCondition.DIFFERS)
        if not (in_service and self._in_service[slot]):
            self._sent[slot].clear()
            self._last_ns[slot] = None
        self._in_service[slot] = in_service
        self.pipeline.on_node(slot, condition, self._now_ns)

    def _good_cycle(self) -> list[Frame]:
        self._sequence = (self._sequence + 1) & 0xFFFF
        frames: list[Frame] = [(0x80, b"", self._now_ns)]
        for slot in POLICIES:
            counts = (self._sequence * 977 * slot) % COUNTS_PER_REV
            tail = b"" if slot == NO_SEQUENCE_SLOT else struct.pack("<H", self._sequence)
            frames.append((0x180 + slot, struct.pack("<I", counts) + tail, self._now_ns))
            if self._sequence % 10 == 0:
                frames.append((0x280 + slot, struct.pack("<h", 2000 + 100 * slot), self._now_ns))
        return frames

    def _bad_frame(self) -> Frame:
        rng = self._rng
        data = self._mutated.made(14) + b"\0\0"
        cob_id = int.from_bytes(data[:2], "big") & 0x7FF
        if rng.random() < 0.6:
            cob_id = rng.choice((0x180, 0x280)) + rng.choice(list(POLICIES))
        data = data[2:10]
        if rng.random() < 0.3:
            length = {0x180: 6, 0x280: 2}.get(cob_id & 0x780, len(data))
            data = (data + bytes(8))[:length]
        stamp_ns = self._now_ns + rng.choice((0, 0, 0, -MS, -60 * MS))
        return (cob_id, data, stamp_ns)

    def _note(self, cob_id: int, data: bytes, stamp_ns: int) -> None:
        slot = cob_id - 0x180
        if slot not in POLICIES or not self._in_service[slot]:
            return
        if len(data) == (4 if slot == NO_SEQUENCE_SLOT else 6):
            self._sent[slot].append(int.from_bytes(data[:4], "little"))
            last_ns = self._last_ns[slot]
            self._last_ns[slot] = stamp_ns if last_ns is None else max(last_ns, stamp_ns)

    def _check(self, image: RegisterImage) -> None:
        for slot in POLICIES:
            fast, detail = image.read(10 + 12 * (slot - 1), 12), image.read(1000 + 100 * (slot - 1) + 34, 2)
            assert fast is not None
            assert detail is not None
            bits, _, corrected, raw, correction, _, age_ms, _ = _FAST.unpack(fast)
            status = StatusBit(bits)
            assert (corrected != MARKER) == bool(status & _LICENCES), f"slot {slot}: {status} with {corrected}"
            counts = int.from_bytes(detail, "big")
            assert counts == NO_UINT32 or counts in self._sent[slot] or not self._sent[slot]
            if StatusBit.VALID in status:
                self._check_valid(slot, status, corrected, raw, correction, age_ms)
            elif StatusBit.HELD in status:
                assert slot == 2
                assert age_ms <= HOLD_MS + ROUNDED_MS
                self.served[StatusBit.HELD] += 1
            elif StatusBit.RAW_SERVED in status:
                assert slot == 3
                assert corrected == raw
                self.served[StatusBit.RAW_SERVED] += 1

    def _check_valid(
        self, slot: int, status: StatusBit, corrected: int, raw: int, correction: int, age_ms: int
    ) -> None:
        last_ns = self._last_ns[slot]
        assert self._in_service[slot], f"slot {slot} is VALID out of service"
        assert last_ns is not None
        assert (self._now_ns - last_ns) * 1e-6 <= STALE_MS, f"slot {slot} is VALID without a fresh frame"
        assert age_ms <= STALE_MS + ROUNDED_MS
        # 10 to 40 degC through the formula.
        assert 20_000 <= correction <= 50_000
        if StatusBit.LATENCY_COMPENSATED not in status:
            off = (raw + correction - corrected) % MAS_PER_TURN
            assert min(off, MAS_PER_TURN - off) <= 2, f"slot {slot}: corrected is not raw + correction"
        self.served[StatusBit.VALID] += 1
