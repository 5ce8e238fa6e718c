"""The short way to a good status word agrees with `judge` on everything that can be known of a joint."""

from functools import reduce

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.daemon.test_pipeline import MS, Bench

from trueangle.core.correction import Correction
from trueangle.core.frames import Quantity
from trueangle.core.health import GOOD, NodeCondition
from trueangle.core.joint_line import JointLine

NOW_NS = 10**12 + 200 * MS
NAN, INFINITY = float("nan"), float("inf")
AGES_NS = st.sampled_from([-MS, 0, MS, 50 * MS, 50 * MS + 1, 60 * MS, 2000 * MS, 2000 * MS + 1, 3000 * MS])


def good_line() -> JointLine:
    """A joint that nothing speaks against at NOW_NS."""
    bench = Bench()
    line = JointLine(bench.channels[0])
    line.condition = NodeCondition.RUNNING
    line.sample.position.move_to(1_000_000, NOW_NS - MS)
    line.sample.temperature_c, line.sample.temperature_stamp_ns = 21.0, NOW_NS - MS
    line.correction = Correction(30.0, 1.0)
    return line


@st.composite
def lines(draw: st.DrawFn) -> JointLine:
    """A joint with up to three things changed: each alone must be seen."""
    line = good_line()
    sample, position = line.sample, line.sample.position
    for change in draw(st.lists(st.integers(0, 12), max_size=3, unique=True)):
        match change:
            case 0:
                line.condition = draw(st.sampled_from(NodeCondition))
            case 1:
                line.clash.active = True
            case 2:
                position.referenced = False
            case 3:
                position.jumped = True
            case 4:
                line.served.user_zero_known = False
            case 5:
                line.past_due = True
            case 6:
                stamp_ns = draw(AGES_NS.map(lambda age_ns: NOW_NS - age_ns) | st.none())
                position.stamp_ns = stamp_ns
            case 7:
                position.raw_deg = draw(st.sampled_from([None, 0.0, 300.0, 300.1, 359.9]))
            case 8:
                sample.temperature_c = draw(st.sampled_from([None, 9.9, 10.0, 40.0, 40.1, NAN, -60.0]))
            case 9:
                sample.temperature_stamp_ns = draw(AGES_NS.map(lambda age_ns: NOW_NS - age_ns) | st.none())
            case 10:
                sample.temperature_status = draw(st.sampled_from([0, 1]))
            case 11:
                arcsec = st.sampled_from([0.0, 18_000.0, -18_000.0, 18_000.1, NAN, INFINITY, -INFINITY])
                line.correction = draw(
                    st.builds(Correction, arcsec, st.sampled_from([None, 1.0, NAN])) | st.none()
                )
            case _:
                line.synchronous = False
    return line


@given(line=lines(), bus_up=st.booleans(), sync_age_ns=AGES_NS | st.none())
def test_the_short_way_and_judge_agree(line: JointLine, bus_up: bool, sync_age_ns: int | None) -> None:
    last_sync_ns = None if sync_age_ns is None else NOW_NS - sync_age_ns
    stamp_ns = line.angle.stamp_ns
    age_ms = None if stamp_ns is None else max(0.0, (NOW_NS - stamp_ns) * 1e-6)
    judged = line.judged(line.correction, age_ms, NOW_NS, bus_up=bus_up, last_sync_ns=last_sync_ns)
    short = bus_up and line.nothing_against(line.correction, age_ms, NOW_NS, last_sync_ns)
    if short:
        assert judged == GOOD
    elif last_sync_ns is not None:
        # Without any SYNC seen the short way says nothing and leaves it to `judge`.
        assert judged != GOOD


def changed(line: JointLine, name: str, value: object) -> JointLine:
    """This joint with one thing changed."""
    *path, last = name.split(".")
    setattr(reduce(getattr, path, line), last, value)
    return line


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("condition", NodeCondition.NOT_READY),
        ("clash.active", True),
        ("sample.position.referenced", False),
        ("sample.position.jumped", True),
        ("served.user_zero_known", False),
        ("past_due", True),
        ("sample.position.stamp_ns", NOW_NS - 50 * MS - 1),
        ("sample.position.stamp_ns", None),
        ("sample.position.raw_deg", 300.1),
        ("sample.temperature_c", 9.9),
        ("sample.temperature_c", 40.1),
        ("sample.temperature_c", NAN),
        ("sample.temperature_stamp_ns", NOW_NS - 2000 * MS - 1),
        ("sample.temperature_status", 1),
        ("sample.temperature_watch._unsettled", 1),
        ("correction", None),
        ("correction", Correction(NAN, 1.0)),
        ("correction", Correction(18_000.1, 1.0)),
        ("correction", Correction(-18_000.1, 1.0)),
    ],
)
def test_each_reason_alone_stops_the_short_way_and_is_one_to_judge(name: str, value: object) -> None:
    line = changed(good_line(), name, value)
    stamp_ns = line.angle.stamp_ns
    age_ms = None if stamp_ns is None else (NOW_NS - stamp_ns) * 1e-6
    assert not line.nothing_against(line.correction, age_ms, NOW_NS, NOW_NS)
    assert line.judged(line.correction, age_ms, NOW_NS, bus_up=True, last_sync_ns=NOW_NS) != GOOD


def test_a_sync_that_stopped_alone_stops_the_short_way() -> None:
    line = good_line()
    assert not line.nothing_against(line.correction, 1.0, NOW_NS, NOW_NS - 50 * MS - 1)


def test_a_joint_that_nothing_speaks_against_goes_the_short_way() -> None:
    line = good_line()
    assert line.nothing_against(line.correction, 1.0, NOW_NS, NOW_NS)
    line.sample.take_value(Quantity.TEMPERATURE_STATUS, 1, NOW_NS)
    assert not line.nothing_against(line.correction, 1.0, NOW_NS, NOW_NS)
