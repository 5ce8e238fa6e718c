"""What findings say in plain words: no number above a threshold that it missed, no claim beyond the plan."""

from dataclasses import replace

import pytest
from tests.training.made_findings import (
    DATA_FAULT,
    HYSTERESIS,
    INSUFFICIENT,
    NAMED,
    NONE,
    PLACES,
    SUBJECT,
    UNKNOWN,
)
from tests.training.test_diagnosis_report import made_page

from trueangle_training.diagnosis import wording
from trueangle_training.diagnosis.findings import EndTask, Estimate, Findings
from trueangle_training.effects.effect import Nature


def line(findings: Findings, name: str) -> str:
    found = [each for each in wording.summary_lines(findings) if each.startswith(name)]
    assert found, name
    return "\n".join(found)


@pytest.mark.parametrize(
    ("probability", "words"), [(0.897, "89.7 %"), (0.8999, "89.9 %"), (0.9, "90 %"), (0.889, "89 %")]
)
def test_a_probability_below_the_threshold_of_a_name_is_not_rounded_up_to_it(
    probability: float, words: str
) -> None:
    assert wording.percent(probability) == words
    cause = replace(HYSTERESIS, probability=probability, class_probability=probability)
    assert f"probability {words}" in line(replace(UNKNOWN, causes=(cause,)), "cause")


def test_nothing_missing_is_said_of_what_the_plan_can_show_only() -> None:
    assert "No effect that this plan can show is missing" in wording.verdict_sentence(NONE)
    sees_all = replace(NONE, invisible=("eccentricity",), not_testable={})
    assert "No effect is missing from" in wording.verdict_sentence(sees_all), "a modelled effect is calibrated"


def test_a_place_that_stands_out_although_nothing_was_found_is_explained() -> None:
    findings = replace(NONE, where=PLACES)
    assert "does not bear it out" in line(findings, "where")
    assert "does not bear it out" in made_page(findings)
    assert not [each for each in wording.summary_lines(NONE) if each.startswith("where")]


def test_another_place_that_the_plan_does_not_rule_out_is_told() -> None:
    other = replace(PLACES[2], could_carry=0.6)
    findings = replace(NAMED, where=(PLACES[0], other, *PLACES[1:2]))
    words = "which this plan does not rule out: twice a turn, temperature"
    assert any(words in each for each in wording.summary_lines(findings))
    assert words in " ".join(made_page(findings).split())
    assert not wording.elsewhere_words(replace(NAMED, where=PLACES))
    # At nine tenths of the largest share the rest speaks against it.
    worse = replace(PLACES[2], could_carry=0.93 * PLACES[0].share)
    assert not wording.elsewhere_words(replace(NAMED, where=(PLACES[0], worse)))


def test_the_terminal_hears_the_notes() -> None:
    assert "was ignored" in line(NAMED, "note")


def test_too_few_readings_are_counted_in_the_verdict() -> None:
    one = replace(INSUFFICIENT, subject=replace(SUBJECT, readings=23, runs=1))
    assert "With 23 readings in 1 run this campaign" in wording.verdict_sentence(one)
    assert "23 readings in\n1 run." in made_page(one, with_curves=False)


def test_what_to_do_with_a_faulty_file_is_no_measurement() -> None:
    findings = replace(DATA_FAULT, next_measurement="Mend the file.")
    assert "Mend the file." in line(findings, "what to do")
    page = made_page(findings, with_curves=False)
    assert "What to do" in page
    assert "What to measure next" not in page


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ("direction", "it would need the direction"),
        ("speed, load", "it would need the speed and the load"),
        ("a reference in each set-up", "it would need a reference in each set-up"),
        ("reference", "it is the reference's own error: measure it, do not compensate it"),
        ("a mean: scatter cannot be compensated", "scatter cannot be compensated"),
        ("resolution: what was rounded away is lost", "what was rounded away is lost"),
        (
            "reference, direction",
            "it is the reference's own error: measure it, do not compensate it; it would need the direction",
        ),
    ],
)
def test_what_a_compensation_lacks_is_a_sentence(missing: str, words: str) -> None:
    task = EndTask(method="linear", compensable=False, missing_input=missing)
    assert wording.missing_words(task) == words


def test_what_cannot_be_compensated_beside_what_can_is_named_with_what_it_would_need() -> None:
    task = EndTask(
        method="linear",
        compensable=True,
        missing_input="direction",
        not_compensable={"hysteresis": "direction"},
        none_arcsec=9.0,
        explained_arcsec=1.0,
    )
    findings = replace(NAMED, end_task=task)
    assert "in part" in line(findings, "compensation")
    assert "hysteresis stays in the angle, it would need the direction" in line(findings, "compensation")
    assert "1 arcsec with the causes added that it can take off" in line(findings, "end task")
    assert "hysteresis stays in the angle" in made_page(findings)


def test_a_pattern_that_may_be_a_sum_is_not_named_alone() -> None:
    cause = replace(HYSTERESIS, effect="reference_artefact", members=("reference_artefact",), probability=0.89)
    findings = replace(NAMED, causes=(cause,), end_task=replace(NAMED.end_task, missing_input="reference"))
    sentence = wording.verdict_sentence(findings)
    assert "reference artefact, or effects whose sum looks like it (probability 99 %)" in sentence
    assert "99 % with effects whose sum looks like it" in line(findings, "cause")
    assert "(if it is reference artefact indeed)" in line(findings, "compensation")
    assert "if it is reference artefact indeed" in made_page(findings)
    assert "indeed" not in line(replace(NAMED, causes=(HYSTERESIS,)), "compensation")


def test_effects_that_cannot_be_seen_for_one_reason_are_told_together() -> None:
    reasons = {
        "thermal_tilt": "the campaign lacks a second temperature",
        "load_deflection": "the campaign lacks load_nm",
        "thermal_lag": "the campaign lacks a second temperature",
    }
    findings = replace(NAMED, not_testable=reasons)
    assert "thermal tilt and thermal lag: the campaign lacks a second temperature" in line(
        findings, "not testable"
    )
    assert made_page(findings).count("lacks a second temperature") == 1


def test_many_parameters_are_folded_away() -> None:
    draws = {f"run_{i}_amplitude_arcsec": Estimate(value=1.0, standard_uncertainty=0.1) for i in range(21)}
    many = replace(HYSTERESIS, kind=Nature.RANDOM, parameters=draws)
    assert "<summary>21 parameters</summary>" in made_page(replace(NAMED, causes=(many,)))
    assert "parameters</summary>" not in made_page(NAMED)


def test_a_number_and_its_percent_sign_stay_on_one_line() -> None:
    assert " %" not in made_page(NAMED)


@pytest.mark.parametrize(
    ("p_value", "words"), [(None, "not tested"), (1.2e-92, "p < 0.0001"), (0.0021, "p = 0.0021")]
)
def test_a_p_value_far_out_is_not_told_by_its_size(p_value: float | None, words: str) -> None:
    assert wording.p_words(p_value) == words


def test_the_page_calls_the_joint_a_joint() -> None:
    named = replace(SUBJECT, joint="j")
    assert "<h1>Joint j</h1>" in made_page(replace(NAMED, subject=named))


def test_effects_drawn_by_chance_that_make_it_worse_close_nothing() -> None:
    worse = replace(NAMED, gap=replace(NAMED.gap, random_control=-54.79))
    assert "drawn by chance close nothing of it." in made_page(worse)
    assert "drawn by chance close 3\N{NO-BREAK SPACE}%." in made_page(NAMED)


def test_the_place_of_what_was_found_is_told_although_whole_runs_do_not_show_it() -> None:
    faint = tuple(replace(place, significant=False, p_value=0.9) for place in PLACES[:1])
    assert "61 % of the structure: once a turn, direction (by the evidence" in line(
        replace(NAMED, where=faint), "where"
    )
    untested = tuple(replace(place, significant=False, p_value=None) for place in PLACES[:1])
    assert "too few runs to test" in line(replace(NAMED, where=untested), "where")
    assert "(" not in line(NAMED, "where")
