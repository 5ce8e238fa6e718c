"""Long-range error of the graduation: orders from 3, whatever the temperature."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import (
    DEFAULT_LAST_ORDER,
    Amplitude,
    Phase,
    check_harmonics,
    check_orders,
    order_span,
)
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm
from trueangle_training.effects.patterns import (
    driven,
    harmonics,
    highest_order,
    order_columns,
    wave_hypothesis,
)
from trueangle_training.effects.thermal_response import series_arcsec

Floats = NDArray[np.float64]
FIRST_ORDER = 3
_OVERTONE_SIZE = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class GraduationHarmonic:
    """One order of the long-range graduation error."""

    order: Annotated[int, Range(minimum=FIRST_ORDER, maximum=MAX_ORDER)]
    amplitude_arcsec: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class GraduationErrorSettings:
    """Orders from 3."""

    orders: tuple[int, int] | None = None
    """First and last order, both modelled; None: 3 to min(11, (faces - 1) // 2)."""
    harmonics: tuple[GraduationHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no error."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=FIRST_ORDER)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One term for each order listed."""
        if self.harmonics is None:
            return None
        check_harmonics([h.order for h in self.harmonics], span=order_span(self.orders, joint.reference.faces))
        return tuple(
            HarmonicTerm(order=h.order, degree=0, amplitude=h.amplitude_arcsec, phase_deg=h.phase_deg)
            for h in self.harmonics
        )

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        return series_arcsec(self, conditions, joint)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """cos and sin of each modelled order; those that the places cannot tell apart are not independent."""
        first, last = order_span(self.orders, joint.reference.faces)
        return order_columns(conditions.angle_deg, range(first, last + 1))


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Each order alone, and all of the first ones together."""
    last = highest_order(conditions)
    for order in range(FIRST_ORDER, last + 1):
        yield wave_hypothesis("graduation_error", order, conditions, _OVERTONE_SIZE)
    together = range(FIRST_ORDER, min(last, DEFAULT_LAST_ORDER) + 1)
    if len(together) > 1:
        yield driven(
            effect="graduation_error",
            label=f"orders {together[0]} to {together[-1]} together",
            cell=Cell(order=str(FIRST_ORDER)),
            conditions=conditions,
            orders=together,
            unit="arcsec",
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The orders found, and a span that holds them."""
    found = harmonics(hypothesis, coefficients, "amplitude_arcsec")
    orders = [int(each["order"]) for each in found]
    return {"orders": [min(orders), max(orders)], "harmonics": found}


EFFECT = LibraryEffect(
    name="graduation_error",
    nature=Nature.MEAN,
    physics="The lines of the grating are not evenly spaced over long stretches of the turn.",
    formula="E = Σ A_n cos(nθ - φ_n), n >= 3",
    source="Fourier series of a closed curve; orders 3 to 11 of Jia et al., Sensors 2020, 20, 2603, Eq. (9)",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=20.0,
            source="data sheets of sealed encoders: graduation accuracy of 1 to 20 arcsec",
        ),
    ),
    cells=tuple(Cell(order=str(order)) for order in range(FIRST_ORDER, 41)),
    proof="Turn the grating on the shaft and measure again: the pattern turns with it.",
    missing_input=None,
    settings=GraduationErrorSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
