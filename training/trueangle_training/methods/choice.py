"""`auto`: the method that predicts a temperature it has not seen best.

Leave-one-temperature-out separates good methods from bad ones reliably and is a coin toss among good ones, which
costs nothing. It never looks at the residuals of the readings that a method was trained on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueangle.contract.errors import Fault
from trueangle_training.evaluation.bootstrap import Estimate, paired_difference, rmse_estimate
from trueangle_training.evaluation.held_out import HeldOut, HeldOutKind, hold_out, temperature_folds
from trueangle_training.methods import Method, Progress, TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.registry import METHODS

BOOTSTRAP_SEED = 0
DEAREST_S = 2.0
"""Methods whose one training takes longer are not tried: eight trainings each would make the user wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """What one method did."""

    name: str
    rmse: Estimate
    """At left-out temperatures, runs centred, noise of the readings included; arcsec."""
    over_best: Estimate | None
    """RMSE minus that of the chosen method, paired over runs; None for the chosen one itself."""
    seconds: float
    """For one fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The chosen method and what the others would have given."""

    chosen: Method
    candidates: tuple[Candidate, ...]
    """Best first."""
    held_out: HeldOut
    """Of the chosen method."""
    refused: tuple[str, ...]
    """Methods that the readings do not suit, and why."""


def automatic_names() -> tuple[str, ...]:
    """Methods that `auto` chooses among: those that estimate the runs' zeros and are quick."""
    return tuple(name for name, entry in METHODS.items() if entry.free_offsets and entry.seconds <= DEAREST_S)


def choose(
    readings: TrainingReadings,
    methods: Sequence[Method],
    *,
    seed: int,
    clock: Callable[[], float],
    progress: Progress,
) -> Choice:
    """Hold out every temperature for every method; UnsuitableReadingsError where there are too few temperatures.

    `clock` gives seconds and is asked for the cost only: it does not influence the choice.
    """
    folds = temperature_folds(readings)
    if not folds:
        expected = "three temperatures or more, of which one can be left out"
        advice = "choose a method by its name"
        raise UnsuitableReadingsError(
            [Fault(where="temperature_c", expected=expected, found="fewer", advice=advice)]
        )
    done, total = 0, len(folds) * len(methods)

    def step() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    tried: list[tuple[Method, HeldOut, Estimate, float]] = []
    refused: list[str] = []
    for method in methods:
        started_s = clock()
        held_out = hold_out(readings, method, HeldOutKind.TEMPERATURE, folds, seed=seed, progress=step)
        seconds = (clock() - started_s) / len(folds)
        estimate = rmse_estimate(held_out, readings.run, np.random.default_rng(BOOTSTRAP_SEED))
        if estimate is None or held_out.refused:
            refused.append(f"{method.name}: {held_out.refused[0]}")
            continue
        tried.append((method, held_out, estimate, seconds))
    if not tried:
        found = "; ".join(refused)
        raise UnsuitableReadingsError(
            [Fault(where="readings", expected="readings that suit at least one method", found=found)]
        )
    tried.sort(key=lambda each: each[2].value)
    best_method, best_held_out, _, _ = tried[0]
    candidates = tuple(
        Candidate(
            name=method.name,
            rmse=estimate,
            over_best=None
            if method is best_method
            else paired_difference(held_out, best_held_out, readings.run, np.random.default_rng(BOOTSTRAP_SEED)),
            seconds=seconds,
        )
        for method, held_out, estimate, seconds in tried
    )
    return Choice(chosen=best_method, candidates=candidates, held_out=best_held_out, refused=tuple(refused))
