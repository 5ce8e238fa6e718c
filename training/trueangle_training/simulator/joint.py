"""A joint that shows wrong angles by known amounts.

    indicated = true + E(true, T)          E in arcsec, a function of the true mechanical angle

The encoder's own zero lies at true angle 0; no preset is set. E there is not zero in general, so an encoder that
stands at the datum shows E(datum, T) and a model that counts from the datum leaves this angle in its readings.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.effects import nominal_effects
from trueangle_training.effects.harmonics import HarmonicSeries, harmonic_series
from trueangle_training.effects.kinds import Effect

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedJoint:
    """A joint with the nominal parameters of all its effects."""

    joint: Joint
    effects: tuple[Effect, ...]
    series: HarmonicSeries
    """All effects in one sum."""

    def error_arcsec(self, true_deg: Floats, temperature_c: Floats | float) -> Floats:
        """E(true, T), indicated minus true, without noise; shapes broadcast."""
        return self.series.error_arcsec(true_deg, temperature_c)

    def error_from_datum_arcsec(self, true_deg: Floats, temperature_c: Floats | float, datum_deg: float) -> Floats:
        """E(true, T) - E(datum, T): what a campaign zeroed at `datum_deg` (a true angle) can show."""
        at_datum = self.series.error_arcsec(np.asarray(datum_deg), temperature_c)
        return self.series.error_arcsec(true_deg, temperature_c) - at_datum

    def indicated_counts(
        self, true_deg: Floats, temperature_c: Floats | float, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Position values of single readings, noise and quantisation included, whole turns kept."""
        error_arcsec = self.error_arcsec(true_deg, temperature_c)
        noise_arcsec = rng.normal(0.0, self.joint.noise.repeatability_arcsec, size=error_arcsec.shape)
        indicated_deg = true_deg + (error_arcsec + noise_arcsec) / ARCSEC_PER_DEG
        counts_per_rev = self.joint.encoder.counts_per_rev
        return np.rint(indicated_deg * (counts_per_rev / DEG_PER_TURN)).astype(np.int64)

    def shown_temperature_c(self, temperature_c: float) -> float:
        """What the temperature sensor shows: the temperature rounded to the sensor's resolution."""
        step_c = self.joint.temperature_sensor.resolution_c
        return round(temperature_c / step_c) * step_c if step_c > 0 else temperature_c


def simulated_joint(joint: Joint) -> SimulatedJoint:
    """The joint ready to be read; ContractError where an effect cannot be simulated or lacks its parameters."""
    effects = nominal_effects(joint)
    terms = [term for effect in effects for term in effect.terms]
    series = harmonic_series(terms, base_temperature_c=joint.base_temperature_c)
    return SimulatedJoint(joint=joint, effects=effects, series=series)
