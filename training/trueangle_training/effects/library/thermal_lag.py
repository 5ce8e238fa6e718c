"""The joint's temperature follows the sensor's with a time constant."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import (
    Amplitude,
    LowOrder,
    Phase,
    TimeConstant,
    both_or_neither,
    check_harmonics,
    check_orders,
)
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.heat import RESOLVED_TIME_CONSTANTS_S, BetweenRuns, lagged_temperature_c
from trueangle_training.effects.patterns import (
    beside,
    driven,
    harmonics,
    no_columns,
    order_columns,
    pattern,
)

Floats = NDArray[np.float64]
DEFAULT_ORDERS = (0, 2)
_TUNING = 1.3
_OTHERS_SIZE = 0.3
_UNKNOWN_START_K = 5.0
"""Typical distance from equilibrium when the campaign began."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LagHarmonic:
    """The drift of one order that lags behind."""

    order: LowOrder
    """0: of the zero; the phase is then 0, or 180 for a negative sign."""
    amplitude_arcsec_per_k: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalLagSettings:
    """Drifts that follow the joint's temperature where the thermal effects take the sensor's."""

    orders: tuple[LowOrder, LowOrder] | None = None
    """First and last order that are modelled; None: 0 to 2."""
    time_constant_s: TimeConstant | None = None
    harmonics: tuple[LagHarmonic, ...] | None = None
    """None: calibrated from data."""
    between_runs: BetweenRuns = BetweenRuns.STEP
    """How the temperature is taken to have gone where only readings are known; the simulator knows it."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=0)
        check_harmonics([h.order for h in self.harmonics or ()], span=self.orders or DEFAULT_ORDERS)
        if self.harmonics is not None:
            both_or_neither("harmonics", 0.0, "time_constant_s", self.time_constant_s)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and the sensor's temperature alone."""
        return None if self.harmonics is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where times or temperatures are not known."""
        if self.harmonics is None or self.time_constant_s is None:
            return np.zeros(len(conditions))
        behind_k = behind_sensor_k(conditions, self.time_constant_s, self.between_runs)
        parts = ((h.order, h.amplitude_arcsec_per_k, h.phase_deg) for h in self.harmonics)
        return np.zeros(len(conditions)) if behind_k is None else behind_k * pattern(conditions.angle_deg, parts)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Lag times each order, and how it changes with the time constant; all of them where none is given."""
        first, last = self.orders or DEFAULT_ORDERS
        waves = order_columns(conditions.angle_deg, range(first, last + 1))
        given = self.time_constant_s
        constants = RESOLVED_TIME_CONSTANTS_S if given is None else (given / _TUNING, given, given * _TUNING)
        lags = [behind_sensor_k(conditions, each, self.between_runs) for each in constants]
        drivers = [lag for lag in lags if lag is not None]
        if not drivers:
            return no_columns(len(conditions))
        if given is not None:
            drivers = [drivers[1], drivers[2] - drivers[0]]
        return beside(*(waves * driver[:, None] for driver in drivers))


def behind_sensor_k(conditions: Conditions, time_constant_s: float, between: BetweenRuns) -> Floats | None:
    """Joint's minus sensor's temperature; None where times or temperatures are not known."""
    lagged_c = lagged_temperature_c(conditions, time_constant_s, between)
    return None if lagged_c is None or conditions.temperature_c is None else lagged_c - conditions.temperature_c


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Some time constants, both ways between runs; none without times and temperatures."""
    time_s = conditions.complete("time_s")
    if time_s is None or conditions.complete("temperature_c") is None:
        return
    for between in BetweenRuns:
        for time_constant_s in RESOLVED_TIME_CONSTANTS_S:
            behind_k = behind_sensor_k(conditions, time_constant_s, between)
            if behind_k is None:
                return
            fading = _UNKNOWN_START_K * np.exp(-(time_s - time_s.min()) / time_constant_s)
            for order in (0, 1, 2):
                others = [other for other in (0, 1, 2) if other != order]
                wiggle = beside(
                    order_columns(conditions.angle_deg, others, behind_k),
                    order_columns(conditions.angle_deg, [order], fading),
                )
                yield driven(
                    effect="thermal_lag",
                    label=f"order {order} lags by {time_constant_s:g} s, {between.value} between runs",
                    cell=Cell(order=str(order), temperature="lagged"),
                    conditions=conditions,
                    orders=[order],
                    unit="arcsec_per_k",
                    driver=behind_k,
                    wiggle=wiggle,
                    wiggle_size=_OTHERS_SIZE,
                    shape={"time_constant_s": time_constant_s, "ramp": float(between is BetweenRuns.RAMP)},
                )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Time constant and the orders found."""
    between = BetweenRuns.RAMP if hypothesis.shape["ramp"] else BetweenRuns.STEP
    return {
        "time_constant_s": hypothesis.shape["time_constant_s"],
        "harmonics": harmonics(hypothesis, coefficients, "amplitude_arcsec_per_k"),
        "between_runs": between.value,
    }


EFFECT = LibraryEffect(
    name="thermal_lag",
    nature=Nature.MEAN,
    physics="The joint warms up later than the sensor beside the reading head: its drift comes late.",
    formula="E = (T_j - T) Σ a_n cos(nθ - φ_n), dT_j/dt = (T - T_j) / τ, n = 0 to 2",
    source="lumped heat capacity (Newton's law of cooling); state carried through the whole campaign",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_k",
            unit="arcsec/K",
            low=0.0,
            high=2.0,
            source="that of the drift which lags: thermal_eccentricity",
        ),
        Parameter(
            name="time_constant_s",
            unit="s",
            low=60.0,
            high=14400.0,
            source="shop experience: a minute of a thin ring to hours of a cast housing",
        ),
    ),
    cells=tuple(Cell(order=str(order), temperature="lagged") for order in (0, 1, 2)),
    proof="Measure at one temperature right after a step and again after a long soak.",
    missing_input="temperature history",
    settings=ThermalLagSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("temperature_c", "time_s"),
)
