"""Scatter that grows with temperature, speed or load."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import no_columns

Floats = NDArray[np.float64]
Growth = Annotated[float, Range(minimum=0, maximum=1000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseGrowthSettings:
    """Standard deviations of white noise that comes on top of the joint's own, added in squares."""

    arcsec_per_k: Growth | None = None
    """Above `from_temperature_c`; below it nothing is added."""
    from_temperature_c: Annotated[float, Range(minimum=-100, maximum=200)] | None = None
    """None: the joint's base temperature."""
    arcsec_per_deg_s: Growth | None = None
    arcsec_per_nm: Growth | None = None

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Its mean is 0."""
        given = (self.arcsec_per_k, self.arcsec_per_deg_s, self.arcsec_per_nm)
        return None if given == (None, None, None) else ()

    def extra_arcsec(self, conditions: Conditions, joint: Joint) -> Floats:
        """Standard deviation of what is added, shape [readings]."""
        squares = np.zeros(len(conditions))
        if self.arcsec_per_k is not None and conditions.temperature_c is not None:
            start_c = joint.base_temperature_c if self.from_temperature_c is None else self.from_temperature_c
            squares += (self.arcsec_per_k * np.maximum(conditions.temperature_c - start_c, 0.0)) ** 2
        if self.arcsec_per_deg_s is not None and conditions.velocity_deg_s is not None:
            squares += (self.arcsec_per_deg_s * conditions.velocity_deg_s) ** 2
        if self.arcsec_per_nm is not None and conditions.load_nm is not None:
            squares += (self.arcsec_per_nm * conditions.load_nm) ** 2
        return np.sqrt(np.nan_to_num(squares))

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        if rng is None:
            return np.zeros(len(conditions))
        return self.extra_arcsec(conditions, joint) * rng.standard_normal(len(conditions))

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """None: it does not move the mean."""
        return no_columns(len(conditions))


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """None: no curve of the mean; see `variance_hypotheses`."""
    yield from ()


def variance_hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """What the extra standard deviation may be proportional to; `main` are arcsec of it per unit.

    A condition that does not vary, or is not known of every reading, is left out.
    """
    temperature_c = conditions.complete("temperature_c")
    if temperature_c is not None:
        start_c = float(temperature_c.min())
        shape = {"from_temperature_c": start_c}
        yield from _growth("temperature", temperature_c - start_c, "arcsec_per_k", Cell(**_TEMPERATURE), shape)
    for name, cell, unit in (
        ("velocity_deg_s", Cell(**_SPEED), "arcsec_per_deg_s"),
        ("load_nm", Cell(**_LOAD), "arcsec_per_nm"),
    ):
        values = conditions.complete(name)
        if values is not None:
            yield from _growth("speed" if name == "velocity_deg_s" else "load", np.abs(values), unit, cell, {})


_TEMPERATURE: dict[str, Any] = {"order": "0", "temperature": "linear", "moment": "variance"}
_SPEED: dict[str, Any] = {"order": "0", "speed": "linear", "moment": "variance"}
_LOAD: dict[str, Any] = {"order": "0", "load": "linear", "moment": "variance"}


def _growth(name: str, size: Floats, unit: str, cell: Cell, shape: dict[str, float]) -> Iterator[Hypothesis]:
    if np.ptp(size) > 0:
        yield Hypothesis(
            effect="noise_growth",
            label=f"grows with {name}",
            cell=cell,
            main=size[:, None],
            coefficients=(unit,),
            wiggle=no_columns(size.size),
            shape=shape,
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """What it grows with, and how fast."""
    return {**hypothesis.shape, hypothesis.coefficients[0]: abs(float(coefficients[0]))}


EFFECT = LibraryEffect(
    name="noise_growth",
    nature=Nature.VARIANCE,
    physics="The scatter grows with temperature, speed or load: signals weaken, vibration gets in.",
    formula="s² = s0² + (a (T - T1))² + (b v)² + (c L)²",
    source="signal-to-noise ratio of photodiodes, vibration; shop experience",
    parameters=(
        Parameter(name="arcsec_per_k", unit="arcsec/K", low=0.0, high=0.2, source="shop experience"),
        Parameter(name="arcsec_per_deg_s", unit="arcsec/(deg/s)", low=0.0, high=0.2, source="shop experience"),
        Parameter(name="arcsec_per_nm", unit="arcsec/(N m)", low=0.0, high=1.0, source="shop experience"),
    ),
    cells=(Cell(**_TEMPERATURE), Cell(**_SPEED), Cell(**_LOAD)),
    proof="Read one angle fifty times at both ends of temperature, speed and load.",
    missing_input="a mean: scatter cannot be compensated",
    settings=NoiseGrowthSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
