"""The reader of our own commands against servers that misbehave, and the values that it makes of registers."""

import asyncio
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.register_server import RegisterServer
from tests.fakes.register_values import joint_state
from tests.fakes.served_images import image_of

from trueangle.core.health import StatusBit
from trueangle.core.modbus_request import AnswerStream, ReadAnswer, ReadRequest, StreamFault
from trueangle.core.register_reading import Block, detail_block, fast_block, read_detail, read_group, status_words
from trueangle.core.registers import RegisterImage
from trueangle.edges.modbus_client import ModbusReader
from trueangle.errors import LinkError, NodeFault

REQUEST = ReadRequest(transaction=7, unit_id=1, address=10, count=2)


def answer(pdu: bytes, *, transaction: int = 7, unit: int = 1) -> bytes:
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def test_a_request_has_the_bytes_of_the_specification() -> None:
    assert bytes(REQUEST).hex(" ") == "00 07 00 00 00 06 01 04 00 0a 00 02"


@given(st.lists(st.integers(1, 5), max_size=20))
def test_an_answer_is_whole_wherever_the_stream_is_cut(cuts: list[int]) -> None:
    stream, rest, got = AnswerStream(), answer(b"\x04\x04\x01\x02\x03\x04"), None
    late = answer(b"\x04\x02\x09\x09", transaction=6)
    rest = late + rest
    for cut in cuts:
        got = got or stream.feed(rest[:cut], REQUEST)
        rest = rest[cut:]
    got = got or stream.feed(rest, REQUEST)
    assert got == ReadAnswer(registers=b"\x01\x02\x03\x04", exception=None)


@pytest.mark.parametrize(
    "data",
    [
        answer(b"\x04\x02\x01\x02"),
        answer(b"\x03\x04\x01\x02\x03\x04"),
        answer(b"\x04\x04\x01\x02\x03\x04", unit=2),
        answer(b"\x04\x04\x01\x02\x03"),
        b"HTTP/1.1 400 Bad Request\r\n",
        struct.pack(">HHHB", 7, 0, 2, 1) + b"\x04",
    ],
)
def test_what_is_no_answer_to_the_request_is_never_read_as_registers(data: bytes) -> None:
    with pytest.raises(StreamFault):
        AnswerStream().feed(data, REQUEST)


def test_values_come_back_as_they_were_served() -> None:
    image = image_of({1: None, 8: joint_state(corrected_deg=None, status=StatusBit.STALE, temperature_c=None)})
    group = read_group(_data(image, fast_block(0)), 0)
    (slot,) = group.slots
    assert (group.joints_configured, group.cycle, group.torn, slot.valid) == (2, 7, False, True)
    assert slot.corrected_deg == pytest.approx(123.4567891, abs=0.0006 / 3600)  # the register's step is 0.001"
    assert slot.correction_arcsec == pytest.approx(19.99656, abs=0.0005)
    detail = read_detail(_data(image, detail_block(8)), 8)
    assert (detail.valid, detail.corrected_deg, detail.temperature_c, detail.raw_deg) == (
        False,
        None,
        None,
        123.4512345,
    )
    assert (detail.node_id, detail.turns, detail.raw_counts) == (18, -3, 89_888)


def test_a_block_of_two_cycles_is_torn() -> None:
    one, two = (image_of({1: None}, cycle=cycle).read(0, 84) for cycle in (7, 8))
    assert one is not None
    assert two is not None
    assert read_group(one[:100] + two[100:], 0).torn


def test_a_bit_that_this_version_does_not_know_is_shown_by_its_number() -> None:
    assert status_words(StatusBit.STALE | StatusBit(1 << 30)) == ("STALE", "BIT_30")


def _data(image: RegisterImage, block: Block) -> bytes:
    data = image.read(block.address, block.count)
    assert data is not None
    return data


def run(change: Callable[[RegisterServer], None]) -> bytes | None:
    async def scenario() -> bytes | None:
        async with RegisterServer(image_of({1: None})) as server:
            change(server)
            reader = ModbusReader("127.0.0.1", server.port, 1, timeout_s=0.2)
            await reader.connect()
            try:
                return await reader.read(0, 84)
            finally:
                await reader.close()

    return asyncio.run(scenario())


def test_an_answer_byte_by_byte_is_read() -> None:
    data = run(lambda server: setattr(server, "piecewise", True))
    assert data == image_of({1: None}).read(0, 84)


def test_silence_and_garbage_are_broken_links_and_an_exception_is_named() -> None:
    with pytest.raises(LinkError, match="no answer in time"):
        run(lambda server: setattr(server, "silent", True))
    with pytest.raises(LinkError, match="no Modbus header"):
        run(lambda server: setattr(server, "garbage", b"\xff" * 20))
    with pytest.raises(NodeFault, match=r"exception 06 \(server busy\)"):
        run(lambda server: setattr(server, "exception", 6))
    assert run(lambda server: setattr(server, "exception", 2)) is None
