"""Every effect of the library, forwards against closed forms and backwards against itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.training.library_conditions import BASE_C, COUNTS, LINES, joint_of, rich_conditions

from trueangle.contract.document import structure
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Joint, effect_settings
from trueangle_training.effects import (
    EFFECTS,
    modelled_columns,
    nominal_effects,
    nominal_error_arcsec,
)
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import EffectSettings, Hypothesis, Nature
from trueangle_training.effects.library.noise_growth import NoiseGrowthSettings
from trueangle_training.effects.library.noise_growth import variance_hypotheses as growth_hypotheses
from trueangle_training.effects.library.quantisation import coarser_counts_per_rev
from trueangle_training.effects.library.quantisation import variance_hypotheses as lattice_hypotheses

THERMAL = {"thermal_eccentricity": {"amplitude_arcsec_per_k": 0.5, "phase_deg": 30}}
IN_THE_MEAN = [name for name, entry in EFFECTS.items() if entry.nature is not Nature.VARIANCE]


def settings_from(name: str, values: dict[str, Any]) -> EffectSettings:
    return structure(EFFECTS[name].settings, effect_settings(values, name=name))


def error_arcsec(name: str, values: dict[str, Any], conditions: Conditions, joint: Joint | None = None) -> Any:
    settings_ = settings_from(name, values)
    return settings_.error_arcsec(conditions, joint or joint_of(THERMAL), np.random.default_rng(1))


def shapes(name: str, conditions: Conditions) -> list[Hypothesis]:
    return list(EFFECTS[name].hypotheses(conditions))


@pytest.fixture(scope="module")
def conditions() -> Conditions:
    return rich_conditions(joint=joint_of(THERMAL))


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_entry_says_what_a_person_needs(name: str) -> None:
    entry = EFFECTS[name]
    for text in (entry.physics, entry.formula, entry.source, entry.proof):
        assert len(text) > 10
    assert entry.parameters
    assert entry.cells
    assert all(each.low < each.high and each.source and each.unit for each in entry.parameters)


@pytest.mark.parametrize("name", IN_THE_MEAN)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_settings_of_a_found_shape_reproduce_its_curve(name: str, data: st.DataObject) -> None:
    joint = joint_of(THERMAL)
    conditions = rich_conditions(data.draw(st.integers(0, 5)), joint=joint)
    found = data.draw(st.sampled_from(shapes(name, conditions)))
    # Latencies are seconds; the sensor's error is linear in its coefficient only to first order.
    size = {"read_latency": 1e-3, "temperature_sensor_error": 0.2}.get(name, 30.0)
    elements = st.floats(-size, size, allow_subnormal=False)
    columns = found.main.shape[1]
    coefficients = np.array(data.draw(st.lists(elements, min_size=columns, max_size=columns)))
    curve = found.main @ coefficients
    again = error_arcsec(name, EFFECTS[name].settings_of(found, coefficients), conditions, joint)
    # 1e-9: rounding of some hundred arcsec. A gain of 0.2 leaves out gain squared, a quarter of the curve.
    scale = float(np.abs(curve).max())
    atol = 1e-9 + 0.3 * scale if name == "temperature_sensor_error" else 1e-9 + 1e-10 * scale
    np.testing.assert_allclose(again, curve, atol=atol)


@pytest.mark.parametrize("name", IN_THE_MEAN)
def test_a_found_shape_lies_in_the_span_that_recalibrates_it(name: str, conditions: Conditions) -> None:
    joint = joint_of(THERMAL)
    for found in shapes(name, conditions)[::5]:
        coefficients = np.full(found.main.shape[1], 1e-3)
        settings_ = settings_from(name, EFFECTS[name].settings_of(found, coefficients))
        columns = settings_.columns(conditions, joint)
        curve = found.main @ coefficients
        left = curve - columns @ np.linalg.lstsq(columns, curve, rcond=None)[0]
        # 1e-6: the least squares' own cut at small singular values.
        assert np.linalg.norm(left) <= 1e-6 * np.linalg.norm(curve)


@pytest.mark.parametrize("name", IN_THE_MEAN)
def test_no_coefficient_is_no_error(name: str, conditions: Conditions) -> None:
    for found in shapes(name, conditions)[::7]:
        values = EFFECTS[name].settings_of(found, np.zeros(found.main.shape[1]))
        np.testing.assert_array_equal(error_arcsec(name, values, conditions), 0.0)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_left_out_parameters_are_no_error(name: str, conditions: Conditions) -> None:
    np.testing.assert_array_equal(settings_from(name, {}).error_arcsec(conditions, joint_of(THERMAL), None), 0.0)
    assert settings_from(name, {}).terms(joint_of(THERMAL)) is None


@pytest.mark.parametrize("name", IN_THE_MEAN)
def test_shapes_are_finite_named_and_as_long_as_the_readings(name: str, conditions: Conditions) -> None:
    found = shapes(name, conditions)
    assert found
    for each in found:
        assert each.effect == name
        assert each.main.shape == (len(conditions), len(each.coefficients))
        assert each.wiggle.shape[0] == len(conditions)
        assert np.isfinite(each.main).all()
        assert np.isfinite(each.wiggle).all()
        assert np.abs(each.main).max() > 0
    assert len({each.label for each in found}) >= len(found) / 2


@pytest.mark.parametrize("name", [name for name in IN_THE_MEAN if EFFECTS[name].needs])
def test_no_shape_without_the_columns_it_needs(name: str, conditions: Conditions) -> None:
    for column in EFFECTS[name].needs:
        without = replace(conditions, **{column: None})
        assert shapes(name, without) == []
        np.testing.assert_array_equal(
            error_arcsec(name, EFFECTS[name].settings_of(*first_shape(name, conditions)), without), 0.0
        )


def first_shape(name: str, conditions: Conditions) -> tuple[Hypothesis, Any]:
    found = shapes(name, conditions)[0]
    return found, np.full(found.main.shape[1], 1e-3)


def test_a_column_with_gaps_counts_as_missing(conditions: Conditions) -> None:
    assert conditions.temperature_c is not None
    gaps = conditions.temperature_c.copy()
    gaps[3] = np.nan
    assert shapes("thermal_eccentricity", replace(conditions, temperature_c=gaps)) == []
    assert conditions.direction is not None
    unknown = np.where(np.arange(len(conditions)) == 3, 0.0, conditions.direction)
    assert shapes("hysteresis", replace(conditions, direction=unknown)) == []


def test_hysteresis_is_the_sign_of_the_approach(conditions: Conditions) -> None:
    values = {"harmonics": [{"order": 0, "amplitude_arcsec": 3.0, "phase_deg": 0}]}
    assert conditions.direction is not None
    np.testing.assert_allclose(error_arcsec("hysteresis", values, conditions), 3.0 * conditions.direction)
    values["harmonics"].append({"order": 1, "amplitude_arcsec": 2.0, "phase_deg": 40})
    expected = conditions.direction * (3.0 + 2.0 * np.cos(np.radians(conditions.angle_deg - 40)))
    np.testing.assert_allclose(error_arcsec("hysteresis", values, conditions), expected, atol=1e-12)


@pytest.mark.parametrize("start", ["relaxed", "wound"])
def test_windup_builds_up_exponentially_after_each_reversal(start: str) -> None:
    way_deg = np.concatenate([np.arange(0.0, 100.0, 5.0), np.arange(100.0, 0.0, -5.0)])
    conditions = Conditions(
        angle_deg=way_deg,
        run=np.ones(40, dtype=np.int64),
        zero_group=np.ones(40, dtype=np.int64),
        lines_per_rev=LINES,
        counts_per_rev=COUNTS,
        base_temperature_c=BASE_C,
        direction=np.repeat([1.0, -1.0], 20),
    )
    values = {"amplitude_arcsec": 8.0, "travel_deg": 20.0, "start": start}
    first = -1.0 if start == "wound" else 0.0
    up = 1.0 + (first - 1.0) * np.exp(-way_deg[:20] / 20.0)
    # The turning point lies at the first reading downwards: 100 deg.
    top = up[-1] - 1.0
    at_100 = -1.0 + (up[-1] + 1.0) * np.exp(-5.0 / 20.0)
    down = -1.0 + (at_100 + 1.0) * np.exp(-(100.0 - way_deg[20:]) / 20.0)
    np.testing.assert_allclose(
        error_arcsec("windup", values, conditions), 8.0 * np.concatenate([up, down]), atol=1e-12
    )
    assert top < 0


def test_index_drift_settles_from_the_first_reading_of_each_run(conditions: Conditions) -> None:
    values = {"amplitude_arcsec": -4.0, "time_constant_s": 200.0}
    since_s = np.tile(np.arange(46) * 15.0, 8)
    expected = -4.0 * (1 - np.exp(-since_s / 200.0))
    np.testing.assert_allclose(error_arcsec("index_drift", values, conditions), expected, atol=1e-12)


def test_read_latency_lags_behind_the_motion(conditions: Conditions) -> None:
    assert conditions.velocity_deg_s is not None
    expected = -0.001 * conditions.velocity_deg_s * 3600.0
    np.testing.assert_allclose(error_arcsec("read_latency", {"latency_s": 0.001}, conditions), expected)


def test_load_deflection_is_proportional_to_the_load(conditions: Conditions) -> None:
    values = {"harmonics": [{"order": 2, "amplitude_arcsec_per_nm": 0.5, "phase_deg": -20}]}
    assert conditions.load_nm is not None
    expected = 0.5 * conditions.load_nm * np.cos(np.radians(2 * conditions.angle_deg + 20))
    np.testing.assert_allclose(error_arcsec("load_deflection", values, conditions), expected, atol=1e-12)


def test_bearing_wobble_does_not_close_over_a_turn(conditions: Conditions) -> None:
    values = {"wobbles": [{"per_turn": 0.4, "amplitude_arcsec": 2.0, "phase_deg": 10}]}
    expected = 2.0 * np.cos(np.radians(0.4 * conditions.angle_deg - 10))
    np.testing.assert_allclose(error_arcsec("bearing_wobble", values, conditions), expected, atol=1e-12)
    a_turn_on = replace(conditions, angle_deg=conditions.angle_deg + 360.0)
    assert np.abs(error_arcsec("bearing_wobble", values, a_turn_on) - expected).max() > 1.0


def test_subdivision_error_repeats_in_each_line(conditions: Conditions) -> None:
    values = {
        "harmonics": [
            {"per_line": 1, "amplitude_arcsec": 2.0, "phase_deg": 30},
            {"per_line": 4, "amplitude_arcsec": 0.5, "phase_deg": 0},
        ]
    }
    line_rad = np.radians(conditions.angle_deg * LINES)
    expected = 2.0 * np.cos(line_rad - np.radians(30)) + 0.5 * np.cos(4 * line_rad)
    # 1e-8: phases of some million degrees in float64.
    np.testing.assert_allclose(error_arcsec("subdivision_error", values, conditions), expected, atol=1e-8)
    with pytest.raises(ContractError, match="one of 1, 2, 4"):
        settings_from("subdivision_error", {"harmonics": [{**values["harmonics"][0], "per_line": 3}]})


@pytest.mark.parametrize(("fwhm_deg", "amplitude"), [(1.0, 20.0), (6.0, -5.0), (15.0, 30.0)])
def test_localized_defect_is_half_as_high_half_a_width_away(fwhm_deg: float, amplitude: float) -> None:
    values = {"defects": [{"centre_deg": 359.0, "fwhm_deg": fwhm_deg, "amplitude_arcsec": amplitude}]}
    joint = joint_of({"localized_defect": values})
    angle_deg = np.array([359.0, 359.0 + fwhm_deg / 2, -1.0 - fwhm_deg / 2, 179.0])
    (effect,) = nominal_effects(joint)
    series = effect.error_arcsec(angle_deg, 33.0)
    far = series[3]
    np.testing.assert_allclose(series[:3] - far, amplitude * np.array([1.0, 0.5, 0.5]), atol=1e-6)
    direct = replace(rich_conditions(), angle_deg=np.linspace(-400, 800, 368))
    # The series stops where a Gaussian has fallen to 1e-8 (orders up to 1000 for the narrowest).
    np.testing.assert_allclose(
        error_arcsec("localized_defect", values, direct), effect.error_arcsec(direct.angle_deg, 20.0), atol=1e-6
    )
    assert abs(np.mean(effect.error_arcsec(np.arange(0, 360, 0.05), 20.0))) < 1e-9


def test_reference_artefact_belongs_to_the_faces(conditions: Conditions) -> None:
    pattern = [float(face) - 12.0 for face in range(1, 24)]
    assert conditions.face is not None
    got = error_arcsec("reference_artefact", {"faces_arcsec": pattern}, conditions)
    np.testing.assert_array_equal(got, conditions.face - 12.0)
    against_encoder = replace(conditions, face=np.zeros_like(conditions.face))
    np.testing.assert_array_equal(
        error_arcsec("reference_artefact", {"faces_arcsec": pattern}, against_encoder), 0.0
    )
    assert shapes("reference_artefact", against_encoder) == []


def test_smooth_patterns_over_the_faces_only_where_the_polygon_was_remounted(conditions: Conditions) -> None:
    assert conditions.polygon_offset is not None
    assert len(shapes("reference_artefact", conditions)) == 4
    once = replace(conditions, polygon_offset=np.zeros_like(conditions.polygon_offset))
    assert len(shapes("reference_artefact", once)) == 1


def test_count_loss_lasts_to_the_end_of_its_run_or_of_its_zero(conditions: Conditions) -> None:
    event = {"run": 3, "reading": 10, "step_arcsec": -25.92}
    got = error_arcsec("count_loss", {"events": [event]}, conditions)
    expected = np.zeros(len(conditions))
    expected[2 * 46 + 9 : 3 * 46] = -25.92
    np.testing.assert_array_equal(got, expected)
    got = error_arcsec("count_loss", {"events": [{**event, "until": "zero_group_end"}]}, conditions)
    expected[3 * 46 : 4 * 46] = -25.92
    np.testing.assert_array_equal(got, expected)


def test_random_count_losses_happen_as_often_as_said_and_are_whole_counts(conditions: Conditions) -> None:
    many = rich_conditions()
    many = replace(many, run=np.arange(368) // 4, zero_group=np.arange(368) // 4)
    loss = settings_from("count_loss", {"probability_per_run": 0.25, "counts": -20})
    happened = []
    for seed in range(40):
        got = loss.error_arcsec(many, joint_of({}), np.random.default_rng(seed))
        assert set(np.unique(got)) <= {0.0, -20 * 1.296}
        happened.append(np.mean(got.reshape(92, 4)[:, -1] != 0))
        assert np.all(got.reshape(92, 4)[:, 0] == 0)
    # 3680 runs at 1/4: a standard error of 0.7 %, four of them allowed.
    assert np.mean(happened) == pytest.approx(0.25, abs=0.029)
    np.testing.assert_array_equal(loss.error_arcsec(conditions, joint_of({}), None), 0.0)


def test_run_to_run_eccentricity_draws_each_run_anew_with_the_size_said(conditions: Conditions) -> None:
    seated = settings_from("run_to_run_eccentricity", {"amplitude_arcsec": 5.0})
    squares = []
    for seed in range(50):
        got = seated.error_arcsec(conditions, joint_of({}), np.random.default_rng(seed)).reshape(8, 46)
        for run in range(8):
            rad = np.radians(conditions.angle_deg[run * 46 : (run + 1) * 46])
            fit = np.linalg.lstsq(np.column_stack([np.cos(rad), np.sin(rad)]), got[run], rcond=None)
            # Of each run alone there is nothing but order 1.
            assert np.linalg.norm(got[run] - np.column_stack([np.cos(rad), np.sin(rad)]) @ fit[0]) < 1e-9
            squares.append(float(np.sum(fit[0] ** 2)))
    # 400 exponential draws: 5 % of the mean square; three and a half of them allowed.
    assert np.mean(squares) == pytest.approx(25.0, rel=0.18)
    np.testing.assert_array_equal(seated.error_arcsec(conditions, joint_of({}), None), 0.0)


def test_thermal_nonlinearity_bends_smoothly_in_its_shapes(conditions: Conditions) -> None:
    found = shapes("thermal_nonlinearity", conditions)
    assert conditions.temperature_c is not None
    squared = (conditions.temperature_c - BASE_C) ** 2
    np.testing.assert_allclose(found[0].main[:, 0], squared * np.cos(np.radians(conditions.angle_deg)))
    assert [each.cell.order for each in found] == ["1", "2", "1"]


def test_a_wrong_temperature_is_what_the_thermal_effects_then_miss(conditions: Conditions) -> None:
    joint = joint_of(THERMAL)
    assert conditions.temperature_c is not None
    got = error_arcsec("temperature_sensor_error", {"bias_c": 1.5, "gain": 0.1}, conditions, joint)
    true_c = BASE_C + (conditions.temperature_c - BASE_C - 1.5) / 1.1
    wave = np.cos(np.radians(conditions.angle_deg - 30))
    np.testing.assert_allclose(got, 0.5 * (true_c - conditions.temperature_c) * wave, atol=1e-12)


def test_a_sensors_error_is_taken_by_recalibration_where_the_response_is_linear() -> None:
    joint = joint_of({"eccentricity": {}, **THERMAL})
    conditions = rich_conditions(joint=joint)
    columns, _ = modelled_columns(joint, conditions)
    for found in shapes("temperature_sensor_error", conditions):
        left = found.main - columns @ np.linalg.lstsq(columns, found.main, rcond=None)[0]
        assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(found.main)
    assert shapes("temperature_sensor_error", rich_conditions(joint=joint_of({}))) == []
    calibrated = joint_of(["eccentricity", "thermal_eccentricity"])
    assert len(shapes("temperature_sensor_error", rich_conditions(joint=calibrated))) == 2


def test_noise_grows_as_said_and_has_no_mean(conditions: Conditions) -> None:
    joint = joint_of({})
    growth = NoiseGrowthSettings(
        arcsec_per_k=0.1, from_temperature_c=10.0, arcsec_per_deg_s=0.02, arcsec_per_nm=0.05
    )
    assert conditions.temperature_c is not None
    assert conditions.velocity_deg_s is not None
    assert conditions.load_nm is not None
    variance = (0.1 * (conditions.temperature_c - 10.0)) ** 2
    variance += (0.02 * conditions.velocity_deg_s) ** 2 + (0.05 * conditions.load_nm) ** 2
    np.testing.assert_allclose(growth.extra_arcsec(conditions, joint) ** 2, variance, atol=1e-12)
    draws = np.array([growth.error_arcsec(conditions, joint, np.random.default_rng(k)) for k in range(200)])
    # 200 x 368 standard normals after division: standard errors of 0.0037 in the mean, 0.0026 in the scatter.
    unit = draws / np.sqrt(variance)
    assert np.mean(unit) == pytest.approx(0.0, abs=0.015)
    assert np.std(unit) == pytest.approx(1.0, abs=0.011)
    np.testing.assert_array_equal(growth.error_arcsec(conditions, joint, None), 0.0)


def test_growth_shapes_give_settings_that_grow_alike(conditions: Conditions) -> None:
    found = list(growth_hypotheses(conditions))
    assert [each.coefficients[0] for each in found] == ["arcsec_per_k", "arcsec_per_deg_s", "arcsec_per_nm"]
    for each in found:
        values = EFFECTS["noise_growth"].settings_of(each, np.array([0.2]))
        settings_ = settings_from("noise_growth", values)
        assert isinstance(settings_, NoiseGrowthSettings)
        np.testing.assert_allclose(settings_.extra_arcsec(conditions, joint_of({})), 0.2 * each.main[:, 0])
    cold = replace(conditions, temperature_c=np.full(len(conditions), 20.0), load_nm=None)
    assert [each.coefficients[0] for each in growth_hypotheses(cold)] == ["arcsec_per_deg_s"]


def test_a_coarser_lattice_is_found_and_no_lattice_where_there_is_none() -> None:
    rng = np.random.default_rng(3)
    joint = joint_of({})
    for counts in (50_000, 2**14, 7 * LINES):
        true = replace(rich_conditions(), angle_deg=rng.uniform(0, 360, 368))
        step = settings_from("quantisation", {"counts_per_rev": counts}).error_arcsec(true, joint, None)
        on_lattice = true.angle_deg + step / 3600
        np.testing.assert_allclose(on_lattice * counts / 360, np.rint(on_lattice * counts / 360), atol=1e-6)
        shown = np.rint(on_lattice * COUNTS / 360) * 360 / COUNTS
        assert coarser_counts_per_rev(replace(true, angle_deg=shown)) == counts
        (found,) = lattice_hypotheses(replace(true, angle_deg=shown))
        assert EFFECTS["quantisation"].settings_of(found, np.ones(1)) == {"counts_per_rev": counts}
        assert found.main[0, 0] == pytest.approx(1_296_000 / counts / 12**0.5)
    for seed in range(20):
        angle_deg = np.random.default_rng(seed).uniform(0, 360, 368)
        fine = np.rint(angle_deg * COUNTS / 360) * 360 / COUNTS
        assert coarser_counts_per_rev(replace(rich_conditions(), angle_deg=fine)) is None


@pytest.mark.parametrize("faces", [12, 24, 32, 36, 64])
def test_stops_of_a_polygon_are_no_lattice(faces: int) -> None:
    rng = np.random.default_rng(faces)
    stop_deg = np.tile(np.arange(faces) * 360.0 / faces, 30)
    angle_deg = stop_deg + rng.normal(0, 0.7, stop_deg.size) / 3600
    fine = np.rint(angle_deg * COUNTS / 360) * 360 / COUNTS
    zeros = np.zeros(fine.size, dtype=np.int64)
    conditions = Conditions(
        angle_deg=fine,
        run=zeros,
        zero_group=zeros,
        lines_per_rev=LINES,
        counts_per_rev=COUNTS,
        base_temperature_c=BASE_C,
        faces=faces,
    )
    assert coarser_counts_per_rev(conditions) is None


def test_the_joint_as_a_whole_is_the_sum_of_its_effects(conditions: Conditions) -> None:
    effects = {
        "eccentricity": {"amplitude_arcsec": 40, "phase_deg": 10},
        "hysteresis": {"harmonics": [{"order": 0, "amplitude_arcsec": 2, "phase_deg": 180}]},
        "noise_growth": {"arcsec_per_k": 1.0},
        "thermal_tilt": {},
    }
    joint = joint_of(effects)
    assert conditions.direction is not None
    expected = 40 * np.cos(np.radians(conditions.angle_deg - 10)) - 2 * conditions.direction
    np.testing.assert_allclose(nominal_error_arcsec(joint, conditions), expected, atol=1e-9)
    columns, names = modelled_columns(joint, conditions)
    assert columns.shape == (len(conditions), 9)
    assert names == ("eccentricity",) * 2 + ("hysteresis",) * 5 + ("thermal_tilt",) * 2


@pytest.mark.parametrize(
    ("name", "values", "complaint"),
    [
        ("windup", {"amplitude_arcsec": 3}, "expected travel_deg beside amplitude_arcsec"),
        ("index_drift", {"time_constant_s": 3}, "expected amplitude_arcsec beside time_constant_s"),
        ("thermal_lag", {"harmonics": []}, "expected time_constant_s beside harmonics"),
        ("self_heating", {"harmonics": []}, "expected time_constant_s beside harmonics"),
        ("hysteresis", {"orders": [2, 1]}, "0 <= first <= last"),
        (
            "hysteresis",
            {"orders": [0, 0], "harmonics": [{"order": 1, "amplitude_arcsec": 1, "phase_deg": 0}]},
            "expected orders 0 to 0, found order 1",
        ),
        ("localized_defect", {"defects": [{"centre_deg": 0, "fwhm_deg": 20, "amplitude_arcsec": 1}]}, "1 to 15"),
        (
            "run_to_run_eccentricity",
            {"amplitude_arcsec": 1, "runs": [{"run": 1, "amplitude_arcsec": 1, "phase_deg": 0}] * 2},
            "each run once",
        ),
        ("count_loss", {"events": [{"run": 1, "reading": 1, "step_arcsec": 1}]}, "at least 2|2 to"),
    ],
)
def test_settings_that_contradict_themselves_are_named(name: str, values: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ContractError, match=complaint):
        settings_from(name, values)
