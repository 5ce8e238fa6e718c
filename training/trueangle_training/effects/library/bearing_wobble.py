"""Wobble of a rolling bearing: periods that do not close over one turn."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Phase
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import angle_rad, beside, no_columns, polar

Floats = NDArray[np.float64]
FIRST_PER_TURN, LAST_PER_TURN = 0.3, 5.9
COARSE_STEP, FINEST_STEP = 0.1, 0.025
_INTEGER_MARGIN = 0.05
_BEND_SIZE = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Wobble:
    """One period."""

    per_turn: Annotated[float, Range(minimum=0.01, maximum=100)]
    """Oscillations in one turn of the shaft; the cage of a rolling bearing goes round 0.35 to 0.45 times."""
    amplitude_arcsec: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class BearingWobbleSettings:
    """Periods over the angle with its turns kept."""

    wobbles: tuple[Wobble, ...] | None = None
    """None: not modelled, as no calibration can start without a period."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of the angle within one turn."""
        return None if self.wobbles is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        total = np.zeros(len(conditions))
        for wobble in self.wobbles or ():
            phase_rad = angle_rad(conditions.angle_deg, wobble.per_turn) - np.radians(wobble.phase_deg)
            total += wobble.amplitude_arcsec * np.cos(phase_rad)
        return total

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """cos and sin of each period, and how they change with it."""
        angle_deg = conditions.angle_deg
        turns = turns_in_one_go(conditions)
        blocks = [
            beside(_waves(angle_deg, w.per_turn), _detuned(angle_deg, w.per_turn, turns))
            for w in self.wobbles or ()
        ]
        return beside(no_columns(len(conditions)), *blocks)


def _waves(angle_deg: Floats, per_turn: float) -> Floats:
    phase_rad = angle_rad(angle_deg, per_turn)
    return np.column_stack([np.cos(phase_rad), np.sin(phase_rad)])


def _detuned(angle_deg: Floats, per_turn: float, turns: float) -> Floats:
    """The waves times the angle from the middle of the usual span, -1 to 1: their change with the period."""
    half_deg = max(turns, 1.0) * DEG_PER_TURN / 2
    from_middle = np.clip((angle_deg - np.median(angle_deg)) / half_deg, -1.0, 1.0)
    return _waves(angle_deg, per_turn) * from_middle[:, None]


def turns_in_one_go(conditions: Conditions) -> float:
    """Span of the runs that three quarters of the readings do not exceed: a few long ones do not set the scale."""
    runs, place, lengths = np.unique(conditions.run, return_inverse=True, return_counts=True)
    lowest, highest = np.full(runs.size, np.inf), np.full(runs.size, -np.inf)
    np.minimum.at(lowest, place, conditions.angle_deg)
    np.maximum.at(highest, place, conditions.angle_deg)
    order = np.argsort(highest - lowest)
    usual = order[np.searchsorted(np.cumsum(lengths[order]), 0.75 * len(conditions))]
    return float(highest[usual] - lowest[usual]) / DEG_PER_TURN


def searched_per_turn(turns: float) -> Floats:
    """Periods as close as the span of a run tells them apart, whole numbers left out."""
    # Half a step off, the phase at the ends of the span is a twenty-fourth of a turn off: the wiggle takes that.
    step = max(min(COARSE_STEP, 1 / (6 * max(turns, 1.0))), FINEST_STEP)
    grid = np.arange(FIRST_PER_TURN, LAST_PER_TURN + step / 2, step)
    return grid[np.abs(grid - np.round(grid)) > _INTEGER_MARGIN]


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Some periods."""
    angle_deg, turns = conditions.angle_deg, turns_in_one_go(conditions)
    for per_turn in searched_per_turn(turns).tolist():
        yield Hypothesis(
            effect="bearing_wobble",
            label=f"{per_turn:.3g} times a turn",
            cell=Cell(order="non-integer"),
            main=_waves(angle_deg, per_turn),
            coefficients=("cos_arcsec", "sin_arcsec"),
            wiggle=beside(_detuned(angle_deg, per_turn, turns), _waves(angle_deg, 2 * per_turn)),
            wiggle_size=_BEND_SIZE,
            shape={"per_turn": per_turn},
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Period, amplitude and phase."""
    found = polar(float(coefficients[0]), float(coefficients[1]), "amplitude_arcsec")
    return {"wobbles": [{"per_turn": hypothesis.shape["per_turn"], **found}]}


EFFECT = LibraryEffect(
    name="bearing_wobble",
    nature=Nature.MEAN,
    physics="Cage and balls of the bearing carry the shaft's wobble: it is not closed over one turn.",
    formula="E = A cos(fθ - φ), f not a whole number, θ with its turns kept",
    source="kinematics of rolling bearings: cage 0.5 (1 - d/D cos a) turns for each turn of the shaft",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=10.0,
            source="shop experience: small ball bearings",
        ),
        Parameter(
            name="per_turn",
            unit="1",
            low=FIRST_PER_TURN,
            high=LAST_PER_TURN,
            source="kinematics: cage 0.35 to 0.45, spin of a ball 2 to 5",
        ),
    ),
    cells=(Cell(order="non-integer"),),
    proof="Sweep five turns and more in one go: the pattern shifts from turn to turn.",
    missing_input="turns since the bearing's zero",
    settings=BearingWobbleSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
