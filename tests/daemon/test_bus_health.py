"""What error frames say of a bus, and how often it is said on."""

import pytest

from trueangle.core.bus_health import QUIET_NS, ControllerState, Trouble, read_error_frame


@pytest.mark.parametrize(
    ("error_class", "data", "state", "words"),
    [  # classes and bits of linux/can/error.h
        (0x004, b"\0\x20\0\0\0\0\0\0", ControllerState.PASSIVE, "error-passive"),
        (0x004, b"\0\x10\0\0\0\0\0\0", ControllerState.PASSIVE, "error-passive"),
        (0x204, b"\0\x08\0\0\0\0\x60\0", ControllerState.WARNING, "error warning"),
        (0x004, b"\0\x40\0\0\0\0\0\0", ControllerState.ACTIVE, "error-active"),
        (0x004, b"\0", ControllerState.WARNING, "error warning"),  # socketcand tells no details
        (0x100, bytes(8), ControllerState.ACTIVE, "error-active"),
        (0x040, bytes(8), ControllerState.BUS_OFF, "bus-off"),
        (0x020, bytes(8), None, "nobody acknowledges"),
        (0x088, bytes(8), None, "bus errors"),
        (0x010, b"", None, "error class 0x10"),
    ],
)
def test_error_frame_is_read(error_class: int, data: bytes, state: ControllerState | None, words: str) -> None:
    told = read_error_frame(error_class, data)
    assert (told.state, told.lost_frames) == (state, False)
    assert words in told.text


def test_overrun_of_the_controller_is_lost_frames() -> None:
    assert read_error_frame(0x004, b"\0\x01\0\0\0\0\0\0").lost_frames


def test_trouble_is_told_at_its_beginning_and_at_its_end_with_its_count() -> None:
    trouble = Trouble()
    assert trouble.change(0) is None
    for i in range(1000):
        trouble.seen("error-passive", i)
    begin = trouble.change(1000)
    assert begin is not None
    assert (begin.begins, begin.reason) == (True, "error-passive")
    trouble.seen("error warning", 2000)
    assert trouble.change(2000 + QUIET_NS - 1) is None
    end = trouble.change(2000 + QUIET_NS)
    assert end is not None
    assert (end.begins, end.reason, end.count) == (False, "error-passive", 1001)
    assert not trouble.stands


def test_trouble_ends_at_once_where_the_controller_says_so() -> None:
    trouble = Trouble()
    trouble.seen("error-passive", 10**12)
    assert trouble.change(10**12) is not None
    trouble.over()
    end = trouble.change(10**12 + 1)
    assert end is not None
    assert not end.begins


def test_trouble_that_began_and_ended_between_two_looks_is_told_all_the_same() -> None:
    trouble = Trouble()
    trouble.seen("error-passive", 10**12)
    trouble.over()
    changes = [trouble.change(10**12 + i) for i in range(3)]
    assert [change.begins for change in changes if change] == [True, False]
