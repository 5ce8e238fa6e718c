"""The paper's networks, FE-GABPNN, FE-BPNN and BPNN, trained in repeated trials that run as one batch.

Each trial has its own random 90/10 split and its own initial weights (section 3.2.2); trial k of two recipes of
the same seed and data has the same split, so that recipes can be compared trial by trial.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trueangle_training.fourier import fit_fourier
from trueangle_training.genetic import GeneticOptions
from trueangle_training.genetic_trials import evolve_trials
from trueangle_training.levenberg_marquardt import LevenbergMarquardtOptions, levenberg_marquardt
from trueangle_training.methods.fe_gabpnn_paper import Fitness
from trueangle_training.network import forward, parameter_count
from trueangle_training.reproduction.grouped_fit import GroupedNetworkFit, grouped_fit
from trueangle_training.reproduction.nominal_campaign import NominalCampaign

Floats = NDArray[np.float64]

BASE_TEMPERATURE_C = 20.0
BASE_ORDER = 11
MEMBERS_IN_CACHE = 30
"""Networks trained together: their matrices JᵀJ, 52 kB each for 20 nodes, stay in the second-level cache."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRecipe:
    """One of the paper's networks, with the settings that its text leaves open."""

    hidden_nodes: int
    fourier_base: bool
    """Whether the mean error at 20 degC is taken off by a Fourier series first."""
    genetic: GeneticOptions = field(default_factory=lambda: GeneticOptions(individuals=1, generations=0))
    """One individual and no generation: random initial weights."""
    fitness: Fitness = Fitness.UNTRAINED
    fitness_lm_steps: int = 20
    training: LevenbergMarquardtOptions = field(
        default_factory=lambda: LevenbergMarquardtOptions(max_epochs=1000, max_accepted_steps=100)
    )
    """An epoch is an accepted step with the trials it took, as MATLAB's trainlm counts; 100 of them."""
    validation_fraction: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkTrials:
    """What became of the trials of one recipe on one campaign."""

    rmse_arcsec: Floats
    """[trials]: of the residuals of all readings, as in the paper's tables (in-sample)."""
    lowest_arcsec: Floats
    """[trials]: smallest residual."""
    highest_arcsec: Floats
    """[trials]: largest residual."""
    first_residual_arcsec: Floats
    """[readings] of the first trial, in the campaign's order."""
    start_fitness: Floats
    """[trials]: F of eq. (7) of what the genetic algorithm chose, in squared arcsec."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Task:
    """The readings scaled by eq. (6), grouped by temperature and face."""

    base_arcsec: Floats
    """[groups]: what the Fourier series takes."""
    inputs: Tensor
    """[groups, 2]"""
    target: Tensor
    """[groups, repeats]"""
    minimum_arcsec: float
    span_arcsec: float

    @property
    def within_square(self) -> float:
        """Sum of squares of the scaled targets about their groups' means."""
        return float((self.target - self.target.mean(dim=1, keepdim=True)).square().sum())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialStarts:
    """Trials whose initial weights are chosen and that are ready to be trained."""

    campaign: NominalCampaign
    recipe: NetworkRecipe
    task: _Task
    training: GroupedNetworkFit
    validation: GroupedNetworkFit
    chosen: Tensor
    """[trials, 4 n + 1]: the best individual of each trial."""
    fitness: Floats
    """[trials]: its fitness in squared arcsec."""

    def train(self, fitness: Fitness) -> NetworkTrials:
        """Train all trials; `fitness` says whether trained weights are handed on."""
        start = self.chosen
        if fitness is Fitness.AFTER_LM_HANDED_ON:
            start = _after_steps(self.training, start, self.recipe)
        outcome = levenberg_marquardt(self.training, start, self.recipe.training, self.validation)
        return _measured(self.task, outcome.parameters, self.campaign, self.fitness)


def train_trials(campaign: NominalCampaign, recipe: NetworkRecipe, *, trials: int, seed: int) -> NetworkTrials:
    """All trials of one recipe; the same arguments and machine give the same figures."""
    return trial_starts(campaign, recipe, trials=trials, seed=seed).train(recipe.fitness)


def trial_starts(campaign: NominalCampaign, recipe: NetworkRecipe, *, trials: int, seed: int) -> TrialStarts:
    """Split the readings and choose initial weights for every trial."""
    task = _pose(campaign, fourier_base=recipe.fourier_base)
    # Splits first and from a stream of their own: recipes of one seed share them.
    training_rows = _splits(
        task.target.shape, recipe.validation_fraction, trials, np.random.default_rng([seed, 0])
    )
    training = grouped_fit(task.inputs, task.target, training_rows)
    chosen, fitness = _choose(task, recipe, training, trials, np.random.default_rng([seed, 1]))
    return TrialStarts(
        campaign=campaign,
        recipe=recipe,
        task=task,
        training=training,
        validation=grouped_fit(task.inputs, task.target, ~training_rows),
        chosen=chosen,
        fitness=fitness,
    )


def _pose(campaign: NominalCampaign, *, fourier_base: bool) -> _Task:
    temperatures, repeats, faces = campaign.error_arcsec.shape
    base_arcsec = np.zeros(faces)
    if fourier_base:
        order = min(BASE_ORDER, (faces - 1) // 2)
        series = fit_fourier(campaign.angle_deg, campaign.mean_at_arcsec(BASE_TEMPERATURE_C), order)
        base_arcsec = series.evaluate(campaign.angle_deg)
    grid = np.meshgrid(_scaled(campaign.temperature_c), _scaled(campaign.angle_deg), indexing="ij")
    remainder = campaign.error_arcsec - base_arcsec
    minimum, span = float(remainder.min()), float(np.ptp(remainder))
    target = ((remainder - minimum) / span).transpose(0, 2, 1).reshape(-1, repeats)
    return _Task(
        base_arcsec=np.tile(base_arcsec, temperatures),
        inputs=torch.from_numpy(np.stack([axis.ravel() for axis in grid], axis=1)),
        target=torch.from_numpy(np.ascontiguousarray(target)),
        minimum_arcsec=minimum,
        span_arcsec=span,
    )


def _scaled(values: Floats) -> Floats:
    return (values - values.min()) / np.ptp(values)


def _splits(shape: torch.Size, fraction: float, trials: int, rng: np.random.Generator) -> Tensor:
    """Which readings each trial is trained on, bool [trials, groups, repeats]."""
    readings = shape.numel()
    kept_apart = round(fraction * readings)
    rows = np.ones((trials, readings), dtype=bool)
    for trial in range(trials):
        rows[trial, rng.permutation(readings)[:kept_apart]] = False
    return torch.from_numpy(rows.reshape(trials, *shape))


def _choose(
    task: _Task, recipe: NetworkRecipe, training: GroupedNetworkFit, trials: int, rng: np.random.Generator
) -> tuple[Tensor, Floats]:
    """Initial parameters [trials, 4 n + 1] and their fitness in squared arcsec."""
    genes = parameter_count(recipe.hidden_nodes)
    mean_target = task.target.mean(dim=1)
    repeats = task.target.shape[1]

    def fitness(parameters: Tensor) -> Tensor:
        squares = (forward(parameters, task.inputs) - mean_target).square().sum(dim=1)
        return (repeats * squares + task.within_square) / task.target.numel()

    def evaluate(population: Floats) -> Floats:
        individuals = population.shape[1]
        rated = np.empty(population.shape[:2])
        for members in _slices(trials * individuals):
            parameters = torch.from_numpy(population.reshape(-1, genes)[members])
            if recipe.fitness is not Fitness.UNTRAINED:
                trial_of = torch.arange(members.start, members.stop) // individuals
                parameters = _after_steps(training.of_members(trial_of), parameters, recipe)
            rated.reshape(-1)[members] = fitness(parameters).numpy()
        return rated

    evolved = evolve_trials(evaluate, trials=trials, genes=genes, options=recipe.genetic, rng=rng)
    return torch.from_numpy(evolved.best), evolved.best_fitness * task.span_arcsec**2


def _slices(members: int) -> Iterator[slice]:
    for first in range(0, members, MEMBERS_IN_CACHE):
        yield slice(first, min(first + MEMBERS_IN_CACHE, members))


def _after_steps(training: GroupedNetworkFit, parameters: Tensor, recipe: NetworkRecipe) -> Tensor:
    options = recipe.training
    steps = LevenbergMarquardtOptions(
        max_epochs=recipe.fitness_lm_steps,
        initial_damping=options.initial_damping,
        accepted_factor=options.accepted_factor,
        rejected_factor=options.rejected_factor,
    )
    return levenberg_marquardt(training, parameters, steps).parameters


def _measured(task: _Task, parameters: Tensor, campaign: NominalCampaign, start_fitness: Floats) -> NetworkTrials:
    output_arcsec = forward(parameters, task.inputs).numpy() * task.span_arcsec + task.minimum_arcsec
    temperatures, _, faces = campaign.error_arcsec.shape
    predicted = (output_arcsec + task.base_arcsec).reshape(-1, temperatures, 1, faces)
    residual = campaign.error_arcsec - predicted
    by_trial = residual.reshape(residual.shape[0], -1)
    return NetworkTrials(
        rmse_arcsec=np.sqrt(np.mean(by_trial**2, axis=1)),
        lowest_arcsec=by_trial.min(axis=1),
        highest_arcsec=by_trial.max(axis=1),
        first_residual_arcsec=by_trial[0],
        start_fitness=start_fitness,
    )
