"""Creep in time within a run: what holds the polygon or the encoder settles after each set-up."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import SignedAmplitude, TimeConstant, both_or_neither
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import beside, no_columns

Floats = NDArray[np.float64]
TIME_CONSTANTS_S = (30.0, 70.0, 150.0, 300.0, 600.0, 1500.0, 4000.0, 30000.0)
"""The last one is a straight line in any run that a shift has time for."""
_TUNING = 1.3
_ROOT_SIZE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class IndexDriftSettings:
    """One creep, the same after each set-up."""

    amplitude_arcsec: SignedAmplitude | None = None
    """Long after the run's first reading; None: calibrated from data."""
    time_constant_s: TimeConstant | None = None

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec", self.amplitude_arcsec, "time_constant_s", self.time_constant_s)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature alone."""
        return None if self.amplitude_arcsec is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where times are not known."""
        since_s = since_run_began_s(conditions)
        if self.amplitude_arcsec is None or self.time_constant_s is None or since_s is None:
            return np.zeros(len(conditions))
        return self.amplitude_arcsec * _settled(since_s, self.time_constant_s)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """The creep and how it changes with its time constant; creeps of all of them where none is given."""
        since_s = since_run_began_s(conditions)
        if since_s is None:
            return no_columns(len(conditions))
        if self.time_constant_s is None:
            return beside(*(_settled(since_s, each) for each in TIME_CONSTANTS_S))
        short, middle, long = (
            _settled(since_s, self.time_constant_s * factor) for factor in (1 / _TUNING, 1.0, _TUNING)
        )
        return beside(middle, short - long)


def since_run_began_s(conditions: Conditions) -> Floats | None:
    """Time since the run's first reading; None where times are not known of all readings."""
    time_s = conditions.complete("time_s")
    if time_s is None:
        return None
    runs, place = np.unique(conditions.run, return_inverse=True)
    began_s = np.full(runs.size, np.inf)
    np.minimum.at(began_s, place, time_s)
    return time_s - began_s[place]


def _settled(since_s: Floats, time_constant_s: float) -> Floats:
    return -np.expm1(-since_s / time_constant_s)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Some time constants; none without times."""
    since_s = since_run_began_s(conditions)
    if since_s is None:
        return
    longest_s = float(since_s.max())
    for time_constant_s in TIME_CONSTANTS_S:
        main = _settled(since_s, time_constant_s)
        root = np.sqrt(since_s / longest_s) * main.max() if longest_s > 0 else np.zeros_like(main)
        yield Hypothesis(
            effect="index_drift",
            label=f"settles within {time_constant_s:g} s",
            cell=Cell(order="0", time="within_run"),
            main=main[:, None],
            coefficients=("amplitude_arcsec",),
            wiggle=root[:, None],
            wiggle_size=_ROOT_SIZE,
            shape={"time_constant_s": time_constant_s},
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Amplitude and time constant."""
    time_constant_s = hypothesis.shape["time_constant_s"]
    return {"amplitude_arcsec": float(coefficients[0]), "time_constant_s": time_constant_s}


EFFECT = LibraryEffect(
    name="index_drift",
    nature=Nature.MEAN,
    physics="Clamping, glue or stand settle after each set-up: the zero creeps while the run is measured.",
    formula="E = A (1 - exp(-u / τ)), u the time since the run began",
    source="creep of a standard linear solid; shop experience",
    parameters=(
        Parameter(name="amplitude_arcsec", unit="arcsec", low=-20.0, high=20.0, source="shop experience"),
        Parameter(name="time_constant_s", unit="s", low=30.0, high=30000.0, source="shop experience"),
    ),
    cells=(Cell(order="0", time="within_run"),),
    proof="Stand still after a set-up and read for an hour; or begin each repeat at another face.",
    missing_input="time since the set-up",
    settings=IndexDriftSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("time_s",),
)
