"""Heat from the joint's own motion."""

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
from trueangle_training.effects.heat import motion_heat_deg_s
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
TIME_CONSTANTS_S = (100.0, 300.0, 1000.0, 3000.0, 10000.0)
_TUNING = 1.3
_SLOW_DEG_S = 5.0
"""Mean speed from stop to stop below which friction leaves milliwatts."""
_SLOW_DOUBT_NATS = 3.0
"""One campaign in twenty."""
_OTHERS_SIZE = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class HeatHarmonic:
    """What lasting motion does to one order."""

    order: LowOrder
    """0: to the zero; the phase is then 0, or 180 for a negative sign."""
    amplitude_arcsec_per_deg_s: Amplitude
    """Long after a speed of 1 deg/s was taken up."""
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfHeatingSettings:
    """A warmth that follows the magnitude of the speed with a time constant."""

    orders: tuple[LowOrder, LowOrder] | None = None
    """First and last order that are modelled; None: 0 to 2."""
    time_constant_s: TimeConstant | None = None
    harmonics: tuple[HeatHarmonic, ...] | None = None
    """None: calibrated from data."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=0)
        check_harmonics([h.order for h in self.harmonics or ()], span=self.orders or DEFAULT_ORDERS)
        if self.harmonics is not None:
            both_or_neither("harmonics", 0.0, "time_constant_s", self.time_constant_s)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and the sensor's temperature alone."""
        return None if self.harmonics is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where times are not known."""
        if self.harmonics is None or self.time_constant_s is None:
            return np.zeros(len(conditions))
        heat = motion_heat_deg_s(conditions, self.time_constant_s)
        parts = ((h.order, h.amplitude_arcsec_per_deg_s, h.phase_deg) for h in self.harmonics)
        return np.zeros(len(conditions)) if heat is None else heat * pattern(conditions.angle_deg, parts)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Heat times each order, and how it changes with the time constant; all of them where none is given."""
        first, last = self.orders or DEFAULT_ORDERS
        waves = order_columns(conditions.angle_deg, range(first, last + 1))
        given = self.time_constant_s
        constants = TIME_CONSTANTS_S if given is None else (given / _TUNING, given, given * _TUNING)
        heats = [motion_heat_deg_s(conditions, each) for each in constants]
        drivers = [heat for heat in heats if heat is not None]
        if not drivers:
            return no_columns(len(conditions))
        if given is not None:
            drivers = [drivers[1], drivers[2] - drivers[0]]
        return beside(*(waves * driver[:, None] for driver in drivers))


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Some time constants; none without times."""
    for time_constant_s in TIME_CONSTANTS_S:
        heat = motion_heat_deg_s(conditions, time_constant_s)
        squared = motion_heat_deg_s(conditions, time_constant_s, power=2.0)
        if heat is None or squared is None:
            return
        fastest = max(float(np.max(squared)) / max(float(np.max(heat)), 1e-9), 1e-9)
        for order in (0, 1, 2):
            others = [other for other in (0, 1, 2) if other != order]
            # Dry friction heats with the speed, viscous friction with its square.
            wiggle = beside(
                order_columns(conditions.angle_deg, others, heat),
                order_columns(conditions.angle_deg, [order], squared / fastest),
            )
            yield driven(
                effect="self_heating",
                label=f"order {order} follows the speed's heat within {time_constant_s:g} s",
                cell=Cell(order=str(order), time="within_run", speed="linear"),
                conditions=conditions,
                orders=[order],
                unit="arcsec_per_deg_s",
                driver=heat,
                wiggle=wiggle,
                wiggle_size=_OTHERS_SIZE,
                shape={"time_constant_s": time_constant_s},
                doubt_nats=_SLOW_DOUBT_NATS if fastest < _SLOW_DEG_S else 0.0,
            )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Time constant and the orders found."""
    return {
        "time_constant_s": hypothesis.shape["time_constant_s"],
        "harmonics": harmonics(hypothesis, coefficients, "amplitude_arcsec_per_deg_s"),
    }


EFFECT = LibraryEffect(
    name="self_heating",
    nature=Nature.MEAN,
    physics="Friction of fast motion warms the bearing, unfelt by the sensor; the warmth stays a while.",
    formula="E = H Σ c_n cos(nθ - φ_n), dH/dt = (|v| - H) / τ, n = 0 to 2",
    source="friction power of a constant torque into one heat capacity; state carried through the whole campaign",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_deg_s",
            unit="arcsec/(deg/s)",
            low=0.0,
            high=0.5,
            source="shop experience: up to 2 K and some arcsec after an hour at 60 deg/s",
        ),
        Parameter(
            name="time_constant_s", unit="s", low=100.0, high=10000.0, source="shop experience: bearing to housing"
        ),
    ),
    cells=tuple(Cell(order=str(order), time="within_run", speed="linear") for order in (0, 1, 2)),
    proof="Soak, turn fast for three time constants, stand still and read until the error has come back.",
    missing_input="motion history",
    settings=SelfHeatingSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("time_s",),
)
