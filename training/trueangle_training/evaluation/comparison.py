"""All that `trueangle compare` says of a method; the in-sample RMSE, the best way to be wrong about it, last."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import DEG_PER_TURN, wrap_deg
from trueangle_training.evaluation.bootstrap import Estimate, paired_difference, rmse_estimate
from trueangle_training.evaluation.held_out import SAME_PLACE_DEG, HeldOut, HeldOutKind, all_folds, hold_out
from trueangle_training.evaluation.truth import TrueError, oracle, true_error
from trueangle_training.methods import FittedModel, Method, TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.separable import harmonics
from trueangle_training.methods.stages import StagedMethod, Stages
from trueangle_training.simulator.joint import SimulatedJoint

Floats = NDArray[np.float64]

BOOTSTRAP_SEED = 0
SHAPE_TEMPERATURES = 7
SHAPE_STEP_DEG = 0.5
JUST_BEFORE_TURN_DEG = DEG_PER_TURN - 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutScore:
    """One kind of left-out readings, in arcsec, noise of the readings included."""

    kind: HeldOutKind
    rmse: Estimate
    largest_arcsec: float
    coverage: float | None
    """Share within 2 sqrt(u² + s²), u of the method and s the noise of a reading; None: the method knows no u."""
    refused: tuple[str, ...]
    """What could not be left out, and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelShape:
    """What a model does where no reading is, RMS or maximum over the measured temperatures, in arcsec."""

    seam_jump_arcsec: float
    """Largest step from just below a full turn to 0 deg; a joint has none."""
    between_faces_rms_arcsec: float
    """From the smoothest harmonics through the model's own values at the measured places."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodScore:
    """Everything about one method."""

    name: str
    seconds: float
    """For one training on all readings."""
    held_out: tuple[HeldOutScore, ...]
    over_best: tuple[Estimate | None, ...]
    """For each of `held_out`: RMSE minus that of the best method of this kind, paired over runs; None: it is the
    best, or the two share too few runs."""
    shape: ModelShape
    truth: TrueError | None
    """None: the joint is not simulated."""
    in_sample_rmse_arcsec: float
    """Each zero group's mean taken off; says little about other angles and temperatures."""

    def score(self, kind: HeldOutKind) -> HeldOutScore | None:
        """The score of one kind; None: nothing of the kind could be left out."""
        return next((score for score in self.held_out if score.kind is kind), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """All methods, the best at left-out temperatures first."""

    scores: tuple[MethodScore, ...]
    refused: tuple[tuple[str, str], ...]
    """Methods that the readings do not suit, and why."""
    oracle: TrueError | None
    """Of the least squares that know the joint's shapes; None: the joint is not simulated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Trained:
    name: str
    seconds: float
    model: FittedModel
    held_out: dict[HeldOutKind, HeldOut]


def compare_methods(
    readings: TrainingReadings,
    methods: tuple[Method, ...],
    *,
    noise_arcsec: float | None,
    joint: SimulatedJoint | None,
    seed: int,
    clock: Callable[[], float],
    progress: Callable[[int, int], None],
    refused: tuple[tuple[str, str], ...] = (),
) -> Comparison:
    """Train every method on everything and without every fold.

    `clock` gives seconds, for the costs only; `refused` names methods that were turned away before, and why.
    """
    kinds = [(kind, folds) for kind, folds in all_folds(readings) if folds]
    total, done = len(methods) * (1 + sum(len(folds) for _, folds in kinds)), 0

    def step() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    trained: list[_Trained] = []
    unsuited = list(refused)
    stages = Stages()
    for method in methods:
        started_s = clock()
        try:
            model = method.fit(readings, seed=seed).model
        except UnsuitableReadingsError as error:
            unsuited.append((method.name, "; ".join(str(fault) for fault in error.faults)))
            continue
        seconds = clock() - started_s
        step()
        # The training above shares nothing, so that its time is what the method costs by itself.
        tried = method.sharing(stages) if isinstance(method, StagedMethod) else method
        held_out = {
            kind: hold_out(readings, tried, kind, folds, seed=seed, progress=step) for kind, folds in kinds
        }
        trained.append(_Trained(name=method.name, seconds=seconds, model=model, held_out=held_out))
    yardstick = None
    if joint is not None:
        yardstick = true_error(oracle(readings, joint), joint, readings)
    scores = [_score(each, trained, readings, noise_arcsec, joint, yardstick) for each in trained]
    return Comparison(scores=tuple(sorted(scores, key=_rank)), refused=tuple(unsuited), oracle=yardstick)


def _rank(score: MethodScore) -> tuple[bool, float]:
    at_temperature = score.score(HeldOutKind.TEMPERATURE)
    return (True, score.in_sample_rmse_arcsec) if at_temperature is None else (False, at_temperature.rmse.value)


def _score(
    each: _Trained,
    trained: list[_Trained],
    readings: TrainingReadings,
    noise_arcsec: float | None,
    joint: SimulatedJoint | None,
    yardstick: TrueError | None,
) -> MethodScore:
    scores: list[HeldOutScore] = []
    over_best: list[Estimate | None] = []
    for kind, held_out in each.held_out.items():
        estimate = rmse_estimate(held_out, readings.run, np.random.default_rng(BOOTSTRAP_SEED))
        if estimate is None:
            continue
        scores.append(
            HeldOutScore(
                kind=kind,
                rmse=estimate,
                largest_arcsec=held_out.largest_arcsec or 0.0,
                coverage=_coverage(held_out, noise_arcsec),
                refused=held_out.refused,
            )
        )
        over_best.append(_over_best(kind, each, trained, readings))
    left = readings.error_arcsec - each.model.error_arcsec(readings.angle_deg, readings.temperature_c)
    group = readings.offset_group
    left = left - (np.bincount(group, weights=left) / np.bincount(group))[group]
    truth = None
    if joint is not None and yardstick is not None:
        truth = true_error(each.model, joint, readings, oracle_rmse_arcsec=yardstick.rmse_arcsec)
    return MethodScore(
        name=each.name,
        seconds=each.seconds,
        held_out=tuple(scores),
        over_best=tuple(over_best),
        shape=model_shape(each.model, readings),
        truth=truth,
        in_sample_rmse_arcsec=float(np.sqrt(np.mean(left**2))),
    )


def _over_best(
    kind: HeldOutKind, each: _Trained, trained: list[_Trained], readings: TrainingReadings
) -> Estimate | None:
    """Against the method of the smallest RMSE over all that has this kind without gaps."""
    complete = [other for other in trained if kind in other.held_out and not other.held_out[kind].refused]
    if not complete:
        return None
    best = min(complete, key=lambda other: other.held_out[kind].rmse_arcsec or np.inf)
    if best is each:
        return None
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    one, other = common(each.held_out[kind], best.held_out[kind])
    return paired_difference(one, other, readings.run, rng)


def common(one: HeldOut, other: HeldOut) -> tuple[HeldOut, HeldOut]:
    """Both with the readings only that both have, so that a difference compares like with like."""
    both = one.known & other.known
    return (
        replace(
            one,
            residual_arcsec=np.where(both, one.residual_arcsec, np.nan),
            degrees_of_freedom=one.degrees_of_freedom * both,
        ),
        replace(
            other,
            residual_arcsec=np.where(both, other.residual_arcsec, np.nan),
            degrees_of_freedom=other.degrees_of_freedom * both,
        ),
    )


def _coverage(held_out: HeldOut, noise_arcsec: float | None) -> float | None:
    if held_out.uncertainty_arcsec is None or noise_arcsec is None:
        return None
    known = held_out.known
    total = np.sqrt(held_out.uncertainty_arcsec[known] ** 2 + noise_arcsec**2)
    return float(np.mean(np.abs(held_out.residual_arcsec[known]) <= 2.0 * total))


def model_shape(model: FittedModel, readings: TrainingReadings) -> ModelShape:
    """The model at the seam and between the measured places."""
    lowest_c, highest_c = float(readings.temperature_c.min()), float(readings.temperature_c.max())
    temperatures_c = np.linspace(lowest_c, highest_c, SHAPE_TEMPERATURES)
    ends_deg = np.array([0.0, JUST_BEFORE_TURN_DEG])
    places_deg = _places_deg(readings)
    fine_deg = np.arange(0.0, DEG_PER_TURN, SHAPE_STEP_DEG)
    orders = tuple(range(1, (places_deg.size - 1) // 2 + 1))
    ones = np.ones((places_deg.size, 1))
    at_places = np.concatenate([ones, harmonics(places_deg, orders)], axis=1)
    at_fine = np.concatenate([np.ones((fine_deg.size, 1)), harmonics(fine_deg, orders)], axis=1)
    through = at_fine @ np.linalg.pinv(at_places)
    jumps, departures = [], []
    for temperature_c in temperatures_c:

        def error(angle_deg: Floats, at_c: float = float(temperature_c)) -> Floats:
            return model.error_arcsec(angle_deg, np.full_like(angle_deg, at_c))

        first, last = error(ends_deg)
        jumps.append(abs(float(last - first)))
        departures.append(error(fine_deg) - through @ error(places_deg))
    return ModelShape(
        seam_jump_arcsec=max(jumps), between_faces_rms_arcsec=float(np.sqrt(np.mean(np.square(departures))))
    )


def _places_deg(readings: TrainingReadings) -> Floats:
    """One angle for each measured place, rising."""
    ordered = np.unique(wrap_deg(readings.angle_deg + SAME_PLACE_DEG))
    starts = np.concatenate([[True], np.diff(ordered) > SAME_PLACE_DEG])
    return wrap_deg(ordered[starts] - SAME_PLACE_DEG)
