"""Effects that change the scatter and not the mean: noise that grows, and a resolution coarser than stated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.noise import NoiseModel, run_kinds
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]

PERMUTATIONS = 4000
GROWTH_P = 0.001
"""Of one condition; three are tested."""
SHAPE_DOUBT = 0.1
"""RMS that a bent shape leaves over that of the shape."""
LEAST_NOISE = 0.25
"""Of a run's variance that is noise whatever the shape leaves."""
LEAST_GROWTH = 1.15
"""Standard deviation at one end of the range over that at the other."""
LOUD = 12.0
"""Variance of a run over the median of its kind; heavy tails and bursts make up to 8 of it, once in a hundred."""
LARGEST_RATIO = 4096
"""Stated counts over those really resolved."""
FEWEST_STEPS = 20
ON_LATTICE = 0.98
"""Of the differences of neighbouring positions; a few may stand across a turn, where the lattice is cut."""
NEAR_COUNTS = 20_000
OFF_COUNT = 0.1
"""Of a count: angles that are no whole counts (averaged, or written with few digits) show no lattice."""
FEWEST_RUNS = 8
FEWEST_DEGREES = 4.0
"""Degrees of freedom of a run's variance from which the run counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How the noise of the runs goes with one condition."""

    condition: str
    """temperature_c, speed_deg_s or load_nm"""
    ratio: float
    """Standard deviation at the highest value over that at the lowest, by a straight line in the logarithm."""
    p_value: float
    """One-sided, by exchanging runs of one kind."""
    log_slope: float
    """Of the natural logarithm of the standard deviation, per unit of the condition."""

    @property
    def significant(self) -> bool:
        """Grows beyond what exchanging the runs would give."""
        return self.p_value <= GROWTH_P and self.ratio >= LEAST_GROWTH


def noise_growth(
    problem: Problem, noise: NoiseModel, explained_arcsec: Floats, *, seed: int = 0
) -> tuple[Growth, ...]:
    """Every condition that varies between runs, the most significant first; none with too few runs.

    What a found curve ([readings]) leaves over where it is a little bent is no noise, and is taken off first.
    """
    rows = noise.transform.rows
    known = np.isfinite(noise.run_variance) & (noise.run_freedom >= FEWEST_DEGREES) & (noise.run_variance > 0)
    if int(known.sum()) < FEWEST_RUNS:
        return ()
    # The logarithm of a chi-squared has the variance 2 / f, near enough from four degrees of freedom on.
    weight = noise.run_freedom[known] / (noise.run_freedom[known] + 8.0)
    left = SHAPE_DOUBT**2 * np.array([float(np.var(explained_arcsec[r])) for r in rows])
    variance = np.maximum(noise.run_variance - left, LEAST_NOISE * noise.run_variance)
    log_sigma = 0.5 * np.log(variance[known])
    kinds = run_kinds(problem.conditions, noise.transform)[known]
    rng = np.random.default_rng(seed)
    orders = _exchanged(kinds, rng)
    found: list[Growth] = []
    for name, values in _conditions(problem):
        by_run = np.array([float(np.mean(values[r])) for r in rows])[known]
        centred = _centred(by_run, kinds, weight)
        if float(np.max(np.abs(centred))) < 1e-9 * max(1.0, float(np.max(np.abs(by_run)))):
            continue
        growth = _centred(log_sigma, kinds, weight)
        denominator = float(np.sum(weight * centred**2))
        slope = float(np.sum(weight * centred * growth)) / denominator
        drawn = np.sum(weight * centred * growth[orders], axis=1) / denominator
        p_value = (1.0 + float(np.sum(drawn >= slope - 1e-12))) / (PERMUTATIONS + 1.0)
        span = max(float(np.ptp(by_run[kinds == kind])) for kind in np.unique(kinds))
        found.append(Growth(condition=name, ratio=float(np.exp(slope * span)), p_value=p_value, log_slope=slope))
    return tuple(sorted(found, key=lambda each: (each.p_value, -each.ratio)))


def loud_run(problem: Problem, noise: NoiseModel) -> int | None:
    """The run, as the campaign numbers it, that scatters far beyond all others of its kind; None: none does."""
    kinds = run_kinds(problem.conditions, noise.transform)
    usable = np.isfinite(noise.run_variance) & (noise.run_freedom >= FEWEST_DEGREES)
    loudest: tuple[float, int] = (LOUD, -1)
    for kind in np.unique(kinds):
        here = np.flatnonzero(usable & (kinds == kind))
        if here.size < FEWEST_RUNS:
            continue
        ratio = noise.run_variance[here] / float(np.median(noise.run_variance[here]))
        place = int(np.argmax(ratio))
        loudest = max(loudest, (float(ratio[place]), int(here[place])))
    run = loudest[1]
    return None if run < 0 else int(problem.conditions.run[noise.transform.rows[run][0]])


def coarser_ratio(conditions: Conditions) -> int | None:
    """By how many stated counts the angle steps; None: by single counts, or it cannot be told.

    Positions that lie near each other differ by whole steps wherever the lattice's zero may be; that all of
    n differences are multiples of r happens by chance with probability r^-n.
    """
    counts = conditions.angle_deg * (conditions.counts_per_rev / DEG_PER_TURN)
    whole = np.rint(counts)
    if float(np.max(np.abs(counts - whole))) > OFF_COUNT:
        return None
    apart = np.diff(np.unique(whole))
    apart = apart[apart <= NEAR_COUNTS].astype(np.int64)
    if apart.size < FEWEST_STEPS:
        return None
    ratios = np.arange(2, LARGEST_RATIO + 1)
    shares = np.array([float(np.mean(apart % ratio == 0)) for ratio in ratios])
    fitting = np.flatnonzero(shares >= ON_LATTICE)
    # Without a place where two steps meet, every multiple of a wide spacing would do as well.
    for place in fitting[::-1]:
        if np.unique(apart // ratios[place]).size >= 2 or float(np.mean(apart == ratios[place])) > 0.5:
            return int(ratios[place])
    return None


def _conditions(problem: Problem) -> list[tuple[str, Floats]]:
    conditions, axes = problem.conditions, axes_of(problem.conditions)
    found: list[tuple[str, Floats]] = []
    if conditions.temperature_c is not None and axes.temperature is not None:
        found.append(("temperature_c", conditions.temperature_c))
    if conditions.velocity_deg_s is not None and axes.speed is not None:
        found.append(("speed_deg_s", np.abs(conditions.velocity_deg_s)))
    if conditions.load_nm is not None and axes.load is not None:
        found.append(("load_nm", conditions.load_nm))
    return found


def _centred(values: Floats, kinds: NDArray[np.int64], weight: Floats) -> Floats:
    """About the mean of the kind: noise that differs between kinds of run is no growth."""
    centred = values.astype(np.float64).copy()
    for kind in np.unique(kinds):
        here = kinds == kind
        centred[here] -= np.average(values[here], weights=weight[here])
    return centred


def _exchanged(kinds: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """[permutations, runs]: runs of one kind exchanged among each other."""
    orders = np.tile(np.arange(kinds.size), (PERMUTATIONS, 1))
    for kind in np.unique(kinds):
        here = np.flatnonzero(kinds == kind)
        orders[:, here] = here[np.argsort(rng.random((PERMUTATIONS, here.size)), axis=1)]
    return orders
