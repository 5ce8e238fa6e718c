"""The register image, read by offsets written out here and not taken from the code."""

import itertools
import math
import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.fakes.register_values import GOOD, joint_identity, joint_state

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.registers import JointState, RegisterImage, RegisterMap

TURN_MAS = 1_296_000_000
NO_INT32 = -0x8000_0000
FAST_SLOT_1 = 10
DETAIL_1 = 1000


def image_of(
    states: dict[int, JointState], slots: tuple[int, ...] = (1,), service_status: int = 0
) -> RegisterImage:
    register_map = RegisterMap(joint_identity(slot) for slot in slots)
    return register_map.image(cycle=0x0102_0304, heartbeat=0x0506, service_status=service_status, states=states)


def number(image: RegisterImage, address: int, code: str) -> float:
    data = image.read(address, struct.calcsize(">" + code) // 2)
    assert data is not None
    return struct.unpack(">" + code, data)[0]


def joint_image(**changes: object) -> RegisterImage:
    return image_of({1: joint_state(**changes)})


def test_fast_image_of_one_joint_reads_field_by_field() -> None:
    image = image_of({1: joint_state()}, service_status=1)
    data = image.read(0, 84)
    assert data is not None
    assert struct.unpack(">HHIHIHI", data[:20]) == (1, 1, 0x0102_0304, 0x0506, 0, 1, 0)
    assert struct.unpack(">IHiiihHH", data[20:44]) == (3, 4711, 444_444_441, 444_424_444, 19_997, 2346, 2, 235)
    assert struct.unpack(">I", data[164:168]) == (0x0102_0304,)


def test_detail_block_of_one_joint_reads_field_by_field() -> None:
    data = joint_image().read(1000, 70)
    assert data is not None
    live = struct.unpack(">IIHHidfidffifffIIII", data[:80])
    single = [struct.unpack(">f", struct.pack(">f", value))[0] for value in (123.4567891, 123.4512345)]
    assert live[:7] == (0x0102_0304, 3, 4711, 11, 444_444_441, 123.4567891, single[0])
    assert live[7:10] == (444_424_444, 123.4512345, single[1])
    assert live[10:12] == (-45.5, -3)
    # binary32 keeps 24 bits: a relative step of 6e-8.
    assert live[12:15] == pytest.approx((23.456, 19.99656, 2.348), rel=1e-7)
    assert live[15:] == (2, 89_888, 1_000_001, 7)
    assert data[80:88] == bytes(range(0xA0, 0xA8))
    assert struct.unpack(">IIIIII", data[88:112]) == (
        20260309,
        20270309,
        0x159,
        0x1234_5678,
        0x0001_0002,
        0xCAFE_0001,
    )
    assert data[112:136] == bytes(24)
    assert struct.unpack(">I", data[136:140]) == (0x0102_0304,)


def test_slots_lie_at_fixed_addresses_whatever_else_is_configured() -> None:
    states = {slot: joint_state(sequence=slot) for slot in (2, 6, 7, 32)}
    image = image_of(states, slots=(32, 2, 7, 6))
    for slot, fast in {2: 22, 6: 70, 7: 110, 32: 522}.items():
        assert number(image, fast + 2, "H") == slot
        assert number(image, 1000 + 100 * (slot - 1) + 4, "H") == slot
    assert number(image, 101, "H") == 4


def test_every_group_repeats_the_header_and_the_tail() -> None:
    image = image_of({1: joint_state(), 32: joint_state(status=StatusBit.CONFIGURED)}, slots=(1, 32))
    for start in (0, 500):
        assert number(image, start + 2, "I") == number(image, start + 82, "I") == 0x0102_0304
        assert number(image, start + 5, "I") == 1 << 31


def test_an_empty_slot_of_a_configured_group_holds_markers_and_status_zero() -> None:
    data = joint_image().read(22, 12)
    assert data == bytes.fromhex("00000000 ffff 80000000 80000000 80000000 8000 ffff ffff")


def test_a_configured_slot_without_a_state_is_configured_and_not_valid() -> None:
    image = image_of({})
    assert image.read(10, 12) == bytes.fromhex("00000002 ffff 80000000 80000000 80000000 8000 ffff ffff")
    assert number(image, 5, "I") == 1


@pytest.mark.parametrize(
    ("address", "count"),
    [
        (0, 0),
        (0, 85),
        (83, 2),
        (84, 1),
        (99, 1),
        (100, 1),
        (600, 1),
        (999, 1),
        (1000, 71),
        (1070, 1),
        (1069, 2),
        (1100, 1),
        (4200, 1),
        (65535, 1),
        (-1, 1),
        (-100, 1),
        (0, -1),
    ],
)
def test_what_is_not_all_of_one_served_block_cannot_be_read(address: int, count: int) -> None:
    assert joint_image().read(address, count) is None


def test_every_register_of_a_served_block_can_be_read_alone_and_agrees_with_the_whole() -> None:
    image = joint_image()
    for start, length in ((0, 84), (1000, 70)):
        whole = image.read(start, length)
        assert whole == b"".join(image.read(start + offset, 1) or b"" for offset in range(length))


@pytest.mark.parametrize("corrected_deg", [12.5, math.nan, math.inf, None])
@pytest.mark.parametrize("status", [StatusBit.CONFIGURED, StatusBit.CONFIGURED | StatusBit.STALE, StatusBit(0)])
def test_without_the_valid_bit_no_corrected_register_holds_an_angle(
    status: StatusBit, corrected_deg: float | None
) -> None:
    image = joint_image(status=status, corrected_deg=corrected_deg)
    assert number(image, FAST_SLOT_1 + 3, "i") == number(image, DETAIL_1 + 6, "i") == NO_INT32
    assert math.isnan(number(image, DETAIL_1 + 8, "d"))
    assert math.isnan(number(image, DETAIL_1 + 12, "f"))
    assert number(image, 5, "I") == 1
    # Raw has registers of its own and stays.
    assert number(image, FAST_SLOT_1 + 5, "i") == 444_424_444


@pytest.mark.parametrize("corrected_deg", [None, math.nan, math.inf, -math.inf, 1e9, -1e300])
def test_the_valid_bit_is_not_served_without_a_corrected_angle(corrected_deg: float | None) -> None:
    image = image_of({1: joint_state(corrected_deg=corrected_deg)}, service_status=int(ServiceBit.ALL_VALID) | 2)
    assert number(image, FAST_SLOT_1, "I") == number(image, DETAIL_1 + 2, "I") == int(StatusBit.CONFIGURED)
    assert number(image, FAST_SLOT_1 + 3, "i") == NO_INT32
    assert number(image, 5, "I") == 1
    assert number(image, 7, "H") == 2


@given(
    valid=st.booleans(),
    corrected_deg=st.none() | st.floats(allow_nan=True, allow_infinity=True, width=64),
    raw_deg=st.none() | st.floats(),
    others=st.lists(st.none() | st.floats(), min_size=5, max_size=5),
    integers=st.lists(st.none() | st.integers(-(2**70), 2**70), min_size=3, max_size=3),
)
def test_any_state_is_served_and_an_angle_only_with_valid(
    valid: bool,
    corrected_deg: float | None,
    raw_deg: float | None,
    others: list[float | None],
    integers: list[int | None],
) -> None:
    names = ("correction_arcsec", "temperature_c", "age_ms", "uncertainty_arcsec", "velocity_deg_s")
    image = joint_image(
        status=GOOD if valid else StatusBit.CONFIGURED,
        corrected_deg=corrected_deg,
        raw_deg=raw_deg,
        **dict(zip(names, others, strict=True)),
        **dict(zip(("sequence", "turns", "raw_counts"), integers, strict=True)),
    )
    served_valid = int(number(image, FAST_SLOT_1, "I")) & 1
    corrected_mas = number(image, FAST_SLOT_1 + 3, "i")
    assert served_valid == (corrected_mas != NO_INT32)
    assert served_valid <= valid
    assert corrected_mas == NO_INT32 or 0 <= corrected_mas < TURN_MAS
    assert math.isnan(number(image, DETAIL_1 + 8, "d")) == (corrected_mas == NO_INT32)
    assert number(image, 5, "I") == 1 - served_valid


@given(st.floats(-1e8, 1e8))
@example(0.0)
@example(-0.0)
@example(360.0)
@example(math.nextafter(360.0, 0.0))
@example(-5e-324)
@example(-1e-12)
@example(360.0 - 0.5 / 3.6e6)
@example(math.nextafter(360.0 - 0.5 / 3.6e6, 0.0))
@example(math.nextafter(360.0 - 0.5 / 3.6e6, 361.0))
@example(360.0 - 2.0**-16)
@example(math.nextafter(360.0 - 2.0**-16, 0.0))
@example(719.9999999999)
def test_integer_and_floats_of_one_angle_agree_also_around_the_wrap(angle_deg: float) -> None:
    image = joint_image(corrected_deg=angle_deg, raw_deg=angle_deg)
    mas = number(image, DETAIL_1 + 6, "i")
    float64_deg = number(image, DETAIL_1 + 8, "d")
    float32_deg = number(image, DETAIL_1 + 12, "f")
    assert 0 <= mas < TURN_MAS
    assert 0.0 <= float64_deg < 360.0
    assert 0.0 <= float32_deg < 360.0
    assert math.copysign(1.0, float64_deg) == 1.0
    assert abs(float64_deg * 3.6e6 - mas) <= 0.5
    # Half a step of binary32 below 360 is 2^-16 deg; on the circle, because 0 may stand for almost 360.
    difference_deg = math.remainder(float32_deg - float64_deg, 360.0)
    assert abs(difference_deg) <= 2.0**-16
    # The served angle is the given one up to the rounding and the resolution of binary64 at 1e8 deg, 1.5e-8.
    assert abs(math.remainder(float64_deg - angle_deg, 360.0)) <= 0.5 / 3.6e6 + 3e-8
    assert number(image, FAST_SLOT_1 + 3, "i") == mas
    # The raw angle goes through the same reduction.
    assert number(image, DETAIL_1 + 14, "i") == mas
    assert number(image, DETAIL_1 + 16, "d") == float64_deg


@given(st.floats(-1e7, 1e7), st.integers(-1000, 1000))
@example(-1e-12, 0)
@example(359.9999999999, 5)
@example(360.0, 5)
def test_turns_and_raw_together_are_the_raw_position(raw_deg: float, turns: int) -> None:
    image = joint_image(raw_deg=raw_deg, turns=turns)
    served_deg = number(image, DETAIL_1 + 24, "i") * 360.0 + number(image, DETAIL_1 + 14, "i") / 3.6e6
    # Rounding to a milli-arcsecond, plus binary64 at 1e7 deg.
    assert served_deg == pytest.approx(raw_deg + turns * 360.0, abs=0.5 / 3.6e6 + 1e-8)


@pytest.mark.parametrize(
    ("field", "value", "address", "code", "expected"),
    [
        ("age_ms", 65534.4, FAST_SLOT_1 + 10, "H", 65534),
        ("age_ms", 65535.0, FAST_SLOT_1 + 10, "H", 65534),
        ("age_ms", 1e30, FAST_SLOT_1 + 10, "H", 65534),
        ("age_ms", math.inf, FAST_SLOT_1 + 10, "H", 65535),
        ("age_ms", -0.1, FAST_SLOT_1 + 10, "H", 65535),
        ("age_ms", 70_000.0, DETAIL_1 + 32, "I", 70_000),
        ("age_ms", 1e30, DETAIL_1 + 32, "I", 0xFFFF_FFFE),
        ("uncertainty_arcsec", 655.35, FAST_SLOT_1 + 11, "H", 65534),
        ("uncertainty_arcsec", 1e30, FAST_SLOT_1 + 11, "H", 65534),
        ("uncertainty_arcsec", -1.0, FAST_SLOT_1 + 11, "H", 65535),
        ("temperature_c", 327.67, FAST_SLOT_1 + 9, "h", 32767),
        ("temperature_c", 327.68, FAST_SLOT_1 + 9, "h", -32768),
        ("temperature_c", -327.67, FAST_SLOT_1 + 9, "h", -32767),
        ("temperature_c", -327.68, FAST_SLOT_1 + 9, "h", -32768),
        ("correction_arcsec", -0.0014, FAST_SLOT_1 + 7, "i", -1),
        ("correction_arcsec", 2_147_484.0, FAST_SLOT_1 + 7, "i", NO_INT32),
        ("turns", 2**31 - 1, DETAIL_1 + 24, "i", 2**31 - 1),
        ("turns", 2**31, DETAIL_1 + 24, "i", NO_INT32),
        ("turns", -(2**31), DETAIL_1 + 24, "i", NO_INT32),
        ("raw_counts", 2**32, DETAIL_1 + 34, "I", 0xFFFF_FFFF),
        ("raw_counts", -1, DETAIL_1 + 34, "I", 0xFFFF_FFFF),
        ("sequence", 65536 + 7, DETAIL_1 + 4, "H", 7),
        ("frames_received", 2**32 + 5, DETAIL_1 + 36, "I", 5),
        ("frames_lost", 2**32 + 6, DETAIL_1 + 38, "I", 6),
    ],
)
def test_the_ends_of_each_range(field: str, value: float, address: int, code: str, expected: int) -> None:
    assert number(joint_image(**{field: value}), address, code) == expected


@pytest.mark.parametrize(
    ("field", "address"),
    [("velocity_deg_s", 22), ("temperature_c", 26), ("correction_arcsec", 28), ("uncertainty_arcsec", 30)],
)
@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf, 1e39])
def test_a_float32_register_holds_quiet_nan_for_what_is_not_known(
    field: str, address: int, value: float | None
) -> None:
    assert joint_image(**{field: value}).read(DETAIL_1 + address, 2) == bytes.fromhex("7fc00000")


def test_an_unknown_angle_is_quiet_nan_in_float64() -> None:
    assert joint_image(raw_deg=None).read(DETAIL_1 + 16, 4) == bytes.fromhex("7ff8000000000000")


def test_an_identity_that_is_not_known_holds_markers() -> None:
    identity = joint_identity(
        model_id=None,
        calibration_date=None,
        calibration_due=None,
        vendor_id=None,
        product_code=None,
        revision_number=None,
        serial_number=None,
    )
    image = RegisterMap([identity]).image(cycle=0, heartbeat=0, service_status=0, states={})
    assert image.read(DETAIL_1 + 40, 16) == b"\xff" * 32


def test_counters_of_the_header_wrap() -> None:
    image = RegisterMap([joint_identity()]).image(
        cycle=2**32 + 9, heartbeat=65536 + 8, service_status=2**16 + 6, states={1: joint_state()}
    )
    assert [number(image, *where) for where in ((2, "I"), (82, "I"), (4, "H"), (7, "H"))] == [9, 9, 8, 6]


def test_an_image_does_not_change_when_the_next_one_is_built() -> None:
    register_map = RegisterMap([joint_identity()])
    states = {1: joint_state()}
    first = register_map.image(cycle=1, heartbeat=1, service_status=0, states=states)
    before = bytes(first.data)
    register_map.image(cycle=2, heartbeat=2, service_status=0, states={1: states[1]._replace(corrected_deg=1.0)})
    assert first.data == before


def test_a_detail_block_that_is_read_late_is_of_the_cycle_of_its_image() -> None:
    register_map = RegisterMap([joint_identity()])
    states = {1: joint_state(corrected_deg=1.0)}
    at_once = register_map.image(cycle=1, heartbeat=1, service_status=0, states=states).read(DETAIL_1, 70)
    late = register_map.image(cycle=1, heartbeat=1, service_status=0, states=states)
    states[1] = joint_state(corrected_deg=2.0)
    register_map.image(cycle=2, heartbeat=2, service_status=0, states=states).read(DETAIL_1, 70)
    assert late.read(DETAIL_1, 70) == at_once


def test_the_bits_of_all_invalid_slots_are_in_every_header() -> None:
    slots = tuple(range(1, 33))
    states = {slot: joint_state(status=GOOD if slot % 3 else StatusBit.CONFIGURED) for slot in slots}
    image = image_of(states, slots)
    expected = sum(1 << slot - 1 for slot in slots if slot % 3 == 0)
    assert {number(image, 100 * group + 5, "I") for group in range(6)} == {expected}


def test_a_state_of_a_slot_that_is_not_configured_is_refused() -> None:
    with pytest.raises(ValueError, match="slots"):
        image_of({2: joint_state()})


def test_a_slot_named_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="slot 3"):
        RegisterMap([joint_identity(3), joint_identity(3)])


@pytest.mark.parametrize(
    "changes",
    [
        {"slot": 0},
        {"slot": 33},
        {"node_id": 0},
        {"node_id": 128},
        {"model_id": b"1234567"},
        {"serial_number": -1},
        {"vendor_id": 2**32},
    ],
)
def test_an_identity_that_the_registers_cannot_hold_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(changes))):
        joint_identity(**changes)


def test_every_pair_of_fields_has_registers_of_its_own() -> None:
    """One changed value changes only its own registers, so no two fields overlap."""
    base = joint_image()
    changes = {
        "sequence": 1,
        "correction_arcsec": 1.0,
        "temperature_c": 1.0,
        "age_ms": 100.0,
        "uncertainty_arcsec": 1.0,
        "velocity_deg_s": 1.0,
        "turns": 1,
        "raw_counts": 1,
        "frames_received": 1,
        "frames_lost": 1,
        "raw_deg": 1.0,
        "corrected_deg": 1.0,
    }
    touched = {
        field: {at // 2 for at, pair in enumerate(zip(base.data, changed.data, strict=True)) if pair[0] != pair[1]}
        for field, changed in ((field, joint_image(**{field: value})) for field, value in changes.items())
    }
    assert all(touched.values())
    for one, other in itertools.combinations(touched, 2):
        assert not touched[one] & touched[other], (one, other)
