"""What was served against what is true: errors of raw and corrected angle, counted from the joint's datum.

A campaign zeroed at its first face cannot see an error common to all angles (Jia et al. 2020, Eq. 11), so both
errors are counted from the datum at the same temperature, and the datum's own drift is stated beside them.
"""

from dataclasses import dataclass, field

import numpy as np

from trueangle.contract.units import ARCSEC_PER_DEG, angle_difference_deg
from trueangle_training.demo.plc import Reading
from trueangle_training.simulator.trajectory import LiveJoint

SEQUENCE_MODULUS = 2**16
DATUM_DEG = 0.0


@dataclass(slots=True)
class JointJudge:
    """Collects one joint's errors, one pair a sample, however often a sample was read."""

    name: str
    live: LiveJoint
    raw_arcsec: list[float] = field(default_factory=list[float])
    corrected_arcsec: list[float] = field(default_factory=list[float])
    not_valid: int = 0
    last: Reading | None = None
    last_true_deg: float = 0.0
    _sequence: int = 0

    def take(self, reading: Reading) -> None:
        """Compare one answer with the truth of the very sample that it shows."""
        self.last = reading
        if not reading.valid or reading.corrected_deg is None or reading.raw_deg is None:
            self.not_valid += 1
            return
        # The register holds 16 bits of the sample number: continue it from the last one.
        sequence = self._sequence + (reading.sequence - self._sequence) % SEQUENCE_MODULUS
        if sequence == self._sequence and self.raw_arcsec:
            return
        self._sequence = sequence
        truth = self.live.truth(sequence)
        self.last_true_deg = truth.true_deg % 360.0
        series = self.live.simulated.series
        datum_arcsec = series.error_at_arcsec(DATUM_DEG, truth.temperature_c)
        for angle_deg, errors in (
            (reading.raw_deg, self.raw_arcsec),
            (reading.corrected_deg, self.corrected_arcsec),
        ):
            off_deg = angle_difference_deg(angle_deg, self.last_true_deg)
            errors.append(off_deg * ARCSEC_PER_DEG - datum_arcsec)

    def datum_drift_arcsec(self, temperatures_c: tuple[float, ...]) -> float:
        """RMS of E(datum, T) about its mean over the campaign's temperatures: what no such campaign can see."""
        drift = [self.live.simulated.series.error_at_arcsec(DATUM_DEG, t) for t in temperatures_c]
        return float(np.std(drift))


def rms(values: list[float]) -> float:
    """Root mean square; 0 for no values."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else 0.0
