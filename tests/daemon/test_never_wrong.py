"""Whatever happens to frames, nodes, sensors, models, zeros and time: no VALID angle that the joint has not had.

The short form of `python -m tests.fuzz --only true_angles`. What each world is configured like is drawn too.
"""

import pytest
from tests.fuzz.true_worlds import served_in_worlds

from trueangle.core.joint_line import JointLine

PERIODS = 1_000
_CORRECT = JointLine.correct


@pytest.mark.parametrize("first", [1000, 2000, 3000])
def test_every_valid_or_held_angle_is_one_that_the_shaft_has_had_since_the_sample_whose_age_is_told(
    first: int,
) -> None:
    served = served_in_worlds(range(first, first + 4), PERIODS)
    # Every way of serving was reached, or the assertions were about nothing.
    for way in ("VALID", "HELD", "RAW_SERVED", "marker", "compensated", "head lost"):
        assert served[way] > 30, served


def _correct_once(line: JointLine) -> None:
    """The first correction for ever."""
    if line.correction is None:
        _CORRECT(line)


@pytest.mark.parametrize("broken", ["age", "zero", "correction"])
def test_a_daemon_that_is_wrong_by_a_little_is_found_out(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oracle must be able to fail: a late frame taken for new, a zero forgotten, a correction of before."""
    if broken == "age":
        monkeypatch.setattr("trueangle.core.sync_time.SyncHistory.stamp_ns", lambda history, _: history.last_ns)
    elif broken == "zero":
        monkeypatch.setattr("trueangle.core.pipeline.Pipeline.set_user_zero", lambda *_: None)
    else:
        monkeypatch.setattr(JointLine, "correct", _correct_once)
    with pytest.raises(AssertionError):
        served_in_worlds(range(8), PERIODS)
