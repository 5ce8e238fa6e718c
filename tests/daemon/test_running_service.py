"""The running daemon against nodes made of bytes, read as a PLC reads it.

The bus is a socket of `struct can_frame`s (as SocketCAN's), the other end a real Modbus TCP connection; between
them is the whole service. Every answer that is read on the way is held to the rule that a corrected angle is
served exactly when the joint is VALID.
"""

import asyncio
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.canopen_device import Address
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.modbus_tcp_client import read_request
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    Rig,
    config_yaml,
    correction_arcsec,
    images_of,
    joint_yaml,
    on_virtual_bus,
    on_wire,
    raw_mas,
    same_angle,
    started,
)

from trueangle.core.health import StatusBit
from trueangle.core.registers import RegisterImage

BASE, ELBOW = joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx")
ONE, TWO = config_yaml(BASE), config_yaml(BASE, ELBOW)
REST_COUNTS = 1_234_567
"""135.6 deg, where the model corrects by some arcseconds."""

Run = Callable[..., None]


def at(counts: int) -> Callable[[int], int]:
    return lambda _: counts


def node(node_id: int = 1, **more: Any) -> EncoderNode:
    """A good node at rest; it is told where to send when the rig is built."""
    made = EncoderNode(node_id, lambda _id, _data: None, **more)
    if "counts" not in more:
        made.counts = at(REST_COUNTS)
    return made


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> Iterator[Run]:
    """Runs a scenario on a service with these nodes and sees to it that no thread is left."""
    before = set(threading.enumerate())

    def go(scenario: Callable[[Rig], Coroutine[Any, Any, None]], config: str, *nodes: EncoderNode) -> None:
        async def within() -> None:
            async with on_wire(monkeypatch, CanWire(), *nodes), started(config, caplog) as r:
                await scenario(r)

        asyncio.run(within())

    yield go
    assert set(threading.enumerate()) <= before


@pytest.fixture
def images(monkeypatch: pytest.MonkeyPatch) -> list[RegisterImage]:
    return images_of(monkeypatch)


def served_raw_mas(image: RegisterImage, slot: int = 1) -> int:
    data = image.read(10 + 12 * (slot - 1) + 5, 2)
    assert data is not None
    return int.from_bytes(data, "big", signed=True)


# What is served


def test_two_moving_joints_are_served_as_raw_plus_the_correction_of_the_model(run: Run) -> None:
    programs: dict[int, Callable[[int], int]] = {
        1: lambda sample: (100_000 + 7_919 * sample) % COUNTS_PER_REV,
        2: lambda sample: 3 * COUNTS_PER_REV - 5_003 * sample,  # starts in its third turn and goes backwards
    }
    celsius = {1: 2150, 2: 3075}
    nodes = [node(i, counts=programs[i], temperature_centi_c=celsius[i]) for i in (1, 2)]

    async def scenario(r: Rig) -> None:
        for slot in (1, 2):
            await r.until_status(slot, StatusBit.VALID)
        samples: dict[int, set[int]] = {1: set(), 2: set()}
        while min(len(seen) for seen in samples.values()) < 20:
            for slot in (1, 2):
                read = await r.live(slot)
                samples[slot].add(read.sequence)
                assert read.status == GOOD
                assert (read.node_id, read.raw_counts) == (slot, programs[slot](read.sequence))
                assert read.turns == read.raw_counts // COUNTS_PER_REV
                correction = correction_arcsec(read.raw_counts, celsius[slot])
                exact = read.raw_counts % COUNTS_PER_REV * 1_296_000_000 / COUNTS_PER_REV
                assert read.raw_mas == raw_mas(read.raw_counts)
                # The register rounds to 1 milli-arcsecond: half of it, and the last bit of binary64.
                assert same_angle(read.corrected_mas, exact + 1e3 * correction, 0.501)
                assert abs(read.correction_arcsec - correction) < 1e-5  # binary32 of some 10 arcsec
                assert read.temperature_c == pytest.approx(celsius[slot] / 100, abs=1e-5)  # binary32
            await asyncio.sleep(0)
        assert await r.service_status() == 1

    run(scenario, TWO, *nodes)


def test_the_correction_under_test_is_no_small_one() -> None:
    """Else every test here could pass with raw served as corrected."""
    assert abs(correction_arcsec(REST_COUNTS, 2500)) > 1.0
    assert abs(correction_arcsec(REST_COUNTS, 2500) - correction_arcsec(REST_COUNTS, 3500)) > 0.01


def test_both_functions_and_both_number_forms_tell_the_same(run: Run) -> None:
    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        while True:  # until both answers are of one image: the two requests travel in one segment
            await r.plc.send(read_request(3, 1000, 70, transaction=1) + read_request(4, 1000, 70, transaction=2))
            holding, inputs = [(await r.plc.receive())[8:] for _ in range(2)]
            if holding[1:5] == inputs[1:5]:
                break
        assert holding == inputs
        read = await r.live(1)
        assert abs(read.corrected_deg * 3.6e6 - read.corrected_mas) <= 0.5
        assert abs(read.raw_deg * 3.6e6 - read.raw_mas) <= 0.5
        # The step of binary32 between 128 and 256 is 2^-16 deg.
        assert abs(read.corrected_float32_deg - read.corrected_deg) <= 2**-17
        fast = await r.fast(1)
        assert (fast.corrected_mas, fast.raw_mas) == (read.corrected_mas, read.raw_mas)
        assert abs(fast.raw_mas + fast.correction_mas - fast.corrected_mas) <= 1  # three roundings

    run(scenario, ONE, node())


# A node goes and comes


def test_a_silent_node_is_marked_and_the_other_stays_valid(run: Run) -> None:
    first, second = node(1), node(2)

    async def scenario(r: Rig) -> None:
        for slot in (1, 2):
            await r.until_status(slot, StatusBit.VALID)
        first.deaf = True
        # A position that no longer comes is seen long before three heartbeats are missing.
        read = await r.until_status(1, StatusBit.STALE)
        assert read.raw_mas == raw_mas(REST_COUNTS)
        lost = await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        assert lost.raw_mas == MARKER  # of a lost node nothing is known
        assert (await r.fast(2)).status == GOOD
        assert await r.service_status() == 0

    run(scenario, TWO, first, second)


def test_a_node_that_comes_back_is_valid_only_after_it_was_identified_again(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.deaf = True
        await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        # Its cable is in again: it still is operational and sends with every SYNC, but does not tell who it is.
        device.reads.clear()
        device.answers_sdo, device.deaf, device.state = False, False, 0x05
        device.ignores_nmt = True
        sent = device.syncs
        while device.syncs < sent + 30:
            assert StatusBit.NODE_NOT_READY in (await r.fast(1)).status
        device.answers_sdo, device.ignores_nmt = True, False
        await r.until_status(1, StatusBit.VALID)
        assert {(0x1018, 4), (0x6000, 0), (0x6003, 0), (0x1A00, 1)} <= set(device.reads)

    run(scenario, ONE, device)


def test_a_node_that_comes_back_as_another_encoder_is_not_corrected(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.reboot({(0x650B, 0): (815, 4)})
        read = await r.until(1, lambda read: StatusBit.ENCODER_DIFFERS in read.status)
        assert read.corrected_mas == MARKER

    run(scenario, ONE, device)


@pytest.mark.parametrize("before_it", [0, 1])
def test_the_first_frame_after_a_reboot_is_never_served(
    run: Run, images: list[RegisterImage], before_it: int
) -> None:
    """The factory mapping swaps position and counter on the same COB-ID with the same length.

    Boot-up message and frame reach the daemon in one batch, so the pipeline may not see it before the master.
    """
    device = node()
    factory: dict[Address, tuple[int, int]] = {
        (0x1800, 2): (1, 1),
        (0x1A00, 0): (2, 1),
        (0x1A00, 1): (0x2100_0010, 4),
        (0x1A00, 2): (0x6004_0020, 4),
    }

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        # One callback of the loop: the daemon reads nothing until all of it lies in its socket.
        for _ in range(before_it):
            device.sample()
        device.reboot(factory)
        device.state = 0x05  # started by itself
        device.sample()
        served, writes = len(images), len(device.writes)
        await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        await r.until_status(1, StatusBit.VALID)
        assert (0x1A00, 1, 0x6004_0020) in device.writes[writes:]
        assert {served_raw_mas(image) for image in images[served:]} == {MARKER, raw_mas(REST_COUNTS)}

    run(scenario, ONE, device)


def test_dropped_frames_take_every_joint_of_the_bus_out_until_it_was_identified_again(run: Run) -> None:
    """A boot-up message may be among them."""
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.reads.clear()
        (line,) = r.service._lines.values()
        line.counters.frames_dropped += 3
        await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
        await r.until_status(1, StatusBit.VALID)
        assert {(0x1018, 4), (0x6003, 0), (0x1A00, 1)} <= set(device.reads)

    run(scenario, ONE, device)


def test_frames_of_another_length_are_never_decoded(run: Run, images: list[RegisterImage]) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        for wrong in (-1, 1, -6):
            device.extra_bytes = wrong
            read = await r.until(1, lambda read: StatusBit.STALE in read.status)
            assert read.raw_mas == raw_mas(REST_COUNTS)  # the last that was known, and its age
            device.extra_bytes = 0
            await r.until_status(1, StatusBit.VALID)
        assert {served_raw_mas(image) for image in images} == {MARKER, raw_mas(REST_COUNTS)}

    run(scenario, ONE, device)


def test_a_node_that_keeps_its_old_mapping_is_a_fault_and_never_served(
    run: Run, images: list[RegisterImage]
) -> None:
    device = node(ignores_mapping=True)

    async def scenario(r: Rig) -> None:
        await r.until(1, lambda read: StatusBit.NODE_FAULT in read.status)
        assert {served_raw_mas(image) for image in images} == {MARKER}

    run(scenario, ONE, device)


def test_an_emergency_takes_the_joint_out_until_the_node_says_it_is_over(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.objects[0x1001, 0] = (0x81, 1)
        device.emergency(0x5010)
        await r.until(1, lambda read: StatusBit.NODE_FAULT in read.status)
        device.objects[0x1001, 0] = (0, 1)
        device.emergency(0)
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


# A joint that must not be corrected


def test_temperature_that_stops_ends_the_correction_and_its_return_brings_it_back(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.sends_temperature = False
        read = await r.until_status(1, StatusBit.TEMPERATURE_STALE)
        assert read.raw_mas == raw_mas(REST_COUNTS)
        device.sends_temperature = True
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


@pytest.mark.parametrize(
    ("centi_c", "status"),
    [
        (4100, StatusBit.TEMPERATURE_OUTSIDE_MODEL),  # the model ends at 40.06 degC
        (900, StatusBit.TEMPERATURE_OUTSIDE_MODEL),  # and begins at 9.94
        (-12700, StatusBit.TEMPERATURE_OUTSIDE_MODEL | StatusBit.TEMPERATURE_BROKEN),  # a torn wire
    ],
)
def test_temperature_outside_of_model_or_sensor_is_not_corrected(
    run: Run, centi_c: int, status: StatusBit
) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.temperature_centi_c = centi_c
        read = await r.until_status(1, status)
        assert (read.raw_mas, read.temperature_centi_c) == (raw_mas(REST_COUNTS), centi_c)
        device.temperature_centi_c = 2000
        await r.until_status(1, StatusBit.VALID)

    run(scenario, ONE, device)


def test_an_angle_outside_of_the_model_is_not_corrected(run: Run) -> None:
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.counts = at(COUNTS_PER_REV // 2 + 1)  # one count above the 180 deg of partial.onnx
        read = await r.until_status(1, StatusBit.ANGLE_OUTSIDE_MODEL)
        assert read.raw_mas == raw_mas(COUNTS_PER_REV // 2 + 1)
        device.counts = at(COUNTS_PER_REV // 2)
        await r.until_status(1, StatusBit.VALID)

    run(scenario, config_yaml(joint_yaml(1, "base", model="partial.onnx")), device)


@pytest.mark.parametrize(("address", "value"), [((0x6003, 0), 1000), ((0x6000, 0), 5), ((0x6509, 0), 9)])
def test_an_encoder_that_another_tool_sets_while_it_runs_is_noticed_and_no_longer_corrected(
    run: Run, caplog: pytest.LogCaptureFixture, address: Address, value: int
) -> None:
    """No frame tells of a preset: only the objects do."""
    device = node()

    async def scenario(r: Rig) -> None:
        await r.until_status(1, StatusBit.VALID)
        device.objects[address] = (value, device.objects[address][1])
        await r.until_told(lambda: "was changed in service from" in caplog.text)
        # Of the offset neither model nor configuration says anything: what it was at first counts.
        await r.until(1, lambda read: StatusBit.ENCODER_DIFFERS in read.status)

    run(scenario, ONE, device)


@pytest.mark.parametrize(
    ("address", "value", "reason"),
    [
        ((0x650B, 0), 4712, "serial_number expected 4711 found 4712"),
        ((0x6003, 0), 1000, "preset_value expected 0 found 1000"),
        ((0x6000, 0), 5, "operating_parameters expected 4 found 5"),  # counts the other way round
        ((0x6001, 0), 65_536, "counts per revolution expected 3276800 found 65536"),
    ],
)
def test_an_encoder_that_differs_is_served_raw_and_never_corrected(
    run: Run, caplog: pytest.LogCaptureFixture, address: Address, value: int, reason: str
) -> None:
    size = 2 if address == (0x6000, 0) else 4

    async def scenario(r: Rig) -> None:
        served = StatusBit.CONFIGURED | StatusBit.ENCODER_DIFFERS
        read = await r.until(1, lambda read: read.status == served)
        assert (read.corrected_mas, read.raw_mas) == (MARKER, raw_mas(REST_COUNTS))
        assert reason in caplog.text
        await r.until_status(2, StatusBit.VALID)

    run(scenario, TWO, node(1, objects={address: (value, size)}), node(2))


def test_the_turns_go_on_where_the_range_that_the_node_tells_ends(run: Run) -> None:
    """Nobody has configured it: of four turns, counted past the end of the fourth."""
    total = 4 * COUNTS_PER_REV
    device = node(counts=at(total - 100_000), objects={(0x6002, 0): (total, 4)})

    async def scenario(r: Rig) -> None:
        await r.until(1, lambda read: read.raw_mas == raw_mas(total - 100_000))
        assert (await r.live(1)).turns == 3
        device.counts = at(50_000)
        await r.until(1, lambda read: read.raw_mas == raw_mas(50_000))
        assert (await r.live(1)).turns == 4

    run(scenario, ONE, device)


# Another transport


def test_two_joints_over_the_virtual_interface_of_python_can(caplog: pytest.LogCaptureFixture) -> None:
    """Through the opener and the threads that every interface but SocketCAN takes."""
    before = set(threading.enumerate())
    channel = "trueangle-running"

    async def scenario() -> None:
        config = config_yaml(BASE, ELBOW, interface="virtual", channel=channel)
        async with on_virtual_bus(channel, node(1), node(2)), started(config, caplog) as r:
            for slot in (1, 2):
                read = await r.until_status(slot, StatusBit.VALID)
                expected = raw_mas(REST_COUNTS) + 1e3 * correction_arcsec(REST_COUNTS, 2500)
                assert same_angle(read.corrected_mas, expected, 1)  # raw and the sum are rounded

    asyncio.run(scenario())
    assert set(threading.enumerate()) <= before
