"""From frames to the register image: cycles, staleness, trouble of one joint that must not touch another."""

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.metadata import Interval
from trueangle.core.correction import ModelAnswer
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.health import Limits, NodeCondition, StatusBit
from trueangle.core.pipeline import JointChannel, Pipeline
from trueangle.core.registers import JointIdentity, RegisterImage, RegisterMap
from trueangle.core.sample import SampleScale

COUNTS_PER_REV = 3_600_000
"""One count is 0.36 arcsec, one degree 10,000 counts: closed forms stay readable."""
MS = 1_000_000
MARKER = -(2**31)


@dataclass
class LinearModel:
    """Corrects by 10 arcsec + 1 arcsec per degC; answers what `broken` says instead where it is set."""

    broken: float | None = None
    passes: int = 0

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        self.passes += 1
        answer = 10.0 + temperature_c if self.broken is None else np.full(angle_deg.shape, self.broken)
        return ModelAnswer(correction_arcsec=answer, uncertainty_arcsec=None)


def plan(slot: int) -> NodePlan:
    position = (
        MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION),
        MappedObject(index=0x2100, subindex=0, bits=16, quantity=Quantity.SEQUENCE),
    )
    temperature = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE, signed=True)
    return NodePlan(
        slot=slot,
        node_id=slot,
        heartbeat_ms=100,
        tpdos=(
            TpdoPlan(number=1, cob_id=0x180 + slot, transmission_type=1, mapping=position),
            TpdoPlan(number=2, cob_id=0x280 + slot, transmission_type=10, mapping=(temperature,)),
        ),
    )


@dataclass
class Bench:
    """A pipeline with two joints on one bus, fed by bytes and by a clock that the test turns."""

    now_ns: int = 10**12
    images: list[RegisterImage] = field(default_factory=list[RegisterImage])
    changes: list[tuple[int, StatusBit, StatusBit]] = field(default_factory=list[tuple[int, StatusBit, StatusBit]])
    models: dict[int, LinearModel] = field(default_factory=dict[int, LinearModel])

    def __post_init__(self) -> None:
        self.models = {1: LinearModel(), 2: LinearModel()}
        limits = Limits(
            stale_ms=50,
            temperature_stale_s=2,
            sensor_range_c=Interval(minimum=-55, maximum=125),
            model_angle_deg=Interval(minimum=0, maximum=300),
            model_temperature_c=Interval(minimum=10, maximum=40),
        )
        scale = SampleScale(
            counts_per_rev=COUNTS_PER_REV, degc_per_unit=0.01, offset_c=0.0, sequence_modulus=2**16
        )
        self.channels = [
            JointChannel(
                slot=slot, bus="arm", plan=plan(slot), scale=scale, limits=limits, model=self.models[slot]
            )
            for slot in (1, 2)
        ]
        self.pipeline = Pipeline(
            self.channels,
            RegisterMap([_identity(1), _identity(2)]),
            publish=self.images.append,
            on_status=lambda slot, before, after: self.changes.append((slot, before, after)),
        )

    def bring_into_service(self) -> None:
        self.pipeline.on_bus("arm", up=True, now_ns=self.now_ns)
        for slot in (1, 2):
            self.pipeline.on_node(slot, NodeCondition.RUNNING, self.now_ns)

    def position(self, slot: int, angle_deg: float, sequence: int) -> tuple[int, bytes, int]:
        counts = round(angle_deg * COUNTS_PER_REV / 360)
        return (0x180 + slot, struct.pack("<IH", counts, sequence), self.now_ns)

    def temperature(self, slot: int, temperature_c: float) -> tuple[int, bytes, int]:
        return (0x280 + slot, struct.pack("<h", round(temperature_c * 100)), self.now_ns)

    def feed(self, *frames: tuple[int, bytes, int]) -> None:
        self.pipeline.on_frames("arm", frames, self.now_ns)

    def cycle(self, sequence: int, angle_deg: float = 90.0, slots: tuple[int, ...] = (1, 2)) -> None:
        """SYNC, 1 ms later the answers of these slots, then 4 ms of nothing."""
        self.pipeline.on_sync("arm", self.now_ns)
        self.now_ns += MS
        self.feed(*(self.position(slot, angle_deg, sequence) for slot in slots))
        self.now_ns += 4 * MS

    def fast(self, slot: int) -> dict[str, int]:
        """The slot's part of the fast image as a PLC would read it."""
        data = self.images[-1].read(10 + 12 * (slot - 1), 12)
        assert data is not None
        names = ("status", "sequence", "corrected", "raw", "correction", "temperature", "age", "uncertainty")
        return dict(zip(names, struct.unpack(">IHiiihHH", data), strict=True))

    def status(self, slot: int) -> StatusBit:
        return StatusBit(self.fast(slot)["status"])


def _identity(slot: int) -> JointIdentity:
    return JointIdentity(
        slot=slot,
        node_id=slot,
        model_id=None,
        calibration_date=None,
        calibration_due=None,
        vendor_id=None,
        product_code=None,
        revision_number=None,
        serial_number=None,
    )


def running() -> Bench:
    bench = Bench()
    bench.bring_into_service()
    bench.feed(bench.temperature(1, 20.0), bench.temperature(2, 25.0))
    bench.cycle(0)
    bench.cycle(1)
    return bench


def test_no_correction_for_a_broken_temperature_is_served_once_the_sensor_is_good_again() -> None:
    bench = Bench()
    bench.bring_into_service()
    bench.feed(bench.temperature(1, 130.0), bench.position(1, 90.0, 0), bench.position(1, 90.0, 1))
    assert StatusBit.TEMPERATURE_BROKEN in bench.status(1)
    bench.feed(bench.temperature(1, 20.0))
    bench.pipeline.tick(bench.now_ns)
    assert StatusBit.VALID in bench.status(1)
    assert bench.fast(1)["correction"] == 30_000


def test_a_complete_cycle_serves_raw_plus_correction() -> None:
    bench = running()
    served = bench.fast(1)
    assert served["status"] == StatusBit.VALID | StatusBit.CONFIGURED
    assert served["raw"] == 90 * 3_600_000
    assert served["correction"] == 30_000  # 10 + 20 arcsec
    assert served["corrected"] == 90 * 3_600_000 + 30_000
    assert served["temperature"] == 2000
    assert bench.fast(2)["correction"] == 35_000
    assert served["sequence"] == 1


def test_nothing_is_corrected_before_a_temperature_arrived() -> None:
    bench = Bench()
    bench.bring_into_service()
    bench.cycle(0)
    bench.cycle(1)
    served = bench.fast(1)
    assert served["status"] == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    assert (served["corrected"], served["raw"]) == (MARKER, 90 * 3_600_000)


def test_one_image_a_cycle_and_one_model_pass_a_joint() -> None:
    bench = running()
    images, passes = len(bench.images), bench.models[1].passes
    for sequence in range(2, 12):
        bench.cycle(sequence)
    assert len(bench.images) - images == 10
    assert bench.models[1].passes - passes == 10


def test_the_cycle_waits_for_every_joint_that_answered_the_last_sync() -> None:
    bench = running()
    images = len(bench.images)
    bench.pipeline.on_sync("arm", bench.now_ns)
    bench.feed(bench.position(1, 91.0, 2))
    assert len(bench.images) == images
    bench.feed(bench.position(2, 91.0, 2))
    assert len(bench.images) == images + 1


def test_a_joint_that_misses_one_sync_delays_the_others_once_and_at_most_to_the_next_sync() -> None:
    bench = running()
    bench.cycle(2, angle_deg=91.0, slots=(1,))
    assert bench.fast(1)["raw"] == 90 * 3_600_000
    images = len(bench.images)
    bench.cycle(3, angle_deg=92.0, slots=(1,))
    # The next SYNC ended the incomplete cycle, and this one no longer waits for the silent joint.
    assert len(bench.images) == images + 2
    assert bench.fast(1)["raw"] == 92 * 3_600_000


def test_a_silent_joint_is_marked_stale_and_the_other_goes_on() -> None:
    bench = running()
    for sequence in range(2, 14):
        bench.cycle(sequence, slots=(2,))
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.STALE
    assert bench.fast(1)["corrected"] == MARKER
    assert StatusBit.VALID in bench.status(2)
    assert bench.changes[-1] == (
        1,
        StatusBit.VALID | StatusBit.CONFIGURED,
        StatusBit.STALE | StatusBit.CONFIGURED,
    )


def test_silence_on_the_whole_bus_is_marked_by_the_tick() -> None:
    bench = running()
    sampled_ns = bench.now_ns - 5 * MS  # at the last SYNC
    bench.now_ns = sampled_ns + 50 * MS
    bench.pipeline.tick(bench.now_ns)
    assert StatusBit.VALID in bench.status(1)
    assert bench.fast(1)["age"] == 50
    bench.now_ns += MS
    bench.pipeline.tick(bench.now_ns)
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.STALE | StatusBit.SYNC_LOST


def test_the_age_counts_from_sync_and_not_from_arrival() -> None:
    bench = running()
    bench.pipeline.on_sync("arm", bench.now_ns)
    bench.now_ns += 4 * MS
    bench.feed(bench.position(1, 90.0, 2), bench.position(2, 90.0, 2))
    assert bench.fast(1)["age"] == 4


def test_frames_that_waited_on_a_stalled_link_have_the_age_of_their_own_sync() -> None:
    """60 SYNCs were sent while a gateway slept; then its queue comes out, oldest answer first."""
    bench = running()
    for _ in range(60):
        bench.pipeline.on_sync("arm", bench.now_ns)
        bench.now_ns += 5 * MS
    bench.feed(bench.position(1, 91.0, 2), bench.position(2, 91.0, 2))
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.STALE
    assert bench.fast(1)["age"] == 300
    assert bench.fast(1)["corrected"] == MARKER
    # The last of the queue is fresh again.
    bench.feed(*(bench.position(slot, 92.0, sequence) for sequence in range(3, 62) for slot in (1, 2)))
    assert bench.fast(1)["age"] == 5
    assert StatusBit.VALID in bench.status(1)


def test_a_sync_that_a_node_missed_makes_its_samples_look_old_and_never_young_until_it_is_forgotten() -> None:
    bench = running()
    bench.pipeline.on_sync("arm", bench.now_ns)  # neither node hears it: no sample, no number
    bench.now_ns += 5 * MS
    bench.cycle(2)
    assert bench.fast(1)["age"] == 6
    for sequence in range(3, 1000):
        bench.cycle(sequence)
    assert bench.fast(1)["age"] == 1


def test_a_number_that_jumped_makes_no_later_frame_younger_than_its_arrival() -> None:
    """Its distance from the SYNCs is then too small: every frame seems to answer the latest SYNC."""
    bench = Bench()
    bench.bring_into_service()
    for sequence in range(1, 6):
        bench.feed(bench.temperature(1, 20.0))
        bench.cycle(sequence)
    bench.feed(bench.position(1, 90.0, 1_000))
    late = [bench.position(1, 90.0, 1_001)]
    for _ in range(12):  # the link stalls for 60 ms, SYNC goes out all the same
        bench.now_ns += 5 * MS
        bench.pipeline.on_sync("arm", bench.now_ns)
    bench.feed(*late)
    bench.pipeline.tick(bench.now_ns)
    assert bench.fast(1)["age"] >= 60
    assert StatusBit.STALE in bench.status(1)


def test_an_old_frame_that_comes_again_is_never_served() -> None:
    bench = running()
    old = bench.position(1, 10.0, 1)
    bench.cycle(2)
    bench.cycle(3)
    bench.feed(old)
    assert bench.fast(1)["raw"] == 90 * 3_600_000
    bench.cycle(4, angle_deg=91.0)
    assert bench.fast(1)["raw"] == 91 * 3_600_000
    assert StatusBit.VALID in bench.status(1)


def test_a_spoofed_sequence_is_no_sixty_thousand_lost_frames() -> None:
    bench = running()
    bench.cycle(40_000)
    detail = bench.images[-1].read(1000 + 38, 2)
    assert detail is not None
    assert struct.unpack(">I", detail)[0] == 0


def test_a_sync_sent_by_another_node_counts_as_well() -> None:
    bench = running()
    bench.feed((0x080, b"", bench.now_ns))
    bench.now_ns += 3 * MS
    bench.feed(bench.position(1, 90.0, 2), bench.position(2, 90.0, 2))
    assert bench.fast(1)["age"] == 3


def test_a_frozen_node_that_repeats_its_frame_grows_stale() -> None:
    bench = running()
    for sequence in range(2, 14):
        bench.pipeline.on_sync("arm", bench.now_ns)
        bench.now_ns += 5 * MS
        bench.feed(bench.position(1, 90.0, 1), bench.position(2, 90.0, sequence))
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.STALE
    assert StatusBit.VALID in bench.status(2)


def test_lost_frames_are_counted_by_their_sequence_also_across_its_wrap() -> None:
    bench = Bench()
    bench.bring_into_service()
    for sequence in (65533, 65534, 1, 2, 5):  # 65535, 0, 3 and 4 are missing
        bench.cycle(sequence)
    detail = bench.images[-1].read(1000 + 36, 4)
    assert detail is not None
    assert struct.unpack(">II", detail) == (5, 4)


def test_frames_of_the_wrong_length_are_counted_and_never_decoded() -> None:
    bench = running()
    cob_id, data, stamp_ns = bench.position(1, 120.0, 2)
    for wrong in (data[:-1], data + b"\0", b""):
        bench.feed((cob_id, wrong, stamp_ns))
    assert bench.pipeline.counters.misfit_frames == 3
    assert bench.fast(1)["raw"] == 90 * 3_600_000


def test_process_data_are_the_planned_tpdos_and_sync() -> None:
    bench = running()
    assert bench.pipeline.process_data("arm") == {0x080, 0x181, 0x281, 0x182, 0x282}
    before = bench.images[-1]
    bench.feed((0x701, b"\x05", bench.now_ns), (0x081, b"\0" * 8, bench.now_ns), (0x381, b"\1" * 6, bench.now_ns))
    assert bench.images[-1] is before


def test_frames_of_a_node_out_of_service_are_not_decoded() -> None:
    bench = running()
    bench.pipeline.on_node(1, NodeCondition.NOT_READY, bench.now_ns)
    bench.cycle(7, angle_deg=123.0)
    served = bench.fast(1)
    assert StatusBit.NODE_NOT_READY in StatusBit(served["status"])
    assert (served["raw"], served["corrected"]) == (MARKER, MARKER)
    assert bench.pipeline.counters.unready_frames == 1
    assert StatusBit.VALID in bench.status(2)


def test_a_node_that_comes_back_is_served_only_after_new_position_and_new_temperature() -> None:
    bench = running()
    bench.pipeline.on_node(1, NodeCondition.NOT_READY, bench.now_ns)
    bench.pipeline.on_node(1, NodeCondition.RUNNING, bench.now_ns)
    assert bench.fast(1)["raw"] == MARKER
    bench.cycle(2)
    # Whether its samples go on is known from the second one.
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.STALE | StatusBit.TEMPERATURE_STALE
    bench.cycle(3)
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE
    bench.feed(bench.temperature(1, 20.0))
    bench.cycle(4)
    assert StatusBit.VALID in bench.status(1)


def test_an_encoder_that_differs_is_served_raw_only() -> None:
    bench = running()
    bench.pipeline.on_node(1, NodeCondition.DIFFERS, bench.now_ns)
    bench.cycle(2)
    served = bench.fast(1)
    assert served["status"] == StatusBit.CONFIGURED | StatusBit.ENCODER_DIFFERS
    assert (served["corrected"], served["raw"]) == (MARKER, 90 * 3_600_000)


def test_each_reason_has_its_own_bit_and_the_marker() -> None:
    cases = [
        (StatusBit.ANGLE_OUTSIDE_MODEL, lambda b: b.cycle(2, angle_deg=301.0)),
        (StatusBit.TEMPERATURE_OUTSIDE_MODEL, lambda b: (b.feed(b.temperature(1, 41.0)), b.cycle(2))),
        (
            StatusBit.TEMPERATURE_BROKEN | StatusBit.TEMPERATURE_OUTSIDE_MODEL,
            lambda b: (b.feed(b.temperature(1, -60.0)), b.cycle(2)),
        ),
        (StatusBit.NODE_FAULT, lambda b: b.pipeline.on_node(1, NodeCondition.FAULT, b.now_ns)),
        (StatusBit.BUS_DOWN, lambda b: b.pipeline.on_bus("arm", up=False, now_ns=b.now_ns)),
    ]
    for bit, happen in cases:
        bench = running()
        happen(bench)
        served = bench.fast(1)
        assert bit in StatusBit(served["status"]), bit
        assert StatusBit.VALID not in StatusBit(served["status"])
        assert (served["corrected"], served["correction"]) == (MARKER, MARKER)


def test_a_model_that_gives_no_usable_number_is_refused() -> None:
    for broken in (float("nan"), float("inf"), 20_000.0):
        bench = running()
        bench.models[1].broken = broken
        bench.cycle(2)
        assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.MODEL_REFUSED
        assert bench.fast(1)["corrected"] == MARKER
        assert StatusBit.VALID in bench.status(2)


def test_a_temperature_that_stopped_coming_stops_the_correction() -> None:
    bench = running()
    for sequence in range(2, 405):  # 2.015 s of cycles
        bench.cycle(sequence)
    assert bench.status(1) == StatusBit.CONFIGURED | StatusBit.TEMPERATURE_STALE


def test_the_corrected_angle_wraps_into_one_turn() -> None:
    bench = running()
    bench.models[1].broken = -3600.0
    bench.cycle(3, angle_deg=0.5)
    assert bench.fast(1)["corrected"] == round(359.5 * 3_600_000)


def test_velocity_is_the_way_over_the_time_between_syncs() -> None:
    bench = running()
    bench.cycle(2, angle_deg=90.5)
    data = bench.images[-1].read(1000 + 22, 2)
    assert data is not None
    # 0.5 deg in 5 ms; FLOAT32 keeps 7 digits
    assert abs(struct.unpack(">f", data)[0] - 100.0) < 1e-4


def test_every_image_has_its_own_cycle_counter() -> None:
    bench = running()
    bench.pipeline.tick(bench.now_ns)
    bench.pipeline.tick(bench.now_ns)
    counters = [image.read(2, 2) for image in bench.images]
    assert len(set(counters)) == len(bench.images)
