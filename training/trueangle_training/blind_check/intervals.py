"""Intervals of what was counted."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

Interval = tuple[float, float]


def exact_binomial(hits: int, cases: int, *, level: float = 0.95) -> Interval:
    """Clopper and Pearson 1934: the shares that neither tail of the binomial rejects."""
    tail = (1.0 - level) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, cases - hits + 1))
    high = 1.0 if hits == cases else float(beta.ppf(1.0 - tail, hits + 1, cases - hits))
    return low, high


def bootstrap(
    values: Sequence[object] | NDArray[np.float64],
    statistic: Callable[[NDArray[np.float64]], float],
    *,
    seed: int = 1,
    draws: int = 1000,
) -> Interval:
    """95 % percentile interval over the cases: rows of `values`."""
    rows = np.asarray(values, dtype=np.float64)
    if rows.shape[0] < 2:
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    drawn = [statistic(rows[rng.integers(0, rows.shape[0], rows.shape[0])]) for _ in range(draws)]
    return float(np.percentile(drawn, 2.5)), float(np.percentile(drawn, 97.5))


def calibration_error(stated_and_right: NDArray[np.float64], *, bins: int = 10) -> float:
    """Expected calibration error of rows (probability, 0 or 1): mean distance between both over equal bins."""
    if stated_and_right.shape[0] == 0:
        return math.nan
    place = np.minimum((stated_and_right[:, 0] * bins).astype(np.int64), bins - 1)
    total = 0.0
    for each in np.unique(place):
        rows = stated_and_right[place == each]
        total += rows.shape[0] * abs(float(rows[:, 0].mean()) - float(rows[:, 1].mean()))
    return total / stated_and_right.shape[0]
