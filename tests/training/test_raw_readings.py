"""Raw readings become errors by eq. (11): closed forms, signs, wraps, and every fault by its line."""

import argparse
import datetime
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueangle.contract.calibration import campaign_to_csv, read_campaign
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import PlanZero
from trueangle_training import errors_command
from trueangle_training.command import Surroundings
from trueangle_training.raw_readings import (
    PolygonCertificate,
    errors_by_equation_11,
    read_certificate,
    read_raw_readings,
    with_autocollimator_reversed,
)

FACES = 5
PITCH_DEG = 72.0
HEADER = "face,angle_deg,autocollimator_arcsec,temperature_c,run"
ROUNDING_ARCSEC = 2e-9
"""Angles of a few turns in float64 have steps of 1e-13 deg, 4e-10 arcsec; two of them are subtracted."""


def raw_csv(lines: list[str], header: str = HEADER) -> bytes:
    return "\n".join([header, *lines]).encode()


def faults(lines: list[str], header: str = HEADER, faces: int = FACES) -> str:
    with pytest.raises(ContractError) as caught:
        errors_by_equation_11(read_raw_readings(raw_csv(lines, header), source="raw.csv"), faces=faces)
    return str(caught.value)


def run_lines(error_arcsec: list[float], *, run: int = 1, start_deg: float = 0.0) -> list[str]:
    """Faces in order, the autocollimator at null."""
    return [
        f"{k + 1},{start_deg + k * PITCH_DEG + error / 3600!r},0,20,{run}" for k, error in enumerate(error_arcsec)
    ]


def test_the_equation_term_by_term() -> None:
    # Face 2: encoder 72 deg + 10", autocollimator +3", so the shaft stands at 72 deg + 3" and the error is 7";
    # face 1 was read with +1" on the encoder and -2" on the autocollimator: an error of 3", the run's zero.
    lines = [f"1,{1 / 3600!r},-2,20,1", f"2,{72 + 10 / 3600!r},3,20,1"]
    campaign = errors_by_equation_11(read_raw_readings(raw_csv(lines), source="raw.csv"), faces=FACES)
    np.testing.assert_allclose(campaign.error_arcsec, [0.0, 4.0], atol=ROUNDING_ARCSEC)
    assert campaign.face is not None
    assert campaign.face.tolist() == [1, 2]
    assert campaign.zero_group.tolist() == [1, 1]


def test_a_face_that_lies_further_on_than_nominal_takes_its_deviation_off_the_error() -> None:
    # A perfect encoder shows the polygon's own deviation: 72 deg + 2" at a face that lies 2" further on.
    raw = read_raw_readings(raw_csv(["1,0,0,20,1", f"2,{72 + 2 / 3600!r},0,20,1"]), source="raw.csv")
    certificate = read_certificate(b"face,deviation_arcsec\n1,0.5\n2,2.5\n3,0\n4,0\n5,0\n", source="cert.csv")
    campaign = errors_by_equation_11(raw, faces=FACES, certificate=certificate)
    np.testing.assert_allclose(campaign.error_arcsec, [0.0, 0.0], atol=ROUNDING_ARCSEC)


def test_a_shaft_that_overshoots_a_perfect_face_shows_no_error() -> None:
    # 4" further on by encoder and autocollimator alike.
    raw = read_raw_readings(raw_csv(["1,0,0,20,1", f"2,{72 + 4 / 3600!r},4,20,1"]), source="raw.csv")
    np.testing.assert_allclose(errors_by_equation_11(raw, faces=FACES).error_arcsec, 0.0, atol=ROUNDING_ARCSEC)
    reversed_sign = with_autocollimator_reversed(raw)
    np.testing.assert_allclose(
        errors_by_equation_11(reversed_sign, faces=FACES).error_arcsec, [0.0, 8.0], atol=ROUNDING_ARCSEC
    )


@given(
    start_deg=st.floats(-720, 720),
    error_arcsec=st.lists(st.floats(-3600, 3600), min_size=FACES, max_size=FACES),
    turns=st.lists(st.integers(-2, 2), min_size=FACES, max_size=FACES),
)
def test_whole_turns_and_the_place_of_the_encoders_zero_change_nothing(
    start_deg: float, error_arcsec: list[float], turns: list[int]
) -> None:
    lines = [
        f"{k + 1},{start_deg + k * PITCH_DEG + error / 3600 + 360 * turn!r},0,20,1"
        for k, (error, turn) in enumerate(zip(error_arcsec, turns, strict=True))
    ]
    campaign = errors_by_equation_11(read_raw_readings(raw_csv(lines), source="raw.csv"), faces=FACES)
    expected = np.array(error_arcsec) - error_arcsec[0]
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=ROUNDING_ARCSEC)


def test_each_run_has_its_own_zero_and_its_first_stop_first() -> None:
    lines = [*run_lines([5, 6, 7, 8, 9]), *reversed(run_lines([1, 3, 5, 7, 9], run=2))]
    campaign = errors_by_equation_11(read_raw_readings(raw_csv(lines), source="raw.csv"), faces=FACES)
    assert campaign.face is not None
    assert campaign.face.tolist() == [1, 2, 3, 4, 5, 1, 5, 4, 3, 2]
    expected = [0, 1, 2, 3, 4, 0, 8, 6, 4, 2]
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=ROUNDING_ARCSEC)
    assert "run 2: the reading of face 1 (line 11) was put first" in campaign.notes


def test_a_remounted_polygon_begins_at_another_face_and_keeps_the_angles() -> None:
    # Re-mounted by 2 faces: face 4 is seen at the encoder's zero, face 5 at 72 deg, face 1 at 144 deg.
    lines = [f"{face},{k * PITCH_DEG + 2 * k / 3600!r},0,20,1,2" for k, face in enumerate([4, 5, 1, 2, 3])]
    raw = read_raw_readings(raw_csv(lines, HEADER + ",polygon_offset"), source="raw.csv")
    deviations = (1.0, 2.0, 3.0, 4.0, 5.0)
    certificate = PolygonCertificate(deviation_arcsec=deviations, source="cert.csv")
    campaign = errors_by_equation_11(raw, faces=FACES, certificate=certificate)
    by_stop = [4.0, 5.0, 1.0, 2.0, 3.0]
    expected = [2 * k - (by_stop[k] - by_stop[0]) for k in range(FACES)]
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=ROUNDING_ARCSEC)
    assert campaign.polygon_offset is not None
    assert campaign.polygon_offset.tolist() == [2] * FACES


def test_with_one_zero_the_drift_of_the_first_stop_stays() -> None:
    lines = [*run_lines([0, 1, 2, 3, 4]), *run_lines([7, 8, 9, 10, 11], run=2)]
    raw = read_raw_readings(raw_csv(lines), source="raw.csv")
    campaign = errors_by_equation_11(raw, faces=FACES, zero=PlanZero.ONE)
    expected = [0, 1, 2, 3, 4, 7, 8, 9, 10, 11]
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=ROUNDING_ARCSEC)
    assert campaign.zero_group.tolist() == [1] * 10
    assert campaign.run.tolist() == [1] * 5 + [2] * 5


def test_incomplete_readings_are_left_out_and_named() -> None:
    lines = [*run_lines([0, 1, 2, 3, 4])[:2], "3,,0,20,1", "4,216,,20,1", "5,288,0,,1"]
    campaign = errors_by_equation_11(read_raw_readings(raw_csv(lines), source="raw.csv"), faces=FACES)
    assert campaign.row.tolist() == [2, 3, 6]
    assert "2 readings without angle or autocollimator value were left out (lines 4, 5)" in campaign.notes
    assert campaign.temperature_c is not None
    assert np.isnan(campaign.temperature_c[2])


def test_the_campaign_survives_writing_and_reading() -> None:
    lines = [*run_lines([0, 1, 2, 3, 4]), *run_lines([0, 2, 4, 6, 8], run=2)]
    campaign = errors_by_equation_11(read_raw_readings(raw_csv(lines), source="raw.csv"), faces=FACES)
    again = read_campaign(campaign_to_csv(campaign, comments=("a note",)).encode(), source="campaign.csv")
    np.testing.assert_array_equal(again.error_arcsec, campaign.error_arcsec)
    np.testing.assert_array_equal(again.run, campaign.run)
    np.testing.assert_array_equal(again.zero_group, campaign.zero_group)


def test_a_run_without_its_first_stop_is_refused() -> None:
    text = faults([*run_lines([0, 1, 2, 3, 4]), *run_lines([0, 1, 2, 3, 4], run=2)[1:]])
    assert "lines 7 to 10, run 2: expected a reading of face 1, found no such reading" in text
    assert "found one without a value" in faults(["1,,0,20,1", *run_lines([0, 1, 2, 3, 4])[1:]])


def test_all_faults_come_at_once_by_line() -> None:
    text = faults(["1,0,0,20,1", "2,72,1e5,20,1", "x,144,0,20,1", "4.5,216,0,20,1"])
    assert "line 4, column face: expected a finite number, found 'x'" in text
    text = faults(["1,0,0,20,1", "2,72,1e5,20,1", "2.5,144,0,20,1", "4,216,0,20,"])
    assert "line 3, column autocollimator_arcsec: expected up to 7200 arcsec, found 100000" in text
    assert "line 4, column face: expected a whole number from 1, found 2.5" in text
    assert "line 5, column run: expected a whole number, found an empty cell" in text
    assert "line 3, column face: expected a face from 1 to 5, found 6" in faults(["1,0,0,20,1", "6,72,0,20,1"])


def test_a_typing_error_of_degrees_is_named() -> None:
    lines = run_lines([0, 1, 2, 3, 4])
    lines[2] = "3,162,0,20,1"
    text = faults(lines)
    assert "line 4: expected an angle within 5 deg of face 3, found 162 deg, +18.00 deg off it" in text


def test_faces_that_run_against_the_angle_are_told() -> None:
    text = faults([f"{k + 1},{-k * PITCH_DEG},0,20,1" for k in range(FACES)])
    assert "faces that run against the angle; number the faces as the angle rises" in text
    assert "is the number of faces right" in faults(run_lines([0, 1, 2, 3, 4]), faces=7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("face,deviation_arcsec\n1,0\n2,0\n2,0\n", "face 2 2 times"),
        ("face,deviation_arcsec\n1,0\n2,\n3,0\n", "line 3, column deviation_arcsec: expected a deviation"),
        ("face,deviation_arcsec\n1,0\n2,0\n4,0\n", "expected a whole number from 1 to 3, found 4"),
        ("face,deviation_arcsec\n1,0\n2,72.5e3\n3,0\n", "is it in another unit"),
        ("face;deviation_arcsec\n1;0\n", "columns are separated by commas"),
        ("face,deviation_arcsec\n1,0,5\n2,0\n3,0\n", "expected 2 cells, found 3 cells; is a decimal comma in it?"),
    ],
)
def test_a_faulty_certificate_is_refused(text: str, expected: str) -> None:
    with pytest.raises(ContractError, match=expected.replace("(", r"\(").replace("?", r"\?")):
        read_certificate(text.encode(), source="cert.csv")


def test_a_certificate_of_another_polygon_is_refused() -> None:
    raw = read_raw_readings(raw_csv(run_lines([0, 1, 2, 3, 4])), source="raw.csv")
    certificate = PolygonCertificate(deviation_arcsec=(0.0,) * 6, source="cert.csv")
    with pytest.raises(ContractError, match=r"cert\.csv: expected 5 faces, as the polygon has, found 6"):
        errors_by_equation_11(raw, faces=FACES, certificate=certificate)


def run_errors(arguments: list[str]) -> str:
    parser = argparse.ArgumentParser()
    errors_command.register(parser.add_subparsers())
    parsed = parser.parse_args(["errors", *arguments])
    out = io.StringIO()
    assert parsed.run(parsed, Surroundings(today=datetime.date(2025, 3, 1), out=out, err=io.StringIO())) == 0
    return out.getvalue()


def test_the_command_writes_a_campaign_that_says_how_it_was_made(tmp_path: Path) -> None:
    raw, certificate, output = tmp_path / "raw.csv", tmp_path / "cert.csv", tmp_path / "campaign.csv"
    raw.write_bytes(raw_csv(run_lines([0, 1, 2, 3, 4])))
    certificate.write_text("face,deviation_arcsec\n5,4\n4,3\n3,2\n2,1\n1,0\n")
    out = run_errors([str(raw), "--certificate", str(certificate), "-o", str(output)])
    assert "5 readings of 5 faces in 1 runs" in out
    campaign = read_campaign(output.read_bytes(), source="campaign.csv")
    np.testing.assert_allclose(campaign.error_arcsec, 0.0, atol=ROUNDING_ARCSEC)
    assert "# Certificate: positive where a face lies further on than nominal" in output.read_text()


def test_the_command_names_what_contradicts_itself(tmp_path: Path) -> None:
    raw, certificate = tmp_path / "raw.csv", tmp_path / "cert.csv"
    raw.write_bytes(raw_csv(run_lines([0, 1, 2, 3, 4])))
    certificate.write_text("face,deviation_arcsec\n1,0\n2,0\n3,0\n4,0\n")
    start = [str(raw), "-o", str(tmp_path / "out.csv")]
    with pytest.raises(
        ContractError, match="expected one number of faces, found 5 by --faces, 4 by --certificate"
    ):
        run_errors([*start, "--faces", "5", "--certificate", str(certificate)])
    with pytest.raises(ContractError) as caught:
        run_errors([str(raw), "-o", str(raw), "--faces", "2", "--joint", str(tmp_path / "none.yaml")])
    for part in ("--output: expected another file than RAW.csv", "--faces: expected 3 or more", "none.yaml"):
        assert part in str(caught.value)
    assert not (tmp_path / "out.csv").exists()


def test_without_a_stated_number_of_faces_the_highest_is_taken_and_said(tmp_path: Path) -> None:
    raw = tmp_path / "raw.csv"
    raw.write_bytes(raw_csv(run_lines([0, 1, 2, 3, 4])))
    out = run_errors([str(raw), "-o", str(tmp_path / "out.csv")])
    assert "the polygon is taken to have 5 faces, the highest number in the file" in out
