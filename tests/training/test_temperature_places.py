"""Places of the turn that are missing at one temperature: named by line, and never part of the valid range."""

from dataclasses import replace

import numpy as np
import pytest
from tests.training.reference_joint import polygon_campaign

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError
from trueangle_training.dataset import TrainingSet, training_set
from trueangle_training.methods import TrainingReadings
from trueangle_training.temperature_places import lines_text, places_by_temperature, places_sentence

PITCH_DEG = 360.0 / 23


def campaign(keep: "np.ndarray | None" = None) -> Campaign:
    made = polygon_campaign(2)
    rows = np.arange(2, made.run.size + 2)
    keep = np.ones(made.run.size, dtype=bool) if keep is None else keep
    return Campaign(
        angle_deg=made.angle_deg[keep],
        error_arcsec=made.error_arcsec[keep],
        run=made.run[keep],
        zero_group=made.run[keep],
        row=rows[keep],
        source="campaign.csv",
        sha256="",
        temperature_c=made.temperature_c[keep],
    )


def without_faces(at_c: float, faces: set[int]) -> Campaign:
    """The campaign without these faces, 1 to 23, of the runs at one temperature."""
    made = polygon_campaign(2)
    face = np.rint(made.angle_deg / PITCH_DEG).astype(int) % 23 + 1
    return campaign(~((np.abs(made.temperature_c - at_c) < 1.0) & np.isin(face, sorted(faces))))


def accept(of: Campaign, base_temperature_c: float | None = None) -> TrainingSet:
    return training_set(of, base_temperature_c=base_temperature_c, free_offsets=True)


def test_a_complete_campaign_has_nothing_to_say() -> None:
    data = accept(campaign())
    assert data.warnings == ()
    assert data.valid_temperature_c.maximum == pytest.approx(40.0, abs=0.3)


def test_one_missing_face_is_named_with_the_lines_and_costs_no_range() -> None:
    data = accept(without_faces(40.0, {4}))
    (warning,) = data.warnings
    assert "campaign.csv lines " in warning
    assert "at 40.0 degC 1 place of other temperatures not read (47.0 deg)" in warning
    assert data.valid_temperature_c.maximum == pytest.approx(40.0, abs=0.3)


@pytest.mark.parametrize(("at_c", "valid_c"), [(40.0, (10.0, 35.0)), (10.0, (15.0, 40.0)), (30.0, (10.0, 40.0))])
@pytest.mark.parametrize("faces", [set(range(2, 24)), set(range(3, 24)), set(range(12, 24)), {4, 5, 6}])
def test_only_temperatures_read_all_round_extend_the_valid_range(
    at_c: float, valid_c: tuple[float, float], faces: set[int]
) -> None:
    data = accept(without_faces(at_c, faces))
    (warning,) = data.warnings
    # The mean over three runs, each met within 0.3 degC.
    shown_c = float(warning.split(": at ")[1].split(" degC")[0])
    assert shown_c == pytest.approx(at_c, abs=0.35)
    assert f" degC {len(faces)} places of other temperatures not read" in warning
    assert "too little of the turn for the valid temperature range" in warning
    # Set temperatures are met within 0.3 degC.
    assert data.valid_temperature_c.minimum == pytest.approx(valid_c[0], abs=0.35)
    assert data.valid_temperature_c.maximum == pytest.approx(valid_c[1], abs=0.35)


def test_without_two_whole_temperatures_there_is_no_range() -> None:
    made = polygon_campaign(2)
    half = made.angle_deg < 170.0
    keep = np.where(made.temperature_c < 12.0, True, np.where((made.run % 2 == 0), half, half & (made.run < 5)))
    kept = campaign(keep.astype(bool))
    with pytest.raises(ContractError, match="two temperatures or more at which the turn was read") as caught:
        accept(kept)
    assert "10.0 degC" in str(caught.value)


def test_a_temperature_of_one_mounting_among_shifted_ones_is_named() -> None:
    mounted = [
        (at_c, shift)
        for at_c in (10.0, 20.0, 30.0)
        for shift in (0.0, 1 / 3, 2 / 3)
        if at_c < 30.0 or shift == 0.0
    ]
    angle_deg = np.concatenate([(np.arange(23, dtype=np.float64) + shift) * PITCH_DEG for _, shift in mounted])
    readings = TrainingReadings(
        angle_deg=angle_deg,
        error_arcsec=np.cos(np.radians(angle_deg)),
        temperature_c=np.repeat([at_c for at_c, _ in mounted], 23),
        run=np.repeat(np.arange(len(mounted)), 23),
    )
    *whole, last = places_by_temperature(readings, np.arange(angle_deg.size))
    assert [each.missing for each in whole] == [0, 0]
    assert (last.missing, last.places) == (46, 23)
    # Five degrees from the next reading is no gap: the temperature counts.
    assert last.whole
    assert "carried over" in places_sentence(last)


def test_angles_that_never_repeat_are_not_called_missing() -> None:
    rng = np.random.default_rng(5)
    angle_deg = rng.uniform(0.0, 360.0, 7 * 200)
    readings = TrainingReadings(
        angle_deg=angle_deg,
        error_arcsec=np.cos(np.radians(angle_deg)),
        temperature_c=np.repeat(np.linspace(10.0, 40.0, 7), 200),
        run=np.repeat(np.arange(7), 200),
    )
    places = places_by_temperature(readings, np.arange(angle_deg.size))
    assert all(each.whole for each in places)
    # A gap half as wide again as the usual widest of 200 has a chance of some percent at each temperature.
    assert sum(each.missing > 0 for each in places) <= 1


def test_a_part_of_the_turn_is_held_against_that_part() -> None:
    made = polygon_campaign(2)
    part = accept(campaign(made.angle_deg < 180.0))
    assert part.warnings == ()
    assert part.valid_temperature_c.maximum == pytest.approx(40.0, abs=0.3)


def test_base_temperature_and_its_lines_are_named() -> None:
    with pytest.raises(ContractError, match="at the base temperature 20 degC") as caught:
        accept(without_faces(20.0, set(range(12, 24))), base_temperature_c=20.0)
    # Seven temperatures in order, three runs of 23 at each: the third begins at reading 138, line 140.
    assert "campaign.csv lines 140 to 150, 163 to 173, 186 to 196, column angle_deg" in str(caught.value)


def test_lines_are_told_in_ranges() -> None:
    assert lines_text(np.array([3])) == "line 3"
    assert lines_text(np.array([3, 4, 5, 9])) == "lines 3 to 5, 9"
    assert lines_text(np.arange(2, 40, 2)).endswith(", ... 19 in all")


def test_where_temperature_is_ignored_places_are_not_compared() -> None:
    data = training_set(
        replace(without_faces(40.0, set(range(2, 24))), temperature_c=None),
        base_temperature_c=None,
        free_offsets=True,
        temperature_used=False,
    )
    assert data.warnings == ()
    assert (data.valid_temperature_c.minimum, data.valid_temperature_c.maximum) == (-60.0, 150.0)
