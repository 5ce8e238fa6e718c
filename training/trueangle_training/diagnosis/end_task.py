"""What the gap costs in use: the error left after compensation by models trained in four ways.

On held-out runs, with the method `linear`: (a) no compensation, (b) a model trained in the simulator as shipped,
(c) in the simulator with what was found, (d) on the measured readings. Simulated training readings are taken at
the very angles and temperatures of the training runs, with the scatter of the floor drawn from a fixed seed that
(b) and (c) share. A simulator whose parameters are all left to be calibrated is calibrated on the training runs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.diagnosis.findings import EndTask
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import (
    Fold,
    Mask,
    calibrated,
    one_fold,
    recalibration_columns,
    run_folds,
)
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.coefficients import reduce_curves
from trueangle_training.methods.linear import fit_without_uncertainty

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

METHOD = "linear"
SEED = 20_200
ANY_TEMPERATURE_C = 20.0
MEASURE_IT = "reference"
"""The missing input of an error that is the reference's own: measure it, do not compensate it."""
MOST_ROWS_FOR_ALL_FOLDS = 2_000
FOLDS_OF_MANY = 2
"""Of many readings two folds tell the error to a few per cent."""

FoundIn = Callable[[int], Mapping[str, Floats]]
"""Of a fold's number: effect to [readings], what an attribution found that did not see that fold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compensation:
    """Which effects were found, and what a compensation by angle and temperature lacks for them."""

    effects: tuple[str, ...]
    missing_inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    """Each of the effects that cannot be compensated to what that would need."""

    @property
    def compensable(self) -> bool:
        """Whether a function of angle and temperature can express what was found, or one of several effects."""
        return not self.missing_inputs or len(self.missing_inputs) < len(set(self.effects))

    @property
    def missing_input(self) -> str | None:
        """All that is missing, in one line; None: nothing."""
        return ", ".join(dict.fromkeys(self.missing_inputs.values())) or None


def compensation_of(problem: Problem, effects: Sequence[str]) -> Compensation:
    """From the library's entries."""
    missing = {name: problem.library[name].missing_input for name in effects if name in problem.library}
    return Compensation(
        effects=tuple(effects),
        missing_inputs={name: each for name, each in missing.items() if each is not None},
    )


def end_task(
    problem: Problem,
    *,
    compensation: Compensation,
    floor_arcsec2: float,
    found_in: FoundIn | None = None,
    folds: tuple[Fold, ...] | None = None,
) -> tuple[EndTask, tuple[str, ...]]:
    """The four residuals and notes; `problem.error_arcsec` cleaned; `found_in` None: nothing was found.

    Of several effects the model with what was found learns those that a function of angle and temperature can
    express: what else it learned of one direction or speed would be wrong in the other.
    """
    folds = run_folds(problem) if folds is None else folds
    empty = EndTask(
        method=METHOD,
        compensable=compensation.compensable,
        missing_input=compensation.missing_input,
        not_compensable=compensation.missing_inputs,
    )
    if len(problem.conditions) > MOST_ROWS_FOR_ALL_FOLDS:
        folds = folds[:FOLDS_OF_MANY]
    if not folds:
        return empty, ("the end task needs two runs or more",)
    size = len(problem.conditions)
    squares: dict[str, float] = dict.fromkeys(("none", "simulator", "explained", "oracle"), 0.0)
    freedom, allowed = 0.0, np.zeros(0)
    # A model counts from the datum at every temperature, so each run of a zero group has an offset of its own.
    pairs = np.column_stack([problem.conditions.run, problem.conditions.zero_group])
    offset = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    noise = np.random.default_rng(SEED).normal(0.0, np.sqrt(floor_arcsec2), size)
    for number, fold in enumerate(folds):
        found = None if found_in is None else found_in(number)
        curves = _training_curves(problem, ~fold.left_out, found, compensation, noise)
        if not compensation.compensable:
            curves.pop("explained", None)
        predicted = {"none": np.zeros(size)}
        readings = _training(problem, ~fold.left_out)
        try:
            reduced = reduce_curves(readings, np.column_stack(list(curves.values()))[~fold.left_out])
        except UnsuitableReadingsError as error:
            return empty, (f"the end task was left out: {error.faults[0]}",)
        for name, data in zip(curves, reduced, strict=True):
            model = fit_without_uncertainty(data, datum_deg=readings.datum_deg)
            predicted[name] = model.error_arcsec(problem.conditions.angle_deg, _temperature(problem))
        for name, values in predicted.items():
            left, allowed, _ = one_fold(problem.error_arcsec - values, np.zeros((size, 0)), offset, fold.left_out)
            squares[name] += float(left @ left)
        freedom += float(allowed.sum())
    rmse = {name: float(np.sqrt(value / freedom)) for name, value in squares.items()}
    explained = compensation.compensable and found_in is not None
    return replace(
        empty,
        none_arcsec=rmse["none"],
        simulator_arcsec=rmse["simulator"],
        explained_arcsec=rmse["explained"] if explained else None,
        oracle_arcsec=rmse["oracle"],
    ), ()


def _training_curves(
    problem: Problem, inside: Mask, found: Mapping[str, Floats] | None, compensation: Compensation, noise: Floats
) -> dict[str, Floats]:
    """[readings] of what each model is trained on."""
    recalibrated = _recalibrated(problem, inside, 0.0)
    shipped = problem.nominal_arcsec if np.any(problem.nominal_arcsec) else recalibrated
    curves = {"simulator": shipped + noise, "oracle": problem.error_arcsec}
    if found is not None:
        nothing = np.zeros(len(problem))
        learned = [curve for name, curve in found.items() if name not in compensation.missing_inputs]
        whole = sum(found.values(), nothing)
        curves["explained"] = _recalibrated(problem, inside, whole) + sum(learned, nothing) + noise
    return curves


def _recalibrated(problem: Problem, inside: Mask, found: Floats | float) -> Floats:
    """[readings]: the modelled effects, calibrated on the training runs beside what was found."""
    columns = recalibration_columns(problem)
    solution = calibrated(problem.error_arcsec - found, columns, problem.conditions.zero_group, inside)
    # The datum's drift is no part of a compensation that counts from the datum.
    solution[: problem.drift.shape[1]] = 0.0
    return columns @ solution


def _temperature(problem: Problem) -> Floats:
    temperature = problem.conditions.temperature_c
    return np.full(len(problem.conditions), ANY_TEMPERATURE_C) if temperature is None else temperature


def _training(problem: Problem, inside: Mask) -> TrainingReadings:
    """Readings of the training runs."""
    at = problem.conditions
    return TrainingReadings(
        angle_deg=at.angle_deg[inside],
        error_arcsec=problem.error_arcsec[inside],
        temperature_c=_temperature(problem)[inside],
        run=at.run[inside],
        zero_group=at.zero_group[inside],
        datum_deg=wrap_deg(float(at.angle_deg[0])),
    )
