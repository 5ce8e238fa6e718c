"""The angle is read later than the reference: an error in proportion to speed."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_DEG
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import no_columns

Floats = NDArray[np.float64]
_BEND_SIZE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadLatencySettings:
    """One delay."""

    latency_s: Annotated[float, Range(minimum=-1, maximum=1)] | None = None
    """Age of the encoder's angle when the reference is read; negative where the reference is older.
    None: calibrated from data."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is a function of angle and temperature alone."""
        return None if self.latency_s is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 where no speed is known."""
        if conditions.velocity_deg_s is None or self.latency_s is None:
            return np.zeros(len(conditions))
        return self.latency_s * _travelled_arcsec_per_s(conditions.velocity_deg_s)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Speed."""
        if conditions.velocity_deg_s is None:
            return no_columns(len(conditions))
        return _travelled_arcsec_per_s(conditions.velocity_deg_s)[:, None]


def _travelled_arcsec_per_s(velocity_deg_s: Floats) -> Floats:
    """What one second of delay makes: an older angle lies behind."""
    return -np.nan_to_num(velocity_deg_s) * ARCSEC_PER_DEG


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Speed, bent a little; none without speeds."""
    velocity_deg_s = conditions.complete("velocity_deg_s")
    if velocity_deg_s is None:
        return
    main = _travelled_arcsec_per_s(velocity_deg_s)
    fastest = float(np.abs(velocity_deg_s).max())
    yield Hypothesis(
        effect="read_latency",
        label="speed",
        cell=Cell(order="0", speed="linear"),
        main=main[:, None],
        coefficients=("latency_s",),
        wiggle=(main * np.abs(velocity_deg_s) / fastest)[:, None] if fastest > 0 else no_columns(main.size),
        wiggle_size=_BEND_SIZE,
    )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The delay."""
    return {"latency_s": float(coefficients[0])}


EFFECT = LibraryEffect(
    name="read_latency",
    nature=Nature.MEAN,
    physics="The encoder's angle is older than the reference's when both are compared: the joint has moved on.",
    formula="E = -v t, v the signed speed, t the delay",
    source="kinematics; transmission of a CANopen PDO and filters in the encoder",
    parameters=(
        Parameter(
            name="latency_s",
            unit="s",
            low=-0.002,
            high=0.02,
            source="shop experience: some 10 us of conversion to some ms of bus and filter",
        ),
    ),
    cells=(Cell(order="0", speed="linear"),),
    proof="Sweep at two speeds and in both directions under one zero: the error follows the speed with its sign.",
    missing_input="speed",
    settings=ReadLatencySettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("velocity_deg_s",),
)
