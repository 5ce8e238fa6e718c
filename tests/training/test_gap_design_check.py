"""What a plan can see, what it cannot tell apart, and the measurement that would: from the plan alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.training import gap_campaigns

from trueangle_training.diagnosis.attribution import Member
from trueangle_training.diagnosis.condensing import MOST_ROWS, condense
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.found_effect import found_effect
from trueangle_training.diagnosis.further_readings import extended
from trueangle_training.diagnosis.next_measurement import next_measurement
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.library.windup import WindupSettings

Floats = NDArray[np.float64]


def _problem(**plan: Any) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(1, **plan), shapes=True).without_errors()


@pytest.fixture(scope="module")
def one_way() -> tuple[Problem, Design]:
    problem = _problem()
    return problem, design_check(problem)


def _sweeps(speeds_deg_s: tuple[float, ...]) -> Problem:
    """Up and down under one zero at each speed."""
    made = gap_campaigns.campaign(1, directions=(1, -1))
    assert made.direction is not None
    up = made.run % 2 == 1
    speed = np.array(speeds_deg_s)[(made.run // 2) % len(speeds_deg_s)]
    joined = replace(
        made,
        velocity_deg_s=speed * made.direction,
        run=(made.run - up.astype(np.int64)) // 2,
        zero_group=np.zeros_like(made.run),
    )
    return problem_of(joined, gap_campaigns.joint(), library=EFFECTS).without_errors()


def test_latency_at_one_speed_hides_in_hysteresis_and_at_two_it_does_not() -> None:
    one, two = design_check(_sweeps((5.0,))), design_check(_sweeps((2.0, 8.0)))
    # v and the direction are proportional at one speed.
    assert one.carries["read_latency"]["hysteresis"] == pytest.approx(1.0, abs=1e-3)
    assert "hysteresis" in one.confusable("read_latency")
    # v = 2 d and 8 d in equal parts: of v the part 1 - (mean |v|)^2 / mean v^2 = 1 - 25 / 34 is not along d.
    assert two.carries["read_latency"]["hysteresis"] == pytest.approx(25 / 34, abs=0.05)
    assert "hysteresis" not in two.confusable("read_latency")


def test_what_the_joint_models_is_invisible_and_what_needs_a_second_direction_is_named(
    one_way: tuple[Problem, Design],
) -> None:
    _, design = one_way
    assert {"eccentricity", "grating_tilt", "thermal_eccentricity"} <= set(design.invisible)
    assert "read_latency" in {*design.invisible, *design.not_testable}
    assert design.visible["graduation_error"] > 0.9
    assert set(design.reasons) == {*design.invisible, *design.not_testable}


def test_a_pattern_over_the_faces_carries_every_constant_order(one_way: tuple[Problem, Design]) -> None:
    _, design = one_way
    assert "reference_artefact" in design.confusable("graduation_error")
    assert "graduation_error" not in design.confusable("thermal_graduation")


def test_the_errors_are_not_looked_at() -> None:
    problem = gap_campaigns.problem(gap_campaigns.campaign(2), shapes=True)
    loud = replace(problem, error_arcsec=100.0 * problem.error_arcsec)
    assert design_check(loud).visible == design_check(problem.without_errors()).visible


def test_a_polygon_moved_on_the_shaft_tells_the_grating_from_the_polygon(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    found = next_measurement(problem, design, ("graduation_error", "reference_artefact"))
    assert found.chosen is not None
    assert found.chosen.separates == ("reference_artefact",)
    by_name = {each.name: each for each in found.candidates}
    assert by_name["polygon re-mounted"].separates == ("reference_artefact",)
    # The same faces again at another temperature say nothing about it.
    assert by_name["another temperature"].separates == ()
    assert found.chosen.hours <= by_name["polygon re-mounted"].hours


def test_without_a_class_the_plan_is_widened_to_show_what_it_cannot_see(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    found = next_measurement(problem, design)
    assert found.chosen is not None
    assert set(found.chosen.shows) <= {*design.invisible, *design.not_testable}
    assert "read_latency" in found.text


def test_what_would_stay_hidden_all_the_same_is_said(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    found = next_measurement(problem, design)
    assert found.chosen is not None
    left = {*design.invisible, *design.not_testable} - set(found.chosen.shows)
    assert "temperature_sensor_error" in left
    shown, hidden = found.text.split(", which this plan hides; ")
    assert all(name in shown for name in found.chosen.shows)
    assert all(name in hidden for name in left)


def test_without_temperatures_only_a_second_temperature_shows_what_heat_does() -> None:
    made = replace(gap_campaigns.campaign(3, temperatures_c=(20.0,), repeats=4), temperature_c=None, load_nm=None)
    problem = gap_campaigns.problem(made, shapes=True)
    found = next_measurement(problem, design_check(problem.without_errors()))
    of_heat = {"thermal_tilt", "thermal_graduation", "thermal_nonlinearity"}
    shown = {each.name: of_heat & set(each.shows) for each in found.candidates}
    assert shown.pop("another temperature") == of_heat
    assert not any(shown.values())


def test_what_no_measurement_would_show_asks_for_none(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    blind = replace(design, invisible=("temperature_sensor_error",), not_testable=())
    found = next_measurement(problem, blind)
    assert found.chosen is None
    assert found.text.startswith("Nothing more to measure: none of the ")
    assert "would show temperature_sensor_error" in found.text


def _left(columns: Floats, span: Floats) -> Floats:
    return columns - span @ np.linalg.lstsq(span, columns, rcond=1e-9)[0]


def _share_over_faces(conditions: Conditions, curve: Floats) -> float:
    """What a pattern over the faces carries of a curve beside zeros, orders 1 and 2 and order 1 linear in T."""
    assert conditions.face is not None
    assert conditions.temperature_c is not None
    zeros = (conditions.zero_group[:, None] == np.unique(conditions.zero_group)).astype(np.float64)
    theta = np.radians(conditions.angle_deg)
    first = np.column_stack([np.cos(theta), np.sin(theta)])
    warm = conditions.temperature_c - 20.0
    span = np.column_stack([zeros, first, np.cos(2 * theta), np.sin(2 * theta), first * warm[:, None], warm])
    faces = (conditions.face[:, None] == np.arange(1, gap_campaigns.FACES + 1)).astype(np.float64)
    visible = _left(curve, span)
    missed = _left(visible, np.column_stack([span, faces]))
    return 1.0 - float(missed @ missed) / float(visible @ visible)


def _order_five(conditions: Conditions) -> Floats:
    return np.cos(5.0 * np.radians(conditions.angle_deg))


def test_what_is_told_apart_is_carried_no_longer(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    found = next_measurement(problem, design, ("graduation_error", "reference_artefact"), _order_five)
    told = [each for each in found.candidates if each.separates]
    assert {"polygon re-mounted", "dense sweep"} <= {each.name for each in told}
    for each in told:
        whole = extended(problem.conditions, each.name, each.times)
        assert whole is not None
        # A class holds the effects that carry at least 95 % of what was found.
        assert _share_over_faces(whole, _order_five(whole)) < 0.95


def test_readings_too_few_are_asked_for_again_and_cost_more(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    found = next_measurement(problem, design, ("graduation_error", "reference_artefact"), _order_five)
    once, twice = (each for each in found.candidates if each.name == "24 more angles")
    whole = extended(problem.conditions, once.name, 1)
    assert whole is not None
    # The faces carry all of 483 readings and nothing of 24 against a reference encoder.
    assert _share_over_faces(whole, _order_five(whole)) == pytest.approx(483 / 507, abs=1e-3)
    assert once.separates == ()
    assert twice.separates == ("reference_artefact",)
    assert twice.times == 2
    assert "Do so 2 times" in twice.text
    assert twice.hours == pytest.approx(2 * once.hours)


def test_what_builds_up_over_the_travel_is_told_from_creep_by_another_pace_only(
    one_way: tuple[Problem, Design],
) -> None:
    problem, design = one_way

    def windup(conditions: Conditions) -> Floats:
        # A polygon's stops are 15 s and 360 / 23 deg apart: over a travel of 120 s / 15 s of them it is a creep
        # of 120 s.
        travel_deg = 8.0 * 360.0 / 23.0
        settings = WindupSettings(amplitude_arcsec=1.0, travel_deg=travel_deg)
        return settings.error_arcsec(conditions, problem.joint, None)

    found = next_measurement(problem, design, ("windup", "index_drift"), windup)
    same_pace = ("another start", "polygon re-mounted", "another temperature")
    assert all(each.separates == () for each in found.candidates if each.name in same_pace)
    assert found.chosen is not None
    assert found.chosen.name not in same_pace


def test_a_further_run_at_the_same_stops_reads_what_was_read_there(one_way: tuple[Problem, Design]) -> None:
    problem, _ = one_way
    plan = problem.conditions
    whole = extended(plan, "another start")
    assert whole is not None
    assert plan.face is not None
    assert whole.face is not None
    for angle_deg, face in zip(whole.angle_deg[len(plan) :], whole.face[len(plan) :], strict=True):
        indicated_deg = float(np.median(plan.angle_deg[plan.face == face]))
        # An eccentricity of 20 arcsec moves the stops by up to a quarter of a line of 79 arcsec.
        assert np.mod(angle_deg - indicated_deg + 180.0, 360.0) - 180.0 == pytest.approx(0.0, abs=1e-5)
    assert np.ptp(whole.angle_deg[len(plan) :]) == pytest.approx(360.0 * 22 / 23, abs=0.02)


def _member(problem: Problem, effect: str, coefficients: Floats) -> Member:
    place = next(i for i, each in enumerate(problem.hypotheses) if each.effect == effect)
    return Member(
        effect=effect,
        hypothesis_index=place,
        coefficients=coefficients,
        covariance=np.eye(coefficients.size),
        log_evidence=50.0,
        share=1.0,
        curve_arcsec=np.zeros(len(problem)),
    )


@pytest.mark.parametrize("effect", ["graduation_error", "windup", "localized_defect", "index_drift"])
def test_a_found_effect_is_under_its_own_conditions_what_was_found(
    one_way: tuple[Problem, Design], effect: str
) -> None:
    problem, _ = one_way
    shape = next(each for each in problem.hypotheses if each.effect == effect)
    coefficients = np.linspace(1.5, 2.5, shape.main.shape[1])
    curve = found_effect(problem, [_member(problem, effect, coefficients)])
    assert curve is not None
    # The hypotheses have each reading's own noise taken off its angle: hundredths of an arcsecond.
    assert curve(problem.conditions) == pytest.approx(shape.main @ coefficients, abs=1e-3)


def test_what_is_drawn_anew_in_each_run_has_no_curve_elsewhere(one_way: tuple[Problem, Design]) -> None:
    problem, _ = one_way
    assert found_effect(problem, [_member(problem, "run_to_run_eccentricity", np.ones(2))]) is None
    assert found_effect(problem, []) is None


def test_many_readings_are_averaged_within_runs_and_said_so() -> None:
    made = gap_campaigns.campaign(3)
    times = 100
    many = replace(
        made,
        **{
            name: np.repeat(getattr(made, name), times)
            for name in (
                "angle_deg",
                "error_arcsec",
                "run",
                "zero_group",
                "row",
                "temperature_c",
                "time_s",
                "direction",
                "velocity_deg_s",
                "load_nm",
                "face",
                "polygon_offset",
            )
        },
    )
    condensed = condense(many)
    assert len(condensed.campaign) <= MOST_ROWS
    assert int(condensed.averaged.sum()) == len(many)
    assert condensed.notes
    # Equal neighbours: the averages are the readings themselves, at their own places.
    assert condensed.campaign.error_arcsec == pytest.approx(many.error_arcsec[condensed.reading])


def test_a_small_campaign_is_not_averaged() -> None:
    made = gap_campaigns.campaign(3)
    condensed = condense(made)
    assert condensed.campaign is made
    assert condensed.notes == ()
