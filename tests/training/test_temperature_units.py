"""Degrees Fahrenheit among degrees Celsius: refused by line where the errors show it, and only there."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.training.reference_joint import polygon_campaign

from trueangle_training.evaluation.reading_noise import held_out_caution
from trueangle_training.methods import TrainingReadings
from trueangle_training.temperature_units import base_temperature_warnings, fahrenheit, mixed_unit_faults


def readings(seed: int = 0, temperatures_c: tuple[float, ...] | None = None) -> TrainingReadings:
    made = (
        polygon_campaign(seed) if temperatures_c is None else polygon_campaign(seed, temperatures_c=temperatures_c)
    )
    return TrainingReadings(
        angle_deg=made.angle_deg, error_arcsec=made.error_arcsec, temperature_c=made.temperature_c, run=made.run
    )


def stated_in_fahrenheit(of: TrainingReadings, which: Callable[[np.ndarray], np.ndarray]) -> TrainingReadings:
    chosen = which(of.temperature_c)
    return replace(of, temperature_c=np.where(chosen, fahrenheit(of.temperature_c), of.temperature_c))


def found(of: TrainingReadings) -> str:
    return "; ".join(str(each) for each in mixed_unit_faults(of, np.arange(2, len(of) + 2), source="campaign.csv"))


@pytest.mark.parametrize("at_c", [10.0, 15.0, 25.0, 40.0])
def test_one_temperature_in_fahrenheit_is_refused_with_its_lines(at_c: float) -> None:
    mixed = stated_in_fahrenheit(readings(), lambda t: np.abs(t - at_c) < 1.0)
    first = 2 + 69 * round((at_c - 10.0) / 5.0)
    text = found(mixed)
    assert f"campaign.csv lines {first} to {first + 68}, column temperature_c" in text
    assert f"they fit to 0.{text.split('they fit to 0.')[1][0]}" in text
    assert "are these in degrees Fahrenheit" in text
    assert f"--exclude-rows {first}-{first + 68}" in text


@pytest.mark.parametrize("from_c", [22.0, 28.0])
def test_the_later_half_in_fahrenheit_is_refused(from_c: float) -> None:
    text = found(stated_in_fahrenheit(readings(), lambda t: t > from_c))
    assert "degrees Fahrenheit" in text


def test_one_run_in_fahrenheit_is_refused() -> None:
    of = readings()
    mixed = replace(
        of, temperature_c=np.where(of.run == of.run[0], fahrenheit(of.temperature_c), of.temperature_c)
    )
    assert "lines 2 to 24, column temperature_c" in found(mixed)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "temperatures_c",
    [None, (10.0, 20.0, 30.0, 40.0, 59.0), (0.0, 20.0, 70.0), (-20.0, 0.0, 20.0, 40.0, 60.0), (20.0, 40.0)],
)
def test_sound_campaigns_are_not_suspected(seed: int, temperatures_c: tuple[float, ...] | None) -> None:
    assert found(readings(seed, temperatures_c)) == ""


def test_a_knee_over_temperature_is_not_suspected() -> None:
    of = readings()
    knee_arcsec = 6.0 * np.maximum(of.temperature_c - 33.0, 0.0) * np.sin(np.radians(of.angle_deg))
    assert found(replace(of, error_arcsec=of.error_arcsec + knee_arcsec)) == ""


def test_all_in_fahrenheit_is_seen_from_the_joints_base_temperature() -> None:
    run_mean_c = np.array([10.0, 15.0, 20.0, 25.0])
    (text,) = base_temperature_warnings(fahrenheit(run_mean_c), 20.0, source="campaign.csv")
    assert "no run within 5 degC of the joint's base temperature 20 degC" in text
    assert "Are they in degrees Fahrenheit? As such they would be 10 to 25 degC" in text
    assert base_temperature_warnings(run_mean_c, 20.0, source="campaign.csv") == ()
    assert base_temperature_warnings(fahrenheit(run_mean_c), None, source="campaign.csv") == ()
    (text,) = base_temperature_warnings(np.array([30.0, 40.0]), 20.0, source="campaign.csv")
    assert "Fahrenheit" not in text


def test_a_left_out_error_far_above_the_noise_is_told_with_its_factor() -> None:
    assert held_out_caution(0.9, 0.63) is None
    assert held_out_caution(4.0, None) is None
    text = held_out_caution(4.45, 0.63)
    assert text is not None
    assert "7.1 times" in text
