"""The socketless Modbus server: bytes in, bytes out, however they are cut and however wrong they are."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.constants import ExcCodes
from tests.fakes.modbus_tcp_client import frame, read_request, split_frames
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.modbus_answer import ModbusTcpStream
from trueangle.core.modbus_pdu import ExceptionCode, Identification, PduResponder
from trueangle.core.registers import RegisterImage, RegisterMap

UNIT_ID = 17
IMAGE = RegisterMap([joint_identity()]).image(
    cycle=0xA1A2_A3A4, heartbeat=9, service_status=0, states={1: joint_state()}
)


def new_stream() -> ModbusTcpStream:
    """A connection that may read and nothing else."""
    return ModbusTcpStream(UNIT_ID, PduResponder(Identification(revision="1.2.3")))


def feed(stream: ModbusTcpStream, data: bytes, image: RegisterImage | None = IMAGE, step: int = 260) -> bytes:
    """Hand over the bytes as a socket would: as many as fit, at most `step` at a time."""
    answers = b""
    while data and stream.broken is None:
        space = stream.space
        take = min(step, len(space), len(data))
        assert take > 0
        space[:take] = data[:take]
        answers += stream.answer(take, image, 0)
        data = data[take:]
    return answers


def answer(data: bytes, image: RegisterImage | None = IMAGE) -> bytes:
    return feed(new_stream(), data, image)


@pytest.mark.parametrize("function", [3, 4])
@pytest.mark.parametrize("unit", [0, 255, UNIT_ID])
def test_a_read_is_answered_from_the_image_under_its_transaction_and_unit(function: int, unit: int) -> None:
    data = IMAGE.read(2, 10)
    assert data is not None
    expected = bytes.fromhex("beef 0000 0017") + bytes([unit, function, 20]) + data
    assert answer(read_request(function, 2, 10, transaction=0xBEEF, unit=unit)) == expected
    assert data.startswith(bytes.fromhex("a1a2a3a4"))


@pytest.mark.parametrize(
    ("pdu", "expected"),
    [
        pytest.param("04 0000 0000", "84 03", id="count 0"),
        pytest.param("04 0000 007e", "84 03", id="count 126"),
        pytest.param("03 0000 ffff", "83 03", id="count 65535"),
        pytest.param("04 0000 00", "84 03", id="one byte short"),
        pytest.param("04 0000 0001 00", "84 03", id="one byte long"),
        pytest.param("04", "84 03", id="function code alone"),
        pytest.param("04 0054 0001", "84 02", id="behind the fast group"),
        pytest.param("04 0000 0055", "84 02", id="out of the fast group"),
        pytest.param("04 0000 007d", "84 02", id="125 registers"),
        pytest.param("04 0064 0001", "84 02", id="group without a joint"),
        pytest.param("04 ffff 007d", "84 02", id="end of the address space"),
        pytest.param("65 00 00", "e5 01", id="unknown function"),
        pytest.param("06 0000 0001", "86 01", id="write"),
        pytest.param("2b 0d 01 00", "ab 01", id="another encapsulated interface"),
        pytest.param("01 0000 07d1", "81 03", id="2001 coils"),
        pytest.param("02 0000 0000", "82 03", id="no discrete input"),
        pytest.param("02 004f 0002", "82 02", id="out of a block of bits"),
        pytest.param("02 07d0 0001", "82 02", id="coils of commands that are not enabled"),
        pytest.param("05 07d0 ff00", "85 01", id="write of a coil"),
        pytest.param("0f 07d0 0001 01 01", "8f 01", id="write of coils"),
        pytest.param("10 1388 0001 02 0001", "90 01", id="write of registers"),
        pytest.param("16 1388 ffff 0000", "96 01", id="masked write"),
        pytest.param("17 0000 0001 1388 0001 02 0001", "97 01", id="exchange"),
        pytest.param("03 1388 0001", "83 02", id="command block that is not enabled"),
        pytest.param("00", "80 01", id="function 0"),
        pytest.param("80 0000 0001", "80 01", id="function 0x80"),
        pytest.param("84 0000 0001", "84 01", id="exception bit in the request"),
        pytest.param("ff", "ff 01", id="function 0xFF"),
    ],
)
def test_a_wrong_request_gets_its_exception(pdu: str, expected: str) -> None:
    request = frame(bytes.fromhex(pdu), transaction=3, unit=UNIT_ID)
    assert answer(request) == frame(bytes.fromhex(expected), transaction=3, unit=UNIT_ID)


@pytest.mark.parametrize("pdu", ["04 0000 0001", "06 0000 0001", "04 0000 0000"])
def test_a_foreign_unit_is_a_gateway_target_that_failed(pdu: str) -> None:
    request = bytes.fromhex(pdu)
    assert answer(frame(request, unit=18)) == frame(bytes([request[0] | 0x80, 0x0B]), unit=18)


def test_before_the_first_image_a_good_read_finds_the_server_busy() -> None:
    assert answer(read_request(4, 0, 84, unit=0), image=None) == frame(b"\x84\x06", unit=0)
    assert answer(read_request(4, 0, 0, unit=0), image=None) == frame(b"\x84\x03", unit=0)


@pytest.mark.parametrize(
    "header",
    [
        "0001 0001 0006 00",
        "0001 8000 0006 00",
        "0001 0000 0000 00",
        "0001 0000 0001 00",
        "0001 0000 00ff 00",
        "0001 0000 ffff 00",
    ],
)
def test_a_header_that_cannot_be_right_ends_the_stream_after_the_requests_before_it(header: str) -> None:
    stream = new_stream()
    good = read_request(4, 0, 1, unit=0)
    answers = feed(stream, good + bytes.fromhex(header) + good)
    assert len(split_frames(answers)) == 1
    assert stream.broken is not None
    stream.space[:12] = good
    assert stream.answer(12, IMAGE, 0) == b""


def test_the_longest_and_the_shortest_frame_are_understood() -> None:
    longest = frame(b"\x10" + bytes(252), unit=0)
    assert len(longest) == 260
    assert split_frames(answer(longest + frame(b"\x07", unit=0))) == [
        frame(b"\x90\x01", unit=0),
        frame(b"\x87\x01", unit=0),
    ]


@pytest.mark.parametrize("step", [1, 2, 5, 7, 11, 13, 260])
def test_pipelined_requests_are_all_answered_in_order_however_they_are_cut(step: int) -> None:
    requests = [read_request(4, number % 80, 2, transaction=number, unit=0) for number in range(100)]
    frames = split_frames(feed(new_stream(), b"".join(requests), step=step))
    assert [int.from_bytes(one[:2], "big") for one in frames] == list(range(100))
    assert [one[9:] for one in frames] == [IMAGE.read(number % 80, 2) for number in range(100)]


def test_reads_of_one_request_s_length_that_are_out_of_step_with_the_requests_lose_none() -> None:
    stream = new_stream()
    numbers = [0x0101 * number for number in range(9)]
    data = b"".join(read_request(4, 2, 2, transaction=number, unit=0) for number in numbers)
    answers = feed(stream, data[:1]) + feed(stream, data[1:], step=12)
    assert [int.from_bytes(one[:2], "big") for one in split_frames(answers)] == numbers


def test_a_stream_that_ended_with_its_buffer_full_still_has_room_for_what_nobody_reads() -> None:
    stream = new_stream()
    feed(stream, b"\xff" * 260)
    assert stream.broken is not None
    assert len(stream.space) > 0


class Everything:
    """Registers without a border."""

    def read(self, address: int, count: int) -> bytes:
        return bytes(2 * count)


@pytest.mark.parametrize(("count", "expected"), [(125, b"\x04\xfa" + bytes(250)), (126, b"\x84\x03")])
def test_no_more_than_125_registers_are_read_however_many_there_are(count: int, expected: bytes) -> None:
    stream = new_stream()
    stream.space[:12] = read_request(4, 0, count, unit=0)
    assert stream.answer(12, Everything(), 0)[7:] == expected


def test_one_read_of_the_buffer_answers_no_more_than_it_holds() -> None:
    stream = new_stream()
    requests = read_request(4, 0, 84, unit=0) * 30
    assert len(stream.space) == 260
    stream.space[:] = requests[:260]
    assert len(split_frames(stream.answer(260, IMAGE, 0))) == 21


def test_requests_and_exceptions_are_counted() -> None:
    stream = new_stream()
    feed(stream, read_request(4, 0, 1, unit=0) + read_request(4, 0, 0, unit=0) + read_request(4, 0, 1, unit=9))
    assert (stream.counts.requests, stream.counts.exceptions) == (3, 2)


def test_exception_codes_are_those_of_the_specification_as_pymodbus_has_them() -> None:
    assert list(ExceptionCode) == [
        ExcCodes.ILLEGAL_FUNCTION,
        ExcCodes.ILLEGAL_ADDRESS,
        ExcCodes.ILLEGAL_VALUE,
        ExcCodes.DEVICE_FAILURE,
        ExcCodes.DEVICE_BUSY,
        ExcCodes.GATEWAY_NO_RESPONSE,
    ]


BITS_SET = {0, 32, 100, 101}
"""VALID and CONFIGURED of slot 1, in the summary and in its status word."""
OBJECTS = (b"trueangle", b"trueangled", b"1.2.3", b"", b"corrected encoder angles", b"register map 1")


def expected_bits(pdu: bytes) -> tuple[int, bytes | None]:
    """Exception code, or what follows the byte count."""
    if len(pdu) != 5 or not 1 <= (count := int.from_bytes(pdu[3:5], "big")) <= 2000:
        return 3, None
    wanted = range(start := int.from_bytes(pdu[1:3], "big"), start + count)
    if not any(wanted[0] >= block[0] and wanted[-1] <= block[-1] for block in (range(80), range(100, 1124))):
        return 2, None
    packed = bytearray((count + 7) // 8)
    for place, address in enumerate(wanted):
        packed[place // 8] |= (address in BITS_SET) << place % 8
    return 0, bytes(packed)


def expected_identification(pdu: bytes) -> tuple[int, bytes | None]:
    """Exception code, or what follows the function code."""
    if len(pdu) < 2 or pdu[1] != 14:
        return 1, None
    if len(pdu) != 4 or pdu[2] not in (1, 2, 3, 4):
        return 3, None
    if pdu[2] == 4:
        if pdu[3] > 5:
            return 2, None
        chosen = [pdu[3]]
    else:
        last = 2 if pdu[2] == 1 else 5
        chosen = list(range(pdu[3] if pdu[3] <= last else 0, last + 1))
    answer = bytes([14, pdu[2], 0x82, 0, 0, len(chosen)])
    return 0, answer + b"".join(bytes([i, len(OBJECTS[i])]) + OBJECTS[i] for i in chosen)


def expected_answers(data: bytes) -> tuple[list[bytes], bool]:
    """The specification applied slowly to all bytes at once: answers, and whether the stream is still good."""
    answers: list[bytes] = []
    while len(data) >= 7:
        length = int.from_bytes(data[4:6], "big")
        if data[2:4] != b"\0\0" or not 2 <= length <= 254:
            return answers, False
        if len(data) < 6 + length:
            break
        transaction, unit, pdu = int.from_bytes(data[:2], "big"), data[6], data[7 : 6 + length]
        function = pdu[0]
        registers: bytes | None = None
        if unit not in (0, 255, UNIT_ID):
            code = 0x0B
        elif function in (1, 2):
            code, registers = expected_bits(pdu)
        elif function == 0x2B:
            code, registers = expected_identification(pdu)
        elif function not in (3, 4):
            code = 1
        elif len(pdu) != 5 or not 1 <= (count := int.from_bytes(pdu[3:5], "big")) <= 125:
            code = 3
        else:
            code = 2
            registers = IMAGE.read(int.from_bytes(pdu[1:3], "big"), count)
        if registers is None:
            answer_pdu = bytes([function | 0x80, code])
        elif function == 0x2B:
            answer_pdu = bytes([function]) + registers
        else:
            answer_pdu = bytes([function, len(registers)]) + registers
        answers.append(frame(answer_pdu, transaction=transaction, unit=unit))
        data = data[6 + length :]
    return answers, True


_REQUESTS = st.builds(
    read_request,
    st.sampled_from([3, 4, 4, 4, 6, 0x84]),
    st.sampled_from([0, 10, 82, 1000, 1068, 1100]) | st.integers(0, 65535),
    st.integers(0, 130),
    transaction=st.integers(0, 65535),
    unit=st.sampled_from([0, 255, UNIT_ID, 5]),
)
_PDUS = st.one_of(
    st.builds(
        lambda function, address, count: bytes([function]) + address.to_bytes(2, "big") + count.to_bytes(2, "big"),
        st.sampled_from([1, 2]),
        st.integers(0, 1200),
        st.integers(0, 2002),
    ),
    st.builds(lambda access, number: bytes([0x2B, 14, access, number]), st.integers(0, 5), st.integers(0, 7)),
)
_GOOD_FRAMES = st.builds(frame, _PDUS, unit=st.sampled_from([0, 255]))
_FRAMES = st.builds(frame, st.binary(min_size=1, max_size=253), unit=st.sampled_from([0, 255, 5]))


@st.composite
def _streams(draw: st.DrawFn) -> bytes:
    """Good requests and any PDUs, then bytes changed, inserted or lost."""
    data = bytearray(
        b"".join(draw(st.lists(_REQUESTS | _FRAMES | _GOOD_FRAMES | st.binary(max_size=20), max_size=12)))
    )
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, len(data)))
        data[at : at + draw(st.integers(0, 2))] = draw(st.binary(max_size=3))
    return bytes(data)


@given(data=_streams() | st.binary(max_size=600), steps=st.lists(st.integers(1, 300), min_size=1, max_size=40))
def test_any_bytes_in_any_pieces_are_answered_as_the_specification_says(data: bytes, steps: list[int]) -> None:
    stream = new_stream()
    answers, at = b"", 0
    for number in range(len(data)):
        if at >= len(data) or stream.broken is not None:
            break
        step = steps[number % len(steps)]
        answers += feed(stream, data[at : at + step])
        at += step
    frames, good = expected_answers(data)
    assert answers == b"".join(frames)
    assert (stream.broken is None) == good
    assert stream.counts.requests == len(frames)
