"""The methods that turn calibration readings into a model of the error, and what to use when.

Every method takes `TrainingReadings` and gives an `ErrorModel`: the error in arcsec over angle and temperature,
counted from the datum (the first face), where it is exactly zero at every temperature. Only that much can be known
from a campaign whose runs are zeroed one by one at their first face, eq. (11) of Jia et al. 2020.

What to use when
- `fe_gabpnn`: the paper's method. Needs a base temperature and at least one other, and complete turns of faces.
  To reproduce the paper and to compare with it. Between the last face and the end of the turn it extrapolates,
  because the paper feeds the plain angle to the network; and beyond the calibrated temperatures, as any network,
  it does not know what it says.

Judge a method by a left-out temperature, or on a simulated joint by the true error; the residual of the readings
it was trained on, and a random tenth kept apart, rank methods wrongly or not at all.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class UnsuitableReadingsError(ContractError, ValueError):
    """Readings that a method cannot be trained on: the faults say which and what to measure or choose instead."""


class ErrorModel(Protocol):
    """What every method gives."""

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """Estimated error, indicated minus reference, counted from the datum at the same temperature.

        `angle_deg` is any finite indicated angle; both arrays have shape [n], and so has the result.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrainingReadings:
    """The readings of one joint's campaign, each array of shape [readings], all finite."""

    angle_deg: Floats
    """Indicated angle, any finite real."""
    error_arcsec: Floats
    """Indicated minus reference, counted from the datum within each run, eq. (11)."""
    temperature_c: Floats
    run: Integers
    """Which run a reading belongs to: readings between two set-ups."""

    def __post_init__(self) -> None:
        shapes = {
            name: getattr(self, name).shape for name in ("angle_deg", "error_arcsec", "temperature_c", "run")
        }
        faults = [
            Fault(where=name, expected=f"shape {(self.angle_deg.size,)} like angle_deg", found=f"shape {shape}")
            for name, shape in shapes.items()
            if shape != (self.angle_deg.size,)
        ]
        if self.angle_deg.size == 0:
            faults.append(Fault(where="readings", expected="at least one", found="none"))
        for name in ("angle_deg", "error_arcsec", "temperature_c"):
            unknown = np.flatnonzero(~np.isfinite(getattr(self, name)))
            if unknown.size:
                found = f"{unknown.size} that are NaN or infinite, the first at index {unknown[0]}"
                advice = "leave out such readings or complete them"
                faults.append(Fault(where=name, expected="finite numbers", found=found, advice=advice))
        if faults:
            raise UnsuitableReadingsError(faults)

    def __len__(self) -> int:
        return int(self.angle_deg.size)

    def run_mean_temperature_c(self) -> Floats:
        """The mean temperature of the run that each reading belongs to, shape [readings]."""
        _, index, counts = np.unique(self.run, return_inverse=True, return_counts=True)
        means = np.bincount(index, weights=self.temperature_c) / counts
        return means[index]


def distinct_angle_count(angle_deg: Floats, tolerance_deg: float = 0.5) -> int:
    """How many places of the circle were measured.

    Angles within `tolerance_deg` behind the first of a place belong to it: indicated angles of one polygon face
    differ by counts, and by the 0.2 deg to which the paper's zero is set. Counting starts after the widest gap, so
    that a face at the seam, some readings just below 360 and some just above 0, is one place.
    """
    ordered = np.sort(np.mod(angle_deg, 360.0))
    gaps = np.diff(ordered, append=ordered[0] + 360.0)
    start = (int(np.argmax(gaps)) + 1) % ordered.size
    unrolled = np.mod(ordered - ordered[start], 360.0)
    unrolled.sort()
    places, first = 0, -np.inf
    for angle in unrolled:
        if angle - first > tolerance_deg:
            places, first = places + 1, angle
    return places
