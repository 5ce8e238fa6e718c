"""A broken file is named as such, and the strongest true effect is not taken for one."""

from dataclasses import replace

import numpy as np
import pytest
from tests.training.gap_campaigns import FACES, campaign, joint, problem

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import ReferenceKind
from trueangle_training.diagnosis.curve_checks import other_joint_faults
from trueangle_training.diagnosis.data_checks import data_checks


def kinds(made: Campaign) -> list[str]:
    return [fault.kind for fault in data_checks(made, joint()).faults]


def test_a_sound_campaign_has_no_fault() -> None:
    for seed in range(5):
        assert kinds(campaign(seed, directions=(1, -1))) == []


def test_strong_hysteresis_is_no_swapped_direction() -> None:
    made = campaign(1, directions=(1, -1))
    assert made.direction is not None
    strong = replace(
        made, error_arcsec=made.error_arcsec + 40.0 * made.direction * np.cos(np.radians(made.angle_deg))
    )
    assert kinds(strong) == []


@pytest.mark.parametrize(
    "pattern",
    [
        lambda theta, t, run: 15.0 * np.cos(7 * theta),
        lambda theta, t, run: 1.0 * (t - 20) * np.cos(theta),
        lambda theta, t, run: 20.0 * np.exp(-(((theta - 3.0) / 0.1) ** 2)),
        lambda theta, t, run: 10.0 * (theta > 4.0) * (run % 4 == 0),
        lambda theta, t, run: 10.0 * np.cos(theta + 1.7 * run),
        lambda theta, t, run: 10.0 * (theta / 6.28),
    ],
    ids=["graduation", "thermal", "local defect", "count loss", "run to run", "creep"],
)
def test_strong_effects_of_the_joint_are_no_fault(pattern: object) -> None:
    assert kinds(campaign(2, pattern)) == []  # pyright: ignore[reportArgumentType]


def test_bursts_of_thirty_sigma_are_no_fault() -> None:
    made = campaign(3)
    error = made.error_arcsec.copy()
    error[100], error[200:204] = error[100] + 15.0, error[200:204] + 4.0
    assert kinds(replace(made, error_arcsec=error)) == []


def test_a_swapped_direction_is_named_with_its_rows() -> None:
    made = campaign(4, directions=(1, -1))
    assert made.direction is not None
    (fault,) = data_checks(replace(made, direction=-made.direction), joint()).faults
    assert fault.kind == "direction_swapped"
    assert len(fault.rows) == len(made)


def test_a_direction_swapped_in_some_runs_is_named_for_these_only() -> None:
    made = campaign(4, directions=(1, -1))
    assert made.direction is not None
    wrong = made.run <= 4
    (fault,) = data_checks(
        replace(made, direction=np.where(wrong, -made.direction, made.direction)), joint()
    ).faults
    assert fault.rows == tuple(made.row[wrong].tolist())


@pytest.mark.parametrize("scale", [0.5, 2.0, 1.0125, 16383 / 16384])
def test_a_wrong_line_count_is_named(scale: float) -> None:
    made = campaign(5)
    added = (scale - 1.0) * made.angle_deg * 3600.0
    wrong = replace(made, angle_deg=made.angle_deg * scale, error_arcsec=made.error_arcsec + added)
    assert kinds(wrong) == ["wrong_line_count"]


def test_angles_of_another_counts_per_rev_are_named() -> None:
    made = campaign(5)
    counts = 2**20
    other = replace(made, angle_deg=np.rint(made.angle_deg * counts / 360) * 360 / counts)
    assert kinds(other) == ["wrong_line_count"]


def test_a_coarser_lattice_that_divides_the_counts_is_no_fault() -> None:
    made = campaign(5)
    counts = 3_276_800 // 100
    assert kinds(replace(made, angle_deg=np.rint(made.angle_deg * counts / 360) * 360 / counts)) == []


def test_a_turn_left_in_the_error_is_named() -> None:
    made = campaign(6)
    wrong = (made.angle_deg > 100) & (made.angle_deg < 150)
    (fault,) = data_checks(replace(made, error_arcsec=made.error_arcsec + 1_296_000.0 * wrong), joint()).faults
    assert (fault.kind, fault.rows) == ("whole_turn_jump", tuple(made.row[wrong].tolist()))


def test_an_angle_that_leaps_by_a_turn_is_named_and_one_that_wraps_is_not() -> None:
    made = campaign(6)
    turned = np.mod(made.angle_deg + 200.0, 360.0)
    assert made.face is not None
    assert kinds(replace(made, angle_deg=turned)) == []
    leap = np.where(made.face > 12, made.angle_deg + 360.0, made.angle_deg)
    (fault,) = data_checks(replace(made, angle_deg=leap), joint()).faults
    assert fault.kind == "whole_turn_jump"
    assert len(fault.rows) == np.unique(made.run).size


def test_a_clock_set_back_is_named_within_a_run_and_between_runs() -> None:
    made = campaign(7)
    assert made.time_s is not None
    for first, kind in ((30, "clock_not_increasing"), (10 * FACES, "clock_offset")):
        late = np.arange(len(made)) >= first
        assert kinds(replace(made, time_s=np.where(late, made.time_s - 7200.0, made.time_s))) == [kind]


def test_runs_sorted_by_temperature_have_a_sound_clock() -> None:
    made = campaign(8)
    assert made.temperature_c is not None
    mean = np.array([made.temperature_c[made.run == run].mean() for run in made.run])
    order = np.lexsort((made.time_s, np.round(mean)))  # pyright: ignore[reportArgumentType]
    columns = ("angle_deg", "error_arcsec", "run", "zero_group", "temperature_c", "time_s", "direction", "face")
    assert kinds(replace(made, **{name: getattr(made, name)[order] for name in columns})) == []


def test_typing_errors_are_named_by_row() -> None:
    made = campaign(9)
    error = made.error_arcsec.copy()
    error[[40, 300]] += (300.0, -2000.0)
    (fault,) = data_checks(replace(made, error_arcsec=error), joint()).faults
    assert (fault.kind, fault.rows) == ("outliers", (42, 302))


def test_runs_in_another_unit_are_named() -> None:
    made = campaign(10)
    wrong = np.isin(made.run, (3, 4))
    (fault,) = data_checks(
        replace(made, error_arcsec=np.where(wrong, made.error_arcsec / 3600.0, made.error_arcsec)), joint()
    ).faults
    assert (fault.kind, fault.rows) == ("unit_mix", tuple(made.row[wrong].tolist()))
    assert "degrees" in fault.text


def test_kelvin_radians_and_constant_errors_are_named() -> None:
    made = campaign(11)
    assert made.temperature_c is not None
    assert kinds(replace(made, temperature_c=made.temperature_c + 273.15)) == ["temperature_unit"]
    assert kinds(replace(made, angle_deg=np.radians(made.angle_deg))) == ["angle_unit"]
    assert kinds(replace(made, error_arcsec=np.zeros(len(made)))) == ["errors_all_equal"]


def test_mirrored_angles_and_reversed_errors_are_named() -> None:
    made = campaign(12)
    assert made.direction is not None
    mirrored = replace(made, angle_deg=360.0 - made.angle_deg, direction=-made.direction)
    assert kinds(mirrored) == ["angle_mirrored"]
    assert kinds(replace(made, error_arcsec=-made.error_arcsec)) == ["error_sign_reversed"]


def test_copied_rows_and_runs_are_named() -> None:
    made = campaign(13)
    again = np.concatenate([np.arange(len(made)), [5]])
    columns = ("angle_deg", "error_arcsec", "run", "zero_group", "temperature_c", "time_s", "direction", "face")
    doubled = replace(
        made,
        **{name: getattr(made, name)[again] for name in columns},
        velocity_deg_s=None,
        load_nm=None,
        polygon_offset=None,
        row=np.arange(2, len(made) + 3),
    )
    assert "duplicated_rows" in kinds(doubled)
    copied = made.error_arcsec.copy()
    copied[made.run == 2] = copied[made.run == 1]
    assert "copied_run" in kinds(replace(made, error_arcsec=copied))


def test_a_face_beyond_the_polygon_is_another_joint() -> None:
    made = campaign(14)
    assert made.face is not None
    assert kinds(replace(made, face=made.face + 3)) == ["other_joint"]


def shipped(turned_deg: float) -> dict[str, object]:
    return {
        "eccentricity": {"amplitude_arcsec": 20.0, "phase_deg": 57.3 + turned_deg},
        "grating_tilt": {"amplitude_arcsec": 3.0, "phase_deg": turned_deg},
        "thermal_eccentricity": {"amplitude_arcsec_per_k": 0.1, "phase_deg": 90.0 + turned_deg},
    }


def test_a_simulator_of_another_joint_is_named_and_a_moved_parameter_is_not() -> None:
    made = campaign(15)
    assert other_joint_faults(problem(made, joint(shipped(0.0)))) == ()
    assert other_joint_faults(problem(made, joint(shipped(40.0)))) == ()
    assert [fault.kind for fault in other_joint_faults(problem(made, joint(shipped(150.0))))] == ["other_joint"]
    assert other_joint_faults(problem(made)) == ()


def test_single_equal_rows_without_a_clock_are_chance_and_a_doubled_block_is_none() -> None:
    made = replace(campaign(6), time_s=None, temperature_c=None)
    angle, error = made.angle_deg.copy(), made.error_arcsec.copy()
    angle[12], error[12] = angle[5], error[5]
    assert "duplicated_rows" not in kinds(replace(made, angle_deg=angle, error_arcsec=error))
    # The same with a clock that stands still there is a row written twice.
    timed = replace(campaign(6), angle_deg=angle, error_arcsec=error)
    assert timed.time_s is not None
    assert timed.temperature_c is not None
    time_s, temperature_c = timed.time_s.copy(), timed.temperature_c.copy()
    time_s[12], temperature_c[12] = time_s[5], temperature_c[5]
    assert "duplicated_rows" in kinds(replace(timed, time_s=time_s, temperature_c=temperature_c))
    angle[13:16], error[13:16] = angle[6:9], error[6:9]
    assert "duplicated_rows" in kinds(replace(made, angle_deg=angle, error_arcsec=error))


def test_faces_of_a_polygon_beside_a_joint_with_a_reference_encoder_are_noted() -> None:
    made, polygon = campaign(7), joint()
    encoder = replace(polygon, reference=replace(polygon.reference, kind=ReferenceKind.ENCODER, faces=None))
    assert any("one is wrong" in note for note in data_checks(made, encoder).notes)
    assert data_checks(made, polygon).notes == ()


@pytest.mark.parametrize(("lines", "counts"), [(18_000, 3_600_000), (10_000, 2_000_000), (9_000, 3_276_801)])
def test_angles_of_another_encoder_are_told_whatever_its_counts_are(lines: int, counts: int) -> None:
    """The campaign's angles are whole multiples of 1/3276800 turn."""
    made, own = campaign(8), joint()
    other = replace(own, encoder=replace(own.encoder, lines_per_rev=lines, counts_per_rev=counts))
    (fault,) = data_checks(made, other).faults
    assert fault.kind == "wrong_line_count"
    assert "1/3276800 turn" in fault.text


@pytest.mark.parametrize("digits", [3, 4, 5, 6])
def test_angles_written_with_few_digits_are_of_no_other_encoder(digits: int) -> None:
    made = campaign(9)
    assert kinds(replace(made, angle_deg=np.round(made.angle_deg, digits))) == []


def test_angles_without_any_lattice_are_of_no_other_encoder() -> None:
    made = campaign(9)
    scattered = made.angle_deg + np.random.default_rng(1).uniform(-1e-4, 1e-4, len(made))
    assert kinds(replace(made, angle_deg=scattered)) == []
