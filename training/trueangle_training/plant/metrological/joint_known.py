"""The joint as its maker knows it: what JOINT.yaml lists is there, with the sizes that it has."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.listing import Encoder, Listing
from trueangle_training.plant.metrological.chain import Bench, Part
from trueangle_training.plant.metrological.grating_lines import Head, Ruling, screw_error
from trueangle_training.plant.metrological.interpolator import Signals
from trueangle_training.plant.metrological.polygon import draw_reference
from trueangle_training.plant.metrological.soak import Soak
from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]

HIGHEST_ORDER = 11
STEEPENING_PER_K = 3e-5
"""Relative growth of an expansion coefficient."""
SPAN_K = 15.0


def any_phase(rng: np.random.Generator) -> float:
    """In radians."""
    return float(rng.uniform(0.0, 2.0 * np.pi))


def expansion(warming_k: Floats, *, steepening_per_k: float = STEEPENING_PER_K) -> Floats:
    """Differential expansion from 20 degC, in that of 15 K at 20 degC: its coefficient grows, shape [n]."""
    return (warming_k + 0.5 * steepening_per_k * warming_k**2) / SPAN_K


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """Sizes of all that may be listed, complex where they have a direction; drawn whether listed or not."""

    constant_arcsec: dict[int, complex]
    warm_arcsec: dict[int, complex]
    """For 15 K."""
    datum_arcsec_per_k: float
    signals: Signals
    stick: float


def draw_known(rng: np.random.Generator) -> Known:
    """Sizes as they are usual."""
    once, twice = float(rng.uniform(20.0, 80.0)), float(rng.uniform(2.0, 10.0))
    high = {k: float(rng.uniform(0.2, 8.0)) / k for k in range(3, HIGHEST_ORDER + 1)}
    constant = {k: size * np.exp(1j * any_phase(rng)) for k, size in ({1: once, 2: twice} | high).items()}
    warm = {
        k: float(rng.uniform(low, top)) * np.exp(1j * any_phase(rng))
        for k, low, top in ((1, 2.0, 8.0), (2, 0.3, 2.0))
    }
    return Known(
        constant_arcsec=constant,
        warm_arcsec=warm,
        datum_arcsec_per_k=float(rng.normal(0.0, 0.1)),
        signals=Signals(
            offset_cos=float(rng.normal(0.0, 6e-5)),
            offset_sin=float(rng.normal(0.0, 6e-5)),
            ellipse_cos=float(rng.normal(0.0, 6e-5)),
            ellipse_sin=float(rng.normal(0.0, 6e-5)),
        ),
        stick=float(rng.uniform(0.0, 2e-3)),
    )


def known_parts(bench: Bench, known: Known, listing: Listing) -> list[Part]:
    """Everything listed, the datum's drift, and very good signals."""
    grown = expansion(bench.warming_k)
    parts = [Part(turned_arcsec=known.datum_arcsec_per_k * bench.warming_k, signals=known.signals)]
    parts += [_order(bench, k, known.constant_arcsec[k], 1.0, known.stick) for k in listing.constant]
    parts += [_order(bench, k, known.warm_arcsec[k], grown, known.stick) for k in listing.thermal]
    return parts


def _order(bench: Bench, order: int, size: complex, course: Floats | float, stick: float) -> Part:
    if order == 1:
        return Part(centre_arcsec=np.asarray(size * course, dtype=np.complex128))
    if order == 2:
        return Part(strain_arcsec=np.asarray(size * course, dtype=np.complex128))
    lines = screw_error(bench.encoder.lines_per_rev, order=order, phase_rad=float(np.angle(size)), stick=stick)
    return Part(rulings=(Ruling(lines_arcsec=float(abs(size)) * lines, course=course),))


def draw_bench(schedule: Schedule, soak: Soak, encoder: Encoder, rng: np.random.Generator) -> Bench:
    """Encoder and reference set up on this shaft."""
    seen_deg = float(rng.uniform(0.3, 1.0))
    half = max(2, int(seen_deg / 360.0 * encoder.lines_per_rev / 2.0))
    jitter = rng.normal(0.0, float(rng.uniform(0.01, 0.03)), size=encoder.lines_per_rev)
    return Bench(
        schedule=schedule,
        soak=soak,
        encoder=encoder,
        head=Head(lines_per_rev=encoder.lines_per_rev, lines_seen=2 * half + 1),
        line_jitter=Ruling(lines_arcsec=jitter),
        reference=draw_reference(schedule, rng),
    )
