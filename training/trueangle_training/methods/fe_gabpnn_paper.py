"""The paper's method, FE-GABPNN: Fourier series at one temperature, network started by a genetic algorithm.

Jia et al. 2020 (Sensors 20, 2603), sections 3.1-3.3. The Fourier series takes the error at the base temperature, a
2-n-1 network of temperature and angle what temperature adds to it:

    E(θ, T) = Fourier(θ) + span · network((T - T_min) / T_range, (θ - θ_min) / θ_range) + offset

The paper subtracts the mean readings of each face from the targets, and its series of orders 0-11 passes through
those 23 means. Here the series' own value at each reading's angle is subtracted. Where it passes through the means
this is the same; with other angles, or angles that differ by counts, it keeps the sum true to what is served.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import torch
from numpy.typing import NDArray

from trueangle.contract.document import plain
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.units import wrap_deg
from trueangle_training.fourier import Floats, FourierSeries
from trueangle_training.genetic import Evaluation, Evolution, GeneticOptions, evolve
from trueangle_training.levenberg_marquardt import (
    LevenbergMarquardtOptions,
    StopReason,
    levenberg_marquardt,
)
from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.base_series import fit_base_series
from trueangle_training.network import NetworkFit, hidden_node_count, parameter_count

Rows = NDArray[np.int64]
LETTER = "the paper's method, eqs. (1)-(10) to the letter but for the misprint in (10)"
"""True of the default options."""
NO_BASE = FourierSeries(constant_arcsec=0.0, sine_arcsec=(0.0,), cosine_arcsec=(0.0,))


class Fitness(Enum):
    """What the genetic algorithm rates an individual by: eq. (7) over all readings, of which weights?"""

    UNTRAINED = "untrained"
    """The individual itself: the paper's text, to the letter."""
    AFTER_LM = "after_lm"
    """After `fitness_lm_steps` Levenberg-Marquardt steps from it; the start is the individual itself."""
    AFTER_LM_HANDED_ON = "after_lm_handed_on"
    """The same, and the best individual's trained weights are the start of the training."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnnOptions:
    """The paper's settings, and those it leaves open."""

    base_temperature_c: float = 20.0
    datum_deg: float = 0.0
    """Where errors are counted from: the first face. In [0, 360)."""
    order: int | None = None
    """Harmonics of the base; None: min(11, (distinct angles - 1) // 2), as many as the angles allow."""
    fourier_base: bool = True
    """False: the network is given the whole error, the paper's BPNN."""
    hidden_nodes: int = 20
    genetic: GeneticOptions = field(default_factory=GeneticOptions)
    fitness: Fitness = Fitness.UNTRAINED
    """On simulated joints of 483 readings UNTRAINED, the text's reading, gains nothing over random weights.
    AFTER_LM takes a tenth off the true error and cuts the outliers, as picking the best of 780 random starts does;
    4 s instead of 0.1 s."""
    fitness_lm_steps: int = 20
    training: LevenbergMarquardtOptions = field(default_factory=LevenbergMarquardtOptions)
    """Epochs, patience and damping of the training proper."""
    validation_fraction: float = 0.1
    seed: int = 0
    threads: int | None = 1
    """Threads torch may use, set for the time of the training; None leaves torch as it is."""

    def __post_init__(self) -> None:
        ranges = (
            ("base_temperature_c", bool(np.isfinite(self.base_temperature_c)), "a finite temperature"),
            ("datum_deg", 0.0 <= self.datum_deg < 360.0, "0 to below 360"),
            ("order", self.order is None or self.order >= 1, "1 or more, or None"),
            ("hidden_nodes", self.hidden_nodes >= 1, "1 or more"),
            ("fitness_lm_steps", self.fitness_lm_steps >= 1, "1 or more"),
            ("validation_fraction", 0.0 < self.validation_fraction < 1.0, "above 0 and below 1"),
            ("threads", self.threads is None or self.threads >= 1, "1 or more, or None"),
        )
        faults = [
            Fault(where=name, expected=expected, found=str(getattr(self, name)))
            for name, legal, expected in ranges
            if not legal
        ]
        if faults:
            raise ContractError(faults)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """Eq. (6) for one quantity: scaled = (value - minimum) / span."""

    minimum: float
    span: float
    """Maximum minus minimum, above 0."""

    @staticmethod
    def of(values: Floats) -> "Scaling":
        """The scaling that takes the values to [0, 1]; a constant is taken to 0."""
        minimum = float(values.min())
        span = float(values.max()) - minimum
        return Scaling(minimum=minimum, span=span if span > 0.0 else 1.0)

    def scaled(self, values: Floats) -> Floats:
        """Values as the network sees them."""
        return (values - self.minimum) / self.span


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnnModel:
    """A trained model: an `ErrorModel` in NumPy, and all that the exported graph is made of."""

    base: FourierSeries
    """Error at the base temperature."""
    parameters: tuple[float, ...]
    """The network's 4 n + 1 parameters in the order of `network`."""
    angle_scaling: Scaling
    temperature_scaling: Scaling
    target_scaling: Scaling
    """Of what the network is trained to give, in arcsec."""
    datum_deg: float

    @property
    def temperature_used(self) -> bool:
        """Always: it is an input of the network."""
        return True

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> None:
        """None: the paper's method gives no uncertainty."""

    @property
    def hidden_nodes(self) -> int:
        """Hidden nodes of the network."""
        return hidden_node_count(len(self.parameters))

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """E(θ, T) - E(datum, T) at each pair, shape [n]; exactly 0 at the datum, whatever the temperature.

        The offset of eq. (6) and φ drop out of the difference.
        """
        angle_deg = wrap_deg(np.asarray(angle_deg, dtype=np.float64))
        datum_deg = np.full_like(angle_deg, self.datum_deg)
        activation = self._activation(angle_deg, temperature_c) - self._activation(datum_deg, temperature_c)
        nodes = self.hidden_nodes
        output_weights = np.array(self.parameters[3 * nodes : 4 * nodes])
        thermal = activation @ output_weights * self.target_scaling.span
        steady = self.base.evaluate(angle_deg) - self.base.evaluate(datum_deg)
        # Zero by rule: equal roundings on both sides of a difference are not promised.
        return np.where(angle_deg == self.datum_deg, 0.0, steady + thermal)

    def _activation(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """b_h of eqs. (2) and (4), shape [n, hidden nodes]."""
        by_temperature, by_angle, bias = np.array(self.parameters[: 3 * self.hidden_nodes]).reshape(3, -1)
        scaled_temperature = self.temperature_scaling.scaled(temperature_c)
        scaled_angle = self.angle_scaling.scaled(angle_deg)
        argument = np.multiply.outer(scaled_temperature, by_temperature)
        argument += np.multiply.outer(scaled_angle, by_angle) - bias
        return np.tanh(argument)


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnnTraining:
    """A model and how it came about."""

    model: FeGabpnnModel
    residual_rms_arcsec: float
    """Of all readings, from E(θ, T) itself: the paper's figure. It says little of the true error."""
    validation_rms_arcsec: float
    training_readings: int
    validation_readings: int
    epochs: int
    stop_reason: StopReason
    genetic_start_rms_arcsec: float
    """Root of the smallest fitness among the first, random individuals."""
    genetic_best_rms_arcsec: float
    """Root of the smallest fitness of all generations: what the genetic algorithm made of it."""


def train_fe_gabpnn(
    readings: TrainingReadings,
    options: FeGabpnnOptions,
    progress: Callable[[int, int], None] | None = None,
) -> FeGabpnnTraining:
    """Train on one joint's readings: the same readings, options and machine give the same model to the last bit.

    `progress` is told (steps done, all steps); steps are generations and the training. UnsuitableReadingsError
    lists what the readings lack.
    """
    threads_before = torch.get_num_threads()
    if options.threads is not None:
        torch.set_num_threads(options.threads)
    try:
        return _train(readings, options, progress)
    finally:
        torch.set_num_threads(threads_before)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """What the network is to learn, scaled by eq. (6), and the model around it."""

    base: FourierSeries
    angle_scaling: Scaling
    temperature_scaling: Scaling
    target_scaling: Scaling
    inputs: torch.Tensor
    target: torch.Tensor

    def fit(self, rows: Rows) -> NetworkFit:
        index = torch.from_numpy(rows)
        return NetworkFit(inputs=self.inputs[index], target=self.target[index])

    @property
    def all_readings(self) -> NetworkFit:
        return NetworkFit(inputs=self.inputs, target=self.target)

    def rms_arcsec(self, mean_square: float) -> float:
        return mean_square**0.5 * self.target_scaling.span


def _train(
    readings: TrainingReadings, options: FeGabpnnOptions, progress: Callable[[int, int], None] | None
) -> FeGabpnnTraining:
    problem = _pose(readings, options)
    rng = np.random.default_rng(options.seed)
    training_rows, validation_rows = _split(len(readings), options.validation_fraction, rng)
    training, validation = problem.fit(training_rows), problem.fit(validation_rows)
    steps = options.genetic.generations + 2
    started = _Initialisation(problem=problem, training=training, options=options)
    evolution = evolve(
        started.evaluate,
        genes=parameter_count(options.hidden_nodes),
        options=options.genetic,
        rng=rng,
        progress=None if progress is None else lambda done, _: progress(done, steps),
    )
    start = torch.from_numpy(started.start_of(evolution))[None]
    outcome = levenberg_marquardt(training, start, options.training, validation)
    if progress is not None:
        progress(steps, steps)
    return FeGabpnnTraining(
        model=FeGabpnnModel(
            base=problem.base,
            parameters=tuple(outcome.parameters[0].tolist()),
            angle_scaling=problem.angle_scaling,
            temperature_scaling=problem.temperature_scaling,
            target_scaling=problem.target_scaling,
            datum_deg=options.datum_deg,
        ),
        residual_rms_arcsec=problem.rms_arcsec(problem.all_readings.mean_square(outcome.parameters).item()),
        validation_rms_arcsec=problem.rms_arcsec(validation.mean_square(outcome.parameters).item()),
        training_readings=training_rows.size,
        validation_readings=validation_rows.size,
        epochs=outcome.epochs[0],
        stop_reason=outcome.stop_reasons[0],
        genetic_start_rms_arcsec=problem.rms_arcsec(float(evolution.history[0])),
        genetic_best_rms_arcsec=problem.rms_arcsec(evolution.best_fitness),
    )


def _pose(readings: TrainingReadings, options: FeGabpnnOptions) -> _Problem:
    """The Fourier base, eq. (1), and the scaled remainder that is left to the network."""
    angle_deg = wrap_deg(readings.angle_deg)
    if options.fourier_base:
        base = fit_base_series(readings, base_temperature_c=options.base_temperature_c, order=options.order)
    else:
        base = NO_BASE
    remainder_arcsec = readings.error_arcsec - base.evaluate(angle_deg)
    angle_scaling, temperature_scaling = Scaling.of(angle_deg), Scaling.of(readings.temperature_c)
    target_scaling = Scaling.of(remainder_arcsec)
    inputs = np.stack(
        [temperature_scaling.scaled(readings.temperature_c), angle_scaling.scaled(angle_deg)], axis=1
    )
    return _Problem(
        base=base,
        angle_scaling=angle_scaling,
        temperature_scaling=temperature_scaling,
        target_scaling=target_scaling,
        inputs=torch.from_numpy(inputs),
        target=torch.from_numpy(target_scaling.scaled(remainder_arcsec)),
    )


def _split(readings: int, validation_fraction: float, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Rows for training and for validation: at random, at least one of each."""
    order = rng.permutation(readings)
    kept_apart = min(max(round(validation_fraction * readings), 1), readings - 1)
    return np.sort(order[kept_apart:]), np.sort(order[:kept_apart])


class _Initialisation:
    """Rates individuals, and knows which weights the best of them hands to the training."""

    def __init__(self, *, problem: _Problem, training: NetworkFit, options: FeGabpnnOptions) -> None:
        self._rated_on = problem.all_readings
        self._trained_on = training
        self._fitness = options.fitness
        self._steps = LevenbergMarquardtOptions(
            max_epochs=options.fitness_lm_steps,
            initial_damping=options.training.initial_damping,
            accepted_factor=options.training.accepted_factor,
            rejected_factor=options.training.rejected_factor,
        )

    def evaluate(self, individuals: Floats) -> Evaluation:
        """Eq. (7) over all readings, those kept apart for validation included, as the paper has it."""
        parameters = torch.from_numpy(individuals)
        if self._fitness is not Fitness.UNTRAINED:
            parameters = self._after_steps(parameters)
        return Evaluation(individuals=individuals, fitness=self._rated_on.mean_square(parameters).numpy())

    def start_of(self, evolution: Evolution) -> Floats:
        """The training's initial parameters, [4 n + 1]."""
        if self._fitness is not Fitness.AFTER_LM_HANDED_ON:
            return evolution.best
        return self._after_steps(torch.from_numpy(evolution.best)[None])[0].numpy()

    def _after_steps(self, parameters: torch.Tensor) -> torch.Tensor:
        return levenberg_marquardt(self._trained_on, parameters, self._steps).parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class FeGabpnnPaper:
    """The `Method` of the paper; seed and datum of `options` give way to those of each fit."""

    options: FeGabpnnOptions = field(default_factory=FeGabpnnOptions)
    name: str = "fe-gabpnn-paper"
    summary: str = LETTER

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Train once; see `train_fe_gabpnn`."""
        options = replace(self.options, seed=seed, datum_deg=readings.datum_deg)
        training = train_fe_gabpnn(readings, options, progress)
        stopped = f"stopped after {training.epochs} epochs: {training.stop_reason.value}"
        residuals = (
            f"residuals as the paper counts them, in-sample: {training.residual_rms_arcsec:.3f} arcsec RMS; of "
            "the random readings kept back to stop the training, at the same angles and temperatures: "
            f"{training.validation_rms_arcsec:.3f} arcsec RMS"
        )
        notes = (*_departures(options), stopped, residuals)
        return Fit(model=training.model, notes=notes, settings=plain(options))


def _departures(options: FeGabpnnOptions) -> tuple[str, ...]:
    """Where the genetic algorithm is not the paper's text."""
    notes: list[str] = []
    if options.fitness is not Fitness.UNTRAINED:
        handed_on = ", which hands its trained weights on" if options.fitness is Fitness.AFTER_LM_HANDED_ON else ""
        notes.append(
            f"not eq. (7) to the letter: individuals are rated after {options.fitness_lm_steps} "
            f"Levenberg-Marquardt steps{handed_on}"
        )
    if options.genetic.parameter_bound is not None:
        bound = f"{options.genetic.parameter_bound:g}"
        notes.append(
            f"not eq. (10) to the letter: its bounds are -{bound} and {bound}, not the population's extremes"
        )
    return tuple(notes)


def make(base_temperature_c: float) -> FeGabpnnPaper:
    """The method with the paper's settings."""
    return FeGabpnnPaper(options=FeGabpnnOptions(base_temperature_c=base_temperature_c))
