"""Tilt or ovality of the grating that grows with temperature: twice a turn."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Degree, Phase, both_or_neither, linear_only
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import harmonics
from trueangle_training.effects.thermal_response import (
    from_base_k,
    linear_hypothesis,
    power_columns,
    series_arcsec,
)

Floats = NDArray[np.float64]
ORDER = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalTiltSettings:
    """Drift of order 2 with temperature; amplitude and phase left out: calibrated from data."""

    amplitude_arcsec_per_k: Amplitude | None = None
    phase_deg: Phase | None = None
    degree: Degree = 1
    """Highest power of the temperature difference that is modelled."""

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec_per_k", self.amplitude_arcsec_per_k, "phase_deg", self.phase_deg)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """The linear term."""
        if self.amplitude_arcsec_per_k is None or self.phase_deg is None:
            return None
        linear_only(self.degree)
        amplitude = self.amplitude_arcsec_per_k
        return (HarmonicTerm(order=ORDER, degree=1, amplitude=amplitude, phase_deg=self.phase_deg),)

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        return series_arcsec(self, conditions, joint)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Order 2 times each power of the temperature difference up to the degree."""
        return power_columns(conditions, [ORDER], range(1, self.degree + 1))


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """One shape; none without temperatures."""
    above_k = from_base_k(conditions)
    if above_k is not None:
        yield linear_hypothesis("thermal_tilt", ORDER, conditions, above_k)


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Amplitude and phase."""
    (found,) = harmonics(hypothesis, coefficients, "amplitude_arcsec_per_k")
    return {name: found[name] for name in ("amplitude_arcsec_per_k", "phase_deg")}


EFFECT = LibraryEffect(
    name="thermal_tilt",
    nature=Nature.MEAN,
    physics="Uneven expansion tilts the grating or makes it oval as the joint warms up.",
    formula="E = a (T - T0) cos(2θ - φ)",
    source="linear expansion of a mounting with two stiff sides; shop experience",
    parameters=(
        Parameter(
            name="amplitude_arcsec_per_k",
            unit="arcsec/K",
            low=0.0,
            high=0.5,
            source="shop experience: a tenth to a quarter of the drift of order 1",
        ),
    ),
    cells=(Cell(order="2", temperature="linear"),),
    proof="Measure once round at five soaked temperatures: the vector of order 2 moves along a straight line.",
    missing_input=None,
    settings=ThermalTiltSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("temperature_c",),
)
