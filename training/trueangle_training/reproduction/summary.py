"""The experiment over many noise seeds: means with their standard errors beside the published figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.reproduction.experiment import (
    FIGURE_8_NODES,
    NoiseSeedResult,
    PairedTrials,
    Residuals,
    Row,
)

Floats = NDArray[np.float64]

STUDENT_95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145)
"""Two-sided 95 % quantiles of Student's t for 1, 2, ... degrees of freedom (ISO 2602, table 1)."""
STUDENT_95_BEYOND = 2.131
"""For 15; with more the true one is smaller, at least 1.960."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """What the paper's tables say, in arcsec."""

    rmse: float
    lowest: float
    highest: float


PUBLISHED: Mapping[Row, Published] = {
    Row.UNTRAINED: Published(rmse=0.85, lowest=-2.3, highest=2.7),
    Row.AS_PRINTED: Published(rmse=0.85, lowest=-2.3, highest=2.7),
    Row.AFTER_LM: Published(rmse=0.85, lowest=-2.3, highest=2.7),
    Row.HANDED_ON: Published(rmse=0.85, lowest=-2.3, highest=2.7),
    Row.FE_BPNN: Published(rmse=0.90, lowest=-2.6, highest=2.8),
    Row.BPNN: Published(rmse=1.38, lowest=-4.1, highest=4.1),
    Row.POLY2D: Published(rmse=3.69, lowest=-9.1, highest=10.6),
    Row.FEPF: Published(rmse=1.20, lowest=-2.1, highest=2.9),
}
"""Tables 1 and 2; the extremes of FEPF are those of its section and of Table 2. The baselines are not in them."""
PUBLISHED_RAW_RANGE = (-110.2, 43.9)
PUBLISHED_THERMAL_RANGE = (-9.7, 7.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mean:
    """A mean over noise seeds."""

    value: float
    standard_error: float | None
    """None: a single seed has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RowSummary:
    """One row of the tables, in arcsec."""

    row: Row
    rmse: Mean
    lowest: Mean
    highest: Mean

    @property
    def over_published(self) -> float | None:
        """RMSE over the published one, minus 1; None: none is published."""
        return self.rmse.value / PUBLISHED[self.row].rmse - 1.0 if self.row in PUBLISHED else None


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticGain:
    """In-sample RMSE with the genetic algorithm minus that of as many random starts, paired by trial, arcsec."""

    difference: float
    low: float | None
    high: float | None
    """95 %, Student's t, over the means of noise seeds; over trials where there is one seed; None: a
    single trial has none."""
    seeds: int
    trials: int
    """In all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentSummary:
    """All seeds together."""

    seeds: tuple[int, ...]
    trials: int
    rows: tuple[RowSummary, ...]
    figure_8: tuple[tuple[int, Mean], ...]
    """Hidden nodes and RMSE."""
    raw_range: tuple[Mean, Mean]
    thermal_range: tuple[Mean, Mean]
    gains: Mapping[str, GeneticGain]
    """By the value of a `Fitness`."""


def summarise(results: Sequence[NoiseSeedResult], *, base: int) -> ExperimentSummary:
    """Means over the seeds; `base` is the number of the base temperature."""
    rows = [row for row in Row if row.name in results[0].rows]
    raw, thermal = [each.raw_range for each in results], [each.thermal_range(base) for each in results]
    fitnesses = {name for each in results for name in each.multistart}
    return ExperimentSummary(
        seeds=tuple(each.seed for each in results),
        trials=len(results[0].rows[Row.FE_BPNN.name].rmse),
        rows=tuple(_row(row, [each.rows[row.name] for each in results]) for row in rows),
        figure_8=tuple(
            (nodes, _mean([float(np.mean(each.hidden_rmse[k])) for each in results]))
            for k, nodes in enumerate(FIGURE_8_NODES)
        ),
        raw_range=(_mean([low for low, _ in raw]), _mean([high for _, high in raw])),
        thermal_range=(_mean([low for low, _ in thermal]), _mean([high for _, high in thermal])),
        gains={
            name: _gain([each.multistart[name] for each in results if name in each.multistart])
            for name in sorted(fitnesses)
        },
    )


def _row(row: Row, residuals: Sequence[Residuals]) -> RowSummary:
    return RowSummary(
        row=row,
        rmse=_mean([float(np.mean(each.rmse)) for each in residuals]),
        lowest=_mean([float(np.mean(each.lowest)) for each in residuals]),
        highest=_mean([float(np.mean(each.highest)) for each in residuals]),
    )


def _mean(values: Sequence[float]) -> Mean:
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None
    return Mean(value=float(np.mean(values)), standard_error=error)


def _gain(pairs: Sequence[PairedTrials]) -> GeneticGain:
    differences = [np.subtract(pair.genetic_rmse, pair.multistart_rmse) for pair in pairs]
    units: Floats = np.array([float(np.mean(each)) for each in differences])
    if units.size == 1:
        units = np.asarray(differences[0], dtype=np.float64)
    mean = float(np.mean(units))
    half = _half_width(units)
    return GeneticGain(
        difference=mean,
        low=None if half is None else mean - half,
        high=None if half is None else mean + half,
        seeds=len(pairs),
        trials=sum(len(each) for each in differences),
    )


def _half_width(units: Floats) -> float | None:
    freedom = units.size - 1
    if freedom == 0:
        return None
    quantile = STUDENT_95[freedom - 1] if freedom <= len(STUDENT_95) else STUDENT_95_BEYOND
    return quantile * float(np.std(units, ddof=1) / np.sqrt(units.size))
