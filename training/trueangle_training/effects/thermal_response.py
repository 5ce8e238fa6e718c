"""What the effects that are harmonics of angle and powers of temperature share."""

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis
from trueangle_training.effects.harmonics import HarmonicTerm, harmonic_series
from trueangle_training.effects.patterns import beside, driven, no_columns, order_columns

Floats = NDArray[np.float64]

TYPICAL_SPAN_K = 20.0
"""Scales curvature columns so that their coefficients compare with those of the linear ones."""
CURVATURE_SIZE = 0.08


class HasTerms(Protocol):
    """Settings that are harmonics."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """As in `EffectSettings`."""
        ...


def series_arcsec(settings: HasTerms, conditions: Conditions, joint: Joint) -> Floats:
    """The error of an effect that is harmonics throughout; 0 where its parameters are left out.

    Without temperatures only what does not depend on them is there.
    """
    terms = settings.terms(joint) or ()
    temperature_c = conditions.temperature_c
    if temperature_c is None:
        terms = tuple(term for term in terms if term.degree == 0)
        temperature_c = np.full(len(conditions), joint.base_temperature_c)
    series = harmonic_series(terms, base_temperature_c=joint.base_temperature_c)
    return series.error_arcsec(conditions.angle_deg, temperature_c)


def from_base_k(conditions: Conditions) -> Floats | None:
    """Temperature above the base temperature; None where it is not known of every reading."""
    temperature_c = conditions.complete("temperature_c")
    return None if temperature_c is None else temperature_c - conditions.base_temperature_c


def power_columns(conditions: Conditions, orders: Iterable[int], degrees: Iterable[int]) -> Floats:
    """cos and sin of each order times each power of the temperature difference; none without temperatures."""
    above_k = from_base_k(conditions)
    if above_k is None:
        return no_columns(len(conditions))
    waves = order_columns(conditions.angle_deg, orders)
    return beside(no_columns(len(conditions)), *(waves * above_k[:, None] ** degree for degree in degrees))


def linear_hypothesis(effect: str, order: int, conditions: Conditions, above_k: Floats) -> Hypothesis:
    """One order, linear in temperature and a little bent."""
    return driven(
        effect=effect,
        label=f"order {order}, linear in temperature",
        cell=Cell(order=str(order), temperature="linear"),
        conditions=conditions,
        orders=[order],
        unit="arcsec_per_k",
        driver=above_k,
        wiggle=order_columns(conditions.angle_deg, [order], above_k**2 / TYPICAL_SPAN_K),
        wiggle_size=CURVATURE_SIZE,
    )
