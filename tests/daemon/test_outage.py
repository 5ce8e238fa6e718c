"""Log lines of a joint's outages: one at the begin, one at the end, none for a flapping joint's every turn."""

from trueangle.core.health import StatusBit
from trueangle.core.outage import FLAPPING_OUTAGES, QUIET_S, SUM_INTERVAL_S, OutageLog

GOOD = StatusBit.VALID | StatusBit.CONFIGURED
STALE = StatusBit.CONFIGURED | StatusBit.STALE
LOST = STALE | StatusBit.NODE_NOT_READY
S = 1_000_000_000


def texts(log: OutageLog, status: StatusBit, at_s: float) -> list[str]:
    return [line.text for line in log.change(status, round(at_s * S))]


def running() -> OutageLog:
    """Valid since 1 s."""
    log = OutageLog(3, "wrist", 0)
    assert texts(log, GOOD, 1) == ["event=joint_valid slot=3 joint='wrist' after_s=1.000 reasons_s=none count=0"]
    return log


def test_an_outage_is_a_line_at_its_begin_and_one_at_its_end_with_the_time_of_each_reason() -> None:
    log = running()
    assert texts(log, STALE, 10) == ["event=joint_not_valid slot=3 joint='wrist' reasons=stale count=1"]
    assert texts(log, STALE, 10.01) == []
    assert texts(log, LOST, 10.5) == [
        "event=joint_reason_added slot=3 joint='wrist' reasons=stale,node_not_ready count=1"
    ]
    # A reason that goes and comes back is no news; its time is added up.
    assert texts(log, StatusBit.CONFIGURED | StatusBit.NODE_NOT_READY, 11) == []
    assert texts(log, LOST, 12) == []
    assert texts(log, GOOD, 12.25) == [
        "event=joint_valid slot=3 joint='wrist' after_s=2.250 reasons_s=stale:1.250,node_not_ready:1.750 count=1"
    ]
    assert log.outages == 1
    assert log.invalid_s(20 * S) == 3.25  # the first second is part of it


def test_information_bits_are_no_reason_and_no_line() -> None:
    log = running()
    assert texts(log, GOOD | StatusBit.HEAD_LOST, 2) == []
    held = STALE | StatusBit.HELD
    assert texts(log, held, 3) == ["event=joint_not_valid slot=3 joint='wrist' reasons=stale count=1"]


def flapping() -> tuple[OutageLog, list[str]]:
    log, said = running(), list[str]()
    for turn in range(100):
        said += texts(log, STALE, 10 + 0.2 * turn)
        said += texts(log, GOOD, 10.1 + 0.2 * turn)
    return log, said


def test_a_flapping_joint_says_so_once_and_is_silent_then() -> None:
    log, said = flapping()
    # Lines of the outages before, then one that says why no more come.
    assert len(said) == 2 * (FLAPPING_OUTAGES - 1) + 1
    assert said[-1] == (
        f"event=joint_flapping slot=3 joint='wrist' outages={FLAPPING_OUTAGES} within_s=1.0 reasons=stale count=6"
    )
    assert log.outages == 100  # silence loses nothing
    assert round(log.invalid_s(100 * S), 6) == 1 + 100 * 0.1


def test_a_flapping_joint_that_was_quiet_for_a_while_speaks_again() -> None:
    log, _ = flapping()
    last_s = 10.1 + 0.2 * 99
    assert log.tick(round((last_s + QUIET_S - 0.1) * S)) == []
    (line,) = log.tick(round((last_s + QUIET_S) * S))
    assert "event=joint_flapping_over slot=3 joint='wrist'" in line.text
    assert "outages=94 state=valid" in line.text
    assert not line.warning
    assert texts(log, STALE, last_s + 100)[0].startswith("event=joint_not_valid")


def test_a_flapping_joint_that_stays_out_is_told_as_such() -> None:
    log, _ = flapping()
    log.change(LOST, 40 * S)
    (line,) = log.tick(round((40 + QUIET_S) * S))
    assert line.warning
    assert line.text.endswith("state=not_valid reasons=stale,node_not_ready")


def test_one_that_flaps_on_is_summed_up_now_and_then() -> None:
    log, lines, at_s = running(), list[str](), 10.0
    while at_s < 10 + 2.5 * SUM_INTERVAL_S:
        log.change(STALE, round(at_s * S))
        log.change(GOOD, round((at_s + 0.5) * S))
        lines += [line.text for line in log.tick(round((at_s + 0.5) * S))]
        at_s += 1
    assert len(lines) == 2
    assert all(line.startswith("event=joint_flaps_on") for line in lines)


def test_outages_far_apart_are_no_flapping() -> None:
    log = running()
    for turn in range(50):
        assert len(texts(log, STALE, 100 + 20 * turn)) == 1
        assert len(texts(log, GOOD, 101 + 20 * turn)) == 1


def test_a_joint_brought_up_anew_has_an_outage_that_began_with_it() -> None:
    """A reload renews it: its time without an angle counts, its reasons of before do not."""
    log = running()
    log.restart(10 * S)
    assert texts(log, GOOD, 12)[0].startswith("event=joint_valid slot=3 joint='wrist' after_s=2.000")
    assert log.invalid_s(20 * S) == 3
