"""Bayes factors against their definition, and selection on nothing and on planted effects."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.training import gap_campaigns

from trueangle_training.diagnosis.attribution import attribute
from trueangle_training.diagnosis.cleaning import wide_dictionary
from trueangle_training.diagnosis.evidence import (
    TAUS,
    Accepted,
    Evidence,
    evidence_of,
    fit,
    scores,
    stacked_columns,
)
from trueangle_training.diagnosis.noise import estimate_noise, run_kinds
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.spectra import run_transform


def _problem(seed: int, pattern: gap_campaigns.Pattern | None = None, **plan: Any) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(seed, pattern, **plan), shapes=True)


def _evidence(problem: Problem) -> Evidence:
    transform = run_transform(problem.conditions.run, problem.conditions.time_s)
    kinds = run_kinds(problem.conditions, transform)
    basis = wide_dictionary(problem).whole
    noise = estimate_noise(problem.error_arcsec, basis, transform, kinds, problem.conditions)
    transformed = transform.of_stacked(stacked_columns(problem))
    return evidence_of(problem, noise, problem.error_arcsec, transformed)


@pytest.fixture(scope="module")
def few_shapes() -> Problem:
    problem = _problem(11, lambda theta, t, run: 0.4 * np.cos(3 * theta))
    wanted = ("graduation_error", "thermal_nonlinearity", "reference_artefact")
    return replace(problem, hypotheses=tuple(h for h in problem.hypotheses if h.effect in wanted))


def _columns(evidence: Evidence, block: int) -> np.ndarray:
    own = evidence.column_range(block)
    crude = np.asarray(evidence.columns[own], dtype=np.float64)
    return (crude - evidence.inside[:, own].T @ evidence.nuisance).T


def _log_marginal(columns: np.ndarray, tau: float, error: np.ndarray) -> float:
    """log N(error; 0, I + tau^2 B B') - log N(error; 0, I), by the dense covariance."""
    covariance = np.eye(error.size) + tau**2 * columns @ columns.T
    sign, log_det = np.linalg.slogdet(covariance)
    assert sign > 0
    return float(-0.5 * log_det - 0.5 * error @ np.linalg.solve(covariance, error) + 0.5 * error @ error)


def test_a_block_is_weighed_as_its_dense_gaussian_covariance_says(few_shapes: Problem) -> None:
    evidence = _evidence(few_shapes)
    found = scores(evidence, [])
    for block in (0, 3, evidence.hypothesis.size - 1):
        columns = _columns(evidence, block)
        by_tau = np.array([_log_marginal(columns, tau, evidence.error) for tau in TAUS])
        averaged = by_tau.max() + np.log(np.mean(np.exp(by_tau - by_tau.max())))
        # A barred tau may be missing from the average, never added.
        assert found.log_evidence[block] <= averaged + 1e-6
        assert found.log_evidence[block] == pytest.approx(averaged, abs=1e-6) or evidence.mains[block] < 4


def test_beside_accepted_blocks_the_evidence_is_that_of_both_less_that_of_the_first(few_shapes: Problem) -> None:
    evidence = _evidence(few_shapes)
    first, second = 0, evidence.hypothesis.size - 1
    tau = float(TAUS[3])
    both = np.column_stack([_columns(evidence, first), _columns(evidence, second)])
    one = _log_marginal(_columns(evidence, first), tau, evidence.error)
    by_tau = []
    for other in TAUS:
        scaled = both.copy()
        scaled[:, evidence.width[first] :] *= other / tau
        by_tau.append(_log_marginal(scaled, tau, evidence.error) - one)
    values = np.array(by_tau)
    expected = values.max() + np.log(np.mean(np.exp(values - values.max())))
    found = scores(evidence, [Accepted(block=first, tau=tau)])
    assert found.log_evidence[second] == pytest.approx(expected, abs=1e-5)


def test_the_fit_is_the_posterior_mean(few_shapes: Problem) -> None:
    evidence = _evidence(few_shapes)
    accepted = [Accepted(block=0, tau=1.1)]
    columns = _columns(evidence, 0)
    precision = columns.T @ columns + np.eye(columns.shape[1]) / 1.1**2
    expected = np.linalg.solve(precision, columns.T @ evidence.error)
    found = fit(evidence, accepted)
    assert found.coefficients == pytest.approx(expected)
    left = evidence.error - columns @ expected
    assert float(found.energy_left) == pytest.approx(float(left @ left), rel=1e-6)


def test_noise_alone_selects_nothing() -> None:
    named = [len(attribute(_problem(200 + seed)).members) for seed in range(8)]
    assert sum(named) == 0


def test_a_planted_order_is_found_with_its_size() -> None:
    found = attribute(_problem(31, lambda theta, t, run: 0.6 * np.cos(5 * theta - 0.7)))
    assert [member.effect for member in found.members] == ["graduation_error"]
    (member,) = found.members
    cosine, sine = member.coefficients[:2]
    # 483 readings of 0.5 arcsec know an amplitude to 0.5 sqrt(2 / 483) = 0.03 arcsec.
    assert np.hypot(cosine, sine) == pytest.approx(0.6, abs=0.12)
    assert np.arctan2(sine, cosine) == pytest.approx(0.7, abs=0.2)


def test_what_was_found_predicts_the_structure_on_any_rows() -> None:
    problem = _problem(32, lambda theta, t, run: 0.02 * (t - 25) * np.cos(4 * theta))
    found = attribute(problem)
    kept = np.arange(0, len(problem), 3)
    assert found.predict(problem.rows(kept)) == pytest.approx(found.predict(problem)[kept])
    assert found.explained(problem) == pytest.approx(sum(m.curve_arcsec for m in found.members))


def test_two_effects_are_both_found() -> None:
    def pattern(theta: np.ndarray, t: np.ndarray, run: np.ndarray) -> np.ndarray:
        return 0.7 * np.cos(6 * theta) + 0.004 * (t - 25) ** 2 * np.cos(theta + 1)

    found = attribute(_problem(33, pattern))
    assert {member.effect for member in found.members} == {"graduation_error", "thermal_nonlinearity"}


def test_a_small_campaign_is_answered_too() -> None:
    problem = _problem(34, temperatures_c=(20.0,), repeats=2)
    assert attribute(problem).members == ()


def test_what_is_small_beside_the_noise_is_left_alone_however_many_readings_show_it() -> None:
    many = {"repeats": 24, "temperatures_c": (20.0, 30.0), "colour": 0.0}
    found = [
        attribute(_problem(35, lambda theta, t, run, size=size: size * np.cos(5 * theta), **many)).members
        for size in (0.04, 0.14)
    ]
    # 0.057 and 0.2 of the noise; sqrt(1104) = 33 readings' worth make both of them evident.
    assert found[0] == ()
    assert [member.effect for member in found[1]] == ["graduation_error"]


def test_counts_lost_once_are_found_beside_a_pattern_with_most_of_the_energy() -> None:
    def pattern(theta: np.ndarray, t: np.ndarray, run: np.ndarray) -> np.ndarray:
        lost = (run == 7) & (theta > 2.6)
        return 0.25 * (t - 20) * np.cos(4 * theta) + 3.0 * lost

    members = attribute(_problem(36, pattern)).members
    assert {member.effect for member in members} == {"thermal_graduation", "count_loss"}
    (lost,) = [member for member in members if member.effect == "count_loss"]
    assert lost.share < 0.07
