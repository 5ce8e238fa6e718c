"""The CANopen master against nodes made of bytes, over a bus that is a function call."""

import asyncio
from dataclasses import replace

import pytest
from tests.fakes.master_bench import (
    BRISK,
    HASTY,
    LIMIT_S,
    NODE_ID,
    PLAN,
    LoopBus,
    bench,
    run,
    with_sequence_object,
)

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.edges.can_master import CanMaster


def test_bring_up_writes_the_mapping_in_the_order_of_cia_301() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            report = await b.until(NodeState.RUNNING)
        assert report.in_service
        assert b.device.writes == [
            (0x1800, 1, 0xC000_0185),  # off, with the node's own RTR bit
            (0x1A00, 0, 0),
            (0x1A00, 1, 0x6004_0020),
            (0x1A00, 2, 0x2100_0010),
            (0x1A00, 0, 2),
            (0x1800, 2, 1),
            (0x1800, 1, 0x4000_0185),  # on
            (0x1801, 1, 0xC000_0285),  # a TPDO that nobody planned is switched off
            (0x1017, 0, 10_000),
        ]
        assert b.device.nmt == [0x80, 0x01]
        states = [r.state for r in b.seen]
        assert states == [NodeState.IDENTIFYING, NodeState.CONFIGURING, NodeState.STARTING, NodeState.RUNNING]

    run(scenario)


def test_settings_are_read_and_an_absent_object_is_unknown() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            del b.device.objects[0x6502, 0]
            report = await b.until(NodeState.RUNNING)
        assert report.settings == EncoderSettings(
            device_type=0x20196,
            vendor_id=0x1234,
            product_code=0x5678,
            revision_number=0x10002,
            serial_number=4711,  # 0x1018:4 is 0, so 0x650B counts
            operating_parameters=4,
            units_per_revolution=1 << 20,
            total_range_units=1 << 20,
            preset_value=77,
            single_turn_resolution=1 << 20,
            distinguishable_revolutions=None,
            offset_value=5,
        )

    run(scenario)


def test_node_that_keeps_its_old_mapping_is_a_fault_and_never_runs() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object(ignores_mapping=True)) as b:
            report = await b.until(NodeState.FAULT)
            assert "0x1A00:0 expected 0x2 found 0x1" in report.reason
            await b.until(NodeState.FAULT)
        assert not any(r.in_service for r in b.seen)
        assert 0x01 not in b.device.nmt

    run(scenario)


def test_refused_mapping_entry_names_object_and_abort_code() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object(refuses={(0x1A00, 2): 0x06040041})) as b:
            report = await b.until(NodeState.FAULT)
        assert "0x1A00:2 = 0x21000010" in report.reason
        assert "06040041" in report.reason

    run(scenario)


def test_unplanned_tpdo_that_stays_on_is_a_fault() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object(refuses={(0x1801, 1): 0x06010002})) as b:
            report = await b.until(NodeState.FAULT)
        assert "0x1801:1" in report.reason

    run(scenario)


def test_encoder_that_differs_is_refused_with_the_reasons_and_still_runs_raw() -> None:
    expected = EncoderSettings(preset_value=0, vendor_id=0x1234)

    async def scenario() -> None:
        async with bench(accept=lambda _, s: s.differences_from(expected), device=with_sequence_object()) as b:
            report = await b.until(NodeState.REFUSED)
        assert report.reason == "preset_value expected 0 found 77"
        assert report.in_service
        assert b.device.state == 0x05

    run(scenario)


def test_silent_node_is_lost_and_tried_again_until_it_answers() -> None:
    async def scenario() -> None:
        async with bench(timing=HASTY, device=with_sequence_object(deaf=True)) as b:
            report = await b.until(NodeState.LOST)
            assert "0x1000:0" in report.reason
            await b.until(NodeState.LOST)
            b.device.deaf = False
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_answer_for_another_object_does_not_count() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object(answers_wrong_object=True)) as b:
            report = await b.until(NodeState.LOST)
            assert "0x1000:0" in report.reason
        assert not any(r.in_service for r in b.seen)

    run(scenario)


def test_reboot_in_service_takes_the_node_out_and_sets_it_up_again() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.writes.clear()
            b.device.boot_up({(0x6003, 0): (123, 4)})  # it comes back with another preset
            report = await b.until(NodeState.LOST)
            assert "boot-up" in report.reason
            report = await b.until(NodeState.RUNNING)
        assert report.settings is not None
        assert report.settings.preset_value == 123
        assert b.device.writes[0] == (0x1800, 1, 0xC000_0185)

    run(scenario)


@pytest.mark.parametrize(
    ("can_id", "data", "state"),
    [
        (0x700 + NODE_ID, b"\x00", NodeState.LOST),
        (0x700 + NODE_ID, b"\x04", NodeState.LOST),
        (0x080 + NODE_ID, b"\x10\x50\x01\0\0\0\0\0", NodeState.FAULT),
    ],
)
def test_node_is_out_of_service_before_its_next_frame_is_looked_at(
    can_id: int, data: bytes, state: NodeState
) -> None:
    """A rebooted node may send its factory mapping on the very same COB-ID one frame later."""

    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.master.notify(can_id, data)
            _, report = b.reports.get_nowait()
            assert report.state is state
            assert not report.in_service
            await b.until(NodeState.RUNNING)
        assert [r.state for r in b.seen].count(state) == 0  # told once, above

    run(scenario)


def test_reboot_during_the_set_up_starts_it_over() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.CONFIGURING)
            b.device.boot_up()
            await b.until(NodeState.LOST)
            await b.until(NodeState.RUNNING)
        assert b.device.objects[0x1A00, 0] == (2, 1)

    run(scenario)


def test_missing_heartbeat_takes_the_node_out() -> None:
    plan = replace(PLAN, heartbeat_ms=20)

    async def scenario() -> None:
        async with bench(plan=plan, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)  # by the one heartbeat that answers NMT start
            report = await b.until(NodeState.LOST)
        assert report.reason == "no heartbeat for 0.06 s"

    run(scenario)


def test_node_that_leaves_operational_is_taken_out() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.state = 0x04
            b.device.heartbeat()
            report = await b.until(NodeState.LOST)
        assert "0x04" in report.reason

    run(scenario)


def test_start_that_is_not_obeyed_is_a_fault_whatever_was_commanded() -> None:
    plan = replace(PLAN, heartbeat_ms=20)

    async def scenario() -> None:
        async with bench(plan=plan, device=with_sequence_object(ignores_nmt=True)) as b:
            report = await b.until(NodeState.FAULT)
        assert "0x7F" in report.reason
        assert not any(r.in_service for r in b.seen)

    run(scenario)


def test_emergency_takes_the_node_out_until_its_error_register_is_clear() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.device.objects[0x1001, 0] = (0x81, 1)
            b.device.emergency(0x5010)
            report = await b.until(NodeState.FAULT)
            assert "code 0x5010" in report.reason
            report = await b.until(NodeState.FAULT)
            assert report.reason == "error register 0x1001:0 expected 0 found 0x81"
            b.device.objects[0x1001, 0] = (0, 1)
            b.device.emergency(0)
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_encoder_alarm_keeps_the_node_out_of_service() -> None:
    async def scenario() -> None:
        async with bench(device={"objects": {(0x2100, 0): (0, 2), (0x6503, 0): (1, 2)}}) as b:
            report = await b.until(NodeState.FAULT)
        assert "encoder alarms 0x6503:0" in report.reason

    run(scenario)


@pytest.mark.parametrize("can_id", [0x085, 0x585, 0x705])
@pytest.mark.parametrize("data", [b"", b"\x01", bytes(3), bytes(8)])
def test_malformed_frames_never_end_the_master(can_id: int, data: bytes) -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.master.notify(can_id, data)
            b.master.notify(0x7FF, data)
            b.device.boot_up()
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_bus_down_loses_the_node_and_bus_up_brings_it_back() -> None:
    async def scenario() -> None:
        async with bench(device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            b.master.on_bus_state(False, "cannot receive: Network is down")
            report = await b.until(NodeState.LOST)
            assert report.reason == "bus down: cannot receive: Network is down"
            b.master.on_bus_state(True, "open")
            await b.until(NodeState.RUNNING)

    run(scenario)


def test_bus_that_cannot_send_is_a_lost_node() -> None:
    async def scenario() -> None:
        loop_bus = LoopBus()
        loop_bus.broken = True
        reports: asyncio.Queue[NodeReport] = asyncio.Queue()
        master = CanMaster(
            loop_bus, [PLAN], on_node=lambda _, r: reports.put_nowait(r), accept=lambda *_: [], timing=BRISK
        )
        async with asyncio.timeout(LIMIT_S), master:
            master.on_bus_state(True, "open")
            assert (await reports.get()).state is NodeState.IDENTIFYING
            assert (await reports.get()).state is NodeState.LOST

    run(scenario)


def test_closing_does_not_wait_for_a_silent_node() -> None:
    """With a time-out of an hour, the test ends only because closing interrupts the transfer."""

    async def scenario() -> None:
        patient = replace(BRISK, sdo_timeout_s=3600.0)
        async with asyncio.timeout(LIMIT_S), bench(timing=patient, device=with_sequence_object(deaf=True)) as b:
            await b.until(NodeState.IDENTIFYING)

    run(scenario)


def test_error_of_the_owner_passes_through_closing_unchanged() -> None:
    async def scenario() -> None:
        with pytest.raises(KeyError):
            async with bench(device=with_sequence_object()):
                raise KeyError("owner")

    run(scenario)


def test_failing_callback_is_not_swallowed() -> None:
    def accept(_slot: int, _settings: EncoderSettings) -> list[str]:
        raise ZeroDivisionError("owner's rule")

    async def scenario() -> None:
        with pytest.raises(ExceptionGroup) as caught:
            async with bench(accept=accept, device=with_sequence_object()) as b:
                await b.until(NodeState.RUNNING)
        assert caught.group_contains(ZeroDivisionError)

    run(scenario)


def test_flapping_node_logs_each_kind_of_failure_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with bench(timing=HASTY, device=with_sequence_object(deaf=True)) as b:
            for _ in range(3):
                await b.until(NodeState.LOST)
            b.device.deaf = False
            await b.until(NodeState.RUNNING)

    with caplog.at_level("INFO", logger="trueangle"):
        run(scenario)
    assert sum("event=node_lost " in r.getMessage() for r in caplog.records) == 1
    running = [r.getMessage() for r in caplog.records if "event=node_running " in r.getMessage()]
    assert len(running) == 1
    assert "attempts=" in running[0]
