"""The run-wise cosine transform, the colour of the noise, and what may not be taken for colour."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.training import gap_campaigns

from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.cleaning import orthonormal, wide_dictionary
from trueangle_training.diagnosis.noise import NoiseModel, estimate_noise, run_kinds
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.spectra import LONGEST_BY_MATRIX, run_transform


def _problem(seed: int, pattern: gap_campaigns.Pattern | None = None, **plan: Any) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(seed, pattern, **plan), shapes=False)


def _noise(problem: Problem) -> NoiseModel:
    transform = run_transform(problem.conditions.run, problem.conditions.time_s)
    kinds = run_kinds(problem.conditions, transform)
    basis = wide_dictionary(problem).whole
    return estimate_noise(problem.error_arcsec, basis, transform, kinds, problem.conditions)


@given(length=st.integers(min_value=1, max_value=LONGEST_BY_MATRIX + 40), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_the_transform_keeps_energy_and_comes_back(length: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=length)
    transform = run_transform(np.zeros(length, dtype=np.int64), None)
    there = transform(values)
    assert float(there @ there) == pytest.approx(float(values @ values))
    assert transform.inverse(there) == pytest.approx(values)
    assert there[0] == pytest.approx(values.sum() / np.sqrt(length)), "j = 0 is the mean"


def test_a_long_run_is_transformed_as_a_short_one_would_be() -> None:
    length = LONGEST_BY_MATRIX + 3
    values = np.random.default_rng(1).normal(size=length)
    j, i = np.arange(length)[:, None], np.arange(length)[None, :]
    by_definition = np.sqrt(2 / length) * np.cos(np.pi * j * (2 * i + 1) / (2 * length)) @ values
    by_definition[0] /= np.sqrt(2)
    assert run_transform(np.zeros(length, dtype=np.int64), None)(values) == pytest.approx(by_definition, abs=1e-10)


def test_runs_are_transformed_each_by_itself_wherever_their_rows_stand() -> None:
    values = np.random.default_rng(2).normal(size=60)
    run = np.tile([3, 1, 2], 20)
    mixed = run_transform(run, None)(values)
    for each in (1, 2, 3):
        alone = run_transform(np.zeros(20, dtype=np.int64), None)(values[run == each])
        assert mixed[run == each] == pytest.approx(alone)
    stacked = run_transform(run, None).of_stacked(np.stack([values, 2 * values]))
    assert stacked == pytest.approx(np.stack([mixed, 2 * mixed]))


def test_white_noise_is_found_white_and_of_its_size() -> None:
    sizes, colours = [], []
    for seed in range(6):
        noise = _noise(_problem(seed, colour=0.0))
        sizes.append(noise.sigma_arcsec)
        colours.append(float(np.median(noise.colour)))
    # 483 readings less some 170 columns: a standard deviation is known to 4 %, its mean over six to 1.6 %; the
    # heavy tails and the encoder's steps move it by as much.
    assert np.mean(sizes) == pytest.approx(gap_campaigns.SIGMA_ARCSEC, rel=0.06)
    assert np.median(colours) < 2.0


def test_slow_noise_is_found_coloured_and_whitening_makes_it_even() -> None:
    low, high = [], []
    for seed in range(6):
        problem = _problem(100 + seed, colour=0.7)
        noise = _noise(problem)
        assert float(np.median(noise.colour)) > 1.5
        basis = orthonormal(noise.whiten(problem.nuisance()))
        white = noise.whiten(problem.error_arcsec)
        white -= basis @ (basis.T @ white)
        cycles = noise.transform.half_cycles
        low.append(float(np.mean(white[(cycles > 3) & (cycles < 9)] ** 2)))
        high.append(float(np.mean(white[cycles > 15] ** 2)))
    # Each mean square is over some 100 rows: 14 %, over six campaigns 6 %.
    assert np.mean(low) == pytest.approx(1.0, abs=0.3)
    assert np.mean(high) == pytest.approx(1.0, abs=0.3)


def test_one_order_drawn_in_each_run_is_not_taken_for_colour() -> None:
    rng = np.random.default_rng(5)
    problem = _problem(7, colour=0.0)
    axes = axes_of(problem.conditions)
    draws = rng.normal(0.0, 0.7, size=(axes.runs, 2))[axes.run_index]
    with_order = problem.error_arcsec + np.sum(draws * axes.cosine_sine(4), axis=1)
    transform = run_transform(problem.conditions.run, problem.conditions.time_s)
    kinds = run_kinds(problem.conditions, transform)
    basis = wide_dictionary(problem).whole
    noise = estimate_noise(with_order, basis, transform, kinds, problem.conditions)
    # Order 4 brings (23 / 2) 0.5 = 5.6 arcsec^2 to the cosine j = 8 of a run, 22 times the white 0.25.
    variance = {j: float(noise.variance[noise.transform.half_cycles == j].mean()) for j in (1, 8, 20)}
    assert variance[8] < 0.25 * 5.6
    assert variance[1] < 6.0 * variance[20]
