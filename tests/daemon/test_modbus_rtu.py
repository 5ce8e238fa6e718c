"""Modbus RTU: framed by silence and CRC, silent for others, and never one request's answer for another's."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU
from tests.fakes.command_target import FakeJoints, FakeStore
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.commands import CommandDesk, Peer
from trueangle.core.modbus_pdu import Identification, PduResponder
from trueangle.core.modbus_rtu import ModbusRtuStream, crc16, silence_ns
from trueangle.core.registers import RegisterMap

UNIT_ID = 17
IMAGE = RegisterMap([joint_identity()]).image(cycle=7, heartbeat=9, service_status=0, states={1: joint_state()})
MS = 1_000_000


def framed(pdu: str | bytes, unit: int = UNIT_ID) -> bytes:
    """With unit id and CRC as pymodbus computes it: independent of the server."""
    data = bytes([unit]) + (pdu if isinstance(pdu, bytes) else bytes.fromhex(pdu))
    return data + FramerRTU.compute_CRC(data).to_bytes(2, "big")


class Line:
    """A serial line with a clock of its own, at 19200 Bd: 0.57 ms a byte, 2 ms of silence."""

    def __init__(self) -> None:
        self.joints = FakeJoints()
        desk = CommandDesk(self.joints, FakeStore(), presets=(), report=lambda _: None)
        peer = Peer(address="line", may_command=True)
        responder = PduResponder(Identification(revision="1"), peer=peer, session=desk.session(peer))
        self.stream = ModbusRtuStream(UNIT_ID, responder, baudrate=19_200)
        self.now_ns = 10**9

    def send(self, data: bytes, *, step: int = 256, gap_ms: float = 0.6) -> None:
        for at in range(0, len(data), step):
            self.now_ns += round(gap_ms * MS)
            self.stream.receive(data[at : at + step], self.now_ns)

    def hear(self, after_ms: float = 2.1) -> bytes:
        self.now_ns += round(after_ms * MS)
        return self.stream.silent(IMAGE, self.now_ns)

    def ask(self, data: bytes) -> bytes:
        self.send(data)
        return self.hear()


READ = framed("04 0002 0002")
ANSWER = framed("04 04 0000 0007")


def test_the_crc_is_that_of_the_specification() -> None:
    # [SL] appendix B: 02 07 has CRC 0x1241, sent 41 12.
    assert crc16(bytes.fromhex("0207")) == 0x1241
    assert crc16(bytes.fromhex("02074112")) == 0


@pytest.mark.parametrize(
    ("baudrate", "us"), [(1200, 32083), (9600, 4010), (19200, 2005), (38400, 1750), (921600, 1750)]
)
def test_a_frame_ends_with_three_and_a_half_characters_of_silence(baudrate: int, us: int) -> None:
    assert silence_ns(baudrate) // 1000 == us


def test_a_request_is_answered_from_the_image_after_the_silence() -> None:
    line = Line()
    line.send(READ)
    assert line.hear(1.9) == b""
    assert line.hear(0.2) == ANSWER
    assert line.hear() == b""


def test_a_request_that_comes_byte_by_byte_is_answered() -> None:
    line = Line()
    line.send(READ, step=1)
    assert line.hear() == ANSWER


def test_a_request_with_a_silence_inside_is_no_request() -> None:
    line = Line()
    line.send(READ[:4])
    line.hear()
    line.send(READ[4:])
    assert line.hear() == b""
    assert line.ask(READ) == ANSWER


@pytest.mark.parametrize("unit", [0, 1, 16, 18, 247, 255])
def test_foreign_units_and_broadcasts_get_no_answer_and_do_nothing(unit: int) -> None:
    line = Line()
    assert line.ask(framed("04 0002 0002", unit)) == b""
    assert line.ask(framed("05 07d0 ff00", unit)) == b""
    assert line.ask(framed("2b 0e 01 00", unit)) == b""
    assert line.joints.cleared == []
    assert line.stream.requests == 0


def test_wrong_checksums_and_garbage_get_no_answer_and_leave_no_trace() -> None:
    line = Line()
    for damaged in (READ[:-1] + bytes([READ[-1] ^ 1]), b"\x11", b"\x11\x04", bytes(300), bytes(5000), READ[1:]):
        assert line.ask(damaged) == b""
    assert line.ask(READ) == ANSWER


def test_of_requests_back_to_back_only_the_last_is_answered() -> None:
    """Without a transaction number the master would take the first answer for that of its last request."""
    line = Line()
    assert line.ask(framed("04 000d 0002") + READ) == ANSWER
    assert line.ask(framed("04 0002 0002", 9) + READ) == ANSWER
    assert line.ask(READ + framed("04 0002 0002", 9)) == b""
    assert line.stream.requests == 2


def test_a_write_that_a_later_request_overtook_is_not_done() -> None:
    line = Line()
    assert line.ask(framed("05 07d0 ff00") + READ) == ANSWER
    assert line.joints.cleared == []


def test_a_request_behind_another_units_answer_is_not_guessed_at() -> None:
    line = Line()
    assert line.ask(framed("04 02 1234", 9) + READ) == b""


def test_a_finished_request_that_waited_through_a_stall_is_not_answered_late() -> None:
    line = Line()
    line.send(framed("04 000d 0002"))
    # The loop stood still; the next request is read before the timer of the first could run.
    line.now_ns += 500 * MS
    line.send(READ)
    assert line.hear() == ANSWER
    assert line.stream.requests == 1


def test_wrong_requests_get_the_same_exceptions_as_over_tcp() -> None:
    line = Line()
    for pdu, answer in (("04 0000 0000", "84 03"), ("04 0054 0001", "84 02"), ("65", "e5 01"), ("04 00", "84 03")):
        assert line.ask(framed(pdu)) == framed(answer)
    assert line.stream.exceptions == 4


def test_before_the_first_image_the_line_is_busy() -> None:
    line = Line()
    line.send(READ)
    assert line.stream.silent(None, line.now_ns + 3 * MS) == framed("84 06")


def test_an_adapter_that_hears_itself_does_not_make_a_write_repeat_itself() -> None:
    line = Line()
    clear = framed("05 07d0 ff00")
    for _ in range(3):
        answer = line.ask(clear)
        assert answer == clear
        # The echo comes as the answer leaves.
        assert line.ask(answer) == b""
        line.hear(100)
    assert line.joints.cleared == [1, 1, 1]


def test_an_echo_in_front_of_the_next_request_does_not_spoil_it() -> None:
    line = Line()
    assert line.ask(READ) == ANSWER
    assert line.ask(ANSWER + READ) == ANSWER


def test_the_same_write_again_later_is_a_request() -> None:
    line = Line()
    clear = framed("05 07d0 ff00")
    assert line.ask(clear) == clear
    line.hear(100)
    assert line.ask(clear) == clear
    assert line.joints.cleared == [1, 1]


def test_a_longer_silence_bridges_an_adapter_that_delivers_in_pieces() -> None:
    line = Line()
    responder = PduResponder(Identification(revision="1"))
    stream = ModbusRtuStream(UNIT_ID, responder, baudrate=115_200, longer_silence_ns=20 * MS)
    stream.receive(READ[:3], line.now_ns)
    stream.receive(READ[3:], line.now_ns + 16 * MS)
    assert stream.silent(IMAGE, line.now_ns + 30 * MS) == b""
    assert stream.silent(IMAGE, line.now_ns + 36 * MS) == ANSWER


_PIECES = st.one_of(
    st.binary(max_size=300),
    st.sampled_from([READ, framed("04 0002 0002", 9), framed("05 07d0 ff00", 0), framed("65"), ANSWER]),
    st.builds(framed, st.binary(min_size=1, max_size=30), st.sampled_from([UNIT_ID, 0, 9])),
)


@given(pieces=st.lists(st.tuples(_PIECES, st.sampled_from([0.0, 0.6, 2.1, 50.0])), max_size=20))
def test_no_bytes_in_no_rhythm_break_the_line_and_every_answer_is_a_frame_of_ours(
    pieces: list[tuple[bytes, float]],
) -> None:
    line = Line()
    for data, gap_ms in pieces:
        line.send(data)
        answer = line.hear(gap_ms)
        if answer:
            assert answer[0] == UNIT_ID
            assert answer == framed(answer[1:-2])
            assert len(answer) <= 256
    line.hear(100)
    assert line.ask(READ) == ANSWER
