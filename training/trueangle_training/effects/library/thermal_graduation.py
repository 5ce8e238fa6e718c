"""Graduation error that grows with temperature: an order from 3, linear in temperature."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import (
    Amplitude,
    Degree,
    Phase,
    check_harmonics,
    check_orders,
    linear_only,
    order_span,
)
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm
from trueangle_training.effects.patterns import harmonics, highest_order
from trueangle_training.effects.thermal_response import (
    from_base_k,
    linear_hypothesis,
    power_columns,
    series_arcsec,
)

Floats = NDArray[np.float64]
FIRST_ORDER = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalHarmonic:
    """One order of the graduation's drift."""

    order: Annotated[int, Range(minimum=FIRST_ORDER, maximum=MAX_ORDER)]
    amplitude_arcsec_per_k: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalGraduationSettings:
    """Long-range graduation error that grows with temperature: orders from 3."""

    orders: tuple[int, int] | None = None
    """First and last order, both modelled; None: 3 to min(11, (faces - 1) // 2)."""
    degree: Degree = 1
    harmonics: tuple[ThermalHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no drift."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=FIRST_ORDER)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One linear term for each order listed."""
        if self.harmonics is None:
            return None
        linear_only(self.degree)
        check_harmonics([h.order for h in self.harmonics], span=order_span(self.orders, joint.reference.faces))
        return tuple(
            HarmonicTerm(order=h.order, degree=1, amplitude=h.amplitude_arcsec_per_k, phase_deg=h.phase_deg)
            for h in self.harmonics
        )

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        return series_arcsec(self, conditions, joint)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Each modelled order times each power of the temperature difference up to the degree."""
        first, last = order_span(self.orders, joint.reference.faces)
        return power_columns(conditions, range(first, last + 1), range(1, self.degree + 1))


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Each order alone; none without temperatures."""
    above_k = from_base_k(conditions)
    if above_k is None:
        return
    for order in range(FIRST_ORDER, highest_order(conditions) + 1):
        yield linear_hypothesis("thermal_graduation", order, conditions, above_k)


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The orders found, and a span that holds them."""
    found = harmonics(hypothesis, coefficients, "amplitude_arcsec_per_k")
    orders = [int(each["order"]) for each in found]
    return {"orders": [min(orders), max(orders)], "harmonics": found}


EFFECT = LibraryEffect(
    name="thermal_graduation",
    nature=Nature.MEAN,
    physics="The grating's carrier warps with temperature and takes the lines along.",
    formula="E = Σ a_n (T - T0) cos(nθ - φ_n), n >= 3",
    source="linear expansion of a carrier held at n places, such as screws; shop experience",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_k",
            unit="arcsec/K",
            low=0.0,
            high=0.3,
            source="shop experience: up to 6 arcsec over 20 K with a carrier on three screws",
        ),
    ),
    cells=tuple(Cell(order=str(order), temperature="linear") for order in range(FIRST_ORDER, 41)),
    proof="Measure at five soaked temperatures: the order grows in proportion; loosen and re-tighten the screws.",
    missing_input=None,
    settings=ThermalGraduationSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("temperature_c",),
)
