"""Deflection in proportion to the load, possibly with the angle."""

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
_OTHER_ORDERS_SIZE = 0.4
_ONE_LOAD_DOUBT_NATS = 4.6
"""Under one load no more is seen of it than a constant pattern over the angle; of such patterns a hundredth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadHarmonic:
    """How the compliance depends on the angle."""

    order: LowOrder
    """0: not at all; the phase is then 0, or 180 for a negative sign."""
    amplitude_arcsec_per_nm: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadDeflectionSettings:
    """Compliance up to order 2."""

    orders: tuple[LowOrder, LowOrder] | None = None
    """First and last order that are modelled; None: 0 to 2."""
    harmonics: tuple[LoadHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed is stiff."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=0)
        check_harmonics([h.order for h in self.harmonics or ()], span=self.orders or DEFAULT_ORDERS)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature alone."""
        return None if self.harmonics is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where no load is known."""
        if conditions.load_nm is None:
            return np.zeros(len(conditions))
        parts = ((h.order, h.amplitude_arcsec_per_nm, h.phase_deg) for h in self.harmonics or ())
        return np.nan_to_num(conditions.load_nm) * pattern(conditions.angle_deg, parts)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Load times each modelled order."""
        if conditions.load_nm is None:
            return no_columns(len(conditions))
        first, last = self.orders or DEFAULT_ORDERS
        load_nm = np.nan_to_num(conditions.load_nm)
        return order_columns(conditions.angle_deg, range(first, last + 1), load_nm)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Each order with a little of the others; none without loads."""
    load_nm = conditions.complete("load_nm")
    if load_nm is None:
        return
    for order in (0, 1, 2):
        others = [other for other in (0, 1, 2) if other != order]
        yield driven(
            effect="load_deflection",
            label="load" if order == 0 else f"load times order {order}",
            cell=Cell(order=str(order), load="linear"),
            conditions=conditions,
            orders=[order],
            unit="arcsec_per_nm",
            driver=load_nm,
            wiggle=order_columns(conditions.angle_deg, others, load_nm),
            wiggle_size=_OTHER_ORDERS_SIZE,
            doubt_nats=_ONE_LOAD_DOUBT_NATS if float(np.ptp(load_nm)) == 0.0 else 0.0,
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The orders found."""
    return {"harmonics": harmonics(hypothesis, coefficients, "amplitude_arcsec_per_nm")}


EFFECT = LibraryEffect(
    name="load_deflection",
    nature=Nature.MEAN,
    physics="A torque twists what lies between the joint and the grating or pushes the shaft in its bearings.",
    formula="E = L Σ k_n cos(nθ - φ_n), n = 0 to 2, L the load",
    source="elastic compliance, Hooke's law; order 1 and 2 for a stiffness that depends on the angle",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_nm",
            unit="arcsec/(N m)",
            low=0.0,
            high=5.0,
            source="data sheets of couplings: 20 000 to 200 000 N m/rad, 1 to 10 arcsec per N m; stiffer shafts",
        ),
    ),
    cells=tuple(Cell(order=str(order), load="linear") for order in (0, 1, 2)),
    proof="Hang a known load on and take it off again at standstill, inside one run.",
    missing_input="load",
    settings=LoadDeflectionSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("load_nm",),
)
