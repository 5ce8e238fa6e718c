"""What can be wrong with the grating, how it sits, and the signals read from it."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.reading_head.contribution import Contribution, LineShift, Setting
from trueangle_training.plant.reading_head.geometry import ARCSEC_PER_RAD, SignalError
from trueangle_training.plant.schedule import FACES

Floats = NDArray[np.float64]


def phase(rng: np.random.Generator) -> float:
    """Any phase, in radians."""
    return float(rng.uniform(0.0, 2.0 * np.pi))


def ruled_wave(place_deg: Floats, *, order: int, phase_rad: float, skew: float) -> Floats:
    """A periodic error as a ruling engine leaves it, amplitude near 1: the angle seen from a point off a circle.

    arg(1 - s e^-ix) / s = sin x + s/2 sin 2x + s^2/3 sin 3x + ...
    """
    x = order * np.deg2rad(place_deg) + phase_rad
    return np.arctan2(skew * np.sin(x), 1.0 - skew * np.cos(x)) / skew


def eccentricity(setting: Setting, rng: np.random.Generator) -> Defect:
    """Grating centre off the axis."""
    toward = np.exp(1j * phase(rng))
    return Defect(
        name="eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(centre_mm=setting.mm(size) * toward),
        cells=(CellTruth(order="1"),),
        parameters={},
    )


def grating_tilt(setting: Setting, rng: np.random.Generator) -> Defect:
    """A tilted or oval grating."""
    axis = np.exp(1j * phase(rng))
    return Defect(
        name="grating_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(ovality=2.0 * size / ARCSEC_PER_RAD * axis),
        cells=(CellTruth(order="2"),),
        parameters={},
    )


def graduation_error(
    setting: Setting, rng: np.random.Generator, *, avoid: tuple[int, ...] = (), skew: float | None = None
) -> Defect:
    """One to three orders of long-range error, none of those to avoid."""
    free = [order for order in range(3, (FACES - 1) // 2 + 1) if order not in avoid]
    orders = tuple(
        int(order) for order in rng.choice(free, size=min(len(free), int(rng.integers(1, 4))), replace=False)
    )
    weights = rng.uniform(0.5, 1.0, size=len(orders))
    phases = [phase(rng) for _ in orders]
    bent = float(rng.uniform(0.02, 0.12)) if skew is None else skew

    def shift_of(size: float) -> LineShift:
        def shift(place: Floats) -> Floats:
            total = np.zeros_like(place)
            for weight, order, at in zip(weights.tolist(), orders, phases, strict=True):
                total += size * weight * ruled_wave(place, order=order, phase_rad=at, skew=bent)
            return total

        return shift

    return Defect(
        name="graduation_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(line_shifts=(shift_of(size),)),
        cells=tuple(CellTruth(order=str(k)) for k in orders),
        parameters={f"order_{i + 1}": float(k) for i, k in enumerate(orders)},
    )


def localized_defect(setting: Setting, rng: np.random.Generator) -> Defect:
    """Displaced or dirty lines, seen through a scanning field that averages over many lines."""
    width, field_deg = float(rng.uniform(2.0, 13.0)), float(rng.uniform(0.5, 2.0))
    seen = setting.schedule.angle_deg[rng.integers(len(setting.schedule))]
    centre = float(seen + rng.uniform(-0.35, 0.35) * width)

    def shift_of(size: float) -> LineShift:
        def shift(place: Floats) -> Floats:
            away = np.abs((place - centre + 180.0) % 360.0 - 180.0)
            common = np.clip((width + field_deg) / 2 - away, 0.0, min(width, field_deg))
            return size * common / min(width, field_deg)

        return shift

    return Defect(
        name="localized_defect",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(line_shifts=(shift_of(size),)),
        cells=(CellTruth(order="localized"),),
        parameters={"width_deg": max(width, field_deg), "centre_deg": centre % 360.0},
    )


def subdivision_error(setting: Setting, rng: np.random.Generator) -> Defect:
    """Offsets, unequal gains, quadrature and distortion of the two signals."""
    offsets = rng.normal(size=2)
    unequal = rng.normal(size=2) * float(rng.uniform(0.3, 1.5))
    third = float(rng.normal() * 0.15)
    unit = setting.lines_per_rev / ARCSEC_PER_RAD
    signals = SignalError(
        offset_cos=float(offsets[0]) * unit,
        offset_sin=float(offsets[1]) * unit,
        gain=float(unequal[0]) * unit,
        quadrature_rad=float(unequal[1]) * unit,
        third=third * unit,
    )
    return Defect(
        name="subdivision_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(signals=signals.scaled(size)),
        cells=(CellTruth(order="N"), CellTruth(order="2N"), CellTruth(order="4N")),
        parameters={},
    )


def quantisation(setting: Setting, rng: np.random.Generator) -> Defect:
    """Interpolation coarser than stated: only every n-th count comes."""

    def contribute(size: float) -> Contribution:
        counts = np.sqrt(12.0) * abs(size) / setting.count_arcsec
        return Contribution(coarse=max(2, round(float(np.sqrt(counts**2 + 1.0)))))

    return Defect(
        name="quantisation",
        in_library=True,
        kind="variance",
        contribute=contribute,
        cells=(CellTruth(order="0", moment="variance"),),
        parameters={},
    )


def count_loss(setting: Setting, rng: np.random.Generator) -> Defect:
    """Whole counts lost at a place in one to three runs and missing until the run ends."""
    schedule = setting.schedule
    runs = rng.choice(np.unique(schedule.run), size=int(rng.integers(1, 4)), replace=False)
    steps = np.zeros(len(schedule))
    for run in runs:
        rows = np.flatnonzero(schedule.run == run)
        start = int(rng.integers(rows.size // 5, rows.size - rows.size // 5))
        steps[rows[start:]] = float(rng.choice([-1.0, 1.0])) * float(rng.choice([1.0, 1.0, 2.0]))

    def contribute(size: float) -> Contribution:
        counts = max(1, round(abs(size) / setting.count_arcsec))
        return Contribution(lost_counts=steps * counts)

    return Defect(
        name="count_loss",
        in_library=True,
        kind="event",
        contribute=contribute,
        cells=(CellTruth(order="0", time="within_run"),),
        parameters={"runs": float(len(runs))},
    )
