"""Bias or gain of the temperature sensor: the thermal effects take a wrong temperature.

What is seen of it is the change of the modelled thermal response with temperature. Where that is a polynomial
whose lower powers are calibrated too, re-calibration takes all of it and it is never named.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range, structure
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter, Stage
from trueangle_training.effects.harmonics import HarmonicTerm, harmonic_series
from trueangle_training.effects.library.thermal_eccentricity import ThermalEccentricitySettings
from trueangle_training.effects.library.thermal_graduation import ThermalGraduationSettings
from trueangle_training.effects.library.thermal_nonlinearity import DEFAULT_ORDERS, ThermalNonlinearitySettings
from trueangle_training.effects.library.thermal_tilt import ThermalTiltSettings
from trueangle_training.effects.patterns import beside, no_columns

Floats = NDArray[np.float64]

_DOUBT_NATS = 3.0
"""Where it can be seen at all, eccentricity makes the same pattern, and does so twenty times as often."""
_RESPONSES = {
    "thermal_eccentricity": (ThermalEccentricitySettings, ((1, 1),)),
    "thermal_tilt": (ThermalTiltSettings, ((2, 1),)),
    "thermal_graduation": (ThermalGraduationSettings, ((3, 1),)),
    "thermal_nonlinearity": (ThermalNonlinearitySettings, tuple((order, 2) for order in DEFAULT_ORDERS)),
}
"""Settings of the effects that take the sensor's temperature; order and degree where nothing is nominal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSensorErrorSettings:
    """shown = true + bias + gain (true - T0)."""

    bias_c: Annotated[float, Range(minimum=-20, maximum=20)] | None = None
    """None: calibrated from data, as far as it can be told from the thermal effects."""
    gain: Annotated[float, Range(minimum=-0.5, maximum=0.5)] = 0.0

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is an error at a true temperature."""
        return None if self.bias_c is None else ()

    def shown_c(self, true_c: Floats, joint: Joint) -> Floats:
        """What the sensor shows, resolution left aside."""
        return true_c + (self.bias_c or 0.0) + self.gain * (true_c - joint.base_temperature_c)

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """What the thermal effects at the shown temperature leave out, shape [readings]."""
        shown_c = conditions.temperature_c
        if shown_c is None:
            return np.zeros(len(conditions))
        base_c = joint.base_temperature_c
        true_c = base_c + (shown_c - base_c - (self.bias_c or 0.0)) / (1.0 + self.gain)
        series = harmonic_series(thermal_response(joint), base_temperature_c=base_c)
        at_true, at_shown = (series.error_arcsec(conditions.angle_deg, at_c) for at_c in (true_c, shown_c))
        return at_true - at_shown

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Change of the nominal thermal response with bias and with gain."""
        shown_c = conditions.complete("temperature_c")
        response = thermal_response(joint)
        if shown_c is None or not response:
            return no_columns(len(conditions))
        slope = _slope_arcsec_per_k(conditions, shown_c, response)
        return beside(-slope, -slope * (shown_c - joint.base_temperature_c))


def thermal_response(joint: Joint) -> tuple[HarmonicTerm, ...]:
    """Terms of the joint's thermal effects; of those without nominal parameters none."""
    terms: list[HarmonicTerm] = []
    for name, (settings, _) in _RESPONSES.items():
        if name in joint.effects:
            terms += structure(settings, joint.effects[name]).terms(joint) or ()
    return tuple(terms)


def _stand_ins(joint: Joint) -> tuple[HarmonicTerm, ...]:
    """One arcsec per kelvin for each modelled response whose parameters are left out."""
    return tuple(
        HarmonicTerm(order=order, degree=degree, amplitude=1.0, phase_deg=0.0)
        for name, (settings, powers) in _RESPONSES.items()
        if name in joint.effects and structure(settings, joint.effects[name]).terms(joint) is None
        for order, degree in powers
    )


def _slope_arcsec_per_k(conditions: Conditions, at_c: Floats, response: tuple[HarmonicTerm, ...]) -> Floats:
    """dE/dT of the response, shape [readings]."""
    derived = [
        HarmonicTerm(
            order=term.order,
            degree=term.degree - 1,
            amplitude=term.amplitude * term.degree,
            phase_deg=term.phase_deg,
        )
        for term in response
        if term.degree > 0
    ]
    series = harmonic_series(derived, base_temperature_c=conditions.base_temperature_c)
    return series.error_arcsec(conditions.angle_deg, at_c)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Bias and gain, to first order; none without temperatures or a modelled thermal response."""
    shown_c, joint = conditions.complete("temperature_c"), conditions.joint
    if shown_c is None or joint is None:
        return
    response = thermal_response(joint) or _stand_ins(joint)
    if not response:
        return
    slope = _slope_arcsec_per_k(conditions, shown_c, response)
    gain = -slope * (shown_c - conditions.base_temperature_c)
    orders = {term.order for term in response}
    for name, main in (("bias_c", -slope), ("gain", gain)):
        yield Hypothesis(
            effect="temperature_sensor_error",
            label=name.removesuffix("_c"),
            cell=Cell(order=str(min(orders)), temperature="linear" if name == "gain" else "constant"),
            main=main[:, None],
            coefficients=(name,),
            wiggle=no_columns(len(conditions)),
            doubt_nats=_DOUBT_NATS,
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Bias or gain."""
    return {"bias_c": 0.0, hypothesis.coefficients[0]: float(coefficients[0])}


EFFECT = LibraryEffect(
    name="temperature_sensor_error",
    nature=Nature.MEAN,
    physics="The sensor shows a wrong temperature: the thermal effects are computed for another one.",
    formula="E = R(θ, T) - R(θ, T_shown), T_shown = T + b + g (T - T0), R the modelled thermal response",
    source="data sheets of temperature sensors: bias and slope; first-order expansion of the response",
    parameters=(
        Parameter(name="bias_c", unit="K", low=-2.0, high=2.0, source="DS18B20 data sheet: 0.5 degC to 2 degC"),
        Parameter(name="gain", unit="1", low=-0.05, high=0.05, source="shop experience: sensor half in the air"),
    ),
    cells=(Cell(order="1", temperature="constant"), Cell(order="1", temperature="linear")),
    proof="Compare with a calibrated thermometer in the same block at three temperatures.",
    missing_input="true temperature",
    settings=TemperatureSensorErrorSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("temperature_c",),
    stage=Stage.SENSOR,
)
