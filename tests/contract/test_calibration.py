"""The campaign file: read, written, refused by line."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trueangle.contract.calibration import (
    Campaign,
    campaign_to_csv,
    derive_runs,
    derive_zero_groups,
    read_campaign,
)
from trueangle.contract.errors import ContractError


def read(text: str) -> Campaign:
    return read_campaign(text.encode(), source="c.csv")


def faults_of(text: str | bytes) -> list[str]:
    with pytest.raises(ContractError) as caught:
        read_campaign(text if isinstance(text, bytes) else text.encode(), source="c.csv")
    return [str(fault) for fault in caught.value.faults]


def test_comments_blank_lines_byte_order_mark_and_unknown_columns_are_allowed() -> None:
    campaign = read("\ufeff# made by hand\n\nangle_deg, error_arcsec,operator\n 0.5 , -1.25,Ann\n# end\n10,2,Bo\n")
    assert campaign.angle_deg.tolist() == [0.5, 10.0]
    assert campaign.error_arcsec.tolist() == [-1.25, 2.0]
    assert campaign.row.tolist() == [4, 6]
    assert campaign.temperature_c is None
    assert "column operator is unknown and was ignored" in campaign.notes


def test_a_reading_without_error_is_left_out_and_said() -> None:
    campaign = read("angle_deg,error_arcsec,temperature_c\n0,1,20\n10,,20\n20,3,\n")
    assert campaign.angle_deg.tolist() == [0.0, 20.0]
    assert campaign.temperature_c is not None
    assert np.isnan(campaign.temperature_c[1])
    assert any("1 reading without angle or error was left out (line 3)" in note for note in campaign.notes)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("angle_deg,temperature_c\n0,20\n", "c.csv line 1: expected the columns error_arcsec, found angle_deg"),
        ("angle_deg;error_arcsec\n0;1\n", "columns are separated by commas"),
        (
            "angle_deg,error_arcsec\n0,abc\n",
            "c.csv line 2, column error_arcsec: expected a finite number, found 'abc'",
        ),
        ("angle_deg,error_arcsec\n0,nan\n", "expected a finite number, found 'nan'"),
        ("angle_deg,error_arcsec\n0,1e999\n", "expected a finite number, found '1e999'"),
        ("angle_deg,error_arcsec\n0,-1e300\n", "column error_arcsec: expected a number from -1e+18 to 1e+18"),
        ("angle_deg,error_arcsec,time_s\n0,1,1e300\n", "line 2, column time_s: expected a number from -1e+18"),
        ("angle_deg,error_arcsec\n0,1_0\n", "expected a finite number, found '1_0'"),
        ("angle_deg,error_arcsec\n0,1,5\n", "line 2: expected 2 cells, found 3 cells; is a decimal comma in it?"),
        ("angle_deg,error_arcsec,run\n0,1,1.5\n", "column run: expected a whole number, found 1.5"),
        (
            "angle_deg,error_arcsec,run\n0,1,1\n1,1,\n",
            "line 3, column run: expected a whole number, found an empty",
        ),
        ("angle_deg,error_arcsec,direction\n0,1,2\n", "column direction: expected 1 or -1, found 2"),
        ("angle_deg,error_arcsec,face\n0,1,-2\n", "column face: expected a whole number from 0, found -2"),
        ("angle_deg,error_arcsec,angle_deg\n0,1,2\n", "expected each column once, found angle_deg 2 times"),
        ("", "expected a header line with column names, found an empty file"),
        ("angle_deg,error_arcsec\n", "expected at least one reading, found only a header"),
        ("angle_deg,error_arcsec\n0,\n", "expected at least one reading, found 1 without angle or error; a recor"),
    ],
)
def test_bad_input_is_named_by_line_and_column(text: str, found: str) -> None:
    assert any(found in fault for fault in faults_of(text))


def test_bytes_that_are_not_utf8_are_named_by_line() -> None:
    assert faults_of(b"angle_deg,error_arcsec\n1,\xff\n") == ["c.csv line 2: expected UTF-8 text, found byte 0xff"]


def test_many_faults_are_counted_after_twenty() -> None:
    faults = faults_of("angle_deg,error_arcsec\n" + "x,1\n" * 100)
    assert len(faults) == 21
    assert "80 more" in faults[-1]


COLUMN = hnp.arrays(np.float64, 7, elements=st.floats(-1e18, 1e18))


@given(COLUMN, COLUMN, COLUMN)
def test_writing_and_reading_give_the_same_readings(
    angle_deg: np.ndarray, error_arcsec: np.ndarray, temperature_c: np.ndarray
) -> None:
    written = Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        temperature_c=temperature_c,
        run=np.arange(7),
        zero_group=np.zeros(7, dtype=np.int64),
        face=np.ones(7, dtype=np.int64),
        row=np.arange(7),
        source="x",
        sha256="",
    )
    back = read(campaign_to_csv(written, comments=["two\nlines"]))
    for name in ("angle_deg", "error_arcsec", "temperature_c", "run", "zero_group", "face"):
        assert np.array_equal(getattr(back, name), getattr(written, name))


def test_a_direction_that_is_not_known_is_written_as_an_empty_cell() -> None:
    written = read("angle_deg,error_arcsec,direction,run\n0,1,1,1\n10,2,,1\n20,3,-1,1\n")
    assert written.direction is not None
    assert written.direction.tolist() == [1, 0, -1]
    back = read(campaign_to_csv(written))
    assert back.direction is not None
    assert back.direction.tolist() == [1, 0, -1]


def test_a_column_of_directions_none_of_which_is_known_is_read_as_none() -> None:
    written = replace(read("angle_deg,error_arcsec,run\n0,1,1\n10,2,1\n"), direction=np.zeros(2, dtype=np.int64))
    assert read(campaign_to_csv(written)).direction is None


def test_a_run_ends_where_the_angle_falls_back_by_more_than_half_its_span() -> None:
    angle_deg = np.array([0.0, 120, 240, 0, 120, 240, 200.0])
    assert derive_runs(angle_deg, direction=None, time_s=None, temperature_c=None).tolist() == [
        0,
        0,
        0,
        1,
        1,
        1,
        1,
    ]


def test_a_run_ends_at_a_reversal_a_pause_or_a_temperature_step() -> None:
    angle_deg = np.array([0.0, 10, 20, 30])
    runs = derive_runs(angle_deg, direction=np.array([1, 1, -1, -1]), time_s=None, temperature_c=None)
    assert runs.tolist() == [0, 0, 1, 1]
    pause_s = np.array([0.0, 15, 616, 630])
    assert derive_runs(angle_deg, direction=None, time_s=pause_s, temperature_c=None).tolist() == [0, 0, 1, 1]
    step_c = np.array([20.0, 20.9, 22, 22])
    assert derive_runs(angle_deg, direction=None, time_s=None, temperature_c=step_c).tolist() == [0, 0, 1, 1]


def test_a_run_measured_backwards_ends_where_the_angle_jumps_up() -> None:
    angle_deg = np.array([240.0, 120, 0, 240, 120, 0])
    direction = np.full(6, -1)
    assert derive_runs(angle_deg, direction=direction, time_s=None, temperature_c=None).tolist() == [
        0,
        0,
        0,
        1,
        1,
        1,
    ]


def test_polygon_runs_have_their_own_zero_and_a_reference_encoder_shares_one() -> None:
    run = np.array([0, 0, 1, 1, 2, 2])
    face = np.array([1, 2, 0, 0, 0, 0])
    assert derive_zero_groups(run, face=face).tolist() == [0, 0, 3, 3, 3, 3]
    assert derive_zero_groups(run, face=None).tolist() == run.tolist()


@pytest.mark.parametrize(
    ("rows", "note"),
    [
        (["0,1", "1,", "2,3"], "1 reading without angle or error was left out (line 3)"),
        (["0,1", "1,", ",3", "4,2"], "2 readings without angle or error were left out (lines 3, 4)"),
        (["0,1", "1,2"], "no column run: all readings are one run by angle, direction, time, temperature"),
    ],
)
def test_notes_count_in_plain_words(rows: list[str], note: str) -> None:
    data = "\n".join(["angle_deg,error_arcsec", *rows]).encode()
    assert note in read_campaign(data, source="a.csv").notes
