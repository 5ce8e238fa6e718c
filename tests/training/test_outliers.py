"""Readings and runs that contradict all others are named by line, sound campaigns are left alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import trueangle_training.examples
from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError
from trueangle_training.dataset import TrainingSet, training_set, without_rows
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

EXAMPLES = Path(trueangle_training.examples.__file__).parent


def campaign_of(seed: int, **plan_changes: object) -> Campaign:
    plan = replace(load_plan(EXAMPLES / "plan.yaml"), **plan_changes)  # pyright: ignore[reportArgumentType]
    return replace(
        simulate_campaign(simulated_joint(load_joint(EXAMPLES / "joint.yaml")), plan, seed), source="C.csv"
    )


@pytest.fixture(scope="module")
def good() -> Campaign:
    return campaign_of(1)


def accept(campaign: Campaign) -> TrainingSet:
    return training_set(campaign, base_temperature_c=None, faces=23, free_offsets=True)


def with_error(campaign: Campaign, index: int, value_arcsec: float) -> Campaign:
    error_arcsec = campaign.error_arcsec.copy()
    error_arcsec[index] = value_arcsec
    return replace(campaign, error_arcsec=error_arcsec)


def in_run(campaign: Campaign, run: int, change: Callable[[np.ndarray], np.ndarray]) -> Campaign:
    error_arcsec = campaign.error_arcsec.copy()
    here = campaign.run == run
    error_arcsec[here] = change(error_arcsec[here])
    return replace(campaign, error_arcsec=error_arcsec)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.parametrize("shift_faces", [0.0, 1.0 / 3.0])
def test_sound_campaigns_are_accepted(seed: int, shift_faces: float) -> None:
    accept(campaign_of(seed, shift_faces=shift_faces))


def test_a_knee_in_temperature_is_no_outlier(good: Campaign) -> None:
    assert good.temperature_c is not None
    # 0.4 arcsec a degree from 30 degC on, in harmonic 1: a straight line with a bend that no cubic follows.
    above_k = np.maximum(good.temperature_c - 30.0, 0.0)
    bend = 0.4 * above_k * (np.cos(np.radians(good.angle_deg)) - 1.0)
    accept(replace(good, error_arcsec=good.error_arcsec + bend))


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.parametrize("shift_faces", [0.0, 1.0 / 3.0])
def test_sound_campaigns_have_no_conspicuous_reading(seed: int, shift_faces: float) -> None:
    assert accept(campaign_of(seed, shift_faces=shift_faces)).warnings == ()


def test_a_reading_off_by_less_than_a_typing_error_is_trained_on_and_named(good: Campaign) -> None:
    # 6 arcsec are nine to ten times the noise of 0.65: beyond 5.5 and within 15.
    bad = with_error(good, 200, good.error_arcsec[200] + 6.0)
    bad = with_error(bad, 77, bad.error_arcsec[77] - 7.0)
    data = accept(bad)
    assert len(data.readings) == 483
    (warning,) = data.warnings
    first, second = int(good.row[77]), int(good.row[200])
    assert f"C.csv, column error_arcsec, line {first}: {bad.error_arcsec[77]:.4g} is -" in warning
    assert f"line {second}: {bad.error_arcsec[200]:.4g} is +" in warning
    assert f"--exclude-rows {first},{second}" in warning
    times = [float(part.split(" times the")[0].rsplit(" ", 1)[1]) for part in warning.split(";")[:2]]
    assert all(6.5 < each < 13.0 for each in times)
    assert accept(without_rows(bad, frozenset({first, second}))).warnings == ()


@pytest.mark.parametrize("shift_faces", [0.0, 1.0 / 3.0])
def test_what_moves_all_readings_of_a_temperature_is_no_mistake_of_one(shift_faces: float) -> None:
    campaign = campaign_of(1, shift_faces=shift_faces)
    assert campaign.temperature_c is not None
    # A bump of 8 arcsec in harmonic 1 at 25 degC alone: no cubic in temperature comes near it.
    bump = 8.0 * np.exp(-(((campaign.temperature_c - 25.0) / 2.0) ** 2))
    bumped = campaign.error_arcsec + bump * (np.cos(np.radians(campaign.angle_deg)) - 1.0)
    assert accept(replace(campaign, error_arcsec=bumped)).warnings == ()


def test_a_conspicuous_reading_is_named_where_nothing_is_repeated() -> None:
    campaign = campaign_of(1, shift_faces=1.0 / 3.0)
    data = accept(with_error(campaign, 200, campaign.error_arcsec[200] + 7.5))
    assert any(f"line {campaign.row[200]}: " in warning for warning in data.warnings)


def test_what_is_less_than_any_noise_is_not_conspicuous(good: Campaign) -> None:
    rng = np.random.default_rng(0)
    exact = 50.0 * (np.cos(np.radians(good.angle_deg)) - 1.0) + rng.normal(0.0, 1e-3, len(good))
    assert accept(with_error(replace(good, error_arcsec=exact), 200, exact[200] + 0.05)).warnings == ()
    assert accept(with_error(replace(good, error_arcsec=exact), 200, exact[200] + 0.5)).warnings != ()


@pytest.mark.parametrize("value_arcsec", [64_800.0, 3600.0, -400.0, 130.0])
def test_a_typing_error_is_named_by_its_line_and_goes_only_by_the_users_word(
    good: Campaign, value_arcsec: float
) -> None:
    bad = with_error(good, 200, value_arcsec)
    line = int(good.row[200])
    with pytest.raises(ContractError) as refusal:
        accept(bad)
    assert len(refusal.value.faults) == 1
    assert str(line) in str(refusal.value)
    assert f"--exclude-rows {line}" in str(refusal.value)
    data = accept(without_rows(bad, frozenset({line})))
    assert len(data.readings) == 482
    assert any("left out by the user" in note and str(line) in note for note in data.notes)


@pytest.mark.parametrize(
    "change",
    [
        lambda errors: errors / 3600.0,
        lambda errors: -errors,
        lambda errors: np.roll(errors, 1),
        lambda errors: np.roll(errors, 7) * 1.2,
    ],
    ids=["in degrees", "sign reversed", "shifted by a face", "another joint"],
)
def test_a_run_that_is_wrong_as_a_whole_is_named_as_a_run(
    good: Campaign, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    bad = in_run(good, 5, change)
    with pytest.raises(ContractError) as refusal:
        accept(bad)
    assert len(refusal.value.faults) == 1
    lines = good.row[good.run == 5]
    assert "run 5: expected" in str(refusal.value)
    assert f"--exclude-rows {lines.min()}-{lines.max()}" in str(refusal.value)


def test_a_run_shifted_by_a_turn_is_refused(good: Campaign) -> None:
    with pytest.raises(ContractError, match="a turn left in the difference"):
        accept(in_run(good, 5, lambda errors: errors + 1_296_000.0))


def test_several_typing_errors_are_all_named(good: Campaign) -> None:
    bad = with_error(with_error(with_error(good, 30, 900.0), 231, -700.0), 410, 300.0)
    with pytest.raises(ContractError) as refusal:
        accept(bad)
    for index in (30, 231, 410):
        assert str(good.row[index]) in str(refusal.value)


def test_lines_without_a_reading_cannot_be_excluded(good: Campaign) -> None:
    with pytest.raises(ContractError, match="lines 1, 4000"):
        without_rows(good, frozenset({1, 4000}))
    with pytest.raises(ContractError, match="readings left over"):
        without_rows(good, frozenset(good.row.tolist()))
