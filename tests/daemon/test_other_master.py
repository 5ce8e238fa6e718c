"""A second CANopen master on the bus: what it reads harms nothing, what it writes does; the log tells of it."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from tests.fakes.master_bench import BRISK, NODE_ID, Bench, bench, run, with_sequence_object

from trueangle.core.node_setup import NodeState

REQUEST, REPLY = 0x600 + NODE_ID, 0x580 + NODE_ID
PRESET = b"\x23\x03\x60\x00\x10\x27\x00\x00"
TIMING = replace(BRISK, phase_check_s=0.01, other_master_quiet_s=0.05)


def read_beside(b: Bench, *, answer: bytes) -> Callable[[], int]:
    """Before each answer to the daemon comes one to another master, who asked in between; gives how many did."""
    send, told = b.device.send, [0]

    def crowded(can_id: int, data: bytes) -> None:
        if can_id == REPLY:
            told[0] += 1
            send(REQUEST, b"\x40\x04\x60\x00\0\0\0\0")
            send(REPLY, answer)
        send(can_id, data)

    b.device.send = crowded
    return lambda: told[0]


@pytest.mark.parametrize(
    "answer", [b"\x43\x04\x60\x00\x4d\0\0\0", b"\x80\x04\x60\x00\0\0\x02\x06"], ids=["value", "abort"]
)
def test_answers_to_another_master_are_not_taken_for_ours(answer: bytes) -> None:
    async def scenario() -> None:
        async with bench(timing=TIMING, device=with_sequence_object()) as b:
            told = read_beside(b, answer=answer)
            await b.until(NodeState.RUNNING)
            seen = told()
            assert all(r.state not in (NodeState.LOST, NodeState.FAULT, NodeState.CLASH) for r in b.seen)
            await b.until_true(lambda: told() > seen + 50)
            assert b.reports.empty()

    run(scenario)


def test_other_master_is_told_when_it_comes_and_when_it_is_gone(caplog: pytest.LogCaptureFixture) -> None:
    def lines(event: str) -> list[str]:
        return [m for m in caplog.messages if f"event={event} " in m]

    async def scenario() -> None:
        async with bench(timing=TIMING, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            for _ in range(20):
                b.master.notify(REQUEST, b"\x40\x04\x60\x00\0\0\0\0")
                b.master.notify(REPLY, b"\x43\x04\x60\x00\x4d\0\0\0")
            await b.until_true(lambda: bool(lines("other_master_ends")))
            assert b.reports.empty()

    with caplog.at_level("INFO", logger="trueangle"):
        run(scenario)
    (begins,), (ends,) = lines("other_master_begins"), lines("other_master_ends")
    assert f"slot=3 node_id={NODE_ID} object=0x6004:0" in begins
    assert "requests=20" in ends


def test_other_master_that_sets_the_node_up_is_one_line_and_the_node_is_back_when_it_is_gone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        async with bench(timing=TIMING, device=with_sequence_object()) as b:
            await b.until(NodeState.RUNNING)
            for index in range(0x20, 0x28):
                b.master.notify(REQUEST, bytes((0x23, index, 0x60, 0, 1, 0, 0, 0)))
                b.master.notify(REPLY, bytes((0x60, index, 0x60, 0, 0, 0, 0, 0)))
                await b.until(NodeState.LOST)
                await b.until(NodeState.IDENTIFYING)
            await b.until(NodeState.RUNNING)

    with caplog.at_level("INFO", logger="trueangle"):
        run(scenario)
    lost = [m for m in caplog.messages if m.startswith("event=node_lost ")]
    assert len(lost) == 1, lost
    assert "another master writes to the node (0x6020:0)" in lost[0]
    assert sum(m.startswith("event=node_running ") for m in caplog.messages) == 2
