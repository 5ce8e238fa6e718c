"""What a defect does to each part of the measuring chain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.reading_head.geometry import SignalError
from trueangle_training.plant.reading_head.heat import Climate
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]
LineShift = Callable[[Floats], Floats]

MM_PER_ARCSEC_AT_1MM = np.pi / 180.0 / 3600.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contribution:
    """One defect's share in the chain; arrays have shape [n] and are broadcast from scalars."""

    twist_arcsec: Floats | float = 0.0
    """Of the grating against the reference, by torque between them."""
    head_arcsec: Floats | float = 0.0
    """The reading head moved along the grating."""
    centre_mm: NDArray[np.complex128] | complex = 0.0
    """Grating's centre in the shaft's frame."""
    wobble_mm: NDArray[np.complex128] | complex = 0.0
    """The shaft's axis in the housing's frame."""
    ovality: NDArray[np.complex128] | complex = 0.0
    line_shifts: tuple[LineShift, ...] = ()
    """Where the lines are, in arcsec, as functions of the place on the grating in degrees [n]."""
    signals: SignalError = field(default_factory=SignalError)
    lost_counts: Floats | float = 0.0
    latency_s: float = 0.0
    coarse: int = 1
    """Only every so many counts are resolved."""
    reference_arcsec: Floats | float = 0.0
    """Added to what the reference says."""
    scatter_arcsec: Floats | float = 0.0
    """Standard deviation of additional noise of each reading."""


def together(parts: Sequence[Contribution]) -> Contribution:
    """All contributions at once."""
    signals = SignalError()
    for part in parts:
        signals = signals.added(part.signals)
    return Contribution(
        twist_arcsec=_total([part.twist_arcsec for part in parts]),
        head_arcsec=_total([part.head_arcsec for part in parts]),
        centre_mm=_total_vector([part.centre_mm for part in parts]),
        wobble_mm=_total_vector([part.wobble_mm for part in parts]),
        ovality=_total_vector([part.ovality for part in parts]),
        line_shifts=tuple(shift for part in parts for shift in part.line_shifts),
        signals=signals,
        lost_counts=_total([part.lost_counts for part in parts]),
        latency_s=sum(part.latency_s for part in parts),
        coarse=max([part.coarse for part in parts], default=1),
        reference_arcsec=_total([part.reference_arcsec for part in parts]),
        scatter_arcsec=np.sqrt(_total([np.square(part.scatter_arcsec) for part in parts])),
    )


def _total(values: Sequence[Floats | float]) -> Floats | float:
    return sum((np.asarray(value, dtype=np.float64) for value in values), np.float64(0.0))


def _total_vector(values: Sequence[NDArray[np.complex128] | complex]) -> NDArray[np.complex128] | complex:
    return sum((np.asarray(value, dtype=np.complex128) for value in values), np.complex128(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """Everything a defect can depend on."""

    schedule: Schedule
    climate: Climate
    radius_mm: float
    lines_per_rev: int
    count_arcsec: float

    def mm(self, arcsec: float) -> float:
        """The displacement across the grating's radius that turns it by so much."""
        return arcsec * self.radius_mm * MM_PER_ARCSEC_AT_1MM

    @property
    def from_middle_k(self) -> Floats:
        """Temperature of the body from the middle of the campaign's range, shape [n]."""
        body = self.climate.temperature_c
        return body - 0.5 * (float(body.min()) + float(body.max()))

    @property
    def relative_temperature(self) -> Floats:
        """-1 at the coldest to 1 at the hottest reading, shape [n]."""
        middle = self.from_middle_k
        return middle / max(float(np.abs(middle).max()), 1e-9)
