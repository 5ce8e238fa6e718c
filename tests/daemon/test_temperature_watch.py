"""A temperature that freezes or jumps; a clock that goes back."""

import datetime

from trueangle.core.calendar_day import LatestDay, is_past_due
from trueangle.core.temperature_watch import SETTLE_VALUES, TemperatureLimits, TemperatureWatch

S = 1_000_000_000


def test_a_value_that_never_changes_is_frozen_and_one_that_moves_a_bit_is_not() -> None:
    watch = TemperatureWatch(TemperatureLimits(frozen_s=10))
    for second in range(30):
        watch.take(2000 + second % 2, 20.0, second * S)
        assert watch.plausible(second * S)
    for second in range(30, 41):
        watch.take(2001, 20.01, second * S)
    assert not watch.plausible(41 * S)
    watch.take(2002, 20.02, 41 * S)
    assert watch.plausible(41 * S)


def test_a_jump_is_implausible_until_the_values_settle() -> None:
    watch = TemperatureWatch(TemperatureLimits(max_rate_c_per_s=0.1))
    watch.take(2000, 20.0, 0)
    watch.take(3000, 30.0, S)
    for second in range(2, 2 + SETTLE_VALUES):
        assert not watch.plausible(second * S)
        watch.take(3000, 30.0, second * S)
    assert watch.plausible(100 * S)


def test_a_slow_change_over_a_long_pause_is_no_jump() -> None:
    watch = TemperatureWatch(TemperatureLimits(max_rate_c_per_s=0.1))
    watch.take(2000, 20.0, 0)
    watch.take(2900, 29.0, 90 * S)
    assert watch.plausible(90 * S)


def test_without_limits_everything_is_plausible() -> None:
    watch = TemperatureWatch(TemperatureLimits())
    watch.take(2000, 20.0, 0)
    watch.take(-2000, -20.0, 1)
    assert watch.plausible(10**6 * S)


def test_a_node_lost_forgets_what_its_sensor_did() -> None:
    watch = TemperatureWatch(TemperatureLimits(max_rate_c_per_s=0.1, frozen_s=10))
    watch.take(2000, 20.0, 0)
    watch.take(3000, 30.0, 1)
    watch.forget()
    assert watch.plausible(100 * S)
    watch.take(1000, 10.0, 2)
    assert watch.plausible(2)


def test_a_clock_set_back_leaves_a_past_due_calibration_past_due() -> None:
    shown = [datetime.date(2026, 1, 5), datetime.date(2026, 1, 11), datetime.date(2026, 1, 6)]
    today = LatestDay(lambda: shown[0])
    calibrated, due = datetime.date(2025, 1, 1), datetime.date(2026, 1, 10)
    assert not is_past_due(today(), calibrated, due)
    for _ in range(2):
        shown.pop(0)
        assert is_past_due(today(), calibrated, due)


def test_the_due_day_itself_is_not_past_and_a_clock_before_the_calibration_proves_nothing() -> None:
    calibrated, due = datetime.date(2025, 1, 1), datetime.date(2026, 1, 10)
    assert not is_past_due(due, calibrated, due)
    assert is_past_due(datetime.date(1970, 1, 1), calibrated, due)
    assert not is_past_due(datetime.date(1970, 1, 1), calibrated, None)
