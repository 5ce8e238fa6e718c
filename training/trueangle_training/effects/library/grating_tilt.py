"""Tilt or ovality of the grating: twice a turn, whatever the temperature."""

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
ORDER = 2
_OVERTONE_SIZE = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class GratingTiltSettings:
    """Amplitude and phase of order 2; both left out: calibrated from data."""

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
        """cos and sin of order 2."""
        return order_columns(conditions.angle_deg, [ORDER])


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """One shape."""
    yield wave_hypothesis("grating_tilt", ORDER, conditions, _OVERTONE_SIZE)


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Amplitude and phase."""
    (found,) = harmonics(hypothesis, coefficients, "amplitude_arcsec")
    return {name: found[name] for name in ("amplitude_arcsec", "phase_deg")}


EFFECT = LibraryEffect(
    name="grating_tilt",
    nature=Nature.MEAN,
    physics="The grating is tilted to the axis or oval: the error goes twice up and down a turn.",
    formula="E = A cos(2θ - φ); of a disc tilted by g radians: A = 206265 g² / 4",
    source="projection of a tilted circle, to second order in the tilt",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=50.0,
            source="shop experience: tilts up to 1 deg after careless mounting, 15 arcsec, and ovality besides",
        ),
    ),
    cells=(Cell(order="2"),),
    proof="Shim the grating by a known tilt, or read a second head at 90 deg: the mean of both loses order 2.",
    missing_input=None,
    settings=GratingTiltSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
