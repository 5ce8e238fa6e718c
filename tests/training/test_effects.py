"""Effects against their closed forms, and what the library says of settings that do not fit."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from trueangle.contract.document import document_from_plain, read_document
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import EFFECT_NAMES, Joint, joint_from_document
from trueangle_training.effects import EFFECTS, Effect, library, nominal_effects
from trueangle_training.effects.harmonics import HarmonicTerm, harmonic_series

ANGLES_DEG = np.array([0.0, 17.0, 90.0, 123.4, 359.99, -31.0, 800.0])


def joint_with(effects: object, *, faces: int = 23) -> Joint:
    return joint_from_document(
        document_from_plain(
            {
                "schema_version": 1,
                "encoder": {"lines_per_rev": 1000, "counts_per_rev": 100000},
                "reference": {"kind": "polygon", "faces": faces},
                "effects": effects,
            },
            source="made in code",
        )
    )


def joint_from_text(effects: str) -> Joint:
    text = f"""schema_version: 1
encoder: {{lines_per_rev: 1000, counts_per_rev: 100000}}
reference: {{kind: polygon, faces: 23}}
effects:
{effects}"""
    return joint_from_document(
        read_document(text, source="JOINT.yaml", loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)
    )


def only_effect(effects: object) -> Effect:
    (effect,) = nominal_effects(joint_with(effects))
    return effect


def cosine(order: int, phase_deg: float) -> np.ndarray:
    return np.array([math.cos(math.radians(order * angle - phase_deg)) for angle in ANGLES_DEG])


@pytest.mark.parametrize(("name", "order"), [("eccentricity", 1), ("grating_tilt", 2)])
def test_constant_effect_is_one_cosine_at_any_temperature(name: str, order: int) -> None:
    effect = only_effect({name: {"amplitude_arcsec": 72.75, "phase_deg": -64}})
    for temperature_c in (-10.0, 20.0, 40.0):
        expected = 72.75 * cosine(order, -64)
        # 1e-9 arcsec: float64 rounding of 72.75 arcsec, with room.
        np.testing.assert_allclose(effect.error_arcsec(ANGLES_DEG, temperature_c), expected, atol=1e-9)


@pytest.mark.parametrize(("name", "order"), [("thermal_eccentricity", 1), ("thermal_tilt", 2)])
def test_thermal_effect_grows_with_the_distance_from_the_base_temperature(name: str, order: int) -> None:
    effect = only_effect({name: {"amplitude_arcsec_per_k": 0.357, "phase_deg": 81}})
    for temperature_c in (10.0, 20.0, 40.0):
        expected = 0.357 * (temperature_c - 20.0) * cosine(order, 81)
        np.testing.assert_allclose(effect.error_arcsec(ANGLES_DEG, temperature_c), expected, atol=1e-9)


def test_graduation_error_sums_its_orders() -> None:
    effect = only_effect(
        {
            "graduation_error": {
                "harmonics": [
                    {"order": 3, "amplitude_arcsec": 2.5, "phase_deg": -101},
                    {"order": 11, "amplitude_arcsec": 0.5, "phase_deg": 49},
                ]
            }
        }
    )
    expected = 2.5 * cosine(3, -101) + 0.5 * cosine(11, 49)
    np.testing.assert_allclose(effect.error_arcsec(ANGLES_DEG, 33.0), expected, atol=1e-9)


def test_thermal_graduation_and_nonlinearity_follow_their_powers_of_temperature() -> None:
    linear = only_effect(
        {"thermal_graduation": {"harmonics": [{"order": 3, "amplitude_arcsec_per_k": 0.01, "phase_deg": -160}]}}
    )
    quadratic = only_effect(
        {"thermal_nonlinearity": {"harmonics": [{"order": 1, "amplitude_arcsec_per_k2": 0.002, "phase_deg": 150}]}}
    )
    for temperature_c in (10.0, 20.0, 40.0):
        from_base_k = temperature_c - 20.0
        expected = 0.01 * from_base_k * cosine(3, -160)
        np.testing.assert_allclose(linear.error_arcsec(ANGLES_DEG, temperature_c), expected, atol=1e-9)
        expected = 0.002 * from_base_k**2 * cosine(1, 150)
        np.testing.assert_allclose(quadratic.error_arcsec(ANGLES_DEG, temperature_c), expected, atol=1e-9)


@given(
    terms=st.lists(
        st.builds(
            HarmonicTerm,
            order=st.integers(1, 40),
            degree=st.integers(0, 3),
            amplitude=st.floats(0, 100),
            phase_deg=st.floats(-360, 360),
        ),
        max_size=8,
    ),
    angle_deg=st.floats(-720, 720),
    temperature_c=st.floats(0, 40),
)
def test_series_is_the_sum_of_its_terms_in_both_its_forms(
    terms: list[HarmonicTerm], angle_deg: float, temperature_c: float
) -> None:
    series = harmonic_series(terms, base_temperature_c=20.0)
    expected = sum(
        term.amplitude
        * (temperature_c - 20.0) ** term.degree
        * math.cos(math.radians(term.order * angle_deg - term.phase_deg))
        for term in terms
    )
    # 8 terms of up to 100 x 20^3 arcsec, phases up to 40 x 720 deg: rounding of some 1e-12 of the sum's scale.
    scale = 1.0 + sum(term.amplitude * 20.0**term.degree for term in terms)
    assert series.error_at_arcsec(angle_deg, temperature_c) == pytest.approx(expected, abs=1e-11 * scale)
    in_arrays = series.error_arcsec(np.array([angle_deg]), np.array([temperature_c]))
    assert in_arrays[0] == pytest.approx(expected, abs=1e-11 * scale)


def test_error_broadcasts_angles_against_temperatures() -> None:
    effect = only_effect({"thermal_tilt": {"amplitude_arcsec_per_k": 1.0, "phase_deg": 0}})
    grid = effect.error_arcsec(ANGLES_DEG[None, :], np.array([[10.0], [20.0], [40.0]]))
    assert grid.shape == (3, ANGLES_DEG.size)
    np.testing.assert_allclose(grid[1], 0.0, atol=1e-12)


def test_every_name_of_the_contract_has_one_file_and_one_entry() -> None:
    files = {Path(path).stem for path in Path(library.__path__[0]).glob("*.py")} - {"__init__"}
    assert files == set(EFFECT_NAMES)
    assert tuple(EFFECTS) == EFFECT_NAMES
    assert all(entry.name == name for name, entry in EFFECTS.items())


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_effect_without_nominal_parameters_is_refused(name: str) -> None:
    with pytest.raises(ContractError, match="expected nominal parameters"):
        nominal_effects(joint_with([name]))


@pytest.mark.parametrize(
    ("effects", "complaint"),
    [
        ({"eccentricity": {"amplitude_arcsec": 5}}, "expected phase_deg beside amplitude_arcsec"),
        ({"eccentricity": {"amplitude_arcsec": -5, "phase_deg": 0}}, "0 to 36000"),
        ({"eccentricity": {"amplitude": 5, "phase_deg": 0}}, "unknown key amplitude"),
        ({"graduation_error": {"orders": [5, 3]}}, "3 <= first <= last"),
        ({"graduation_error": {"orders": [2, 4]}}, "3 <= first <= last"),
        (
            {"graduation_error": {"harmonics": [{"order": 12, "amplitude_arcsec": 1, "phase_deg": 0}]}},
            "expected orders 3 to 11, found order 12",
        ),
        (
            {"graduation_error": {"harmonics": [{"order": 2, "amplitude_arcsec": 1, "phase_deg": 0}]}},
            "3 to 1000",
        ),
        (
            {"graduation_error": {"harmonics": [{"order": 3, "amplitude_arcsec": 1, "phase_deg": 0}] * 2}},
            "order 3 2 times",
        ),
        ({"thermal_tilt": {"amplitude_arcsec_per_k": 1, "phase_deg": 0, "degree": 2}}, "thermal_nonlinearity"),
        (
            {"thermal_nonlinearity": {"harmonics": [{"order": 0, "amplitude_arcsec_per_k2": 1, "phase_deg": 0}]}},
            "1 to 1000",
        ),
    ],
)
def test_settings_that_do_not_fit_are_named(effects: dict[str, object], complaint: str) -> None:
    with pytest.raises(ContractError, match=complaint):
        nominal_effects(joint_with(effects))


def test_fewer_faces_lower_the_default_last_order() -> None:
    settings = {"graduation_error": {"harmonics": [{"order": 6, "amplitude_arcsec": 1, "phase_deg": 0}]}}
    assert nominal_effects(joint_with(settings, faces=13))
    with pytest.raises(ContractError, match="expected orders 3 to 5, found order 6"):
        nominal_effects(joint_with(settings, faces=12))


def test_faults_of_all_effects_come_at_once_with_their_lines() -> None:
    joint = joint_from_text("  eccentricity: {amplitude_arcsec: 5}\n  hysteresis: {}\n  thermal_tilt: {}\n")
    with pytest.raises(ContractError) as caught:
        nominal_effects(joint)
    wheres = [fault.where.split(",")[0] for fault in caught.value.faults]
    assert wheres == ["JOINT.yaml line 5", "JOINT.yaml line 6", "JOINT.yaml line 7"]
