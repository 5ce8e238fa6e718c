"""From the shaft's angle through grating, head and interpolator on one side, the reference on the other."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.listing import Encoder
from trueangle_training.plant.metrological.grating_lines import TURN_ARCSEC, Head, Ruling, indicated_arcsec
from trueangle_training.plant.metrological.interpolator import Signals, interpolation_error_rad
from trueangle_training.plant.metrological.polygon import Reference
from trueangle_training.plant.metrological.soak import Soak
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """What stands in the laboratory and what happens there, before anything is wrong."""

    schedule: Schedule
    soak: Soak
    encoder: Encoder
    head: Head
    line_jitter: Ruling
    """Each line a little beside its place, by itself."""
    reference: Reference

    @property
    def warming_k(self) -> Floats:
        """Of the body from 20 degC, shape [n]."""
        return self.soak.temperature_c - 20.0

    @property
    def from_cold_to_hot(self) -> Floats:
        """0 at the coldest reading to 1 at the hottest, shape [n]."""
        body = self.soak.temperature_c
        return (body - float(body.min())) / max(float(np.ptp(body)), 1e-9)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """What one cause does to the chain; arrays have shape [n] or are one number for all readings."""

    turned_arcsec: Floats | float = 0.0
    """Of the disc, or of the head the other way, against the place where the reference sits."""
    centre_arcsec: Complexes | complex = 0.0
    """Shift of the disc's centre over its radius, in the disc's frame."""
    strain_arcsec: Complexes | complex = 0.0
    """Pure shear of the disc: of a tilted or oval one."""
    rulings: tuple[Ruling, ...] = ()
    signals: Signals = field(default_factory=Signals)
    missing_counts: Floats | float = 0.0
    bits_lost: int = 1
    """Counts come in steps of so many."""
    delay_s: float = 0.0
    reference_arcsec: Floats | float = 0.0
    """What the reference says too much."""
    scatter_arcsec: Floats | float = 0.0
    """Standard deviation of noise added."""


def sum_of(parts: Sequence[Part], size: int) -> Part:
    """All causes at once, arrays of shape [size]."""
    signals = Signals()
    for part in parts:
        signals = signals.plus(part.signals)

    def real(name: str) -> Floats:
        return sum((np.asarray(getattr(part, name), dtype=np.float64) for part in parts), np.zeros(size))

    def plane(name: str) -> Complexes:
        start = np.zeros(size, dtype=np.complex128)
        return sum((np.asarray(getattr(part, name), dtype=np.complex128) for part in parts), start)

    variance = sum((np.square(np.asarray(part.scatter_arcsec)) for part in parts), np.zeros(size))
    return Part(
        turned_arcsec=real("turned_arcsec"),
        centre_arcsec=plane("centre_arcsec"),
        strain_arcsec=plane("strain_arcsec"),
        rulings=tuple(ruling for part in parts for ruling in part.rulings),
        signals=signals,
        missing_counts=real("missing_counts"),
        bits_lost=max([part.bits_lost for part in parts], default=1),
        delay_s=sum(part.delay_s for part in parts),
        reference_arcsec=real("reference_arcsec"),
        scatter_arcsec=np.sqrt(variance),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signs:
    """Of both sides before rounding, against the shaft's true angle, shape [n]."""

    encoder_arcsec: Floats
    reference_arcsec: Floats

    @property
    def error_arcsec(self) -> Floats:
        """Indicated minus reference."""
        return self.encoder_arcsec - self.reference_arcsec


def signs(bench: Bench, parts: Sequence[Part]) -> Signs:
    """One pass through both sides without noise."""
    schedule, head = bench.schedule, bench.head
    whole = sum_of(parts, len(schedule))
    true_arcsec = schedule.angle_deg * 3600.0
    cogging = 1.0 + 0.008 * np.cos(7.0 * np.deg2rad(schedule.angle_deg))
    late = whole.delay_s * schedule.velocity_deg_s * 3600.0 * cogging
    disc = true_arcsec + np.asarray(whole.turned_arcsec) - late
    place = indicated_arcsec(
        disc,
        head,
        centre_arcsec=np.asarray(whole.centre_arcsec),
        strain_arcsec=np.asarray(whole.strain_arcsec),
        rulings=(bench.line_jitter, *whole.rulings),
    )
    pitch_arcsec = TURN_ARCSEC / head.lines_per_rev
    phase = 2.0 * np.pi * (place / pitch_arcsec % 1.0)
    within = interpolation_error_rad(phase, whole.signals) / (2.0 * np.pi) * pitch_arcsec
    missing = np.asarray(whole.missing_counts) * bench.encoder.count_arcsec
    return Signs(
        encoder_arcsec=place + within - missing - true_arcsec,
        reference_arcsec=bench.reference.error_arcsec(schedule) + np.asarray(whole.reference_arcsec),
    )
