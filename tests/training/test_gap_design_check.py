"""What a plan can see, what it cannot tell apart, and the measurement that would: from the plan alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.training import gap_campaigns

from trueangle_training.diagnosis.condensing import MOST_ROWS, condense
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.next_measurement import next_measurement
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.effects import EFFECTS


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


def test_what_no_measurement_would_show_asks_for_none(one_way: tuple[Problem, Design]) -> None:
    problem, design = one_way
    blind = replace(design, invisible=("temperature_sensor_error",), not_testable=())
    found = next_measurement(problem, blind)
    assert found.chosen is None
    assert found.text.startswith("Nothing more to measure: none of the ")
    assert "would show temperature_sensor_error" in found.text


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
