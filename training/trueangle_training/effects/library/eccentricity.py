"""Grating centre off the axis of rotation: once a turn, whatever the temperature."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Phase, both_or_neither
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import harmonics, order_columns, wave_hypothesis
from trueangle_training.effects.thermal_response import series_arcsec

Floats = NDArray[np.float64]
ORDER = 1
_OVERTONE_SIZE = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class EccentricitySettings:
    """Amplitude and phase of order 1; both left out: calibrated from data."""

    amplitude_arcsec: Amplitude | None = None
    phase_deg: Phase | None = None

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec", self.amplitude_arcsec, "phase_deg", self.phase_deg)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """The only term."""
        if self.amplitude_arcsec is None or self.phase_deg is None:
            return None
        term = HarmonicTerm(order=ORDER, degree=0, amplitude=self.amplitude_arcsec, phase_deg=self.phase_deg)
        return (term,)

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        return series_arcsec(self, conditions, joint)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """cos and sin of order 1."""
        return order_columns(conditions.angle_deg, [ORDER])


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """One shape."""
    yield wave_hypothesis("eccentricity", ORDER, conditions, _OVERTONE_SIZE)


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Amplitude and phase."""
    (found,) = harmonics(hypothesis, coefficients, "amplitude_arcsec")
    return {name: found[name] for name in ("amplitude_arcsec", "phase_deg")}


EFFECT = LibraryEffect(
    name="eccentricity",
    nature=Nature.MEAN,
    physics="The centre of the grating lies off the axis of rotation: the error goes once up and down a turn.",
    formula="E = A cos(θ - φ), A = 206265 e / r with eccentricity e and grating radius r",
    source="geometry of a circle read off its centre; order 1 of Jia et al., Sensors 2020, 20, 2603, section 2",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=200.0,
            source="shop experience: 0 to 25 um of eccentricity at 25 mm radius",
        ),
    ),
    cells=(Cell(order="1"),),
    proof="Read a second head opposite the first: the mean of both loses order 1 and keeps the rest.",
    missing_input=None,
    settings=EccentricitySettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
