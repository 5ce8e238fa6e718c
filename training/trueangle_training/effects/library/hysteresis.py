"""Error that depends on the side from which the angle was approached: backlash, dry friction."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, LowOrder, Phase, check_harmonics, check_orders
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import (
    driven,
    harmonics,
    no_columns,
    order_columns,
    pattern,
)

Floats = NDArray[np.float64]
DEFAULT_ORDERS = (0, 2)
_OTHER_ORDERS_SIZE = 0.3
_ONE_WAY_DOUBT_NATS = 4.6
"""Approached from one side only, no more is seen of it than how it bends with the angle, as a constant pattern; of
such patterns a hundredth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HysteresisHarmonic:
    """How half the gap between the directions depends on the angle."""

    order: LowOrder
    """0: not at all; the phase is then 0, or 180 for a negative sign."""
    amplitude_arcsec: Amplitude
    """Upwards; downwards the sign is the other."""
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class HysteresisSettings:
    """The sign of the approach, with an angle dependence up to order 2, saturated within 3 deg of travel."""

    orders: tuple[LowOrder, LowOrder] | None = None
    """First and last order that are modelled; None: 0 to 2."""
    harmonics: tuple[HysteresisHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no gap."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=0)
        check_harmonics([h.order for h in self.harmonics or ()], span=self.orders or DEFAULT_ORDERS)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature alone."""
        return None if self.harmonics is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where the direction is not known."""
        if conditions.direction is None:
            return np.zeros(len(conditions))
        parts = ((h.order, h.amplitude_arcsec, h.phase_deg) for h in self.harmonics or ())
        return conditions.direction * pattern(conditions.angle_deg, parts)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Direction times each modelled order."""
        if conditions.direction is None:
            return no_columns(len(conditions))
        first, last = self.orders or DEFAULT_ORDERS
        return order_columns(conditions.angle_deg, range(first, last + 1), conditions.direction)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Each order with a little of the others; none without directions."""
    direction = conditions.known_direction()
    if direction is None:
        return
    for order in (0, 1, 2):
        others = [other for other in (0, 1, 2) if other != order]
        yield driven(
            effect="hysteresis",
            label="direction" if order == 0 else f"direction times order {order}",
            cell=Cell(order=str(order), direction="odd"),
            conditions=conditions,
            orders=[order],
            unit="arcsec",
            driver=direction,
            wiggle=order_columns(conditions.angle_deg, others, direction),
            wiggle_size=_OTHER_ORDERS_SIZE,
            doubt_nats=_ONE_WAY_DOUBT_NATS if float(np.ptp(direction)) == 0.0 else 0.0,
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The orders found."""
    return {"harmonics": harmonics(hypothesis, coefficients, "amplitude_arcsec")}


EFFECT = LibraryEffect(
    name="hysteresis",
    nature=Nature.MEAN,
    physics="Backlash or dry friction: the indicated angle depends on the side from which it was approached.",
    formula="E = d Σ A_n cos(nθ - φ_n), n = 0 to 2, d = +1 upwards, -1 downwards",
    source="ISO 230-2, reversal value: half of it is A_0; saturated within 3 deg of travel",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=60.0,
            source="data sheets of couplings: reversal errors of 2 to 40 arcsec; shop experience beyond",
        ),
    ),
    cells=tuple(Cell(order=str(order), direction="odd") for order in (0, 1, 2)),
    proof="Approach the same angle from both sides under one zero, turn after turn.",
    missing_input="direction",
    settings=HysteresisSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("direction",),
)
