"""Three shares that add up, and parameters that are tested for staying the same."""

from dataclasses import replace

import numpy as np
import pytest
from tests.training.gap_campaigns import FACES, SIGMA_ARCSEC, campaign, joint, problem

from trueangle_training.diagnosis.constancy import constancy_tests, drifting
from trueangle_training.diagnosis.recalibration import held_out, recalibration_columns, run_folds
from trueangle_training.diagnosis.shares import floor_of, shares_of

SHIPPED = {
    "eccentricity": {"amplitude_arcsec": 18.0, "phase_deg": 57.2958},
    "grating_tilt": {"amplitude_arcsec": 3.0, "phase_deg": 0.0},
    "thermal_eccentricity": {"amplitude_arcsec_per_k": 0.1, "phase_deg": 90.0},
}


def test_held_out_squares_of_pure_noise_are_its_variance() -> None:
    """With the training's own uncertainty taken off, for any number of columns: 60 sets, standard error 0.9 %."""
    rng = np.random.default_rng(0)
    made = problem(campaign(0))
    group = made.conditions.zero_group
    columns = np.column_stack([recalibration_columns(made), rng.normal(size=(len(made), 30))])
    folds = run_folds(made)
    squares = [
        held_out(rng.normal(0.0, 2.0, len(made)), columns, group, folds).mean_square(4.0) for _ in range(60)
    ]
    assert np.mean(squares) == pytest.approx(4.0, rel=0.03)


def test_an_offset_of_a_held_out_run_costs_a_degree_of_freedom_and_a_shared_one_does_not() -> None:
    made = problem(campaign(0))
    none = np.zeros((len(made), 0))
    own = held_out(made.error_arcsec, none, made.conditions.zero_group, run_folds(made))
    shared = held_out(made.error_arcsec, none, np.zeros_like(made.conditions.zero_group), run_folds(made))
    assert own.freedom.sum() == pytest.approx(len(made) * (FACES - 1) / FACES)
    assert shared.freedom.sum() == len(made)


def test_shares_of_a_moved_parameter_are_parametric_and_floor() -> None:
    """G0 - G1 is half the square of the 2 arcsec that the amplitude is off: 2 arcsec^2."""
    found = shares_of(problem(campaign(1), joint(dict(SHIPPED))))
    assert found is not None
    assert found.parametric_share + found.structural_share + found.floor_share == pytest.approx(1.0)
    assert found.shipped_arcsec2 - found.recalibrated_arcsec2 == pytest.approx(2.0, rel=0.15)
    assert found.structural_share < 0.03
    assert found.floor.repeated
    assert found.floor.variance_arcsec2 == pytest.approx(SIGMA_ARCSEC**2, rel=0.25)


def test_shares_of_an_unmodelled_order_are_structural() -> None:
    found = shares_of(problem(campaign(2, lambda theta, t, run: 1.0 * np.cos(5 * theta))))
    assert found is not None
    assert found.recalibrated_arcsec2 - found.floor.variance_arcsec2 == pytest.approx(0.5, rel=0.15)


def test_shares_below_zero_are_set_to_zero_and_said() -> None:
    shipped = dict(SHIPPED) | {"eccentricity": {"amplitude_arcsec": 20.0, "phase_deg": 57.2958}}
    noted = [shares_of(problem(campaign(seed), joint(dict(shipped)))) for seed in range(6)]
    below = [
        each for each in noted if each is not None and each.recalibrated_arcsec2 < each.floor.variance_arcsec2
    ]
    assert below
    for each in below:
        assert each.structural_share == 0.0
        assert any("structural share is set to 0" in note for note in each.notes)


def test_draws_of_single_runs_are_kept_out_of_the_floor_when_they_were_found() -> None:
    amplitude = np.random.default_rng(5).normal(size=(22, 2)) * 2.0
    made = problem(
        campaign(3, lambda theta, t, run: amplitude[run, 0] * np.cos(theta) + amplitude[run, 1] * np.sin(theta))
    )
    theta = np.radians(made.conditions.angle_deg)
    own = made.conditions.run[:, None] == np.unique(made.conditions.run)
    columns = np.column_stack([own * np.cos(theta)[:, None], own * np.sin(theta)[:, None]])
    assert floor_of(made).variance_arcsec2 > 2.0
    assert floor_of(made, found=columns).variance_arcsec2 == pytest.approx(SIGMA_ARCSEC**2, rel=0.3)


def test_without_repeats_the_floor_is_the_scatter_about_a_saturated_fit() -> None:
    made = problem(campaign(4, repeats=1, temperatures_c=tuple(np.linspace(10.0, 40.0, 16))))
    floor = floor_of(made)
    assert not floor.repeated
    assert 50 < floor.freedom < len(made)
    assert floor.variance_arcsec2 == pytest.approx(SIGMA_ARCSEC**2, rel=0.3)


def test_one_run_has_no_shares() -> None:
    assert shares_of(problem(campaign(5, temperatures_c=(20.0,), repeats=1))) is None


def test_parameters_of_a_sound_simulator_stay_the_same() -> None:
    """Family-wise level 5 %: of 25 campaigns with coloured noise 6 or more alarms have probability 0.002."""
    alarms = sum(bool(drifting(problem(campaign(seed, directions=(1, -1))))) for seed in range(100, 125))
    assert alarms < 6


def test_a_parameter_that_bends_with_temperature_is_found() -> None:
    found = drifting(problem(campaign(7, lambda theta, t, run: 0.01 * (t - 25.0) ** 2 * np.cos(2 * theta))))
    assert ("grating_tilt", "temperature") in {(each.effect, each.over) for each in found}


def test_thermal_growth_counts_as_movement_only_where_it_is_not_modelled() -> None:
    without = joint({"eccentricity": {}, "grating_tilt": {}})
    made = campaign(8)
    assert drifting(problem(made)) == ()
    assert [(each.effect, each.over) for each in drifting(problem(made, without))] == [
        ("eccentricity", "temperature")
    ]


def test_a_parameter_that_depends_on_direction_is_found() -> None:
    made = campaign(9, lambda theta, t, run: np.where(run % 2 == 0, 0.5, -0.5) * np.cos(theta), directions=(1, -1))
    found = {(each.effect, each.over) for each in drifting(problem(made))}
    assert ("eccentricity", "direction") in found


def test_an_amplitude_drawn_anew_in_each_run_is_found() -> None:
    amplitude = np.random.default_rng(5).normal(size=(22, 2)) * 0.8
    made = campaign(
        10, lambda theta, t, run: amplitude[run, 0] * np.cos(theta) + amplitude[run, 1] * np.sin(theta)
    )
    assert ("eccentricity", "run") in {(each.effect, each.over) for each in drifting(problem(made))}


def test_fewer_than_six_runs_allow_no_statement() -> None:
    assert constancy_tests(problem(campaign(11, temperatures_c=(10.0, 20.0), repeats=2))) == ()


def test_draws_that_the_simulator_models_are_judged_by_half_runs() -> None:
    """No other run tells the draw of a held-out one: that it is not predicted must not count as structure."""
    rng = np.random.default_rng(5)
    made = campaign(4)
    runs, index = np.unique(made.run, return_inverse=True)
    draws = rng.normal(0.0, 3.0, (runs.size, 2))[index]
    theta = np.radians(made.angle_deg)
    moved = made.error_arcsec + draws[:, 0] * np.cos(theta) + draws[:, 1] * np.sin(theta)
    drawn = replace(made, error_arcsec=moved)
    effects: dict[str, object] = {"eccentricity": {}, "grating_tilt": {}, "thermal_eccentricity": {}}
    without = shares_of(problem(drawn, joint(effects)))
    modelled = shares_of(problem(drawn, joint({**effects, "run_to_run_eccentricity": {"amplitude_arcsec": 4.2}})))
    assert without is not None
    assert modelled is not None
    # Order 1 drawn with 3 arcsec each way: 9 arcsec^2 a reading.
    assert without.recalibrated_arcsec2 == pytest.approx(9.0, rel=0.4)
    assert modelled.recalibrated_arcsec2 == pytest.approx(SIGMA_ARCSEC**2, rel=0.2)
    assert any("draws anew" in note for note in modelled.notes)
    assert not any("draws anew" in note for note in without.notes)
