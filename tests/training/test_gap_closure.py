"""How far the gap shrinks: against the truth that the test knows, and against controls."""

from dataclasses import replace

import numpy as np
import pytest
from tests.training.gap_campaigns import SIGMA_ARCSEC, Pattern, campaign, joint, problem

from trueangle_training.diagnosis.attribution import Attribution, attribute
from trueangle_training.diagnosis.black_box import black_box, chance_effects
from trueangle_training.diagnosis.closure import Closure, closure_of
from trueangle_training.diagnosis.end_task import Compensation, compensation_of, end_task
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    held_out,
    recalibration_columns,
    recalibration_span,
    run_folds,
)
from trueangle_training.diagnosis.shares import Shares, shares_of
from trueangle_training.effects.effect import Nature


def order_five(theta: np.ndarray, t: np.ndarray, run: np.ndarray) -> np.ndarray:
    return 0.8 * np.cos(5 * theta + 0.3)


def bent_tilt(theta: np.ndarray, t: np.ndarray, run: np.ndarray) -> np.ndarray:
    return 0.05 * (t - 25.0) * np.cos(2 * theta)


def laid_out(seed: int, pattern: Pattern | None, **options: object) -> tuple[Problem, Attribution, Shares]:
    made = problem(campaign(seed, pattern, colour=0.05, **options), shapes=True)  # pyright: ignore[reportArgumentType]
    attribution = attribute(made)
    cleaned = replace(made, error_arcsec=attribution.cleaned_arcsec)
    shares = shares_of(cleaned)
    assert shares is not None
    return cleaned, attribution, shares


def closed(seed: int, pattern: Pattern | None, *, named: tuple[str, ...] | None = None) -> Closure:
    made, attribution, shares = laid_out(seed, pattern)
    names = tuple(m.effect for m in attribution.members if m.effect is not None) if named is None else named
    return closure_of(made, attribution, named=names, shares=shares, rng=np.random.default_rng(0))


def test_nothing_found_says_nothing() -> None:
    found = closed(1, None)
    assert (found.closure, found.interval, found.ceiling, found.closes, found.waterfall) == (
        None,
        None,
        None,
        None,
        (),
    )


def true_closure_of_tilt(made: Problem, attribution: Attribution) -> float:
    assert made.conditions.temperature_c is not None
    theta = np.radians(made.conditions.angle_deg)
    truth = bent_tilt(theta, made.conditions.temperature_c, made.conditions.run)
    span = recalibration_span(made)
    seen, left = span.outside(truth), span.outside(truth - attribution.explained(made))
    return 1.0 - float(left @ left) / float(seen @ seen)


def test_the_interval_holds_the_truth_in_nearly_all_campaigns() -> None:
    held = 0
    for seed in range(20, 28):
        made, attribution, shares = laid_out(seed, bent_tilt)
        names = tuple(member.effect for member in attribution.members if member.effect is not None)
        found = closure_of(made, attribution, named=names, shares=shares, rng=np.random.default_rng(0))
        assert found.interval is not None
        held += found.interval[0] <= true_closure_of_tilt(made, attribution) <= found.interval[1]
    # 0.95 each: fewer than 6 of 8 would come to pass once in 170 times.
    assert held >= 6


def test_an_effect_of_the_library_closes_nearly_all() -> None:
    made, attribution, shares = laid_out(2, bent_tilt)
    assert [m.effect for m in attribution.members] == ["thermal_tilt"]
    found = closure_of(made, attribution, named=("thermal_tilt",), shares=shares, rng=np.random.default_rng(0))
    true_closure = true_closure_of_tilt(made, attribution)
    assert found.closure is not None
    assert found.closure == pytest.approx(true_closure, abs=0.03)
    assert found.ceiling is not None
    assert found.ceiling >= found.closure
    assert found.random_control is not None
    assert found.random_control < 0.5
    assert found.over_temperatures is not None
    assert found.over_temperatures.closure > 0.9
    assert found.worse_orders == ()


def test_the_waterfall_ends_at_the_closure_and_each_effect_closes_its_part() -> None:
    made, attribution, shares = laid_out(
        3, lambda theta, t, run: order_five(theta, t, run) + 0.03 * (t - 25.0) * np.cos(2 * theta)
    )
    names = ("graduation_error", "thermal_tilt")
    assert set(names) <= {m.effect for m in attribution.members}
    found = closure_of(made, attribution, named=names, shares=shares, rng=np.random.default_rng(0))
    assert found.closure is not None
    assert found.closes is not None
    assert [step.closure for step in found.waterfall] == sorted(step.closure for step in found.waterfall)
    assert found.waterfall[-1].closure == pytest.approx(found.closure)
    assert sum(found.closes.values()) == pytest.approx(found.closure, abs=0.02)
    # 0.8^2 / 2 of a constant amplitude against 0.03^2 x 100 K^2 / 2 (uniform over 30 K: mean square 100 K^2).
    assert max(found.closes.values()) == pytest.approx(0.32 / (0.32 + 0.045), abs=0.05)


def test_structure_without_a_name_closes_nothing() -> None:
    found = closed(4, bent_tilt, named=())
    assert (found.closure, found.interval) == (0.0, (0.0, 0.0))
    assert found.ceiling is not None
    assert found.ceiling > 0.5


def test_draws_of_single_runs_are_told_from_half_of_the_run() -> None:
    amplitude = np.random.default_rng(5).normal(size=(22, 2)) * 1.5
    found = closed(5, lambda theta, t, run: amplitude[run, 0] * np.cos(theta) + amplitude[run, 1] * np.sin(theta))
    assert found.closure is not None
    # Two amplitudes and an offset from 11 or 12 readings: about 0.85 of 2.25 arcsec^2 at noise 0.25 arcsec^2.
    assert 0.7 < found.closure < 0.98
    assert any("new run" in note for note in found.notes)


def test_a_black_box_closes_what_is_smooth_and_gains_nothing_on_noise() -> None:
    for pattern, expected in ((order_five, (0.8, 1.05)), (None, (-0.35, 0.1))):
        made = problem(campaign(6, pattern))
        shares = shares_of(made)
        assert shares is not None
        before = shares.recalibrated.residual_arcsec
        after = black_box(made, run_folds(made)).residual_arcsec
        gain = float(before @ before - after @ after) / (0.32 * len(made))
        assert expected[0] < gain < expected[1]


def test_the_end_task_closes_what_temperature_and_angle_can_express() -> None:
    made, attribution, shares = laid_out(7, bent_tilt)
    compensation = compensation_of(made, ("thermal_tilt",))
    assert compensation.compensable
    explained = attribution.explained(made)
    found, notes = end_task(
        made,
        compensation=compensation,
        floor_arcsec2=shares.floor.variance_arcsec2,
        found_in=lambda fold: {"thermal_tilt": explained},
    )
    assert notes == ()
    assert found.none_arcsec == pytest.approx(np.sqrt((20.0**2 + 3.0**2) / 2.0), rel=0.05)
    assert found.simulator_arcsec is not None
    # The noise and the tilt that the simulator does not know: 0.05^2 x 100 K^2 / 2.
    assert found.simulator_arcsec == pytest.approx(np.sqrt(SIGMA_ARCSEC**2 + 0.125), rel=0.15)
    assert found.gap_left is not None
    assert abs(found.gap_left) < 0.3


def test_an_effect_that_needs_another_input_is_not_compensable() -> None:
    made, _, shares = laid_out(8, None, directions=(1, -1))
    compensation = compensation_of(made, ("hysteresis",))
    assert not compensation.compensable
    found, _ = end_task(made, compensation=compensation, floor_arcsec2=shares.floor.variance_arcsec2)
    assert found.missing_input == compensation.missing_input
    assert found.explained_arcsec is None
    assert found.oracle_arcsec == pytest.approx(SIGMA_ARCSEC, rel=0.2)


def test_of_two_effects_the_one_that_can_be_is_compensated_and_the_other_is_named() -> None:
    made, attribution, shares = laid_out(7, bent_tilt)
    tilt = attribution.explained(made)
    # Of one sign in the campaign's one direction: a model that learned it would take it off.
    other = 2.0 * np.cos(np.radians(made.conditions.angle_deg))
    beside = replace(made, error_arcsec=made.error_arcsec + other)
    compensation = compensation_of(made, ("thermal_tilt", "hysteresis"))
    assert compensation.compensable
    floor_arcsec2 = shares.floor.variance_arcsec2
    found, _ = end_task(
        beside,
        compensation=compensation,
        found_in=lambda fold: {"thermal_tilt": tilt, "hysteresis": other},
        floor_arcsec2=floor_arcsec2,
    )
    assert found.missing_input == "direction"
    assert dict(found.not_compensable) == {"hysteresis": "direction"}
    assert found.explained_arcsec == pytest.approx(np.sqrt(2.0 + SIGMA_ARCSEC**2), rel=0.1)
    alone, _ = end_task(
        made,
        compensation=compensation_of(made, ("thermal_tilt",)),
        found_in=lambda fold: {"thermal_tilt": tilt},
        floor_arcsec2=floor_arcsec2,
    )
    assert alone.not_compensable == {}


def test_the_end_task_of_too_few_angles_is_left_out_with_the_reason() -> None:
    made = problem(campaign(9, temperatures_c=(20.0,), repeats=1), joint({"eccentricity": {}}))
    found, notes = end_task(made, compensation=Compensation(effects=()), floor_arcsec2=0.25)
    assert found.oracle_arcsec is None
    assert notes


def test_a_chance_effect_that_lives_in_one_run_does_not_make_the_control_meaningless() -> None:
    """Fitted to noise without that run, such a shape is off there by its size: 1e4 of what it is elsewhere."""
    made = problem(campaign(1), shapes=True)
    rng = np.random.default_rng(0)
    first = made.conditions.run == made.conditions.run[0]
    shapes = [
        next(each for each in made.hypotheses if each.effect == effect and each.nature is Nature.MEAN)
        for effect in ("thermal_tilt", "thermal_graduation", "thermal_nonlinearity")
    ]
    wild = rng.normal(size=len(made)) * np.where(first, 1e4, 1.0)
    chosen = (*shapes[:2], replace(shapes[2], main=wild[:, None]))
    small = replace(made, hypotheses=chosen)
    folds = run_folds(made)
    chance = chance_effects(small, folds, count=1, without=frozenset(), draws=21, rng=np.random.default_rng(2))
    plain = held_out(made.error_arcsec, recalibration_columns(made), made.conditions.zero_group, folds)
    assert chance == pytest.approx(float(np.sum(plain.residual_arcsec**2)), rel=0.1)


def test_without_a_clock_the_order_of_the_runs_tells_the_black_box_what_wanders() -> None:
    """The same drift over the campaign, with the column time_s and without it."""
    drifting = problem(
        campaign(
            7, lambda theta, t, run: np.asarray(0.1 * (run - 11) * np.cos(2 * theta), np.float64), colour=0.05
        )
    )
    timeless = replace(drifting, conditions=replace(drifting.conditions, time_s=None, temperature_c=None))
    for made in (drifting, timeless):
        folds = run_folds(made)
        left = black_box(made, folds).mean_square(SIGMA_ARCSEC**2)
        before = held_out(made.error_arcsec, recalibration_columns(made), made.conditions.zero_group, folds)
        gap = before.mean_square(SIGMA_ARCSEC**2) - SIGMA_ARCSEC**2
        assert (before.mean_square(SIGMA_ARCSEC**2) - left) / gap > 0.8
