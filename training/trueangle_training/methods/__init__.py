"""The methods that turn calibration readings into a model of the error, and what to use when.

Every method takes `TrainingReadings` and gives a `Fit` whose model is a `FittedModel`: the error in arcsec over
angle and temperature, counted from the datum (the first face), where it is exactly zero at every temperature. Only
that much can be known from a campaign whose runs are zeroed one by one at their first face, eq. (11) of Jia et al.
2020. `registry.load_method(name)` gives a method by its command-line name and imports nothing of the others.

What to use when
- `fe-gabpnn` (default): Fourier series plus a small network in temperature, started by a genetic algorithm and
  trained by Levenberg-Marquardt, as in the paper, but in the domain of the Fourier coefficients, with offsets of
  the runs, known noise and evidence in place of a random hold-out.
- `linear`: harmonics with smooth temperature terms weighted by evidence (a mixture of Gaussian processes).
  Deterministic, milliseconds, needs no torch. The one to look at first.
- `best`: the average of the network, the kernels and shapes shared by all harmonics; seconds instead of a fraction
  of one. On usual joints no better than the others, on odd shapes over temperature (bumps, waves, steps) clearly.
- `fe-gabpnn-paper`: the paper's equations (1)-(10) to the letter but for the misprint in (10), to reproduce the
  paper and to compare with it. Needs a base temperature; between the last face and the end of the turn it
  extrapolates.
- `fe-bpnn`, `bpnn`, `poly2d`, `fepf`, `harmonics-poly`, `angle-only`: what the paper and its predecessor compare
  with.

Judge a method by a left-out temperature, or on a simulated joint by the true error; the residual of the readings
it was trained on, and a random tenth kept apart, rank methods wrongly or not at all.
"""

from collections.abc import Callable, Mapping
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
    """The error over angle and temperature, all that export and judgement need."""

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """Estimated error, indicated minus reference, counted from the datum at the same temperature.

        `angle_deg` is any finite indicated angle; both arrays have shape [n], and so has the result.
        """
        ...


class FittedModel(ErrorModel, Protocol):
    """What every method gives."""

    @property
    def datum_deg(self) -> float:
        """Where the error is exactly 0 at every temperature, in [0, 360)."""
        ...

    @property
    def temperature_used(self) -> bool:
        """False: the second input changes nothing."""
        ...

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        """Standard uncertainty (k = 1) of `error_arcsec`, shape [n]; None: the method knows none.

        Of the model alone: the spread of E(θ, T) - E(datum, T) that the readings leave open. The reference's and
        the temperature sensor's parts are added in the export.
        """
        ...


Progress = Callable[[int, int], None]
"""Told (steps done, all steps)."""


def no_progress(done: int, total: int) -> None:
    """For callers that do not watch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A model and what must be said of it."""

    model: FittedModel
    notes: tuple[str, ...] = ()
    """In plain words, for the report and the model file."""
    settings: Mapping[str, object]
    """Plain values for the model file's metadata: str, int, float, bool, None, lists and mappings of them."""


class Method(Protocol):
    """One way to make a model; the same readings and seed give the same model to the last bit."""

    @property
    def name(self) -> str:
        """As on the command line, with hyphens."""
        ...

    @property
    def summary(self) -> str:
        """One line."""
        ...

    def fit(self, readings: "TrainingReadings", *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Make a model; UnsuitableReadingsError lists what the readings lack."""
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
    zero_group: Integers | None = None
    """Readings zeroed together; None: each run by itself."""
    datum_deg: float = 0.0
    """Where models count errors from, in [0, 360): normally the first face."""

    def __post_init__(self) -> None:
        names = ["angle_deg", "error_arcsec", "temperature_c", "run"]
        names += [] if self.zero_group is None else ["zero_group"]
        shapes = {name: getattr(self, name).shape for name in names}
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
        if not 0.0 <= self.datum_deg < 360.0:
            faults.append(Fault(where="datum_deg", expected="0 to below 360", found=f"{self.datum_deg:g}"))
        if faults:
            raise UnsuitableReadingsError(faults)

    def __len__(self) -> int:
        return int(self.angle_deg.size)

    @property
    def offset_group(self) -> Integers:
        """Which free offset a reading has, numbered from 0, shape [readings].

        One offset for each part of a run that was zeroed by itself. Runs at different temperatures that share a
        zero get offsets of their own too: an error that is the same at all angles and drifts with temperature is
        not part of the model and must not be pressed into it.
        """
        labels = self.run if self.zero_group is None else self.zero_group
        pairs = np.stack([self.run, labels], axis=1)
        return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)

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
