"""Offset, gain and quadrature of the sine and cosine signals: errors within one line of the grating."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Phase, check_harmonics
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter, Stage
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import driven, harmonics, order_columns, pattern

Floats = NDArray[np.float64]
_DISTORTION_SIZE = 0.3


class PerLine(IntEnum):
    """How often in one line."""

    OFFSET = 1
    """Unequal zero of the two signals."""
    GAIN = 2
    """Unequal amplitudes, or not quite a quarter of a line between them."""
    DISTORTION = 4
    """Third harmonic in the signals."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineHarmonic:
    """One multiple of the line count."""

    per_line: PerLine
    amplitude_arcsec: Amplitude
    phase_deg: Phase
    """Counted in one oscillation, at the scale's zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubdivisionErrorSettings:
    """Errors that go once, twice or four times up and down within each line."""

    harmonics: tuple[LineHarmonic, ...] | None = None
    """None: calibrated from data; a multiple that is not listed has no error."""

    def __post_init__(self) -> None:
        check_harmonics([int(h.per_line) for h in self.harmonics or ()], span=(1, 4))

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """None of the low orders of a harmonic series: it is a function of the scale's angle, line by line."""
        return None if self.harmonics is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; `angle_deg` is the angle that the scale shows."""
        lines = conditions.lines_per_rev
        parts = ((h.per_line * lines, h.amplitude_arcsec, h.phase_deg) for h in self.harmonics or ())
        return pattern(conditions.angle_deg, parts)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """cos and sin of all three multiples."""
        return order_columns(conditions.angle_deg, [each * conditions.lines_per_rev for each in PerLine])


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Each multiple, and the two usual ones together, with a little distortion."""
    lines = conditions.lines_per_rev
    for multiples, order in (((1,), "N"), ((2,), "2N"), ((4,), "4N"), ((1, 2), "N")):
        rest = [each * lines for each in PerLine if each not in multiples]
        yield driven(
            effect="subdivision_error",
            label=f"{' and '.join(str(each) for each in multiples)} times a line",
            cell=Cell(order=order),
            conditions=conditions,
            orders=[each * lines for each in multiples],
            unit="arcsec",
            wiggle=order_columns(conditions.angle_deg, rest),
            wiggle_size=_DISTORTION_SIZE,
            shape={"lines_per_rev": float(lines)},
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The multiples found."""
    lines = int(hypothesis.shape["lines_per_rev"])
    found = harmonics(hypothesis, coefficients, "amplitude_arcsec")
    return {
        "harmonics": [
            {
                "per_line": int(each["order"]) // lines,
                "amplitude_arcsec": each["amplitude_arcsec"],
                "phase_deg": each["phase_deg"],
            }
            for each in found
        ]
    }


EFFECT = LibraryEffect(
    name="subdivision_error",
    nature=Nature.MEAN,
    physics="Offset, unequal gain or a wrong quarter phase of sine and cosine distort the angle within each line.",
    formula="E = Σ A_m cos(mNθ - φ_m), m = 1 (offset), 2 (gain, quadrature), 4 (third harmonic), N lines a turn",
    source="P. L. M. Heydemann, Applied Optics 20, 3382 (1981), expanded to first order",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=5.0,
            source="data sheets: within 1 to 2 % of a line's pitch, which is 79 arcsec at 16384 lines",
        ),
    ),
    cells=(Cell(order="N"), Cell(order="2N"), Cell(order="4N")),
    proof="Read a hundred angles within two lines against a fine reference.",
    missing_input=None,
    settings=SubdivisionErrorSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    stage=Stage.SCALE,
)
