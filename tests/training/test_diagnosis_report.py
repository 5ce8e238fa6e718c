"""report.json, design.json and the page: fixed keys, the rule of the verdict, no text of a file taken as HTML."""

import datetime
import json
from dataclasses import replace
from html.parser import HTMLParser

import jsonschema
import pytest
from tests.training.made_findings import (
    ALL,
    CLASS_OF_THREE,
    DATA_FAULT,
    GAP,
    HOSTILE,
    HYSTERESIS,
    INSUFFICIENT,
    NAMED,
    NONE,
    PLACES,
    SIGHT,
    UNKNOWN,
    made_curves,
)

from trueangle.contract.joint import EFFECT_NAMES
from trueangle_training.diagnosis import wording
from trueangle_training.diagnosis.findings import (
    Conclusion,
    DataFault,
    EndTask,
    Findings,
    Gap,
    Unexplained,
    conclusion_of,
)
from trueangle_training.diagnosis.findings_json import (
    DESIGN_SCHEMA,
    REPORT_SCHEMA,
    design_json,
    report_json,
    schema,
)
from trueangle_training.diagnosis.report_page import PageInputs, pictures, report_page, split_bar
from trueangle_training.diagnosis.report_plots import heat_map
from trueangle_training.effects import EFFECTS

MADE_ON = datetime.date(2025, 6, 1)


def made_page(findings: Findings, *, with_curves: bool = True) -> str:
    curves = made_curves() if with_curves else None
    inputs = PageInputs(findings=findings, sight=SIGHT, curves=curves, library=EFFECTS, made_on=MADE_ON)
    return report_page(inputs, pictures(inputs))


class Seen(HTMLParser):
    """Tags and addresses of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]


@pytest.mark.parametrize("findings", ALL, ids=lambda each: each.conclusion.value)
def test_every_verdict_is_written_as_the_shipped_schema_has_it(findings: Findings) -> None:
    document = json.loads(report_json(findings))
    jsonschema.validate(document, schema(REPORT_SCHEMA))
    assert document["verdict"] == findings.conclusion.value


def test_the_keys_that_outside_tools_rely_on_are_there() -> None:
    document = json.loads(report_json(NAMED))
    assert {
        "schema_version",
        "verdict",
        "unexplained",
        "data_faults",
        "causes",
        "where",
        "gap",
        "end_task",
        "invisible",
        "not_testable",
        "next_measurement",
    } <= document.keys()
    cause = document["causes"][1]
    assert cause["class"] == ["graduation_error", "subdivision_error", "reference_artefact"]
    assert {"effect", "probability", "class_probability", "kind", "parameters", "closes"} <= cause.keys()
    assert document["causes"][0]["parameters"] == {
        "amplitude_arcsec": {"value": -2.31, "standard_uncertainty": 0.12}
    }
    assert document["where"][0]["cell"] == {
        "order": "1",
        "temperature": "constant",
        "direction": "odd",
        "time": "constant",
        "speed": "constant",
        "load": "constant",
        "frame": "encoder",
        "moment": "mean",
    }
    assert document["gap"]["closure_interval"] == [0.88, 0.96]
    assert document["not_testable"] == ["load_deflection"]


def test_what_is_not_known_is_null_never_a_number_that_is_none() -> None:
    broken = replace(NAMED, gap=replace(GAP, closure=float("nan"), ceiling=float("inf")))
    document = json.loads(report_json(broken))
    assert document["gap"]["closure"] is None
    assert document["gap"]["ceiling"] is None


def test_the_design_is_written_as_its_schema_has_it() -> None:
    document = json.loads(design_json(SIGHT))
    jsonschema.validate(document, schema(DESIGN_SCHEMA))
    by_name = {each["effect"]: each for each in document["effects"]}
    assert by_name["hysteresis"]["carried_by"] == {"windup": 0.97}
    assert by_name["load_deflection"]["visible_fraction"] is None
    assert document["testable"] == ["hysteresis"]


def test_the_schemas_know_every_effect_and_refuse_another_name() -> None:
    for name in (REPORT_SCHEMA, DESIGN_SCHEMA):
        assert schema(name)["$defs"]["effect"]["enum"] == list(EFFECT_NAMES)
        jsonschema.Draft202012Validator.check_schema(schema(name))
    document = json.loads(report_json(NAMED))
    document["causes"][0]["effect"] = "gremlins"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, schema(REPORT_SCHEMA))


FAULT = DataFault(kind="outliers", rows=(3,), text="one")
UNSURE = replace(HYSTERESIS, probability=0.5, class_probability=0.8)


@pytest.mark.parametrize(
    ("faults", "testable", "causes", "significant", "expected"),
    [
        ([FAULT], True, [HYSTERESIS], True, Conclusion.DATA_FAULT),
        ([FAULT], False, [], False, Conclusion.DATA_FAULT),
        ([], False, [HYSTERESIS], True, Conclusion.INSUFFICIENT),
        ([], True, [HYSTERESIS], False, Conclusion.NAMED),
        ([], True, [UNSURE, HYSTERESIS], True, Conclusion.NAMED),
        ([], True, [CLASS_OF_THREE], False, Conclusion.NAMED),
        ([], True, [UNSURE], False, Conclusion.UNKNOWN),
        ([], True, [], True, Conclusion.UNKNOWN),
        ([], True, [], False, Conclusion.NONE),
    ],
)
def test_a_fault_of_the_file_comes_before_all_else_and_a_name_only_where_it_is_likely(
    faults: list[DataFault], testable: bool, causes: list[object], significant: bool, expected: Conclusion
) -> None:
    found = conclusion_of(
        data_faults=faults,
        testable=testable,
        causes=causes,  # pyright: ignore[reportArgumentType]
        unexplained=Unexplained(significant=significant),
    )
    assert found is expected


@pytest.mark.parametrize("findings", ALL, ids=lambda each: each.conclusion.value)
def test_the_page_needs_nothing_beside_itself_and_takes_no_text_of_a_file_as_html(findings: Findings) -> None:
    page = made_page(findings, with_curves=findings not in (DATA_FAULT, INSUFFICIENT))
    seen = Seen(page)
    assert "script" not in seen.tags
    assert HOSTILE not in page
    assert all(address.startswith("data:image/svg+xml;base64,") for address in seen.addresses)
    assert "http" not in page.replace("http-equiv", "")
    assert wording.verdict_sentence(findings) in page.replace("&#39;", "'").replace("\N{NO-BREAK SPACE}", " ")


def test_the_page_shows_causes_proof_and_what_cannot_be_seen() -> None:
    page = made_page(NAMED)
    assert EFFECTS["hysteresis"].proof in page.replace("&#39;", "'").replace("&gt;", ">").replace("&lt;", "<")
    for text in (
        "98\N{NO-BREAK SPACE}%",
        "read latency".capitalize(),
        "the campaign lacks load_nm",
        "cannot be compensated",
    ):
        assert text in page
    assert "Waterfall" not in made_page(NONE)
    assert "Lines 2, 3" in made_page(DATA_FAULT, with_curves=False)
    assert "90 in all" in made_page(DATA_FAULT, with_curves=False)


def test_the_same_findings_give_the_same_bytes() -> None:
    assert made_page(NAMED) == made_page(NAMED)
    assert report_json(NAMED) == report_json(NAMED)


def test_the_split_bar_is_as_wide_as_its_parts() -> None:
    bars = split_bar(NAMED)
    assert [bar.kind for bar in bars] == ["parametric", "structural", "floor"]
    assert sum(bar.width_percent for bar in bars) == pytest.approx(100.0, abs=0.02)
    assert bars[0].width_percent == pytest.approx(62.0, abs=0.1)
    assert split_bar(INSUFFICIENT) == ()


def test_a_share_too_small_to_be_seen_still_has_its_place_in_the_bar() -> None:
    tiny = replace(GAP, parametric_share=0.9999, structural_share=0.0001, floor_share=0.0)
    bars = split_bar(replace(NAMED, gap=tiny))
    assert bars[1].width_percent > 1.0
    assert bars[2].width_percent == 0.0
    assert bars[1].text == "less than 1 %"


def test_the_map_is_drawn_where_there_are_cells() -> None:
    assert heat_map(()) is None
    drawn = heat_map(PLACES)
    assert drawn is not None
    assert drawn.startswith(b"<?xml")


def test_the_sentence_says_class_and_not_one_member_where_the_plan_cannot_tell_them_apart() -> None:
    sentence = wording.verdict_sentence(NAMED)
    assert "hysteresis (probability 99 %)" in sentence
    assert "one of graduation error, subdivision error or reference artefact" in sentence
    assert "closes 93 %" in sentence.replace("close 93", "closes 93")
    assert "thermal graduation" in wording.verdict_sentence(UNKNOWN)
    assert "re-calibrating its parameters closes 62 %" in wording.verdict_sentence(NONE)
    assert "direction swapped" in wording.verdict_sentence(DATA_FAULT)


def test_the_terminal_hears_verdict_split_cause_and_what_to_measure_next() -> None:
    lines = wording.summary_lines(NAMED)
    names = [line.split("  ")[0] for line in lines]
    assert names[0] == "verdict"
    assert {"split", "cause", "where", "compensation", "not visible", "measure next"} <= set(names)
    assert all("\n" not in line for line in lines)


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.0, "0 %"),
        (0.004, "less than 1 %"),
        (-0.001, "0 %"),
        (0.5, "50 %"),
        (0.996, "more than 99 %"),
        (1.0, "100 %"),
        (-0.2, "\N{MINUS SIGN}20 %"),
    ],
)
def test_a_share_is_never_rounded_to_certainty(share: float, words: str) -> None:
    assert wording.percent(share) == words


def test_the_gap_left_of_the_end_task_is_that_of_squares() -> None:
    task = EndTask(
        method="linear",
        compensable=True,
        none_arcsec=9.0,
        simulator_arcsec=5.0,
        explained_arcsec=4.0,
        oracle_arcsec=3.0,
    )
    assert task.gap_left == pytest.approx((16 - 9) / (25 - 9))
    assert replace(task, simulator_arcsec=2.0).gap_left is None
    assert Gap().closure is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("amplitude_arcsec", "Amplitude"),
        ("amplitude_arcsec_per_k", "Amplitude"),
        ("phase_deg", "Phase"),
        ("time_constant_s", "Time constant"),
        ("order_3_cos_arcsec", "Order 3 cos"),
        ("step_arcsec_2", "Step (2)"),
        ("kept_in_later_runs_3", "Kept in later runs (3)"),
    ],
)
def test_a_parameter_is_told_in_words_with_its_unit_at_the_value(name: str, words: str) -> None:
    assert wording.parameter_words(name) == words
