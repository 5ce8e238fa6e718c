"""Twist that builds up over the travel after a reversal: a friction that gives way slowly."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import SignedAmplitude, both_or_neither
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.heat import first_order
from trueangle_training.effects.patterns import beside, no_columns

Floats = NDArray[np.float64]
TRAVELS_DEG = (4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 120.0)
"""From three quarters built up within 5 deg, which is hysteresis to a polygon, to a third of a turn."""
_TUNING = 1.3


class WindupStart(Enum):
    """What the first reading of a run finds, where no reversal inside the run is behind it."""

    RELAXED = "relaxed"
    WOUND = "wound"
    """The other way: the joint came back to where the run begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WindupSettings:
    """Size and travel of one build-up."""

    amplitude_arcsec: SignedAmplitude | None = None
    """Far from the last reversal, upwards; downwards the sign is the other. None: calibrated from data."""
    travel_deg: Annotated[float, Range(minimum=1, maximum=3600)] | None = None
    """Travel after which all but 1/e has built up."""
    start: WindupStart = WindupStart.RELAXED

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec", self.amplitude_arcsec, "travel_deg", self.travel_deg)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature alone."""
        return None if self.amplitude_arcsec is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where the direction is not known."""
        if self.amplitude_arcsec is None or self.travel_deg is None or conditions.direction is None:
            return np.zeros(len(conditions))
        return self.amplitude_arcsec * build_up(conditions, conditions.direction, self.travel_deg, self.start)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """The build-up and how it changes with its travel; build-ups of all travels where none is given."""
        direction = conditions.direction
        if direction is None:
            return no_columns(len(conditions))
        if self.travel_deg is None:
            travels = (each for each in TRAVELS_DEG)
            return beside(*(build_up(conditions, direction, travel, self.start) for travel in travels))
        short, middle, long = (
            build_up(conditions, direction, self.travel_deg * factor, self.start)
            for factor in (1 / _TUNING, 1.0, _TUNING)
        )
        return beside(middle, short - long)


def build_up(conditions: Conditions, direction: Floats, travel_deg: float, start: WindupStart) -> Floats:
    """w of w' = (d - w) / travel along the way travelled, shape [readings]: Dahl's friction of exponent 1."""
    begins = np.ones(len(conditions), dtype=bool)
    begins[1:] = np.diff(conditions.run) != 0
    way_deg = np.abs(np.diff(conditions.angle_deg, prepend=conditions.angle_deg[:1]))
    kept = np.exp(-way_deg / travel_deg)
    inflow = -np.expm1(-way_deg / travel_deg) * direction
    kept[begins] = 0.0
    inflow[begins] = -direction[begins] if start is WindupStart.WOUND else 0.0
    return first_order(kept, inflow)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Some travels; from a wound start only where that is another shape. None without directions."""
    direction = conditions.known_direction()
    if direction is None:
        return
    # With one direction under each zero a wound start only scales the shape and moves the zero.
    starts = list(WindupStart) if _both_directions_share_a_zero(conditions, direction) else [WindupStart.RELAXED]
    for start in starts:
        for travel_deg in TRAVELS_DEG:
            yield Hypothesis(
                effect="windup",
                label=f"builds up over {travel_deg:g} deg from a {start.value} start",
                cell=Cell(order="0", direction="odd", time="within_run"),
                main=build_up(conditions, direction, travel_deg, start)[:, None],
                coefficients=("amplitude_arcsec",),
                wiggle=no_columns(len(conditions)),
                shape={"travel_deg": travel_deg, "wound": float(start is WindupStart.WOUND)},
            )


def _both_directions_share_a_zero(conditions: Conditions, direction: Floats) -> bool:
    upwards = set(np.unique(conditions.zero_group[direction > 0]).tolist())
    return bool(upwards & set(np.unique(conditions.zero_group[direction < 0]).tolist()))


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Amplitude, travel and start."""
    start = WindupStart.WOUND if hypothesis.shape["wound"] else WindupStart.RELAXED
    return {
        "amplitude_arcsec": float(coefficients[0]),
        "travel_deg": hypothesis.shape["travel_deg"],
        "start": start.value,
    }


EFFECT = LibraryEffect(
    name="windup",
    nature=Nature.MEAN,
    physics="A drag twists coupling or cable; the twist turns over slowly as the joint travels after a reversal.",
    formula="E = A w, dw/ds = (d - w) / s0 along the travel s",
    source="P. Dahl, A Solid Friction Model, 1968; needs 10 deg or more where hysteresis needs 3",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=-60.0,
            high=60.0,
            source="shop experience: cables and seals on compliant couplings",
        ),
        Parameter(name="travel_deg", unit="deg", low=3.5, high=120.0, source="shop experience"),
    ),
    cells=(Cell(order="0", direction="odd", time="within_run"),),
    proof="Reverse and read every degree for a third of a turn, both ways, under one zero.",
    missing_input="travel since the last reversal",
    settings=WindupSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("direction",),
)
