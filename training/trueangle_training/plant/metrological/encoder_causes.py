"""Causes in grating, head and interpolator."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.metrological.chain import Bench, Part
from trueangle_training.plant.metrological.grating_lines import ARCSEC_PER_RAD, Ruling, screw_error
from trueangle_training.plant.metrological.interpolator import Signals
from trueangle_training.plant.metrological.joint_known import HIGHEST_ORDER, any_phase

Floats = NDArray[np.float64]


def eccentricity(bench: Bench, rng: np.random.Generator) -> Defect:
    """The disc was glued beside the hub's centre."""
    toward = np.exp(1j * any_phase(rng))
    return Defect(
        name="eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(centre_arcsec=size * toward),
        cells=(CellTruth(order="1"),),
        parameters={},
    )


def grating_tilt(bench: Bench, rng: np.random.Generator) -> Defect:
    """The disc is pulled out of round by its screws."""
    along = np.exp(1j * any_phase(rng))
    return Defect(
        name="grating_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(strain_arcsec=size * along),
        cells=(CellTruth(order="2"),),
        parameters={},
    )


def graduation_error(bench: Bench, rng: np.random.Generator, *, avoid: tuple[int, ...] = ()) -> Defect:
    """The ruling engine's screw: one order or two or three, with a little of their third harmonic."""
    free = [order for order in range(3, HIGHEST_ORDER + 1) if order not in avoid]
    orders = rng.choice(free, size=min(len(free), int(rng.integers(1, 4))), replace=False)
    stick = float(rng.uniform(0.0, 0.25))
    lines = np.zeros(bench.encoder.lines_per_rev)
    for order in orders.tolist():
        wave = screw_error(lines.size, order=order, phase_rad=any_phase(rng), stick=stick)
        lines += float(rng.uniform(0.5, 1.0)) * wave
    return Defect(
        name="graduation_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(rulings=(Ruling(lines_arcsec=size * lines),)),
        cells=tuple(CellTruth(order=str(k)) for k in orders.tolist()),
        parameters={f"order_{i + 1}": float(k) for i, k in enumerate(orders.tolist())},
    )


def localized_defect(bench: Bench, rng: np.random.Generator) -> Defect:
    """A group of lines that a scratch or a blister of the glue pushes along the track, most in its middle."""
    width_deg = float(rng.uniform(2.0, 12.0))
    seen_deg = float(bench.schedule.angle_deg[rng.integers(len(bench.schedule))])
    centre_deg = seen_deg + float(rng.uniform(-0.35, 0.35)) * width_deg
    place_deg = 360.0 * np.arange(bench.encoder.lines_per_rev) / bench.encoder.lines_per_rev
    away = np.abs((place_deg - centre_deg + 180.0) % 360.0 - 180.0)
    lines = np.where(away < width_deg, 0.5 * (1.0 + np.cos(np.pi * away / width_deg)), 0.0)
    return Defect(
        name="localized_defect",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(rulings=(Ruling(lines_arcsec=size * lines),)),
        cells=(CellTruth(order="localized"),),
        parameters={"width_deg": width_deg, "centre_deg": centre_deg % 360.0},
    )


def subdivision_error(bench: Bench, rng: np.random.Generator) -> Defect:
    """The figure of both signals is off centre, an ellipse, and has corners."""
    offset, ellipse = rng.normal(size=2), rng.normal(size=2) * float(rng.uniform(0.2, 1.3))
    unit = bench.encoder.lines_per_rev / ARCSEC_PER_RAD
    signals = Signals(
        offset_cos=float(offset[0]),
        offset_sin=float(offset[1]),
        ellipse_cos=float(ellipse[0]),
        ellipse_sin=float(ellipse[1]),
        square=float(rng.normal(0.0, 0.15)),
    ).times(unit)
    return Defect(
        name="subdivision_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(signals=signals.times(size)),
        cells=(CellTruth(order="N"), CellTruth(order="2N"), CellTruth(order="4N")),
        parameters={},
    )


def quantisation(bench: Bench, rng: np.random.Generator) -> Defect:
    """The lowest counts of the interpolator stand still."""
    count = bench.encoder.count_arcsec

    def contribute(size: float) -> Part:
        return Part(bits_lost=max(2, round(float(np.sqrt(12.0 * (size / count) ** 2 + 1.0)))))

    return Defect(
        name="quantisation",
        in_library=True,
        kind="variance",
        contribute=contribute,
        cells=(CellTruth(order="0", moment="variance"),),
        parameters={},
    )


def count_loss(bench: Bench, rng: np.random.Generator) -> Defect:
    """A counter misses edges, once or twice in some runs; its index mark sets it right before the next run."""
    schedule = bench.schedule
    runs = rng.choice(np.unique(schedule.run), size=int(rng.integers(1, 4)), replace=False)
    missing = np.zeros(len(schedule))
    for run in runs:
        rows = np.flatnonzero(schedule.run == run)
        way = float(rng.choice([-1.0, 1.0]))
        for _ in range(int(rng.choice([1, 1, 1, 2]))):
            start = int(rng.integers(rows.size // 6, rows.size - rows.size // 6))
            missing[rows[start:]] += way

    def contribute(size: float) -> Part:
        return Part(missing_counts=missing * max(1, round(abs(size) / bench.encoder.count_arcsec)))

    return Defect(
        name="count_loss",
        in_library=True,
        kind="event",
        contribute=contribute,
        cells=(CellTruth(order="0", time="within_run"),),
        parameters={"runs": float(runs.size)},
    )


def read_latency(bench: Bench, rng: np.random.Generator) -> Defect:
    """The interpolator's filter is late by a fixed time, or the trigger of the reference is."""
    fastest = max(float(np.abs(bench.schedule.velocity_deg_s).max()), 1.0)
    sense = float(rng.choice([1.0, 1.0, -1.0]))
    return Defect(
        name="read_latency",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(delay_s=sense * size / 3600.0 / fastest),
        cells=(CellTruth(order="0", speed="linear"), CellTruth(order="0", direction="odd", speed="linear")),
        parameters={},
    )
