"""What may be trained on, and every kind of file that must not be."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import trueangle_training.examples
from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError
from trueangle.contract.metadata import Interval
from trueangle_training.dataset import TrainingSet, readings_needed, training_set, without_rows
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint
from trueangle_training.train_options import excluded_rows

EXAMPLES = Path(trueangle_training.examples.__file__).parent
COUNT = 81


def example_campaign(**plan_changes: object) -> Campaign:
    plan = replace(load_plan(EXAMPLES / "plan.yaml"), **plan_changes)  # pyright: ignore[reportArgumentType]
    return simulate_campaign(simulated_joint(load_joint(EXAMPLES / "joint.yaml")), plan, 1)


@pytest.fixture(scope="module")
def good() -> Campaign:
    return replace(example_campaign(), source="CALIBRATION.csv")


def accept(campaign: Campaign, *, base_temperature_c: float = 20.0, parameters: int = COUNT) -> TrainingSet:
    return training_set(
        campaign, base_temperature_c=base_temperature_c, parameters=parameters, validation_fraction=0.1, faces=23
    )


def only(campaign: Campaign, keep: np.ndarray) -> Campaign:
    """The campaign with some of its readings."""
    columns = {
        name: getattr(campaign, name)[keep]
        for name in Campaign.__dataclass_fields__
        if isinstance(getattr(campaign, name), np.ndarray)
    }
    return replace(campaign, **columns)


def temperature_of(campaign: Campaign) -> np.ndarray:
    assert campaign.temperature_c is not None
    return campaign.temperature_c


def test_a_good_campaign_is_taken_whole(good: Campaign) -> None:
    data = accept(good)
    assert len(data.readings) == 483
    np.testing.assert_array_equal(data.readings.error_arcsec, good.error_arcsec)
    assert data.datum_deg == 0.0
    assert data.valid_angle_deg == Interval(minimum=0.0, maximum=360.0)
    lowest_c, highest_c = float(temperature_of(good).min()), float(temperature_of(good).max())
    assert data.valid_temperature_c == Interval(minimum=lowest_c, maximum=highest_c)
    assert data.notes == good.notes
    assert data.raw_rms_arcsec == pytest.approx(59.0, abs=1.0)


def unset_temperature(campaign: Campaign) -> Campaign:
    return replace(campaign, temperature_c=None)


def one_temperature(campaign: Campaign) -> Campaign:
    return replace(campaign, temperature_c=np.full(len(campaign), 20.0))


def errors_in_degrees(campaign: Campaign) -> Campaign:
    return replace(campaign, error_arcsec=campaign.error_arcsec / 3600)


def one_absurd_error(campaign: Campaign) -> Campaign:
    error_arcsec = campaign.error_arcsec.copy()
    error_arcsec[205] = 1_295_990.0
    return replace(campaign, error_arcsec=error_arcsec)


def angles_in_radians(campaign: Campaign) -> Campaign:
    return replace(campaign, angle_deg=np.radians(campaign.angle_deg))


def angles_in_arcseconds(campaign: Campaign) -> Campaign:
    return replace(campaign, angle_deg=campaign.angle_deg * 3600)


def temperature_in_kelvin(campaign: Campaign) -> Campaign:
    return replace(campaign, temperature_c=temperature_of(campaign) + 273.15)


def rows_twice(campaign: Campaign) -> Campaign:
    twice = only(campaign, np.r_[np.arange(len(campaign)), 40])
    return replace(twice, row=np.arange(2, len(twice) + 2, dtype=np.int64))


def a_run_copied(campaign: Campaign) -> Campaign:
    error_arcsec = campaign.error_arcsec.copy()
    error_arcsec[23:46] = error_arcsec[:23]
    return replace(campaign, error_arcsec=error_arcsec)


def without_base_temperature(campaign: Campaign) -> Campaign:
    return only(campaign, np.abs(temperature_of(campaign) - 20.0) > 1.0)


def four_angles(campaign: Campaign) -> Campaign:
    assert campaign.face is not None
    return only(campaign, np.isin(campaign.face, (1, 7, 13, 19)))


def zeros_at_different_angles(campaign: Campaign) -> Campaign:
    return replace(example_campaign(shift_faces=1 / 3), source=campaign.source)


def two_gaps(campaign: Campaign) -> Campaign:
    inside = (campaign.angle_deg % 180.0) < 100.0
    return only(campaign, inside)


def errors_of_reversed_sign(campaign: Campaign) -> Campaign:
    return replace(campaign, error_arcsec=-campaign.error_arcsec)


def mirrored_angles(campaign: Campaign) -> Campaign:
    return replace(campaign, angle_deg=-campaign.angle_deg % 360.0)


def angles_in_arcminutes(campaign: Campaign) -> Campaign:
    return replace(campaign, angle_deg=campaign.angle_deg * 60.0)


def errors_in_arcminutes(campaign: Campaign) -> Campaign:
    return replace(campaign, error_arcsec=campaign.error_arcsec / 60.0)


def errors_in_microradians(campaign: Campaign) -> Campaign:
    return replace(campaign, error_arcsec=campaign.error_arcsec * 4.84814)


def another_polygon(campaign: Campaign) -> Campaign:
    assert campaign.face is not None
    return replace(campaign, face=campaign.face + 1)


@pytest.mark.parametrize(
    ("spoil", "complaints"),
    [
        (unset_temperature, ["column temperature_c: expected the joint's temperature"]),
        (one_temperature, ["two or more temperatures, 1 degC or more apart, found runs at about 20 degC only"]),
        (errors_in_degrees, ["arcsec peak to peak; are they in degrees?"]),
        (one_absurd_error, ["line 207, column error_arcsec", "found up to 1.29599e+06", "wrong unit"]),
        (angles_in_radians, ["are they radians?"]),
        (angles_in_arcseconds, ["are they arcseconds or counts?"]),
        (temperature_in_kelvin, ["found 283.15", "are they in kelvin?"]),
        (rows_twice, ["lines that repeat another one: 485 like 42"]),
        (a_run_copied, ["run 2 with the errors of run 1", "lines 25, 26,", "copied"]),
        (without_base_temperature, ["base temperature 20 degC, found runs at about 10, 15, 25, 30, 35, 40 degC"]),
        (four_angles, ["at least 5 distinct angles in the turn, found 4", "at least 91 readings", "found 84"]),
        (zeros_at_different_angles, ["every zero group to begin within 0.5 deg", "5.22", "10.4"]),
        (two_gaps, ["gaps from 93.9 to 187.8 deg, 266.1 to 0.0 deg"]),
        (errors_of_reversed_sign, ["errors that run against the indicated angles", "is the sign reversed?"]),
        (mirrored_angles, ["expected angles that follow the faces, 15.65 deg from one to the next"]),
        (angles_in_arcminutes, ["expected angles that follow the faces"]),
        (errors_in_arcminutes, ["found errors 0.0167 times as large", "are they in another unit?"]),
        (errors_in_microradians, ["times as large", "are they in another unit?"]),
        (another_polygon, ["faces 1 to 23 of the joint's polygon, found face 24"]),
    ],
)
def test_a_bad_campaign_is_refused_with_what_was_seen(
    good: Campaign, spoil: Callable[[Campaign], Campaign], complaints: list[str]
) -> None:
    with pytest.raises(ContractError) as caught:
        accept(spoil(good))
    for complaint in complaints:
        assert complaint in str(caught.value)
    assert all(fault.where.startswith("CALIBRATION.csv") for fault in caught.value.faults)


@pytest.mark.parametrize("sign", [1, -1])
def test_nominal_angles_say_nothing_of_the_sign(good: Campaign, sign: int) -> None:
    assert good.face is not None
    nominal_deg = (good.face - 1) * 360 / 23
    accept(replace(good, angle_deg=nominal_deg, error_arcsec=sign * good.error_arcsec))


def test_a_polygon_turned_by_whole_faces_does_not_look_reversed() -> None:
    accept(example_campaign(shift_faces=7.0))


def test_all_faults_come_at_once(good: Campaign) -> None:
    with pytest.raises(ContractError) as caught:
        accept(one_absurd_error(a_run_copied(angles_in_radians(good))), base_temperature_c=5.0)
    text = str(caught.value)
    for part in ("wrong unit", "copied", "radians", "base temperature 5 degC"):
        assert part in text


@pytest.mark.parametrize(("parameters", "fraction"), [(81, 0.1), (5, 0.1), (101, 0.25), (41, 0.5)])
def test_number_of_readings_needed_is_the_smallest_that_suffices(parameters: int, fraction: float) -> None:
    needed = readings_needed(parameters, fraction)
    assert needed - round(fraction * needed) > parameters
    assert (needed - 1) - round(fraction * (needed - 1)) <= parameters


def test_readings_one_short_of_the_need_are_refused(good: Campaign) -> None:
    needed = readings_needed(COUNT, 0.1)
    # Two temperatures, the base among them, of 3 x 23 readings each.
    two = only(good, np.isin(np.round(temperature_of(good)), (20.0, 40.0)))
    assert len(accept(only(two, np.arange(len(two)) < needed)).readings) == needed
    with pytest.raises(ContractError, match=f"at least {needed} readings.*81 parameters, found {needed - 1}"):
        accept(only(two, np.arange(len(two)) < needed - 1))


def test_readings_without_temperature_are_left_out_and_told(good: Campaign) -> None:
    temperature_c = temperature_of(good).copy()
    temperature_c[[3, 4]] = np.nan
    data = accept(replace(good, temperature_c=temperature_c))
    assert len(data.readings) == 481
    assert data.notes[-1] == "2 readings without a temperature were left out (lines 5, 6)"


def test_a_wide_gap_leaves_the_covered_interval(good: Campaign) -> None:
    covered = only(good, good.angle_deg < 200.0)
    data = accept(covered)
    assert data.valid_angle_deg.minimum == pytest.approx(0.008, abs=0.001)
    assert data.valid_angle_deg.maximum == pytest.approx(12 * 360 / 23, abs=0.02)
    # The datum belongs to the covered interval, whose lower end is the first stop itself.
    assert data.valid_angle_deg.holds(data.datum_deg)


def test_few_evenly_spaced_angles_still_cover_the_turn(good: Campaign) -> None:
    assert good.face is not None
    sparse = accept(only(good, good.face % 4 == 1), parameters=21)
    assert sparse.valid_angle_deg == Interval(minimum=0.0, maximum=360.0)


def test_a_first_stop_just_below_zero_is_the_datum_itself(good: Campaign) -> None:
    # Reduced to a turn such readings lie at 359.99 deg: a datum at 0 would be at the far end of what was measured.
    shifted = replace(good, angle_deg=good.angle_deg - 0.02)
    assert accept(shifted).datum_deg == pytest.approx(360.0 - 0.02 + 0.0082, abs=0.001)


def test_first_stops_on_both_sides_of_zero_have_their_mean_as_datum(good: Campaign) -> None:
    angle_deg = good.angle_deg.copy()
    angle_deg[0::46] -= 0.02
    datum_deg = accept(replace(good, angle_deg=angle_deg)).datum_deg
    assert min(datum_deg, 360.0 - datum_deg) < 0.02


def test_a_datum_away_from_zero_is_kept(good: Campaign) -> None:
    assert accept(replace(good, angle_deg=good.angle_deg + 90.0)).datum_deg == pytest.approx(90.008, abs=0.001)


def test_the_option_of_the_advice_mends_the_file(good: Campaign) -> None:
    errors = good.error_arcsec.copy()
    wrong = [*range(50, 68), 200, 300]
    errors[wrong] += 400_000.0
    bad = replace(good, error_arcsec=errors)
    with pytest.raises(ContractError) as refusal:
        accept(bad)
    option = re.search(r"--exclude-rows (\S+)", str(refusal.value))
    assert option is not None
    assert len(accept(without_rows(bad, excluded_rows(option[1]))).readings) == 483 - len(wrong)


def test_one_line_is_called_a_line(good: Campaign) -> None:
    faces = np.asarray(good.face).copy()
    faces[99] = 24
    with pytest.raises(ContractError, match=f"CALIBRATION.csv line {good.row[99]}, column face"):
        accept(replace(good, face=faces))
