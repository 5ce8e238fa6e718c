"""A joint that shows wrong angles by known amounts.

    indicated = true + E(true, T)          E in arcsec, a function of the true mechanical angle

and, in a campaign, of everything else that effects depend on. The encoder's own zero lies at true angle 0; no
preset is set. E there is not zero in general, so an encoder that stands at the datum shows E(datum, T) and a model
that counts from the datum leaves this angle in its readings.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.effects import Effect, Stage, nominal_effects
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.harmonics import HarmonicSeries, harmonic_series
from trueangle_training.effects.library.temperature_sensor_error import TemperatureSensorErrorSettings

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
EffectRng = Callable[[str], np.random.Generator]
"""A generator of its own for each effect: adding one leaves the draws of the others as they were."""
IN_A_LINE = "the place in a line"
"""A function of the angle too, but none that low orders could express."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedJoint:
    """A joint with the nominal parameters of all its effects."""

    joint: Joint
    effects: tuple[Effect, ...]
    series: HarmonicSeries
    """All effects that are functions of angle and temperature, in one sum."""

    def require_series(self) -> None:
        """ContractError where an effect depends on more than angle and temperature."""
        beyond = [effect for effect in self.effects if not effect.is_series]
        if beyond:
            raise ContractError(
                [
                    Fault(
                        where=self.joint.effects[effect.name].where,
                        expected="an effect that is a function of angle and temperature",
                        found=f"{effect.name}, which depends on {effect.library.missing_input or IN_A_LINE}",
                        advice="leave it out here; trueangle simulate can simulate it in a campaign",
                    )
                    for effect in beyond
                ]
            )

    def error_arcsec(self, true_deg: Floats, temperature_c: Floats | float) -> Floats:
        """E(true, T), indicated minus true, without noise; shapes broadcast.

        ContractError where this is not all of the joint's error.
        """
        self.require_series()
        return self.series.error_arcsec(true_deg, temperature_c)

    def error_from_datum_arcsec(self, true_deg: Floats, temperature_c: Floats | float, datum_deg: float) -> Floats:
        """E(true, T) - E(datum, T): what a campaign zeroed at `datum_deg` (a true angle) can show."""
        at_datum = self.error_arcsec(np.asarray(datum_deg), temperature_c)
        return self.series.error_arcsec(true_deg, temperature_c) - at_datum

    def indicated_counts(self, conditions: Conditions, noise_arcsec: Floats, rng_of: EffectRng) -> Integers:
        """Position values, whole turns kept, shape [readings]; `conditions` hold the true angles.

        First what is a function of the shaft's angle, then what is one of the scale's, then the noise, then what
        the readout does to all of it.
        """
        true_deg = conditions.angle_deg
        temperature_c = conditions.temperature_c
        at_c = np.full_like(true_deg, self.joint.base_temperature_c) if temperature_c is None else temperature_c
        error_arcsec = self.series.error_arcsec(true_deg, at_c)
        error_arcsec = error_arcsec + self._stage_arcsec(Stage.SHAFT, conditions, rng_of)
        on_scale = replace(conditions, angle_deg=true_deg + error_arcsec / ARCSEC_PER_DEG)
        error_arcsec = error_arcsec + self._stage_arcsec(Stage.SCALE, on_scale, rng_of)
        indicated_deg = true_deg + (error_arcsec + noise_arcsec) / ARCSEC_PER_DEG
        shown = replace(conditions, angle_deg=indicated_deg)
        indicated_deg = indicated_deg + self._stage_arcsec(Stage.READOUT, shown, rng_of) / ARCSEC_PER_DEG
        counts_per_rev = self.joint.encoder.counts_per_rev
        return np.rint(indicated_deg * (counts_per_rev / DEG_PER_TURN)).astype(np.int64)

    def reference_arcsec(self, conditions: Conditions, rng_of: EffectRng) -> Floats:
        """What the reference's own error adds to indicated minus reference, shape [readings]."""
        return self._stage_arcsec(Stage.REFERENCE, conditions, rng_of)

    def _stage_arcsec(self, stage: Stage, conditions: Conditions, rng_of: EffectRng) -> Floats:
        total = np.zeros(len(conditions))
        for effect in self.effects:
            if effect.library.stage is stage and not effect.is_series:
                total += effect.settings.error_arcsec(conditions, self.joint, rng_of(effect.name))
        return total

    def shown_temperature_c(self, temperature_c: float) -> float:
        """What the temperature sensor shows of one temperature."""
        return float(self.shown_temperatures_c(np.array([temperature_c]))[0])

    def shown_temperatures_c(self, temperature_c: Floats) -> Floats:
        """What the temperature sensor shows: with its error, rounded to its resolution."""
        for effect in self.effects:
            if isinstance(effect.settings, TemperatureSensorErrorSettings):
                temperature_c = effect.settings.shown_c(temperature_c, self.joint)
        step_c = self.joint.temperature_sensor.resolution_c
        return np.round(temperature_c / step_c) * step_c if step_c > 0 else temperature_c


def simulated_joint(joint: Joint) -> SimulatedJoint:
    """The joint ready to be read; ContractError where an effect lacks its parameters."""
    effects = nominal_effects(joint)
    terms = [term for effect in effects for term in effect.terms]
    series = harmonic_series(terms, base_temperature_c=joint.base_temperature_c)
    return SimulatedJoint(joint=joint, effects=effects, series=series)
