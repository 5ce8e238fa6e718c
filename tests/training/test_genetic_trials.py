"""The genetic algorithm over many trials at once keeps the rules of the single one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from trueangle_training.genetic import GeneticOptions, MutationForm
from trueangle_training.genetic_trials import (
    cross_in_trials,
    evolve_trials,
    mutate_in_trials,
    select_in_trials,
)

Floats = NDArray[np.float64]


def sphere(population: Floats) -> Floats:
    """Squared distance from (0.5, 0.5, ...), [trials, individuals]."""
    return ((population - 0.5) ** 2).sum(axis=2)


def test_roulette_draws_in_proportion_within_each_trial() -> None:
    population = np.tile(np.arange(3.0)[:, None], (2, 1, 1)) + np.array([0.0, 10.0])[:, None, None]
    fitness = np.array([[1.0, 2.0, 4.0], [4.0, 2.0, 1.0]])
    rng = np.random.default_rng(1)
    drawn = np.concatenate([select_in_trials(population, fitness, rng) for _ in range(4000)], axis=1)[:, :, 0]
    for trial, shares in enumerate(([4 / 7, 2 / 7, 1 / 7], [1 / 7, 2 / 7, 4 / 7])):
        counted = np.bincount((drawn[trial] - 10.0 * trial).astype(int), minlength=3) / drawn.shape[1]
        # 12,000 draws: four standard deviations are 0.018. Other trials' individuals would fall outside 0 to 2.
        assert counted == pytest.approx(shares, abs=0.018)


def test_crossover_keeps_each_genes_sum_within_its_trial() -> None:
    rng = np.random.default_rng(2)
    population = rng.uniform(-1, 1, (5, 6, 4))
    before = population.copy()
    cross_in_trials(population, rng)
    # Both lines of eq. (9) added.
    np.testing.assert_allclose(population.sum(axis=1), before.sum(axis=1), atol=1e-13)
    assert (population <= before.max(axis=1, keepdims=True) + 1e-15).all()
    assert not np.array_equal(population, before)


@pytest.mark.parametrize("form", list(MutationForm))
def test_mutation_goes_both_ways_as_meant_and_only_down_as_printed(form: MutationForm) -> None:
    rng = np.random.default_rng(3)
    population = rng.uniform(-1, 1, (40, 10, 3))
    before = population.copy()
    mutate_in_trials(population, 0.2, form, rng)
    raised = int((population > before).sum())
    assert (population < before).sum() > 50
    if form is MutationForm.AS_MEANT:
        assert raised > 50
        assert (population <= before.max(axis=1, keepdims=True) + 1e-15).all()
        assert (population >= before.min(axis=1, keepdims=True) - 1e-15).all()
    else:
        assert raised == 0


def test_mutation_has_faded_in_the_last_generation() -> None:
    population = np.random.default_rng(4).uniform(-1, 1, (3, 5, 3))
    before = population.copy()
    mutate_in_trials(population, 1.0, MutationForm.AS_MEANT, np.random.default_rng(5))
    assert np.array_equal(population, before)


def test_each_trial_keeps_its_best_ever() -> None:
    seen: list[Floats] = []

    def watched(population: Floats) -> Floats:
        fitness = sphere(population)
        seen.append(fitness.min(axis=1))
        return fitness

    options = GeneticOptions()
    evolved = evolve_trials(watched, trials=4, genes=5, options=options, rng=np.random.default_rng(6))
    assert len(seen) == options.generations + 1
    np.testing.assert_array_equal(evolved.best_fitness, np.min(seen, axis=0))
    np.testing.assert_array_equal(evolved.first_fitness, seen[0])
    np.testing.assert_allclose(sphere(evolved.best[:, None])[:, 0], evolved.best_fitness, atol=1e-15)
    assert (evolved.best_fitness < 0.7 * evolved.first_fitness).all()


def test_no_generation_is_the_best_of_random_starts() -> None:
    options = GeneticOptions(individuals=780, generations=0)
    evolved = evolve_trials(sphere, trials=2, genes=2, options=options, rng=np.random.default_rng(7))
    np.testing.assert_array_equal(evolved.best_fitness, evolved.first_fitness)
    # 780 points in a square of area 4: the nearest within 0.1 but for exp(-780 pi 0.01 / 4) = 0.2 %.
    assert (evolved.best_fitness < 0.01).all()
