"""Nodes that send by themselves, have no heartbeat, must not be written to, or measure only a temperature."""

import asyncio
from dataclasses import replace

import pytest
from tests.fakes.canopen_device import Address
from tests.fakes.master_bench import BRISK, HASTY, NODE_ID, PLAN, bench, run, with_sequence_object

from trueangle.core.frames import ExpectedValue, MappedObject, NodePlan, PolledObject, Quantity, TpdoPlan
from trueangle.core.node_setup import NodeState

TIMER = replace(PLAN, tpdos=(replace(PLAN.tpdos[0], transmission_type=255, event_timer_ms=5),))
AS_FOUND = replace(PLAN, as_found=True)
RIGHT: dict[Address, tuple[int, int]] = {
    (0x2100, 0): (0, 2),
    (0x1800, 1): (0x4000_0185, 4),
    (0x1800, 2): (1, 1),
    (0x1801, 1): (0xC000_0285, 4),
    (0x1A00, 0): (2, 1),
    (0x1A00, 1): (0x6004_0020, 4),
    (0x1A00, 2): (0x2100_0010, 4),
    (0x1017, 0): (200, 2),
}
"""A unit that somebody else has set up as PLAN wants it."""
TEMPERATURE = MappedObject(index=0x7130, subindex=2, bits=16, quantity=Quantity.TEMPERATURE, signed=True, slot=7)
STATUS = MappedObject(index=0x6150, subindex=2, bits=8, quantity=Quantity.TEMPERATURE_STATUS, slot=7)
SENSOR = NodePlan(
    slot=None,
    node_id=NODE_ID,
    heartbeat_ms=10_000,
    tpdos=(TpdoPlan(number=1, cob_id=0x185, transmission_type=255, mapping=(TEMPERATURE, STATUS)),),
    polls=(
        PolledObject(value=STATUS, period_ms=None),
        PolledObject(value=TEMPERATURE, period_ms=None),
    ),
    expected=(ExpectedValue(index=0x6132, subindex=2, value=2, meaning="decimal digits"),),
)
SENSOR_OBJECTS: dict[Address, tuple[int, int]] = {
    (0x7130, 2): (0xFF38, 2),  # -2.00 degC
    (0x6132, 2): (2, 1),
    (0x6150, 2): (0, 1),
    (0x6003, 0): (1, 1),  # means something else on a node that is no encoder
}


# A node that sends by itself


def test_event_timer_is_written_before_the_pdo_is_switched_on_and_read_back() -> None:
    async def scenario() -> None:
        async with bench(plan=TIMER, device={"objects": {(0x2100, 0): (0, 2), (0x1800, 5): (0, 2)}}) as b:
            await b.until(NodeState.RUNNING)
        assert b.device.writes[4:8] == [
            (0x1A00, 0, 2),
            (0x1800, 2, 255),
            (0x1800, 5, 5),  # silent from the factory: 0
            (0x1800, 1, 0x4000_0185),
        ]

    run(scenario)


def test_cyclic_timer_of_the_encoder_profile_serves_where_the_unit_has_no_event_timer() -> None:
    async def scenario() -> None:
        async with bench(plan=TIMER, device={"objects": {(0x2100, 0): (0, 2), (0x6200, 0): (0, 4)}}) as b:
            await b.until(NodeState.RUNNING)
        assert (0x6200, 0, 5) in b.device.writes
        assert b.device.objects[0x6200, 0] == (5, 4)

    run(scenario)


def test_unit_without_any_event_timer_is_a_fault_that_says_so() -> None:
    async def scenario() -> None:
        async with bench(plan=TIMER, device=with_sequence_object()) as b:
            report = await b.until(NodeState.FAULT)
        assert "0x1800:5 or 0x6200:0 is absent" in report.reason

    run(scenario)


def test_event_timer_that_does_not_take_is_a_fault_and_never_runs() -> None:
    """A unit that confirms the write and keeps 0 would be silent at standstill."""

    async def scenario() -> None:
        objects = {(0x2100, 0): (0, 2), (0x1800, 5): (0, 2)}
        async with bench(plan=TIMER, device={"objects": objects, "forgets": {(0x1800, 5)}}) as b:
            report = await b.until(NodeState.FAULT)
            assert "0x1800:5 expected 0x5 found 0x0" in report.reason
        assert not any(r.in_service for r in b.seen)

    run(scenario)


# A node that is never written to


def test_node_taken_as_found_is_read_and_never_written_to() -> None:
    async def scenario() -> None:
        async with bench(plan=AS_FOUND, device={"objects": RIGHT}) as b:
            await b.until(NodeState.RUNNING)
        assert b.device.writes == []

    run(scenario)


@pytest.mark.parametrize(
    ("address", "value", "reason"),
    [
        ((0x1A00, 1), 0x6030_0020, "0x1A00:1 expected 0x60040020 found 0x60300020"),  # speed, same length
        ((0x1A00, 0), 1, "0x1A00:0 expected 0x2 found 0x1"),
        ((0x1800, 1), 0xC000_0185, "0x1800:1"),  # switched off
        ((0x1800, 2), 2, "0x1800:2"),
        ((0x1801, 1), 0x4000_0185, "TPDO 2 sends on the planned COB-ID 0x185 too"),
    ],
)
def test_node_taken_as_found_that_is_set_otherwise_is_a_fault(address: Address, value: int, reason: str) -> None:
    size = RIGHT[address][1]

    async def scenario() -> None:
        async with bench(plan=AS_FOUND, device={"objects": RIGHT | {address: (value, size)}}) as b:
            report = await b.until(NodeState.FAULT)
            assert reason in report.reason
        assert not any(r.in_service for r in b.seen)

    run(scenario)


def test_node_taken_as_found_without_heartbeat_is_asked_for_life() -> None:
    plan = replace(AS_FOUND, heartbeat_ms=20)

    async def scenario() -> None:
        async with bench(plan=plan, timing=HASTY, device={"objects": RIGHT | {(0x1017, 0): (0, 2)}}) as b:
            await b.until(NodeState.RUNNING)
            await b.until_true(lambda: len(b.alive) >= 2)
            b.device.deaf = True
            report = await b.until(NodeState.LOST)
        assert "SDO" in report.reason

    run(scenario)


# A node without heartbeat


def test_node_without_heartbeat_runs_on_its_answers_and_is_lost_without_them() -> None:
    plan = replace(PLAN, polled=True, heartbeat_ms=20)

    async def scenario() -> None:
        async with bench(plan=plan, timing=HASTY, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            assert (0x1017, 0) not in {(index, subindex) for index, subindex, _ in b.device.writes}
            await b.until_true(lambda: len(b.alive) >= 3)
            b.device.deaf = True
            await b.until(NodeState.LOST)
            b.device.deaf = False
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_alarm_of_a_node_without_heartbeat_is_found_by_asking() -> None:
    async def scenario() -> None:
        plan = replace(PLAN, polled=True, heartbeat_ms=20)
        async with bench(plan=plan, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.objects[0x6503, 0] = (1, 2)
            report = await b.until(NodeState.FAULT)
        assert "encoder alarms" in report.reason

    run(scenario)


# A node that only measures a temperature


def test_sensor_node_is_set_up_asked_once_and_not_taken_for_an_encoder() -> None:
    async def scenario() -> None:
        async with bench(plan=SENSOR, device={"objects": SENSOR_OBJECTS}) as b:
            report = await b.until(NodeState.RUNNING)
            await b.until_true(lambda: len(b.values) == 2)
            assert report.settings is not None
            assert report.settings.preset_value is None
            await asyncio.sleep(0)
        assert b.values == [(7, Quantity.TEMPERATURE_STATUS, 0), (7, Quantity.TEMPERATURE, -200)]
        assert b.device.objects[0x1A00, 1] == (0x7130_0210, 4)
        assert b.device.objects[0x1A00, 2] == (0x6150_0208, 4)

    run(scenario)


def test_decimal_digits_that_the_configuration_does_not_know_are_a_fault() -> None:
    """Else 21.5 degC would be read as 2.15."""

    async def scenario() -> None:
        objects = SENSOR_OBJECTS | {(0x6132, 2): (1, 1)}
        async with bench(plan=SENSOR, device={"objects": objects}) as b:
            report = await b.until(NodeState.FAULT)
        assert report.reason == "decimal digits 0x6132:2 expected 2 found 1"

    run(scenario)


def test_polled_temperature_is_asked_again_and_again() -> None:
    plan = replace(SENSOR, polls=(PolledObject(value=TEMPERATURE, period_ms=10),))

    async def scenario() -> None:
        async with bench(plan=plan, device={"objects": SENSOR_OBJECTS}) as b:
            await b.until(NodeState.RUNNING)
            await b.until_true(lambda: len(b.values) >= 3)
            b.device.objects[0x7130, 2] = (2150, 2)
            await b.until_true(lambda: b.values[-1][2] == 2150)

    run(scenario)


def test_polled_temperature_of_another_length_is_a_fault_and_no_number() -> None:
    async def scenario() -> None:
        objects = SENSOR_OBJECTS | {(0x7130, 2): (2150, 4)}
        async with bench(plan=SENSOR, device={"objects": objects}) as b:
            report = await b.until(NodeState.FAULT)
        assert report.reason == "0x7130:2 expected 16 bits found 32"
        assert all(quantity is not Quantity.TEMPERATURE for _, quantity, _ in b.values)

    run(scenario)


# Behind our back


def test_mapping_that_is_changed_in_service_is_found_by_asking() -> None:
    """Another tool maps speed in place of the position: same COB-ID, same length, and no frame that tells."""
    timing = replace(BRISK, phase_check_s=0.01)

    async def scenario() -> None:
        async with bench(timing=timing, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.objects[0x1A00, 1] = (0x6030_0020, 4)
            report = await b.until(NodeState.FAULT)
            assert "0x1A00:1 was changed in service from 0x60040020 to 0x60300020" in report.reason
            await b.until(NodeState.RUNNING)
        assert b.device.objects[0x1A00, 1] == (0x6004_0020, 4)

    run(scenario)


def test_write_of_another_master_takes_the_node_out_before_its_next_frame() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.master.notify(0x600 + NODE_ID, b"\x23\x03\x60\x00\x10\x27\x00\x00")  # preset 10000
            _, report = b.reports.get_nowait()
            assert report.state is NodeState.LOST
            assert report.reason == "another master writes to the node (0x6003:0)"
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_reading_of_another_master_disturbs_nothing() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            for _ in range(5):
                b.master.notify(0x600 + NODE_ID, b"\x40\x03\x60\x00\0\0\0\0")
                b.master.notify(0x580 + NODE_ID, b"\x43\x03\x60\x00\x4d\0\0\0")
            assert b.reports.empty()

    run(scenario)


# Two nodes with one id


def test_doubled_sdo_answers_are_a_clash_and_the_node_never_runs() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object(answers_twice=True)) as b:
            report = await b.until(NodeState.CLASH)
            assert f"two nodes have id {NODE_ID}" in report.reason
            await b.until(NodeState.CLASH)
            assert not any(r.in_service for r in b.seen)
            b.device.answers_twice = False
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_one_late_answer_is_no_clash() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.master.notify(0x580 + NODE_ID, bytes(8))
            assert b.reports.empty()

    run(scenario)


def test_heartbeats_that_come_twice_as_often_as_told_are_a_clash() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:  # 10 s
            await b.until(NodeState.RUNNING)
            for _ in range(9):
                b.device.heartbeat()
            report = await b.until(NodeState.CLASH)
        assert "heartbeats come twice as often" in report.reason

    run(scenario)


def test_storm_of_emergencies_is_one_log_line_and_its_end_tells_how_many(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.objects[0x1001, 0] = (0x81, 1)
            for burst in range(3):
                for i in range(100):
                    b.device.send(0x080 + NODE_ID, bytes((0x10, 0x50, 1, burst, i, 0, 0, 0)))
                report = await b.until(NodeState.FAULT)
                assert report.reason.startswith("EMCY")
                while "error register" not in report.reason:  # asked for in the attempts between
                    report = await b.until(NodeState.FAULT)
                await b.until(NodeState.IDENTIFYING)
            b.device.objects[0x1001, 0] = (0, 1)
            await b.until(NodeState.RUNNING)

    with caplog.at_level("INFO", logger="trueangle"):
        run(scenario)
    lines = [r.getMessage() for r in caplog.records]
    assert sum("EMCY" in line for line in lines) == 1
    assert sum("error register" in line for line in lines) == 1
    assert any("event=node_running " in line and "emergencies=300" in line for line in lines)


def test_errors_that_come_and_go_do_not_make_the_master_flood_the_bus() -> None:
    """Each EMCY 'no error' is a reason to try again at once, but not twice within the shortest pause."""
    timing = replace(BRISK, backoff_first_s=1000.0, backoff_limit_s=1000.0)

    async def scenario() -> None:
        async with bench(timing=timing, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            commands = len(b.device.nmt)
            for _ in range(50):
                b.device.emergency(0x5010)
                b.device.emergency(0)
                for _ in range(5):
                    await asyncio.sleep(0)
            assert len(b.device.nmt) == commands

    run(scenario)


def test_unit_that_was_swapped_without_a_word_is_found_by_its_serial_number() -> None:
    timing = replace(BRISK, phase_check_s=0.005)

    async def scenario() -> None:
        async with bench(timing=timing, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.objects[0x650B, 0] = (4712, 4)
            report = await b.until(NodeState.FAULT)
            assert report.reason == "0x650B:0 was changed in service from 0x1267 to 0x1268"
            report = await b.until(NodeState.RUNNING)
            assert report.settings is not None
            assert report.settings.serial_number == 4712

    run(scenario)
