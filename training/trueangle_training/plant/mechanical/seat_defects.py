"""How the grating sits on the shaft, and what its track is like."""

import numpy as np

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.mechanical.chain import Floats, Share, Stand, phasor
from trueangle_training.plant.schedule import FACES

HIGHEST_ORDER = (FACES - 1) // 2


def eccentricity(stand: Stand, rng: np.random.Generator) -> Defect:
    """The seat is off the axis."""
    toward = phasor(rng)
    return Defect(
        name="eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(centre_arcsec=size * toward),
        cells=(CellTruth(order="1"),),
        parameters={},
    )


def grating_tilt(stand: Stand, rng: np.random.Generator) -> Defect:
    """The shoulder is not square to the axis."""
    toward = phasor(rng)
    return Defect(
        name="grating_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(oval_arcsec=size * toward),
        cells=(CellTruth(order="2"),),
        parameters={},
    )


def screwed_down(stand: Stand, *, screws: int, at: complex, uneven: float) -> Floats:
    """A ring pulled out of round by its screws: a wave steeper on one side, amplitude near 1, shape [n]."""
    wave = at * np.exp(1j * screws * stand.angle_rad)
    return np.asarray((wave / (1.0 - uneven * wave)).imag, dtype=np.float64)


def graduation_error(stand: Stand, rng: np.random.Generator, *, avoid: tuple[int, ...] = ()) -> Defect:
    """One to three sets of screws or masks, none of an order to avoid."""
    free = [order for order in range(3, HIGHEST_ORDER + 1) if order not in avoid]
    count = min(len(free), int(rng.integers(1, 4)))
    orders = [int(order) for order in rng.choice(free, size=count, replace=False)]
    uneven = float(rng.uniform(0.01, 0.06))
    track = np.zeros(stand.angle_rad.size)
    for order in orders:
        track += float(rng.uniform(0.5, 1.0)) * screwed_down(stand, screws=order, at=phasor(rng), uneven=uneven)
    return Defect(
        name="graduation_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(track_arcsec=size * track),
        cells=tuple(CellTruth(order=str(order)) for order in orders),
        parameters={f"order_{i + 1}": float(order) for i, order in enumerate(orders)},
    )


def run_to_run_eccentricity(stand: Stand, rng: np.random.Generator) -> Defect:
    """A seat with play: in each run the hub rests somewhere else within its clearance, often against the edge."""
    runs, which = np.unique(stand.conditions.schedule.run, return_inverse=True)
    out = np.sqrt(rng.uniform(0.2, 1.0, size=runs.size)) * 1.8
    seats = (out * np.exp(2j * np.pi * rng.random(runs.size)))[which]
    return Defect(
        name="run_to_run_eccentricity",
        in_library=True,
        kind="random",
        contribute=lambda size: Share(centre_arcsec=size * seats),
        cells=(CellTruth(order="1", time="between_runs"),),
        parameters={},
    )
