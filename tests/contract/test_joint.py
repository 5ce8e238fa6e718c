"""JOINT.yaml and PLAN.yaml in the forms that outside tools write."""

import pytest
import yaml

from trueangle.contract.document import Node, document_from_plain, read_document
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import (
    Joint,
    Plan,
    PlanZero,
    SegmentKind,
    joint_from_document,
    joint_to_plain,
    plan_from_document,
    plan_to_plain,
)

MINIMUM = """
schema_version: 1
encoder: {lines_per_rev: 16384, counts_per_rev: 3276800}
reference: {kind: polygon, faces: 23}
effects: [eccentricity, grating_tilt, graduation_error, thermal_eccentricity]
"""
PLAN = """
{schema_version: 1, faces: 23, temperatures_c: [10, 15, 20, 25, 30, 35, 40], repeats: 3, directions: [1],
 shift_faces: 0, soak_h: 4}
"""


def document(text: str) -> Node:
    return read_document(text, source="j.yaml", loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)


def joint(text: str) -> Joint:
    return joint_from_document(document(text))


def test_the_minimum_joint_is_read() -> None:
    got = joint(MINIMUM)
    assert list(got.effects) == ["eccentricity", "grating_tilt", "graduation_error", "thermal_eccentricity"]
    assert got.encoder.counts_per_rev == 3_276_800
    assert got.base_temperature_c == 20.0


def test_effects_may_be_a_mapping_with_settings() -> None:
    text = MINIMUM.split("effects")[0] + "effects: {graduation_error: {orders: [3, 11]}, eccentricity: }\n"
    assert joint(text).effects["graduation_error"].plain() == {"orders": [3, 11]}


def test_a_joint_survives_writing_and_reading() -> None:
    first = joint_to_plain(joint(MINIMUM))
    assert joint_to_plain(joint_from_document(document_from_plain(first, source="back"))) == first
    assert joint_to_plain(joint(yaml.safe_dump(first))) == first


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("eccentricity,", "excentricity,"), "expected an effect of the library, found excentricity"),
        (("[eccentricity", "[3, eccentricity"), "expected an effect's name, found 3"),
        ((", faces: 23", ""), "expected faces beside kind polygon"),
        (("kind: polygon", "kind: laser"), "expected one of polygon, encoder, found the text 'laser'"),
        (
            ("schema_version: 1", "schema_version: 2"),
            "schema_version: expected a whole number, exactly 1, found 2",
        ),
        (("3276800", "100"), "counts_per_rev: expected at least lines_per_rev (16384), found 100"),
        (("3276800}", "3276800, settings: {units_per_revolution: 4}}"), "equal to counts_per_rev"),
        (("reference:", "referense:"), "did you mean reference?"),
    ],
)
def test_a_contradictory_joint_is_refused_with_its_place(change: tuple[str, str], found: str) -> None:
    with pytest.raises(ContractError) as caught:
        joint(MINIMUM.replace(*change))
    assert found in str(caught.value)
    assert "j.yaml line" in str(caught.value)


def test_the_plan_of_the_paper_is_read_and_written() -> None:
    plan = plan_from_document(document(PLAN))
    assert plan.faces == 23
    assert plan.temperatures_c == (10, 15, 20, 25, 30, 35, 40)
    assert plan_from_document(document_from_plain(plan_to_plain(plan), source="back")) == plan


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("[1]", "[0]"), "directions: expected 1, -1 or both, each once"),
        (("[10, 15, 20, 25, 30, 35, 40]", "[]"), "expected at least one temperature"),
        (("faces: 23", "faces: 2"), "faces: expected a whole number, 3 to 1000, found 2"),
    ],
)
def test_an_impossible_plan_is_refused(change: tuple[str, str], found: str) -> None:
    with pytest.raises(ContractError, match="line") as caught:
        plan_from_document(document(PLAN.replace(*change)))
    assert found in str(caught.value)


def test_a_plan_needs_its_keys() -> None:
    with pytest.raises(ContractError, match="expected the key repeats"):
        plan_from_document(document("{schema_version: 1, faces: 23, temperatures_c: [20]}"))
    assert Plan(schema_version=1, faces=23, temperatures_c=(20.0,), repeats=1).directions == (1,)


def test_a_plan_may_keep_one_zero_and_survives_writing_and_reading() -> None:
    assert plan_from_document(document(PLAN)).zero is PlanZero.PER_RUN
    kept = plan_from_document(document(PLAN.replace("soak_h: 4", "soak_h: 4, zero: one")))
    assert kept.zero is PlanZero.ONE
    assert plan_from_document(document_from_plain(plan_to_plain(kept), source="back")) == kept


def test_one_zero_and_a_turned_polygon_exclude_each_other() -> None:
    text = PLAN.replace("shift_faces: 0", "shift_faces: 0.5").replace("soak_h: 4", "soak_h: 4, zero: one")
    with pytest.raises(ContractError, match=r"expected 0 beside zero: one.*found 0\.5"):
        plan_from_document(document(text))


def segmented(segments: str) -> Plan:
    return plan_from_document(document(f"{PLAN.strip()[:-1]}, segments: [{segments}]}}"))


def test_a_plan_with_segments_survives_writing_and_reading() -> None:
    plan = segmented(
        "{kind: polygon, temperatures_c: [20], polygon_offset: 5, loads_nm: [0, 20], one_run: true, zero: one},"
        "{kind: sweep, temperatures_c: [15, 35], speeds_deg_s: [10, 40], turns: 4, degrees_per_reading: 2.5}"
    )
    assert [segment.kind for segment in plan.segments] == [SegmentKind.POLYGON, SegmentKind.SWEEP]
    assert plan_from_document(document_from_plain(plan_to_plain(plan), source="back")) == plan


def test_a_plan_without_segments_is_written_without_the_key() -> None:
    assert "segments" not in plan_to_plain(plan_from_document(document(PLAN)))


def test_a_plan_may_be_segments_alone() -> None:
    text = (
        "{schema_version: 1, faces: 23, temperatures_c: [], repeats: 1,"
        " segments: [{kind: polygon, temperatures_c: [20]}]}"
    )
    assert plan_from_document(document(text)).temperatures_c == ()


@pytest.mark.parametrize(
    ("segment", "found"),
    [
        ("{kind: laser, temperatures_c: [20]}", "expected one of polygon, sweep"),
        ("{kind: polygon, temperatures_c: []}", "temperatures_c: expected at least one, found none"),
        ("{kind: polygon, temperatures_c: [20], loads_nm: []}", "loads_nm: expected at least one, found none"),
        ("{kind: polygon, temperatures_c: [20], directions: [1, 1]}", "1, -1 or both, each once"),
        ("{kind: polygon, temperatures_c: [20], turns: 1.5}", "expected whole turns of a polygon, found 1.5"),
        ("{kind: polygon, temperatures_c: [20], speeds_deg_s: [3]}", "expected none beside kind polygon"),
        ("{kind: polygon, temperatures_c: [20], from_deg: 3}", "from_deg: expected 0 beside kind polygon"),
        ("{kind: sweep, temperatures_c: [20]}", "expected both in stop and go, found neither"),
        (
            "{kind: sweep, temperatures_c: [20], degrees_per_reading: 3}",
            "expected both in stop and go, found one",
        ),
        (
            "{kind: sweep, temperatures_c: [20], speeds_deg_s: [10]}",
            "expected one of the two at a constant speed, found neither",
        ),
        (
            "{kind: sweep, temperatures_c: [9], speeds_deg_s: [9], seconds_per_reading: 1,degrees_per_reading: 2}",
            "expected one of the two at a constant speed, found both",
        ),
        (
            "{kind: sweep, temperatures_c: [20], speeds_deg_s: [0, 10], degrees_per_reading: 1}",
            "expected speeds above 0, or 0 alone for stop and go",
        ),
        (
            "{kind: sweep, temperatures_c: [20], speeds_deg_s: [9], degrees_per_reading: 1, polygon_offset: 2}",
            "polygon_offset: expected 0 beside kind sweep",
        ),
    ],
)
def test_an_impossible_segment_is_refused_with_its_line(segment: str, found: str) -> None:
    with pytest.raises(ContractError) as caught:
        segmented(segment)
    assert found in str(caught.value)
    assert "j.yaml line" in str(caught.value)


def test_an_effect_that_is_listed_twice_is_refused() -> None:
    text = MINIMUM.split("effects")[0] + "effects: [eccentricity, grating_tilt, eccentricity]\n"
    with pytest.raises(ContractError, match="expected each effect once, found eccentricity again"):
        joint(text)
