"""The command block and the coils over PDUs: every function, every order of checks, every right."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.command_target import FakeJoints, FakeStore
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.commands import CommandDesk, Peer
from trueangle.core.modbus_pdu import Identification, PduResponder
from trueangle.core.register_fields import MAP_VERSION
from trueangle.core.registers import RegisterImage, RegisterMap

IMAGE = RegisterMap([joint_identity()]).image(cycle=1, heartbeat=9, service_status=5, states={1: joint_state()})
NOW_NS = 10**12
SETTER = Peer(address="192.0.2.7", role="setter", may_command=True)
ABOUT = Identification(revision="1.2.3")


class Plc:
    """One connection to a desk over fakes."""

    def __init__(self, peer: Peer = SETTER) -> None:
        self.joints, self.store = FakeJoints(), FakeStore()
        self.desk = CommandDesk(self.joints, self.store, presets=(), report=lambda _: None)
        self.responder = PduResponder(ABOUT, peer=peer, session=self.desk.session(peer))
        self.now_ns = NOW_NS

    def ask(self, pdu: str, image: RegisterImage | None = IMAGE) -> str:
        return self.responder.answer(bytes.fromhex(pdu), image, self.now_ns).hex(" ", 2)


def test_one_write_of_slot_angle_and_command_arms_and_another_confirms() -> None:
    plc = Plc()
    # Slot 1 shall read 10 degrees, 36,000,000 mas.
    assert plc.ask("10 1388 0004 08 0001 0225 5100 0001") == bytes.fromhex("10 1388 0004").hex(" ", 2)
    assert plc.ask("03 138c 0004") == bytes.fromhex("03 08 0002 0001 1388 0001").hex(" ", 2)
    plc.now_ns += 200_000_000
    plc.ask("10 1388 0004 08 0001 0225 5100 0002")
    assert plc.joints.zeros[1] == 90 * 3_600_000
    assert plc.ask("04 1388 0008") == bytes.fromhex("04 10 0001 0225 5100 0000 0001 0000 0000 0002").hex(" ", 2)


def test_single_writes_do_the_same() -> None:
    plc = Plc()
    for pdu in ("06 1388 0001", "06 1389 0225", "06 138a 5100", "06 138b 0001"):
        assert plc.ask(pdu) == bytes.fromhex(pdu).hex(" ", 2)
    plc.now_ns += 200_000_000
    assert plc.ask("06 138b 0002") == bytes.fromhex("06 138b 0002").hex(" ", 2)
    assert plc.joints.zeros[1] == 90 * 3_600_000


def test_an_exchange_writes_first_and_reads_the_result_in_the_same_answer() -> None:
    plc = Plc()
    pdu = "17 138c 0004 1388 0004 08 0001 0000 0000 0001"
    assert plc.ask(pdu) == bytes.fromhex("17 08 0002 0001 1388 0001").hex(" ", 2)


@pytest.mark.parametrize(
    "pdu",
    [
        pytest.param("17 0055 0001 1388 0004 08 0001 0000 0000 0001", id="bad read"),
        pytest.param("17 138c 0004 138c 0001 02 0001", id="bad write"),
    ],
)
def test_an_exchange_that_is_half_wrong_does_nothing(pdu: str) -> None:
    plc = Plc()
    assert plc.ask(pdu) == "9702"
    assert plc.ask("04 1388 0008") == bytes.fromhex("04 10" + "0000" * 8).hex(" ", 2)


def test_a_masked_write_changes_bits_and_repeats_no_command() -> None:
    plc = Plc()
    plc.ask("06 1388 0012")
    # The specification's own example: current 0x12, and 0xF2, or 0x25 gives 0x17.
    assert plc.ask("16 1388 00f2 0025") == bytes.fromhex("16 1388 00f2 0025").hex(" ", 2)
    assert plc.ask("03 1388 0001") == bytes.fromhex("03 02 0017").hex(" ", 2)
    plc.ask("10 1388 0004 08 0001 0000 0000 0005")
    plc.ask("16 138b ffff 0000")
    assert plc.joints.cleared == [1]


def test_coils_clear_faults_and_read_zero() -> None:
    plc = Plc()
    assert plc.ask("05 07d1 ff00") == bytes.fromhex("05 07d1 ff00").hex(" ", 2)
    assert plc.joints.cleared == [2]
    assert plc.ask("05 07d0 0000") == bytes.fromhex("05 07d0 0000").hex(" ", 2)
    assert plc.joints.cleared == [2]
    assert plc.ask("0f 07d0 0003 01 03") == bytes.fromhex("0f 07d0 0003").hex(" ", 2)
    assert plc.joints.cleared == [2, 1, 2]
    assert plc.ask("01 07d0 0020") == bytes.fromhex("01 04 00000000").hex(" ", 2)
    assert plc.ask("02 07d0 0001") == "8202"


def test_bits_agree_with_the_registers() -> None:
    plc = Plc()
    assert plc.ask("02 0000 0050") == bytes.fromhex("02 0a 01000000 01000000 0500").hex(" ", 2)
    assert plc.ask("01 0020 0001") == bytes.fromhex("01 01 01").hex(" ", 2)
    assert plc.ask("02 0064 0040") == bytes.fromhex("02 08 03000000 00000000").hex(" ", 2)
    assert plc.ask("02 0065 0001") == bytes.fromhex("02 01 01").hex(" ", 2)


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        pytest.param("05 07d0 0001", "8503", id="coil neither on nor off"),
        pytest.param("05 07f0 ff00", "8502", id="behind the coils"),
        pytest.param("05 07d2 ff00", "8502", id="coil of a slot without a joint"),
        pytest.param("05 0000 ff00", "8502", id="a bit that is read only"),
        pytest.param("05 07d0 ff", "8503", id="coil, short"),
        pytest.param("0f 07d0 0001 02 01 00", "8f03", id="coils, wrong byte count"),
        pytest.param("0f 07d0 0000 00", "8f03", id="no coil"),
        pytest.param("0f 07d0 07b1 f7" + "00" * 247, "8f03", id="1969 coils"),
        pytest.param("0f 07d0 0004 01 0f", "8f02", id="coils, one without a joint: none is done"),
        pytest.param("0f 07d0", "8f03", id="coils, short"),
        pytest.param("06 0000 0001", "8602", id="a register that is read only"),
        pytest.param("06 138c 0001", "8602", id="the result"),
        pytest.param("06 1387 0001", "8602", id="before the block"),
        pytest.param("06 1388", "8603", id="write, short"),
        pytest.param("10 138b 0002 04 0000 0000", "9002", id="out of what is writable"),
        pytest.param("10 1388 0000 00", "9003", id="no register"),
        pytest.param("10 1388 0001 03 0001 00", "9003", id="odd byte count"),
        pytest.param("10 1388 007c f8" + "00" * 248, "9003", id="124 registers"),
        pytest.param("16 138c ffff 0000", "9602", id="masked, not writable"),
        pytest.param("16 1388 ffff", "9603", id="masked, short"),
        pytest.param("17 1388 007e 1388 0001 02 0001", "9703", id="exchange, 126 read"),
        pytest.param("17 1388 0001 1388 007a f4" + "00" * 244, "9703", id="exchange, 122 written"),
        pytest.param("17 1388 0001 1388 0001", "9703", id="exchange, short"),
        pytest.param("03 1388 0009", "8302", id="out of the command block"),
        pytest.param("06 138b 0001", "8603", id="arm without a slot"),
        pytest.param("06 138b 0063", "8603", id="no such command"),
        pytest.param("10 1388 0004 08 0001 0000 0000 0002", "9004", id="confirm what is not armed"),
        pytest.param("08 0000 0000", "8801", id="diagnostics"),
        pytest.param("11", "9101", id="server id"),
    ],
)
def test_a_wrong_request_gets_its_exception_and_does_nothing(pdu: str, answer: str) -> None:
    plc = Plc()
    assert plc.ask(pdu) == answer
    assert (plc.joints.cleared, plc.store.saved) == ([], [])


def test_before_the_first_image_commands_find_the_server_busy() -> None:
    plc = Plc()
    pdus = ("06 1388 0001", "05 07d0 ff00", "10 1388 0001 02 0001", "16 1388 ffff 0000", "02 0000 0001")
    assert [plc.ask(pdu, None) for pdu in pdus] == ["8606", "8506", "9006", "9606", "8206"]
    assert plc.joints.cleared == []


def test_a_preset_being_stored_makes_the_next_one_wait() -> None:
    plc = Plc()
    plc.store.slow = True
    for slot in ("0001", "0002"):
        plc.ask(f"10 1388 0004 08 {slot} 0000 0000 0001")
        plc.now_ns += 200_000_000
        answer = plc.ask(f"10 1388 0004 08 {slot} 0000 0000 0002")
    assert answer == "9006"


WRITES = ("05 07d0 ff00", "06 1388 0001", "0f 07d0 0001 01 01", "10 1388 0001 02 0001", "16 1388 ffff 0000")


@pytest.mark.parametrize("may_read", [True, False])
def test_who_may_not_command_gets_illegal_function_and_sees_no_block(may_read: bool) -> None:
    plc = Plc(Peer(address="192.0.2.9", may_read=may_read))
    for pdu in WRITES:
        assert plc.ask(pdu) == f"{int(pdu[:2], 16) | 0x80:02x}01"
    assert plc.ask("03 1388 0001") == ("8302" if may_read else "8301")
    assert plc.ask("01 07d0 0001") == ("8102" if may_read else "8101")
    assert plc.ask("04 0000 0001")[:2] == ("04" if may_read else "84")
    assert plc.ask("2b 0e 01 00")[:2] == ("2b" if may_read else "ab")
    assert plc.joints.cleared == []


def identify(pdu: str) -> bytes:
    return bytes.fromhex(Plc().ask(pdu))


def test_identification_as_a_stream_and_one_by_one() -> None:
    basic = identify("2b 0e 01 00")
    assert basic == bytes.fromhex("2b 0e 01 82 00 00 03") + b"\x00\x09trueangle\x01\x0atrueangled\x02\x051.2.3"
    assert identify("2b 0e 02 00")[6] == 6
    # A level that is not there gets the highest that is; an object that is not there starts from the first.
    assert identify("2b 0e 03 00")[3:] == identify("2b 0e 02 00")[3:]
    assert identify("2b 0e 01 04") == basic
    assert identify("2b 0e 04 02") == bytes.fromhex("2b 0e 04 82 00 00 01 02 05") + b"1.2.3"
    assert identify("2b 0e 04 06") == b"\xab\x02"
    assert identify("2b 0e 05 00") == identify("2b 0e 01") == b"\xab\x03"
    assert identify("2b 0d 01 00") == identify("2b") == b"\xab\x01"
    assert len(identify("2b 0e 02 00")) <= 253


def test_identification_that_fills_more_than_one_answer_is_read_on_from_the_object_that_follows() -> None:
    about = Identification(
        vendor_name="v" * 100, product_code="p" * 100, revision="r" * 244, product_name="n", model_name="m" * 240
    )
    responder = PduResponder(about)
    read: dict[int, bytes] = {}
    asked = []
    more, object_id = 0xFF, 0
    while more == 0xFF:
        asked.append(object_id)
        answer = responder.answer(bytes([0x2B, 0x0E, 2, object_id]), None, NOW_NS)
        assert len(answer) <= 253
        more, object_id, number = answer[4:7]
        at = 7
        for _ in range(number):
            read[answer[at]] = answer[at + 2 : at + 2 + answer[at + 1]]
            at += 2 + answer[at + 1]
        assert at == len(answer)
    assert asked == [0, 2, 3, 5]
    assert (more, object_id) == (0, 0)
    assert read == {i: text.encode() for i, text in enumerate(about.texts)}
    # Of single objects nothing follows, whatever is behind them.
    assert responder.answer(bytes.fromhex("2b 0e 04 02"), None, NOW_NS)[4:7] == bytes([0, 0, 1])


def test_identification_names_the_version_of_the_register_map() -> None:
    assert identify("2b 0e 04 05").endswith(f"register map {MAP_VERSION}".encode())


@pytest.mark.parametrize("text", ["x" * 245, "Prüfstand"])
def test_an_identification_that_does_not_fit_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="244 ASCII"):
        Identification(revision=text)


_BODY = st.binary(max_size=252) | st.builds(
    lambda address, rest: (address % 65536).to_bytes(2, "big") + rest,
    st.sampled_from([0, 2000, 2031, 5000, 5001, 5003, 5004, 5007]),
    st.binary(max_size=14),
)


@given(
    requests=st.lists(st.tuples(st.integers(0, 255) | st.sampled_from(WRITES), _BODY), max_size=30),
    ready=st.booleans(),
)
def test_no_pdu_is_too_strange_and_no_answer_too_long(
    requests: list[tuple[int | str, bytes]], ready: bool
) -> None:
    plc = Plc()
    for head, body in requests:
        pdu = bytes.fromhex(head) + body[:1] if isinstance(head, str) else bytes([head]) + body
        answer = plc.responder.answer(pdu, IMAGE if ready else None, plc.now_ns)
        assert answer[0] in (pdu[0], pdu[0] | 0x80)
        assert 2 <= len(answer) <= 253
        if answer[0] != pdu[0]:
            assert answer[1] in (1, 2, 3, 4, 6)
        plc.now_ns += 50_000_000
    assert plc.store.saved == [] or ready
