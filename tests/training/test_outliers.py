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
