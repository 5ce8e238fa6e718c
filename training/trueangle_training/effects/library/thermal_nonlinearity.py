"""The part of the drift that goes with the square of the temperature difference."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Phase, check_harmonics
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm, Order
from trueangle_training.effects.patterns import driven, harmonics, order_columns
from trueangle_training.effects.thermal_response import (
    TYPICAL_SPAN_K,
    from_base_k,
    power_columns,
    series_arcsec,
)

Floats = NDArray[np.float64]
DEFAULT_ORDERS = (1, 2)
_BEND_SIZE = 0.35
"""A cubic part beside the square: a curve that is smooth, but no parabola about the base temperature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticHarmonic:
    """One order of the quadratic drift."""

    order: Order
    amplitude_arcsec_per_k2: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalNonlinearitySettings:
    """Quadratic drift of some orders."""

    harmonics: tuple[QuadraticHarmonic, ...] | None = None
    """None: orders 1 and 2, calibrated from data; an order that is not listed has no quadratic drift."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One quadratic term for each order listed."""
        if self.harmonics is None:
            return None
        check_harmonics([h.order for h in self.harmonics], span=(1, MAX_ORDER))
        return tuple(
            HarmonicTerm(order=h.order, degree=2, amplitude=h.amplitude_arcsec_per_k2, phase_deg=h.phase_deg)
            for h in self.harmonics
        )

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        return series_arcsec(self, conditions, joint)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """The listed orders times the square of the temperature difference."""
        orders = DEFAULT_ORDERS if self.harmonics is None else [h.order for h in self.harmonics]
        return power_columns(conditions, orders, [2])


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Order 1, order 2, and both; none without temperatures."""
    above_k = from_base_k(conditions)
    if above_k is None:
        return
    for orders in ((1,), (2,), (1, 2)):
        # No linear part: that is thermal_eccentricity or thermal_tilt, which it could carry altogether.
        cubic = order_columns(conditions.angle_deg, orders, above_k**3 / TYPICAL_SPAN_K)
        yield driven(
            effect="thermal_nonlinearity",
            label=f"order {' and '.join(map(str, orders))}, quadratic in temperature",
            cell=Cell(order=str(orders[0]), temperature="quadratic"),
            conditions=conditions,
            orders=orders,
            unit="arcsec_per_k2",
            driver=above_k**2,
            wiggle=cubic,
            wiggle_size=_BEND_SIZE,
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The orders found."""
    return {"harmonics": harmonics(hypothesis, coefficients, "amplitude_arcsec_per_k2")}


EFFECT = LibraryEffect(
    name="thermal_nonlinearity",
    nature=Nature.MEAN,
    physics="The drift of order 1 or 2 does not grow in proportion to temperature: fits tighten, seals stiffen.",
    formula="E = Σ b_n (T - T0)² cos(nθ - φ_n), n = 1, 2",
    source="second term of the drift's power series in temperature; shop experience",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_k2",
            unit="arcsec/K2",
            low=0.0,
            high=0.05,
            source="shop experience: up to the size of the linear drift at 40 K",
        ),
    ),
    cells=tuple(Cell(order=str(order), temperature="quadratic") for order in DEFAULT_ORDERS),
    proof="Soak at seven temperatures on both sides of the base one: the drift bends smoothly.",
    missing_input=None,
    settings=ThermalNonlinearitySettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("temperature_c",),
)
