"""Whole counts lost inside a run and not recovered."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import SignedAmplitude
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import beside, no_columns

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

USUAL_SEARCH, LARGEST_SEARCH = 800, 2400
"""Places of a step that are tried in all; where that leaves fewer than the readings of a run, they stand apart."""
PLACES_OF_A_RUN = 12
"""Kept up to the largest search: half a twelfth of a run beside the step, little of it is missed."""
_BETWEEN_SIZE = 0.5


class Until(Enum):
    """How long the loss stays."""

    RUN_END = "run_end"
    ZERO_GROUP_END = "zero_group_end"
    """Through later runs that are counted from the same zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """One event of a diagnosed campaign."""

    run: Annotated[int, Range(minimum=-(2**53), maximum=2**53)]
    reading: Annotated[int, Range(minimum=2, maximum=2**53)]
    """The first reading of the run that shows it; the run's first reading is 1."""
    step_arcsec: SignedAmplitude
    """What is added from then on: a whole number of counts."""
    until: Until = Until.RUN_END


@dataclass(frozen=True, slots=True, kw_only=True)
class CountLossSettings:
    """Events that are known, and events that may happen in any run."""

    events: tuple[Loss, ...] | None = None
    probability_per_run: Annotated[float, Range(minimum=0, maximum=1)] = 0.0
    """Of a loss in a run, at any of its readings after the first."""
    counts: Annotated[int, Range(minimum=-1_000_000, maximum=1_000_000)] = 0
    """Added by such a loss."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature."""
        return None if self.events is None and self.probability_per_run == 0.0 else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        total = np.zeros(len(conditions))
        for event in self.events or ():
            total += event.step_arcsec * _after(conditions, event.run, event.reading, event.until)
        if rng is not None and self.probability_per_run > 0.0:
            step_arcsec = self.counts * 1_296_000.0 / conditions.counts_per_rev
            for run, readings in zip(*np.unique(conditions.run, return_counts=True), strict=True):
                if rng.random() < self.probability_per_run and readings > 1:
                    reading = int(rng.integers(2, readings, endpoint=True))
                    total += step_arcsec * _after(conditions, int(run), reading, Until.RUN_END)
        return total

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """One step for each event that is known."""
        steps = [_after(conditions, event.run, event.reading, event.until) for event in self.events or ()]
        return beside(no_columns(len(conditions)), *steps)


def _after(conditions: Conditions, run: int, reading: int, until: Until) -> Floats:
    """1 from that reading on, 0 elsewhere."""
    rows = np.flatnonzero(conditions.run == run)[reading - 1 :]
    step = np.zeros(len(conditions))
    step[rows] = 1.0
    if until is Until.ZERO_GROUP_END and rows.size:
        later = np.arange(len(conditions)) > rows[-1]
        step[later & (conditions.zero_group == conditions.zero_group[rows[0]])] = 1.0
    return step


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """A step at each reading of each run, or at every few of them."""
    runs = [_RunRows.of(conditions, run) for run in np.unique(conditions.run).tolist()]
    searches = sum(len(each.untils) for each in runs)
    places = max(min(PLACES_OF_A_RUN, LARGEST_SEARCH // searches), USUAL_SEARCH // searches, 1)
    for each in runs:
        stride = max(1, -(-(each.rows.size - 1) // places))
        for reading in range(2, each.rows.size + 1, stride):
            between = np.zeros((len(conditions), 1 if stride > 1 else 0))
            between[each.rows[reading - 1 : reading - 2 + stride]] = 1.0
            for until in each.untils:
                yield Hypothesis(
                    effect="count_loss",
                    label=f"a step at reading {reading} of run {each.run}",
                    cell=Cell(order="0", time="within_run"),
                    main=_after(conditions, each.run, reading, until)[:, None],
                    coefficients=("step_arcsec",),
                    wiggle=between,
                    wiggle_size=_BETWEEN_SIZE,
                    shape={
                        "run": float(each.run),
                        "reading": float(reading),
                        "kept_in_later_runs": float(until is Until.ZERO_GROUP_END),
                    },
                )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RunRows:
    """A run and how long a loss in it may stay."""

    run: int
    rows: Integers
    untils: tuple[Until, ...]

    @classmethod
    def of(cls, conditions: Conditions, run: int) -> "_RunRows":
        rows = np.flatnonzero(conditions.run == run)
        later = conditions.zero_group[rows[-1] + 1 :] == conditions.zero_group[rows[0]]
        untils = tuple(Until) if later.any() else (Until.RUN_END,)
        return cls(run=run, rows=rows, untils=untils)


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The event."""
    until = Until.ZERO_GROUP_END if hypothesis.shape["kept_in_later_runs"] else Until.RUN_END
    return {
        "events": [
            {
                "run": int(hypothesis.shape["run"]),
                "reading": int(hypothesis.shape["reading"]),
                "step_arcsec": float(coefficients[0]),
                "until": until.value,
            }
        ]
    }


EFFECT = LibraryEffect(
    name="count_loss",
    nature=Nature.EVENT,
    physics="A counter missed whole counts in the middle of a run: all that follows is off by the same angle.",
    formula="E = k · 1296000 / counts_per_rev from one reading of a run to its end, k a whole number",
    source="incremental counting; interference or too high a speed",
    parameters=(
        Parameter(
            name="step_arcsec",
            unit="arcsec",
            low=-1000.0,
            high=1000.0,
            source="shop experience: one count to some lines of the grating",
        ),
    ),
    cells=(Cell(order="0", time="within_run"),),
    proof="Return to the run's first angle: the zero is off by whole counts; read the index mark.",
    missing_input="index mark",
    settings=CountLossSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
