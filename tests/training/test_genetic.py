"""The genetic algorithm's operators, eqs. (7)-(10), one by one and together."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trueangle_training.genetic import (
    Evaluation,
    GeneticOptions,
    MutationForm,
    cross,
    evolve,
    mutate,
    select,
    selection_probabilities,
)

Floats = NDArray[np.float64]


def sphere(individuals: Floats) -> Evaluation:
    """Squared distance from (0.5, 0.5, ...)."""
    return Evaluation(individuals=individuals, fitness=((individuals - 0.5) ** 2).sum(axis=1))


def test_selection_probability_is_inverse_to_fitness() -> None:
    # 1/F = 1, 0.5, 0.25: divided by their sum, 1.75.
    assert selection_probabilities(np.array([1.0, 2.0, 4.0])) == pytest.approx([4 / 7, 2 / 7, 1 / 7], abs=1e-15)


@pytest.mark.parametrize("fitness", [[0.0, 1.0], [5e-324, 1e-300], [1e-320, 1e300]])
def test_selection_survives_fitnesses_whose_inverse_overflows(fitness: list[float]) -> None:
    probabilities = selection_probabilities(np.array(fitness))
    assert probabilities.sum() == pytest.approx(1.0)
    assert probabilities[0] > 0.99


def test_roulette_draws_in_proportion() -> None:
    individuals = np.arange(3.0)[:, None]
    evaluation = Evaluation(individuals=individuals, fitness=np.array([1.0, 2.0, 4.0]))
    rng = np.random.default_rng(7)
    drawn = np.concatenate([select(evaluation, rng) for _ in range(4000)])
    shares = np.bincount(drawn[:, 0].astype(int)) / drawn.size
    # 12,000 draws: a share's standard deviation is at most 0.0045, and 0.018 is four of them.
    assert shares == pytest.approx([4 / 7, 2 / 7, 1 / 7], abs=0.018)


@given(seed=st.integers(0, 1000))
def test_crossover_keeps_each_genes_sum_and_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    population = rng.uniform(-1, 1, (6, 4))
    before = population.copy()
    cross(population, rng)
    # Both lines of eq. (9) added: a'_mk + a'_nk = a_mk + a_nk; and each is a mean of the two.
    assert population.sum(axis=0) == pytest.approx(before.sum(axis=0), abs=1e-13)
    assert (population <= before.max(axis=0) + 1e-15).all()
    assert (population >= before.min(axis=0) - 1e-15).all()
    assert not np.array_equal(population, before)


def test_mutation_as_meant_goes_both_ways_and_stays_within_the_population() -> None:
    rng = np.random.default_rng(8)
    raised = lowered = 0
    for _ in range(50):
        population = rng.uniform(-1, 1, (10, 3))
        before = population.copy()
        mutate(population, 0.2, MutationForm.AS_MEANT, rng)
        raised += int((population > before).sum())
        lowered += int((population < before).sum())
        assert (population <= before.max(axis=0) + 1e-15).all()
        assert (population >= before.min(axis=0) - 1e-15).all()
    # About 400 changed genes, of which a half goes up: six standard deviations are 60.
    assert abs(raised - lowered) < 120


def test_mutation_as_printed_only_ever_lowers() -> None:
    rng = np.random.default_rng(8)
    population = rng.uniform(-1, 1, (10, 3))
    before = population.copy()
    mutate(population, 0.2, MutationForm.AS_PRINTED, rng)
    assert (population <= before).all()
    assert (population < before).any()


class ScriptedDraws:
    """A generator that hands out what it is given, in order."""

    def __init__(self, *, integers: list[int], uniforms: list[float]) -> None:
        self._integers, self._uniforms = iter(integers), iter(uniforms)

    def integers(self, _high: int) -> int:
        return next(self._integers)

    def uniform(self) -> float:
        return next(self._uniforms)


@pytest.mark.parametrize(
    ("form", "r", "expected"),
    [
        # Gene values 1, 2, 5; a = 2, r_e = 0.5, e / e_max = 0.5, so f = 0.5 · 0.25 = 0.125.
        (MutationForm.AS_MEANT, 0.9, 2 + (5 - 2) * 0.125),
        (MutationForm.AS_MEANT, 0.5, 2 + (1 - 2) * 0.125),
        (MutationForm.AS_PRINTED, 0.9, 2 + (2 - 5) * 0.125),
        (MutationForm.AS_PRINTED, 0.5, 2 + (1 - 2) * 0.125),
    ],
)
def test_mutation_follows_equation_10(form: MutationForm, r: float, expected: float) -> None:
    population = np.array([[1.0], [2.0], [5.0]])
    # The individual of value 2 is mutated by f; the two that follow have r_e = 0 and stay.
    draws = ScriptedDraws(integers=[1, 0, 0, 0, 2, 0], uniforms=[r, 0.5, 0.9, 0.0, 0.9, 0.0])
    mutate(population, 0.5, form, draws)  # pyright: ignore[reportArgumentType]
    assert population[:, 0] == pytest.approx([1.0, expected, 5.0], abs=1e-15)


def test_mutation_has_faded_in_the_last_generation() -> None:
    population = np.random.default_rng(9).uniform(-1, 1, (5, 3))
    before = population.copy()
    mutate(population, 1.0, MutationForm.AS_MEANT, np.random.default_rng(10))
    assert np.array_equal(population, before)


def test_evolution_finds_better_individuals_and_never_forgets_the_best() -> None:
    seen: list[Evaluation] = []

    def watched(individuals: Floats) -> Evaluation:
        evaluation = sphere(individuals)
        seen.append(Evaluation(individuals=individuals.copy(), fitness=evaluation.fitness.copy()))
        return evaluation

    evolution = evolve(watched, genes=4, options=GeneticOptions(), rng=np.random.default_rng(11))
    assert len(seen) == 26
    assert all(evaluation.individuals.shape == (30, 4) for evaluation in seen)
    best_of_each = np.array([evaluation.fitness.min() for evaluation in seen])
    assert evolution.history == pytest.approx(np.minimum.accumulate(best_of_each), abs=0)
    assert evolution.best_fitness == best_of_each.min()
    assert sphere(evolution.best[None]).fitness[0] == evolution.best_fitness
    assert evolution.best_fitness < 0.5 * best_of_each[0]


def test_first_individuals_fill_the_initial_range() -> None:
    populations: list[Floats] = []

    def watched(individuals: Floats) -> Evaluation:
        populations.append(individuals.copy())
        return sphere(individuals)

    evolve(watched, genes=500, options=GeneticOptions(generations=0), rng=np.random.default_rng(12))
    (first,) = populations
    assert np.abs(first).max() <= 1.0
    # 15,000 draws: the chance that none lies beyond 0.99 on a given side is e^-75.
    assert first.max() > 0.99
    assert first.min() < -0.99


def test_the_same_generator_gives_the_same_evolution() -> None:
    runs = [evolve(sphere, genes=4, options=GeneticOptions(), rng=np.random.default_rng(s)) for s in (13, 13, 14)]
    assert np.array_equal(runs[0].best, runs[1].best)
    assert not np.array_equal(runs[0].best, runs[2].best)


def test_progress_counts_evaluated_populations() -> None:
    told: list[tuple[int, int]] = []
    evolve(
        sphere,
        genes=2,
        options=GeneticOptions(individuals=4, generations=3),
        rng=np.random.default_rng(15),
        progress=lambda done, total: told.append((done, total)),
    )
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0])
def test_a_fitness_that_is_no_error_is_refused(bad: float) -> None:
    def broken(individuals: Floats) -> Evaluation:
        fitness = np.ones(len(individuals))
        fitness[3] = bad
        return Evaluation(individuals=individuals, fitness=fitness)

    with pytest.raises(ValueError, match="fitness of individual 3"):
        evolve(broken, genes=2, options=GeneticOptions(), rng=np.random.default_rng(16))


def test_one_individual_is_enough_only_without_generations() -> None:
    GeneticOptions(individuals=1, generations=0)
    with pytest.raises(ValueError, match="2 or more individuals"):
        GeneticOptions(individuals=1)
