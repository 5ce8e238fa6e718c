"""The joint with what was found: its settings give the fitted curve, its file keeps what the user wrote."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from trueangle.contract.document import document_from_plain, structure
from trueangle.contract.joint import Joint, effect_settings, joint_from_document
from trueangle_training.diagnosis.joint_update import (
    FoundShape,
    growth_settings,
    joint_update,
    merged,
    updated_joint,
)
from trueangle_training.diagnosis.scatter import Growth
from trueangle_training.documents import joint_text_with_effects
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.conditions import Conditions

FACES = 23
CAMPAIGN_ARCSEC = 1e-3
"""Settings are written with seven digits: of 40 arcsec that is 4e-6."""


def made_joint(effects: object) -> Joint:
    plain = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": 16384, "counts_per_rev": 3276800},
        "reference": {"kind": "polygon", "faces": FACES},
        "effects": effects,
    }
    return joint_from_document(document_from_plain(plain, source="made"))


def made_conditions() -> Conditions:
    """Seven temperatures, both directions, two speeds and loads, in turn."""
    runs = 28
    run = np.repeat(np.arange(1, runs + 1), FACES)
    rng = np.random.default_rng(3)
    direction = np.where(run % 2 == 0, 1.0, -1.0)
    step = np.tile(np.arange(FACES), runs)
    angle_deg = np.where(direction > 0, step, FACES - 1 - step) * 360.0 / FACES + (run % 3) * 5.0
    return Conditions(
        angle_deg=angle_deg,
        run=run,
        zero_group=run,
        lines_per_rev=16384,
        counts_per_rev=3276800,
        base_temperature_c=20.0,
        temperature_c=10.0 + 5.0 * ((run - 1) // 4) + rng.uniform(-0.1, 0.1, run.size),
        time_s=3600.0 * run + 15.0 * step,
        direction=direction,
        velocity_deg_s=direction * np.where(run % 3 == 0, 5.0, 1.0),
        load_nm=np.where(run % 4 < 2, 0.0, 10.0) + 0.1 * step.astype(np.float64),
        face=step + 1,
        polygon_offset=run % 3,
        faces=FACES,
    )


def curve_of(joint: Joint, conditions: Conditions) -> np.ndarray:
    """The error that the joint's effects give, the mean of each zero group taken off."""
    total = np.zeros(len(conditions))
    for name, node in joint.effects.items():
        total += structure(EFFECTS[name].settings, node).error_arcsec(conditions, joint, None)
    _, group = np.unique(conditions.zero_group, return_inverse=True)
    return total - (np.bincount(group, weights=total) / np.bincount(group))[group]


def centred(values: np.ndarray, conditions: Conditions) -> np.ndarray:
    _, group = np.unique(conditions.zero_group, return_inverse=True)
    return values - (np.bincount(group, weights=values) / np.bincount(group))[group]


HARMONIC = {
    "eccentricity": {},
    "grating_tilt": {},
    "graduation_error": {},
    "thermal_eccentricity": {},
    "thermal_tilt": {},
    "thermal_graduation": {"orders": [3, 5]},
    "thermal_nonlinearity": {},
    "hysteresis": {},
}


@pytest.mark.parametrize("name", HARMONIC)
def test_a_re_calibrated_effect_gives_the_curve_of_the_fit(name: str) -> None:
    joint, conditions = made_joint({name: HARMONIC[name]}), made_conditions()
    columns = structure(EFFECTS[name].settings, joint.effects[name]).columns(conditions, joint)
    coefficients = np.random.default_rng(1).normal(0.0, 2.0, columns.shape[1])
    update = joint_update(joint, conditions, EFFECTS, modelled={name: coefficients}, found=[])
    assert update.notes == ()
    assert set(update.comments.values()) == {"re-calibrated"}
    expected = centred(columns @ coefficients, conditions)
    assert curve_of(updated_joint(joint, update), conditions) == pytest.approx(expected, abs=CAMPAIGN_ARCSEC)


def test_a_drift_of_degree_two_is_written_under_two_effects() -> None:
    joint, conditions = made_joint({"thermal_eccentricity": {"degree": 2}}), made_conditions()
    columns = structure(EFFECTS["thermal_eccentricity"].settings, joint.effects["thermal_eccentricity"]).columns(
        conditions, joint
    )
    coefficients = np.array([0.3, -0.1, 0.01, 0.004])
    update = joint_update(joint, conditions, EFFECTS, modelled={"thermal_eccentricity": coefficients}, found=[])
    assert set(update.effects) == {"thermal_eccentricity", "thermal_nonlinearity"}
    expected = centred(columns @ coefficients, conditions)
    assert curve_of(updated_joint(joint, update), conditions) == pytest.approx(expected, abs=CAMPAIGN_ARCSEC)


def test_what_was_found_is_added_beside_what_was_modelled() -> None:
    joint, conditions = made_joint({"graduation_error": {}}), made_conditions()
    shape = next(each for each in EFFECTS["graduation_error"].hypotheses(conditions) if each.cell.order == "13")
    found = FoundShape(hypothesis=shape, coefficients=np.array([0.8, -0.6] + [0.0] * (shape.main.shape[1] - 2)))
    columns = structure(EFFECTS["graduation_error"].settings, joint.effects["graduation_error"]).columns(
        conditions, joint
    )
    coefficients = np.ones(columns.shape[1])
    update = joint_update(joint, conditions, EFFECTS, modelled={"graduation_error": coefficients}, found=[found])
    settings = update.effects["graduation_error"]
    assert settings["orders"] == [3, 13]
    assert [each["order"] for each in settings["harmonics"]] == [*range(3, 12), 13]
    expected = centred(columns @ coefficients + shape.main @ found.coefficients, conditions)
    assert curve_of(updated_joint(joint, update), conditions) == pytest.approx(expected, abs=CAMPAIGN_ARCSEC)
    assert "found" in update.comments["graduation_error"]


def test_every_shape_of_an_effect_of_the_mean_can_be_added_and_gives_its_curve() -> None:
    conditions, joint = made_conditions(), made_joint({})
    for name, effect in EFFECTS.items():
        shapes = list(effect.hypotheses(conditions))
        if effect.nature.value != "mean" or not shapes:
            continue
        shape = shapes[len(shapes) // 2]
        coefficients = np.full(shape.main.shape[1], 0.7)
        update = joint_update(
            joint,
            conditions,
            EFFECTS,
            modelled={},
            found=[FoundShape(hypothesis=shape, coefficients=coefficients)],
        )
        made = curve_of(updated_joint(joint, update), conditions)
        expected = centred(shape.main @ coefficients, conditions)
        assert made == pytest.approx(expected, abs=1e-3 + 1e-4 * float(np.abs(expected).max())), name


def test_an_effect_without_a_fit_keeps_its_settings() -> None:
    settings = {"arcsec_per_k": 0.01}
    joint = made_joint({"noise_growth": settings})
    update = joint_update(joint, made_conditions(), EFFECTS, modelled={}, found=[])
    assert update.effects == {"noise_growth": settings}
    assert update.comments == {}


def test_two_parts_of_one_effect_become_one() -> None:
    one = {"orders": [3, 3], "harmonics": [{"order": 3, "amplitude_arcsec": 1.0, "phase_deg": 0.0}]}
    other = {"orders": [7, 7], "harmonics": [{"order": 7, "amplitude_arcsec": 2.0, "phase_deg": 9.0}]}
    both = merged(other, one)
    assert both["orders"] == [3, 7]
    assert [each["order"] for each in both["harmonics"]] == [3, 7]
    newer = {"harmonics": [{"order": 3, "amplitude_arcsec": 5.0, "phase_deg": 1.0}]}
    assert merged(one, newer)["harmonics"] == newer["harmonics"]
    assert merged(None, one) == one
    assert structure(EFFECTS["graduation_error"].settings, effect_settings(both, name="graduation_error"))


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        (
            "subdivision_error",
            {"harmonics": [{"per_line": 1, "amplitude_arcsec": 1.0, "phase_deg": 0.0}]},
            {"harmonics": [{"per_line": 2, "amplitude_arcsec": 2.0, "phase_deg": 9.0}]},
        ),
        (
            "bearing_wobble",
            {"wobbles": [{"per_turn": 0.43, "amplitude_arcsec": 1.0, "phase_deg": 0.0}]},
            {"wobbles": [{"per_turn": 0.61, "amplitude_arcsec": 2.0, "phase_deg": 9.0}]},
        ),
        (
            "localized_defect",
            {"defects": [{"centre_deg": 10.0, "fwhm_deg": 5.0, "amplitude_arcsec": 1.0}]},
            {"defects": [{"centre_deg": 90.0, "fwhm_deg": 5.0, "amplitude_arcsec": 2.0}]},
        ),
        (
            "count_loss",
            {"events": [{"run": 3, "reading": 5, "step_arcsec": 4.0}]},
            {"events": [{"run": 3, "reading": 9, "step_arcsec": 2.0}]},
        ),
    ],
)
def test_lists_that_know_no_order_are_joined_too(name: str, old: dict, new: dict) -> None:
    (key,) = old
    both = merged(old, new)
    assert both[key] == [*old[key], *new[key]]
    assert structure(EFFECTS[name].settings, effect_settings(both, name=name))
    if name in {"subdivision_error", "bearing_wobble"}:
        newer = {key: [{**old[key][0], "amplitude_arcsec": 7.0}]}
        assert merged(old, newer) == newer


def test_curves_inside_a_line_are_taken_over_with_their_bends() -> None:
    conditions, joint = made_conditions(), made_joint({})
    shape = next(iter(EFFECTS["subdivision_error"].hypotheses(conditions)))
    coefficients = np.full(shape.main.shape[1], 0.7)
    curve = shape.main @ coefficients
    part = FoundShape(hypothesis=shape, coefficients=coefficients, curve_arcsec=curve)
    update = joint_update(joint, conditions, EFFECTS, modelled={}, found=[part])
    made = curve_of(updated_joint(joint, update), conditions)
    assert made == pytest.approx(centred(curve, conditions), abs=CAMPAIGN_ARCSEC)


@pytest.mark.parametrize(
    ("condition", "steady_arcsec", "key", "per_unit"),
    [
        ("temperature_c", 0.6, "arcsec_per_k", 0.08),
        ("speed_deg_s", 0.5, "arcsec_per_deg_s", 0.3),
        ("load_nm", 0.5, "arcsec_per_nm", 0.1),
    ],
)
def test_growing_scatter_is_written_with_the_size_that_it_has(
    condition: str, steady_arcsec: float, key: str, per_unit: float
) -> None:
    """Ratio and mean variance of a scatter made with the effect's own formula give its settings back."""
    conditions = made_conditions()
    assert conditions.velocity_deg_s is not None
    assert conditions.load_nm is not None
    assert conditions.temperature_c is not None
    lowest_c = float(conditions.temperature_c.min())
    values = {
        "temperature_c": conditions.temperature_c - lowest_c,
        "speed_deg_s": np.abs(conditions.velocity_deg_s),
        "load_nm": np.abs(conditions.load_nm),
    }[condition]
    variance = steady_arcsec**2 + (per_unit * values) ** 2
    ratio = float(np.sqrt(variance[np.argmax(values)] / variance[np.argmin(values)]))
    growth = Growth(condition=condition, ratio=ratio, p_value=0.0002, log_slope=0.1)
    made = growth_settings(growth, conditions, scatter_arcsec=float(np.sqrt(variance.mean())))
    expected = {key: per_unit}
    if condition == "temperature_c":
        expected["from_temperature_c"] = lowest_c
    assert made == pytest.approx(expected, rel=1e-9)


TEXT = """\
# the elbow, as delivered
schema_version: 1
encoder: {lines_per_rev: 16384, counts_per_rev: 3276800}   # 0.4 arcsec a count
effects: [eccentricity]
# the bench
noise: {repeatability_arcsec: 0.6}
reference: {kind: polygon, faces: 23}
"""
EFFECTS_WRITTEN = {"eccentricity": {"amplitude_arcsec": 4.0, "phase_deg": 1.0}, "hysteresis": {}}


def written(text: str) -> str:
    return joint_text_with_effects(
        text,
        source="joint.yaml",
        effects=EFFECTS_WRITTEN,
        comments={"hysteresis": "found"},
        heading="by trueangle diagnose\nfrom campaign.csv",
    )


def test_the_user_s_other_lines_and_comments_stay() -> None:
    text = written(TEXT)
    lines = text.splitlines()
    for line in TEXT.splitlines():
        assert (line in lines) is (not line.startswith("effects"))
    assert "# by trueangle diagnose" in lines
    assert "  # found" in lines
    assert yaml.safe_load(text)["effects"] == EFFECTS_WRITTEN


@pytest.mark.parametrize(
    "text",
    [
        "{schema_version: 1, effects: [eccentricity], name: elbow}\n",
        "schema_version: 1\nname: elbow\neffects:\n  eccentricity:\n    amplitude_arcsec: 1\n    phase_deg: 2\n",
        "schema_version: 1\neffects:\n- eccentricity\nname: elbow",
        "schema_version: 1\r\neffects: [eccentricity]\r\nname: elbow\r\n",
    ],
    ids=["in braces", "effects last", "no newline at the end", "DOS line ends"],
)
def test_every_form_of_yaml_keeps_its_other_keys(text: str) -> None:
    assert yaml.safe_load(written(text)) == {**yaml.safe_load(text), "effects": EFFECTS_WRITTEN}


def test_a_joint_without_any_effect_is_written() -> None:
    text = joint_text_with_effects(TEXT, source="joint.yaml", effects={}, comments={}, heading="nothing")
    assert yaml.safe_load(text)["effects"] == {}


def test_a_face_that_the_campaign_did_not_use_is_written_as_zero() -> None:
    conditions = made_conditions()
    kept = np.flatnonzero(np.asarray(conditions.face) <= FACES - 2)
    few = conditions.rows(kept)
    few = replace(few, faces=None)
    update = joint_update(
        made_joint({"reference_artefact": {}}),
        few,
        EFFECTS,
        modelled={"reference_artefact": np.linspace(-0.5, 0.5, FACES - 2)},
        found=[],
    )
    assert len(update.effects["reference_artefact"]["faces_arcsec"]) == FACES
    assert update.effects["reference_artefact"]["faces_arcsec"][-2:] == [0.0, 0.0]
