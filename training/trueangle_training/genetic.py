"""The paper's genetic algorithm over real-coded parameter vectors, section 3.3, eqs. (7)-(10) of Jia et al. 2020.

One generation: roulette selection on 1/F (8), as many one-gene crossovers (9) and one-gene mutations (10) as there
are individuals, then the fitness of all of them in one batch. The best individual ever seen is the result; it is
not put back into the population.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class MutationForm(Enum):
    """Two readings of eq. (10); f = r_e (1 - e / e_max)² with r_e uniform on [0, 1]."""

    AS_MEANT = "as meant"
    """a + (a_max - a) f for r > 0.5, else a + (a_min - a) f: non-uniform mutation, to both sides."""
    AS_PRINTED = "as printed"
    """a + (a - a_max) f for r > 0.5, else a + (a_min - a) f: both lower the gene, surely a misprint."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticOptions:
    """Section 4.2 of the paper; section 3.2.2 for the range.

    One individual and no generation is no genetic algorithm: random initial weights, the paper's FE-BPNN.
    """

    individuals: int = 30
    generations: int = 25
    mutation_form: MutationForm = MutationForm.AS_MEANT
    initial_range: float = 1.0
    """First genes are uniform on [-initial_range, initial_range]."""
    parameter_bound: float | None = None
    """a_max = -a_min of eq. (10); None: the largest and smallest of each gene in the population, as the paper has
    it, so that nothing leaves the range of the first genes."""

    def __post_init__(self) -> None:
        if self.generations < 0 or self.individuals < (2 if self.generations else 1) or not self.initial_range > 0:
            raise ValueError(
                "genetic algorithm: expected 2 or more individuals (1 where there are no generations), 0 or more "
                f"generations, a positive initial range; found {self.individuals}, {self.generations}, "
                f"{self.initial_range}"
            )
        if self.parameter_bound is not None and not self.initial_range <= self.parameter_bound < np.inf:
            raise ValueError(
                "genetic algorithm: expected a parameter bound of at least the initial range "
                f"({self.initial_range:g}), or None; found {self.parameter_bound:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """A population and what it is worth."""

    individuals: Floats
    """[individuals, genes] to breed on: those given, or improved ones."""
    fitness: Floats
    """[individuals], F of eq. (7): 0 or more, smaller is better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evolution:
    """The outcome of a run."""

    best: Floats
    """[genes] of the individual with the smallest fitness of all generations."""
    best_fitness: float
    history: Floats
    """[generations + 1]: smallest fitness seen up to and including each generation; the first is the start."""


def evolve(
    evaluate: Callable[[Floats], Evaluation],
    *,
    genes: int,
    options: GeneticOptions,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> Evolution:
    """Evolve individuals of `genes` genes; `evaluate` is called once for each generation with all of them.

    `progress` is told (evaluated populations, all populations). ValueError where a fitness is negative or not
    finite.
    """
    total = options.generations + 1
    start = rng.uniform(-options.initial_range, options.initial_range, (options.individuals, genes))
    history = np.empty(total)
    evaluation = _evaluated(evaluate, start)
    best, best_fitness = _fittest(evaluation)
    history[0] = best_fitness
    for generation in range(1, total):
        if progress is not None:
            progress(generation, total)
        population = select(evaluation, rng)
        cross(population, rng)
        elapsed = generation / options.generations
        mutate(population, elapsed, options.mutation_form, rng, bound=options.parameter_bound)
        evaluation = _evaluated(evaluate, population)
        candidate, fitness = _fittest(evaluation)
        if fitness < best_fitness:
            best, best_fitness = candidate, fitness
        history[generation] = best_fitness
    if progress is not None:
        progress(total, total)
    return Evolution(best=best, best_fitness=best_fitness, history=history)


def _evaluated(evaluate: Callable[[Floats], Evaluation], population: Floats) -> Evaluation:
    evaluation = evaluate(population)
    unfit = ~(np.isfinite(evaluation.fitness) & (evaluation.fitness >= 0.0))
    if unfit.any():
        raise ValueError(
            f"fitness of individual {int(np.argmax(unfit))}: expected a finite number of 0 or more, "
            f"found {evaluation.fitness[unfit][0]}"
        )
    return evaluation


def _fittest(evaluation: Evaluation) -> tuple[Floats, float]:
    index = int(np.argmin(evaluation.fitness))
    return evaluation.individuals[index].copy(), float(evaluation.fitness[index])


def selection_probabilities(fitness: Floats) -> Floats:
    """p_n of eq. (8), proportional to 1/F_n; a fitness of zero counts as the smallest normal number."""
    # Scaled by the smallest first, or 1/F of very small fitnesses would overflow to infinity.
    floor = np.maximum(fitness, np.finfo(np.float64).tiny)
    worth = floor.min() / floor
    return worth / worth.sum()


def select(evaluation: Evaluation, rng: np.random.Generator) -> Floats:
    """A new population of the same size drawn by roulette, eq. (8)."""
    count = evaluation.fitness.size
    chosen = rng.choice(count, size=count, p=selection_probabilities(evaluation.fitness))
    return evaluation.individuals[chosen]


def cross(population: Floats, rng: np.random.Generator) -> None:
    """As many arithmetic crossovers as individuals, in place, eq. (9): each of one gene of two individuals."""
    count, genes = population.shape
    for _ in range(count):
        first, second = rng.choice(count, size=2, replace=False)
        gene = rng.integers(genes)
        weight = rng.uniform()
        one, other = population[first, gene], population[second, gene]
        population[first, gene] = one * (1.0 - weight) + other * weight
        population[second, gene] = other * (1.0 - weight) + one * weight


def mutate(
    population: Floats,
    elapsed: float,
    form: MutationForm,
    rng: np.random.Generator,
    *,
    bound: float | None = None,
) -> None:
    """As many mutations as individuals, in place, eq. (10); `elapsed` is e / e_max in [0, 1].

    `bound` is a_max = -a_min; None: the gene's extremes in the population.
    """
    count, genes = population.shape
    for _ in range(count):
        individual, gene = rng.integers(count), rng.integers(genes)
        upwards = rng.uniform() > 0.5
        extent = rng.uniform() * (1.0 - elapsed) ** 2
        value = population[individual, gene]
        if upwards:
            largest = population[:, gene].max() if bound is None else bound
            reach = largest - value if form is MutationForm.AS_MEANT else value - largest
        else:
            reach = (population[:, gene].min() if bound is None else -bound) - value
        population[individual, gene] = value + reach * extent
