"""The genetic algorithm of `genetic` for many repeated trials at once: one batch of individuals a generation.

The same algorithm, eqs. (7)-(10), with the trials along a leading axis: the operators of one trial never look at
another, and all individuals of all trials are rated together.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.genetic import GeneticOptions, MutationForm

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialEvolutions:
    """The outcome of every trial."""

    best: Floats
    """[trials, genes] of the individual with the smallest fitness of all generations."""
    best_fitness: Floats
    """[trials]"""
    first_fitness: Floats
    """[trials]: the smallest among the first, random individuals."""


def evolve_trials(
    evaluate: Callable[[Floats], Floats],
    *,
    trials: int,
    genes: int,
    options: GeneticOptions,
    rng: np.random.Generator,
) -> TrialEvolutions:
    """Evolve all trials; `evaluate` rates [trials, individuals, genes] by fitness [trials, individuals]."""
    shape = (trials, options.individuals, genes)
    population = rng.uniform(-options.initial_range, options.initial_range, shape)
    every = np.arange(trials)
    fitness = evaluate(population)
    fittest = fitness.argmin(axis=1)
    best, best_fitness = population[every, fittest], fitness[every, fittest]
    first_fitness = best_fitness.copy()
    for generation in range(1, options.generations + 1):
        population = select_in_trials(population, fitness, rng)
        cross_in_trials(population, rng)
        mutate_in_trials(population, generation / options.generations, options.mutation_form, rng)
        fitness = evaluate(population)
        fittest = fitness.argmin(axis=1)
        better = fitness[every, fittest] < best_fitness
        best[better] = population[every, fittest][better]
        best_fitness[better] = fitness[every, fittest][better]
    return TrialEvolutions(best=best, best_fitness=best_fitness, first_fitness=first_fitness)


def select_in_trials(population: Floats, fitness: Floats, rng: np.random.Generator) -> Floats:
    """Roulette on 1/F within each trial, eq. (8)."""
    trials, count = fitness.shape
    floor = np.maximum(fitness, np.finfo(np.float64).tiny)
    worth = floor.min(axis=1, keepdims=True) / floor
    wheel = np.cumsum(worth, axis=1)
    spin = rng.uniform(size=(trials, count, 1)) * wheel[:, None, -1:]
    chosen = np.minimum((spin >= wheel[:, None, :]).sum(axis=2), count - 1)
    return population[np.arange(trials)[:, None], chosen]


def cross_in_trials(population: Floats, rng: np.random.Generator) -> None:
    """As many one-gene arithmetic crossovers as individuals in each trial, in place, eq. (9)."""
    trials, count, genes = population.shape
    every = np.arange(trials)
    first = rng.integers(count, size=(count, trials))
    # The second is any individual but the first.
    second = (first + rng.integers(1, count, size=(count, trials))) % count
    gene = rng.integers(genes, size=(count, trials))
    weight = rng.uniform(size=(count, trials))
    for m, n, k, w in zip(first, second, gene, weight, strict=True):
        one, other = population[every, m, k], population[every, n, k]
        population[every, m, k] = one * (1.0 - w) + other * w
        population[every, n, k] = other * (1.0 - w) + one * w


def mutate_in_trials(population: Floats, elapsed: float, form: MutationForm, rng: np.random.Generator) -> None:
    """As many one-gene mutations as individuals in each trial, in place, eq. (10); `elapsed` is e / e_max."""
    trials, count, genes = population.shape
    every = np.arange(trials)
    individual = rng.integers(count, size=(count, trials))
    gene = rng.integers(genes, size=(count, trials))
    upwards = rng.uniform(size=(count, trials)) > 0.5
    extent = rng.uniform(size=(count, trials)) * (1.0 - elapsed) ** 2
    for i, k, up, f in zip(individual, gene, upwards, extent, strict=True):
        column = population[every, :, k]
        value = population[every, i, k]
        largest, smallest = column.max(axis=1), column.min(axis=1)
        upper = largest - value if form is MutationForm.AS_MEANT else value - largest
        population[every, i, k] = value + np.where(up, upper, smallest - value) * f
