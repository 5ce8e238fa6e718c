"""Tables 1 and 2 and Figures 7 to 10 of Jia et al. 2020 on one simulated campaign."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle_training.genetic import GeneticOptions, MutationForm
from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.base_series import fit_base_series
from trueangle_training.methods.fe_gabpnn_paper import Fitness
from trueangle_training.methods.fepf import Fepf
from trueangle_training.methods.harmonics_poly import HIGHEST_ORDER, HarmonicsPoly
from trueangle_training.methods.least_squares import Constant, fit_harmonics_times_powers
from trueangle_training.methods.poly2d import Poly2d, fit_poly2d
from trueangle_training.reproduction.network_trials import (
    BASE_TEMPERATURE_C,
    NetworkRecipe,
    NetworkTrials,
    train_trials,
    trial_starts,
)
from trueangle_training.reproduction.nominal_campaign import NominalCampaign

Floats = NDArray[np.float64]

HIDDEN_NODES = 20
BPNN_HIDDEN_NODES = 25
FIGURE_8_NODES = (5, 10, 15, 20, 25, 30)
"""The figure's own sizes cannot be read from the text."""


class Row(Enum):
    """The rows of both tables, each reading of the text a row of its own."""

    UNTRAINED = "FE-GABPNN, fitness of the untrained weights"
    AS_PRINTED = "FE-GABPNN, the same, eq. (10) as printed"
    AFTER_LM = "FE-GABPNN, fitness after 20 LM steps"
    HANDED_ON = "FE-GABPNN, the same, trained weights handed on"
    FE_BPNN = "FE-BPNN"
    BPNN = "BPNN, 25 nodes"
    POLY2D = "2-D polynomial, degree 5"
    FEPF = "FEPF, orders 0-7, degree 5"
    NONE = "no correction"
    ANGLE_ONLY = "harmonics 0-11 at the base temperature, temperature ignored"
    HARMONICS_POLY = "harmonics 0-11, degree 2 in temperature (the 2019 idea)"


FITNESS_ROWS: Mapping[Fitness, Row] = {
    Fitness.UNTRAINED: Row.UNTRAINED,
    Fitness.AFTER_LM: Row.AFTER_LM,
    Fitness.AFTER_LM_HANDED_ON: Row.HANDED_ON,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentOptions:
    """How much is repeated."""

    trials: int = 20
    fitness: Fitness = Fitness.AFTER_LM
    """The reading of eq. (7) that Fig. 9 shows. All but UNTRAINED also make the two rows whose genetic algorithm
    rates trained weights: a minute instead of seconds."""
    multistart_after_lm: bool = False
    """Whether the 20-step fitness is also compared with plain multistart, which doubles its time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """In-sample residuals of one row, each value a trial (one for the methods without chance), in arcsec."""

    rmse: tuple[float, ...]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedTrials:
    """In-sample RMSE of one trial each with the same split: genetic algorithm and as many random starts."""

    genetic_rmse: tuple[float, ...]
    multistart_rmse: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseSeedResult:
    """Everything of one noise seed, in arcsec."""

    seed: int
    rows: Mapping[str, Residuals]
    """By the name of a `Row`."""
    hidden_rmse: tuple[tuple[float, ...], ...]
    """Fig. 8: [sizes of FIGURE_8_NODES][trials], fitness of the untrained weights."""
    multistart: Mapping[str, PairedTrials]
    """By the value of a `Fitness`."""
    mean_error: tuple[tuple[float, ...], ...]
    """Fig. 7: [temperatures][faces]."""
    network_residuals: tuple[float, ...]
    """Fig. 9: one trial of FE-GABPNN, [readings]."""
    polynomial_residuals: tuple[float, ...]
    """Fig. 10: [readings]."""

    @property
    def raw_range(self) -> tuple[float, float]:
        """Smallest and largest mean error of a face."""
        mean = np.array(self.mean_error)
        return float(mean.min()), float(mean.max())

    def thermal_range(self, base: int) -> tuple[float, float]:
        """Smallest and largest change of a face's mean error from temperature number `base`."""
        change = np.array(self.mean_error) - np.array(self.mean_error)[base]
        return float(change.min()), float(change.max())


def run_experiment(campaign: NominalCampaign, options: ExperimentOptions, seed: int) -> NoiseSeedResult:
    """All rows and figures; the same campaign, options and seed give the same numbers on one machine."""
    genetic = GeneticOptions()
    printed = GeneticOptions(mutation_form=MutationForm.AS_PRINTED)
    recipes = {
        Row.UNTRAINED: _fourier_recipe(genetic),
        Row.AS_PRINTED: _fourier_recipe(printed),
        Row.FE_BPNN: NetworkRecipe(hidden_nodes=HIDDEN_NODES, fourier_base=True),
        Row.BPNN: NetworkRecipe(hidden_nodes=BPNN_HIDDEN_NODES, fourier_base=False),
    }
    trained = {
        row: train_trials(campaign, each, trials=options.trials, seed=seed) for row, each in recipes.items()
    }
    if options.fitness is not Fitness.UNTRAINED:
        trained |= _after_lm_rows(campaign, options, seed)
    polynomial, fepf = _surface_residuals(campaign)
    baselines = _baseline_residuals(campaign)
    rows = {row: _residuals(each) for row, each in trained.items()}
    rows |= {Row.POLY2D: _one_residual(polynomial), Row.FEPF: _one_residual(fepf)}
    rows |= {row: _one_residual(residual) for row, residual in baselines.items()}
    shown = trained[FITNESS_ROWS[options.fitness]]
    return NoiseSeedResult(
        seed=seed,
        rows={row.name: rows[row] for row in Row if row in rows},
        hidden_rmse=_figure_8(campaign, options, seed, trained[Row.UNTRAINED]),
        multistart=_multistart(campaign, options, seed, trained),
        mean_error=tuple(map(tuple, campaign.error_arcsec.mean(axis=1).tolist())),
        network_residuals=tuple(shown.first_residual_arcsec.tolist()),
        polynomial_residuals=tuple(polynomial.tolist()),
    )


def _fourier_recipe(genetic: GeneticOptions, fitness: Fitness = Fitness.UNTRAINED) -> NetworkRecipe:
    return NetworkRecipe(hidden_nodes=HIDDEN_NODES, fourier_base=True, genetic=genetic, fitness=fitness)


def _after_lm_rows(campaign: NominalCampaign, options: ExperimentOptions, seed: int) -> dict[Row, NetworkTrials]:
    """Both rows of the 20-step fitness: they share the genetic algorithm and differ in what it hands on."""
    recipe = _fourier_recipe(GeneticOptions(), Fitness.AFTER_LM)
    starts = trial_starts(campaign, recipe, trials=options.trials, seed=seed)
    return {
        Row.AFTER_LM: starts.train(Fitness.AFTER_LM),
        Row.HANDED_ON: starts.train(Fitness.AFTER_LM_HANDED_ON),
    }


def _multistart(
    campaign: NominalCampaign, options: ExperimentOptions, seed: int, trained: Mapping[Row, NetworkTrials]
) -> dict[str, PairedTrials]:
    """As many random starts as the genetic algorithm rates individuals, rated alike, the best trained alike."""
    genetic = GeneticOptions()
    evaluations = genetic.individuals * (genetic.generations + 1)
    starts = GeneticOptions(individuals=evaluations, generations=0)
    pairs = {}
    for fitness in Fitness:
        row = FITNESS_ROWS[fitness]
        if row not in trained or fitness is Fitness.AFTER_LM_HANDED_ON:
            continue
        if fitness is Fitness.AFTER_LM and not options.multistart_after_lm:
            continue
        rated = trial_starts(campaign, _fourier_recipe(starts, fitness), trials=options.trials, seed=seed)
        pairs[fitness.value] = _pair(trained[row], rated.train(fitness))
        if fitness is Fitness.AFTER_LM:
            handed_on = rated.train(Fitness.AFTER_LM_HANDED_ON)
            pairs[Fitness.AFTER_LM_HANDED_ON.value] = _pair(trained[Row.HANDED_ON], handed_on)
    return pairs


def _pair(genetic: NetworkTrials, multistart: NetworkTrials) -> PairedTrials:
    return PairedTrials(
        genetic_rmse=tuple(genetic.rmse_arcsec.tolist()), multistart_rmse=tuple(multistart.rmse_arcsec.tolist())
    )


def _figure_8(
    campaign: NominalCampaign, options: ExperimentOptions, seed: int, untrained: NetworkTrials
) -> tuple[tuple[float, ...], ...]:
    figures = []
    for nodes in FIGURE_8_NODES:
        if nodes == HIDDEN_NODES:
            figures.append(untrained)
        else:
            recipe = NetworkRecipe(hidden_nodes=nodes, fourier_base=True, genetic=GeneticOptions())
            figures.append(train_trials(campaign, recipe, trials=options.trials, seed=seed))
    return tuple(tuple(each.rmse_arcsec.tolist()) for each in figures)


def _surface_residuals(campaign: NominalCampaign) -> tuple[Floats, Floats]:
    """Residuals of eq. (12) and of eqs. (13)-(14), their constants included, [readings]."""
    readings = _readings(campaign)
    angle_deg, temperature_c, error_arcsec = readings.angle_deg, readings.temperature_c, readings.error_arcsec
    polynomial = fit_poly2d(readings, degree=Poly2d().degree)
    method = Fepf()
    fepf = fit_harmonics_times_powers(
        readings, order=method.order, degree=method.degree, constant=Constant.POLYNOMIAL
    )
    return error_arcsec - polynomial.value_arcsec(angle_deg, temperature_c), error_arcsec - fepf.fitted_arcsec


def _readings(campaign: NominalCampaign) -> TrainingReadings:
    angle_deg, temperature_c, error_arcsec = campaign.flat()
    run = np.repeat(np.arange(campaign.readings // campaign.angle_deg.size), campaign.angle_deg.size)
    return TrainingReadings(angle_deg=angle_deg, error_arcsec=error_arcsec, temperature_c=temperature_c, run=run)


def _baseline_residuals(campaign: NominalCampaign) -> dict[Row, Floats]:
    """What a correction must beat, counted as in the tables: from E(θ, T) itself, [readings] each."""
    readings = _readings(campaign)
    error_arcsec = readings.error_arcsec
    series = fit_base_series(readings, base_temperature_c=BASE_TEMPERATURE_C, order=None)
    harmonics_poly = fit_harmonics_times_powers(
        readings,
        order=min(HIGHEST_ORDER, (campaign.angle_deg.size - 1) // 2),
        degree=HarmonicsPoly().degree,
        constant=Constant.POLYNOMIAL,
    )
    return {
        Row.NONE: error_arcsec,
        Row.ANGLE_ONLY: error_arcsec - series.evaluate(readings.angle_deg),
        Row.HARMONICS_POLY: error_arcsec - harmonics_poly.fitted_arcsec,
    }


def _residuals(trials: NetworkTrials) -> Residuals:
    return Residuals(
        rmse=tuple(trials.rmse_arcsec.tolist()),
        lowest=tuple(trials.lowest_arcsec.tolist()),
        highest=tuple(trials.highest_arcsec.tolist()),
    )


def _one_residual(residual: Floats) -> Residuals:
    rmse = float(np.sqrt(np.mean(residual**2)))
    return Residuals(rmse=(rmse,), lowest=(float(residual.min()),), highest=(float(residual.max()),))


def base_index(campaign: NominalCampaign) -> int:
    """Which of the campaign's temperatures is the base."""
    return int(np.flatnonzero(campaign.temperature_c == BASE_TEMPERATURE_C)[0])
