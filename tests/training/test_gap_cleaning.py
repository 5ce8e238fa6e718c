"""Wild readings are drawn in; what comes again at a place, or makes a whole run odd, is structure and stays."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.training import gap_campaigns

from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.cleaning import Cleaned, clean, wide_dictionary
from trueangle_training.diagnosis.problem import Problem

Floats = NDArray[np.float64]
SIGMA = gap_campaigns.SIGMA_ARCSEC
FACES = gap_campaigns.FACES


def _problem(seed: int, pattern: gap_campaigns.Pattern | None = None, **plan: Any) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(seed, pattern, **plan), shapes=False)


def _cleaned(problem: Problem) -> Cleaned:
    return clean(problem, wide_dictionary(problem), scale_group=np.zeros(len(problem), dtype=np.int64))


def _with(extra: dict[int, float], seed: int = 3) -> Problem:
    problem = _problem(seed)
    for row, size in extra.items():
        problem.error_arcsec[row] += size * SIGMA
    return problem


def test_noise_alone_is_hardly_touched() -> None:
    changed = [float(np.mean(_cleaned(_problem(seed)).replaced)) for seed in range(5)]
    assert np.mean(changed) < 0.01


@pytest.mark.parametrize("row", [100, FACES * 6, FACES * 7 - 1])
def test_a_single_wild_reading_is_replaced_also_at_the_ends_of_a_run(row: int) -> None:
    found = _cleaned(_with({row: 15.0}))
    undisturbed = _problem(3).error_arcsec
    assert found.replaced[row]
    # At the end of a run, with a slope and an order of its own, a reading is foretold to 2 standard deviations.
    assert found.error_arcsec[row] == pytest.approx(undisturbed[row], abs=6 * SIGMA)


def test_a_burst_of_neighbours_is_taken_out() -> None:
    rows = range(FACES * 4 + 8, FACES * 4 + 13)
    found = _cleaned(_with(dict.fromkeys(rows, 7.0)))
    undisturbed = _problem(3).error_arcsec
    assert found.replaced[list(rows)].all()
    assert np.mean(found.error_arcsec[list(rows)] - undisturbed[list(rows)]) == pytest.approx(0.0, abs=1.5 * SIGMA)


def test_a_defect_that_comes_again_in_every_run_stays() -> None:
    rows = range(7, 21 * FACES, FACES)
    problem = _with(dict.fromkeys(rows, 12.0))
    found = _cleaned(problem)
    assert not found.replaced[list(rows)].any()
    assert np.mean(np.abs(found.error_arcsec - problem.error_arcsec)[list(rows)]) < 0.5 * SIGMA


def test_a_run_that_is_odd_as_a_whole_stays() -> None:
    problem = _problem(3)
    axes = axes_of(problem.conditions)
    odd = axes.run_index == 9
    shape = np.cos(4 * axes.angle_rad + 1.0)[odd] + np.cos(6 * axes.angle_rad)[odd]
    problem.error_arcsec[odd] += 5.0 * SIGMA * shape
    found = _cleaned(problem)
    kept = float(np.sum((found.error_arcsec - _problem(3).error_arcsec)[odd] * shape)) / float(np.sum(shape**2))
    assert kept > 0.85 * 5.0 * SIGMA


def test_steps_in_many_runs_are_structure_and_no_bursts() -> None:
    rows = [FACES * run + place for run in range(0, 21, 2) for place in range(15, 20)]
    problem = _with(dict.fromkeys(rows, 6.0))
    found = _cleaned(problem)
    assert np.mean(found.replaced[rows]) < 0.15


@pytest.mark.parametrize(("first", "last"), [(0, 9), (9, 23), (13, 23), (15, 23)])
def test_a_step_in_one_run_is_no_burst(first: int, last: int) -> None:
    # Counts lost before reading `last`, or from reading `first` on: the run's own offset takes up which.
    rows = range(FACES * 6 + first, FACES * 6 + last)
    found = _cleaned(_with(dict.fromkeys(rows, 7.0)))
    assert np.mean(found.replaced[list(rows)]) < 0.2


def test_a_step_whose_first_reading_noise_has_pushed_back_is_no_burst() -> None:
    rows = range(FACES * 6, FACES * 6 + 8)
    found = _cleaned(_with({row: (1.0 if row == FACES * 6 else 7.0) for row in rows}))
    assert np.mean(found.replaced[list(rows)[1:]]) < 0.3
