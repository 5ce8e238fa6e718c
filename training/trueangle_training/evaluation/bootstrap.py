"""Intervals by resampling runs: a run shares its zero and its temperature, so it is drawn or left as a whole.

Where there is one run its readings are drawn one by one: less sure, as neighbours may err alike.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.evaluation.held_out import HeldOut

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

DRAWS = 2000
LEVEL = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure and its 95 % percentile interval over resampled runs, or readings of a single run."""

    value: float
    low: float
    high: float


def _per_run(held_out: HeldOut, run: Integers) -> tuple[Floats, Floats]:
    """Sum of squares and degrees of freedom of each run, [runs], or of each reading of a single run."""
    index = np.unique(run, return_inverse=True)[1]
    if index.max() == 0:
        index = np.arange(run.size)
    squares = np.bincount(index, weights=np.nan_to_num(held_out.residual_arcsec) ** 2).astype(np.float64)
    return squares, np.bincount(index, weights=held_out.degrees_of_freedom).astype(np.float64)


def _draws(runs: int, rng: np.random.Generator) -> Integers:
    """How often each of the runs is drawn, [DRAWS, runs]."""
    return rng.multinomial(runs, np.full(runs, 1.0 / runs), size=DRAWS)


def _estimate(value: float, resampled: Floats) -> Estimate:
    tail = (1.0 - LEVEL) / 2.0
    low, high = np.quantile(resampled, [tail, 1.0 - tail])
    return Estimate(value=value, low=float(low), high=float(high))


def rmse_estimate(held_out: HeldOut, run: Integers, rng: np.random.Generator) -> Estimate | None:
    """The held-out RMSE with its interval; None: fewer than two runs have residuals."""
    squares, freedom = _per_run(held_out, run)
    known = freedom > 0.0
    if np.count_nonzero(known) < 2:
        return None
    squares, freedom = squares[known], freedom[known]
    drawn = _draws(squares.size, rng)
    return _estimate(float(np.sqrt(squares.sum() / freedom.sum())), np.sqrt((drawn @ squares) / (drawn @ freedom)))


def paired_difference(one: HeldOut, other: HeldOut, run: Integers, rng: np.random.Generator) -> Estimate | None:
    """RMSE of `one` minus that of `other` over the runs that both have; None: fewer than two."""
    squares_one, freedom_one = _per_run(one, run)
    squares_other, freedom_other = _per_run(other, run)
    both = (freedom_one > 0.0) & (freedom_other > 0.0)
    if np.count_nonzero(both) < 2:
        return None
    drawn = _draws(int(np.count_nonzero(both)), rng)

    def rmse(squares: Floats, freedom: Floats) -> tuple[float, Floats]:
        squares, freedom = squares[both], freedom[both]
        return float(np.sqrt(squares.sum() / freedom.sum())), np.sqrt((drawn @ squares) / (drawn @ freedom))

    value_one, drawn_one = rmse(squares_one, freedom_one)
    value_other, drawn_other = rmse(squares_other, freedom_other)
    return _estimate(value_one - value_other, drawn_one - drawn_other)
