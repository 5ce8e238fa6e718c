"""FE-GABPNN in the domain of the Fourier coefficients: the default, and how it differs from the paper.

As in Jia et al. 2020: a Fourier expansion over the angle, a network with one tansig hidden layer for what
temperature does, a genetic algorithm (the paper's operators, roulette on 1/F) for its initial weights,
Levenberg-Marquardt for its training.

Unlike it: the network gives the Fourier coefficients at a temperature instead of the error at an angle and a
temperature, so the seam at 360 deg is like any other place. The constant part and one free offset a run are
estimated from all runs, not from those at 20 degC. The noise is known from the repeats; fitness is the evidence
with the output weights integrated out, so nothing is kept back for validation. And the result is the
evidence-weighted average of networks with 2, 3 and 4 hidden nodes, started by the fittest and trained.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.genetic import Evaluation, GeneticOptions, evolve
from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.coefficient_network import (
    HiddenUnits,
    OutputLayers,
    fitness,
    for_both,
    output_layers,
    train,
)
from trueangle_training.methods.linear import LinearFit, fit_linear, plan_notes, plan_settings
from trueangle_training.methods.posterior import HarmonicPosterior, spread_nodes, widened
from trueangle_training.methods.separable import TemperatureBasis
from trueangle_training.methods.temperature_kernels import ContrastLikelihood

Floats = NDArray[np.float64]

SCALE_C = 10.0
GENE_RANGE = 2.0
"""First genes are uniform within it: slopes up to one saturation in 5 degC."""
SELECTION_PRESSURE = 0.2
"""Roulette probabilities are proportional to exp(0.2 fitness): nats are too steep as they are."""
STARTS = 20
NEGLIGIBLE_WEIGHT = 1e-3
DOUBT = 0.3
"""How far the uncertainty counts on the kernels being right where the networks differ from them; without, one
network family is too sure of shapes that it cannot take."""
SURELY_BETTER_NATS = 10.0
VARIANT_NOTE = (
    "a variant of the paper's FE-GABPNN: the network gives Fourier coefficients over temperature, run offsets and "
    "noise come from all runs, and evidence takes the place of a validation set"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnnSettings:
    """Of the genetic algorithm and the average."""

    hidden_nodes: tuple[int, ...] = (2, 3, 4)
    individuals: int = 30
    generations: int = 25


DEFAULT_SETTINGS = FeGabpnnSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnn:
    """The `Method`."""

    settings: FeGabpnnSettings = DEFAULT_SETTINGS
    name: str = "fe-gabpnn"
    summary: str = "Fourier series + GA-started LM network of the coefficients over temperature"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Train; the same readings and seed give the same model."""
        linear = fit_linear(readings)
        networks = fit_networks(linear, seed=seed, settings=self.settings, progress=progress)
        settings = {
            **plan_settings(linear),
            "individuals": self.settings.individuals,
            "generations": self.settings.generations,
            "hidden_nodes": list(self.settings.hidden_nodes),
            "share_of_hidden_nodes": [round(share, 6) for share in networks.shares],
            "networks": networks.count,
        }
        notes = (VARIANT_NOTE, *plan_notes(linear))
        lead = linear.mixture.log_evidence - max(networks.log_evidence)
        if lead > SURELY_BETTER_NATS:
            doubt = (
                f"these readings speak by {lead:.0f} nats for shapes over temperature that so small a network "
                "cannot take: train with --method best and compare"
            )
            notes = (*notes, doubt)
        return Fit(model=linear.model_of(doubted(linear, networks)), notes=notes, settings=settings)


def make(base_temperature_c: float) -> FeGabpnn:
    """The method; no temperature is its base."""
    del base_temperature_c
    return FeGabpnn()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkAverage:
    """The averaged networks and what they were weighed by."""

    posterior: HarmonicPosterior
    shares: tuple[float, ...]
    """Of each number of hidden nodes."""
    log_evidence: tuple[float, ...]
    """Best fitness of each number of hidden nodes, in nats."""
    count: int
    """Networks that count in the average."""


def doubted(linear: LinearFit, networks: NetworkAverage) -> HarmonicPosterior:
    """The networks' mean, with the doubt that the kernels cast on it."""
    return widened(networks.posterior, linear.posterior, DOUBT)


def fit_networks(
    linear: LinearFit,
    *,
    seed: int = 0,
    settings: FeGabpnnSettings = DEFAULT_SETTINGS,
    progress: Progress = no_progress,
) -> NetworkAverage:
    """Evolve, train and average networks on a campaign that `linear` has reduced."""
    nodes_c = linear.data.nodes_c
    middle_c = float(nodes_c.mean())
    hidden = HiddenUnits(contrast=linear.mixture.grid.contrast, t=(nodes_c - middle_c) / SCALE_C)
    likelihood = linear.mixture.likelihood
    rng = np.random.default_rng(seed)
    populations: list[tuple[Floats, OutputLayers]] = []
    for number, units in enumerate(settings.hidden_nodes):
        starts = _evolved(likelihood, hidden, units, settings, rng)
        first = output_layers(likelihood, hidden, starts)
        scaled = first.mean / np.tile(hidden.rms(starts), 2)[:, None, :]
        trained = train(likelihood, hidden, starts, scaled)
        genes = np.concatenate([starts, trained])
        populations.append((genes, output_layers(likelihood, hidden, genes)))
        progress(number + 1, len(settings.hidden_nodes))
    best = np.array([layers.fitness.max() for _, layers in populations])
    shares = np.exp(best - best.max())
    shares /= shares.sum()
    return _averaged(linear, hidden, populations, shares, best)


def _evolved(
    likelihood: ContrastLikelihood,
    hidden: HiddenUnits,
    units: int,
    settings: FeGabpnnSettings,
    rng: np.random.Generator,
) -> Floats:
    """The fittest distinct hidden layers of all generations, [STARTS, 2 units]."""
    seen: list[Floats] = []
    worths: list[Floats] = []

    def evaluate(individuals: Floats) -> Evaluation:
        worth = fitness(likelihood, hidden, individuals * GENE_RANGE)
        seen.append(individuals.copy())
        worths.append(worth)
        reference = float(worths[0].max())
        exponent = np.clip(-SELECTION_PRESSURE * (worth - reference), -600.0, 600.0)
        return Evaluation(individuals=individuals, fitness=np.exp(exponent))

    options = GeneticOptions(individuals=settings.individuals, generations=settings.generations)
    evolve(evaluate, genes=2 * units, options=options, rng=rng)
    individuals, first = np.unique(np.concatenate(seen), axis=0, return_index=True)
    fittest = np.argsort(-np.concatenate(worths)[first], kind="stable")[:STARTS]
    return individuals[fittest] * GENE_RANGE


def _averaged(
    linear: LinearFit,
    hidden: HiddenUnits,
    populations: list[tuple[Floats, OutputLayers]],
    shares: Floats,
    best: Floats,
) -> NetworkAverage:
    """All networks of all sizes with weight exp(fitness) within a size and the size's share."""
    likelihood, orders = linear.mixture.likelihood, len(linear.data.orders)
    nodes_c = spread_nodes(linear.data.nodes_c)
    t = (nodes_c - float(linear.data.nodes_c.mean())) / SCALE_C
    ones = np.kron(np.eye(2), np.ones((t.size, 1)))
    slopes: list[Floats] = []
    offsets: list[Floats] = []
    rows: list[Floats] = []
    constant = np.zeros((orders, 2))
    mean = np.zeros((orders, 2 * t.size))
    second = np.zeros((orders, 2 * t.size, 2 * t.size))
    for (genes, layers), share in zip(populations, shares, strict=True):
        weight = np.exp(layers.fitness - layers.fitness.max())
        weight[weight < NEGLIGIBLE_WEIGHT] = 0.0
        weight *= share / weight.sum()
        design = hidden.both(genes)
        rms = hidden.rms(genes)
        middles = hidden.activation(genes, hidden.t).mean(axis=1)
        for member in np.flatnonzero(weight):
            unit_weights = layers.mean[member].reshape(orders, 2, -1) / rms[member]
            own = weight[member]
            contrasts = layers.mean[member] @ design[member].T
            fall = (likelihood.constant_slope @ contrasts[:, :, None])[:, :, 0]
            constant += own * (likelihood.constant - fall - unit_weights @ middles[member])
            slope, offset = np.split(genes[member], 2)
            slopes.append(slope)
            offsets.append(offset)
            rows.append(own * unit_weights.transpose(2, 0, 1).reshape(slope.size, -1))
            at = (hidden.activation(genes[member][None], t)[0] - middles[member]) / rms[member]
            reach = for_both(at) - ones @ likelihood.constant_slope @ design[member]
            level = likelihood.constant @ ones.T + (reach @ layers.mean[member][:, :, None])[:, :, 0]
            spread = reach @ layers.covariance[member] @ reach.swapaxes(-1, -2)
            mean += own * level
            second += own * (spread + level[:, :, None] * level[:, None, :])
    covariance = second - mean[:, :, None] * mean[:, None, :] + ones @ likelihood.constant_covariance @ ones.T
    basis = TemperatureBasis(
        centre_c=float(linear.data.nodes_c.mean()),
        scale_c=SCALE_C,
        powers=(0,),
        tanh_slope=tuple(np.concatenate(slopes).tolist()),
        tanh_offset=tuple(np.concatenate(offsets).tolist()),
    )
    posterior = HarmonicPosterior(
        basis=basis,
        weights_arcsec=np.concatenate([constant.reshape(1, -1), *rows]),
        nodes_c=nodes_c,
        covariance=covariance,
    )
    return NetworkAverage(
        posterior=posterior,
        shares=tuple(shares.tolist()),
        log_evidence=tuple(best.tolist()),
        count=len(slopes),
    )
