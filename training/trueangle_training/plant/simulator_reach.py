"""What re-calibration of the listed effects can absorb, and what each effect of the library could imitate.

Only the truth of a case is judged with this: nothing here makes a reading.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.defect import CellTruth
from trueangle_training.plant.history import follow, friction_at_readings
from trueangle_training.plant.listing import Listing
from trueangle_training.plant.schedule import FACES

Floats = NDArray[np.float64]

VISIBLE_FRACTION = 0.01
"""Below this an effect cannot be told from what is re-calibrated."""
CONTAINED = 0.95
"""From this on one effect can carry another's curve."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Span:
    """An orthonormal basis of what is re-calibrated, shape [n, columns]."""

    basis: Floats

    def outside(self, curves: Floats) -> Floats:
        """What of curves [n] or [n, columns] is left."""
        return curves - self.basis @ (self.basis.T @ curves)


def harmonic(conditions: Conditions, order: int) -> Floats:
    """cos and sin of an order at the true angles, [n, 2]; a column of ones at order 0."""
    if order == 0:
        return np.ones((len(conditions.schedule), 1))
    angle = order * np.deg2rad(conditions.schedule.angle_deg)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def recalibrated_span(conditions: Conditions, listing: Listing) -> Span:
    """One offset for each zero group, the datum's drift with temperature, and the listed orders."""
    groups = np.unique(conditions.schedule.zero_group)
    columns = [
        (conditions.schedule.zero_group[:, None] == groups[None, :]).astype(np.float64),
        conditions.from_middle_k[:, None],
    ]
    columns += [harmonic(conditions, order) for order in listing.constant]
    warm = conditions.temperature_c[:, None] - 20.0
    columns += [harmonic(conditions, order) * warm for order in listing.thermal]
    return Span(basis=orthonormal(np.column_stack(columns)))


def orthonormal(columns: Floats) -> Floats:
    """A basis of the columns' span, dependent ones left out; by the Gram matrix, as rows are many."""
    scaled = columns / np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-300)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return scaled @ (vectors[:, kept] / np.sqrt(values[kept]))


def _carried(columns: Floats, span: Span, target: Floats) -> float:
    """Energy of a target outside the span that the columns carry."""
    visible = _kept(span.outside(columns), columns)
    return float(np.sum((orthonormal(visible).T @ target) ** 2)) if visible.shape[1] else 0.0


def containments(
    curve: Floats, conditions: Conditions, span: Span, *, base_arcsec: Floats | float = 0.0
) -> dict[str, float]:
    """How much of a curve's energy outside the span each effect of the library could carry, 0 to 1.

    `base_arcsec`: how far the encoder reads wrong anyway; a line of the grating is not much wider.
    """
    target = span.outside(curve)
    energy = float(target @ target)
    best: dict[str, float] = {}
    if energy <= 0.0:
        return best
    line_deg = conditions.schedule.angle_deg + (curve + base_arcsec) / 3600.0
    for name, columns in _shapes(conditions, line_deg):
        best[name] = max(best.get(name, 0.0), _carried(columns, span, target) / energy)
    return best


def _kept(visible: Floats, columns: Floats) -> Floats:
    """Columns of which at least a hundredth is visible."""
    before, after = (columns**2).sum(axis=0), (visible**2).sum(axis=0)
    kept = after > VISIBLE_FRACTION * np.maximum(before, 1e-300)
    return visible[:, kept]


def _shapes(conditions: Conditions, line_deg: Floats) -> Iterator[tuple[str, Floats]]:
    """Shapes of the library's effects on these readings, a set of columns each."""
    x = conditions.relative_temperature[:, None]
    warm = (conditions.temperature_c[:, None] - 20.0) / 15.0
    ones = np.ones_like(x)
    waves = {order: harmonic(conditions, order) for order in range(12)}
    for order in range(1, 12):
        name = {1: "eccentricity", 2: "grating_tilt"}.get(order, "graduation_error")
        yield name, waves[order]
        thermal = {1: "thermal_eccentricity", 2: "thermal_tilt"}.get(order, "thermal_graduation")
        yield thermal, waves[order] * warm
    yield "graduation_error", np.column_stack([waves[order] for order in range(3, 12)])
    for order in (0, 1, 2):
        yield "thermal_nonlinearity", waves[order] * warm**2
        yield "thermal_nonlinearity", np.column_stack([waves[order] * warm**2, waves[order] * warm**3 * 0.3])
    yield from _grating_shapes(conditions, line_deg)
    yield from _mechanical_shapes(conditions, waves[1], waves[2], ones)
    yield from _history_shapes(conditions, waves[1])


def _grating_shapes(conditions: Conditions, line_deg: Floats) -> Iterator[tuple[str, Floats]]:
    angle_deg = conditions.schedule.angle_deg
    for width_deg in (3.0, 6.0, 11.0):
        for centre_deg in np.arange(0.0, 360.0, width_deg / 2):
            away = np.abs((angle_deg - centre_deg + 180.0) % 360.0 - 180.0)
            bump = np.clip(1.25 - away / width_deg, 0.0, 1.0)
            if bump.any():
                yield "localized_defect", bump[:, None]
    lines = np.deg2rad(line_deg) * conditions.lines_per_rev
    yield (
        "subdivision_error",
        np.column_stack([part for k in (1, 2, 4) for part in (np.cos(k * lines), np.sin(k * lines))]),
    )


def _mechanical_shapes(
    conditions: Conditions, once: Floats, twice: Floats, ones: Floats
) -> Iterator[tuple[str, Floats]]:
    schedule = conditions.schedule
    sense = schedule.direction[:, None].astype(np.float64)
    yield "hysteresis", np.column_stack([sense, sense * once])
    yield "hysteresis", np.column_stack([sense, sense * twice])
    for length_deg in (10.0, 15.0, 25.0, 40.0, 60.0, 90.0, 120.0):
        yield "windup", friction_at_readings(schedule, length_deg=length_deg)[:, None]
    rolled = np.deg2rad(schedule.path_angle_deg[schedule.reading_at])
    for ratio in np.arange(0.3, 6.0, 0.1):
        if abs(ratio - round(float(ratio))) > 0.05:
            yield "bearing_wobble", np.column_stack([np.cos(ratio * rolled), np.sin(ratio * rolled)])
    load = schedule.load_nm[:, None] / float(schedule.load_nm.max()) * ones
    yield "load_deflection", np.column_stack([load, load * once])
    yield "load_deflection", np.column_stack([load, load * twice])
    speed = schedule.velocity_deg_s[:, None]
    if np.ptp(speed) > 0:
        yield "read_latency", speed / float(np.abs(speed).max())
    faces = np.arange(1, FACES + 1)
    yield "reference_artefact", (schedule.face[:, None] == faces[None, :]).astype(np.float64)
    runs = np.unique(schedule.run)
    member = (schedule.run[:, None] == runs[None, :]).astype(np.float64)
    yield "run_to_run_eccentricity", np.column_stack([member * once[:, :1], member * once[:, 1:]])
    for run in runs:
        rows = np.flatnonzero(schedule.run == run)
        for start in rows[1 :: max(1, rows.size // 24)]:
            step = np.zeros((len(schedule), 1))
            step[rows[rows >= start]] = 1.0
            yield "count_loss", step


def _history_shapes(conditions: Conditions, once: Floats) -> Iterator[tuple[str, Floats]]:
    since = conditions.schedule.seconds_into_run()
    for constant_s in (400.0, 900.0, 2000.0, 4500.0):
        behind = (conditions.lagged_c(constant_s) - conditions.temperature_c)[:, None]
        yield "thermal_lag", np.column_stack([behind, behind * once])
        heat = conditions.motion_heat(constant_s)[:, None]
        heat = heat / max(float(heat.max()), 1e-9)
        yield "self_heating", np.column_stack([heat, heat * once])
    rest = np.ones(int(since.max() / 5.0) + 2)
    for constant_s in (80.0, 200.0, 500.0, 1300.0):
        creep = follow(rest, time_constant_s=constant_s, start=0.0, step_s=5.0)
        yield "index_drift", np.interp(since, 5.0 * np.arange(rest.size), creep)[:, None]


OTHER_CELLS = {
    "reference_artefact": tuple(CellTruth(order=str(k), frame="polygon") for k in range(1, 12)),
    "bearing_wobble": (CellTruth(order="non-integer"),),
    "localized_defect": (CellTruth(order="localized"),),
    "index_drift": (CellTruth(order="0", time="within_run"),),
    "count_loss": (CellTruth(order="0", time="within_run"),),
    "windup": (CellTruth(order="0", direction="odd", time="within_run"), CellTruth(order="0", direction="odd")),
    "subdivision_error": (CellTruth(order="N"), CellTruth(order="2N"), CellTruth(order="4N")),
    "thermal_lag": (CellTruth(order="0", temperature="lagged"), CellTruth(order="1", temperature="lagged")),
}
"""Of effects that `cell_shares` has no columns for: places of a pattern that such an effect could carry."""


def cell_shares(curve: Floats, conditions: Conditions, span: Span) -> dict[CellTruth, float]:
    """How much of a curve's energy outside the span each cell of the lattice could carry, 0 to 1."""
    target = span.outside(curve)
    energy = float(target @ target)
    shares: dict[CellTruth, float] = {}
    if energy <= 0.0:
        return shares
    for cell, columns in _cells(conditions):
        shares[cell] = max(shares.get(cell, 0.0), _carried(columns, span, target) / energy)
    return shares


def _cells(conditions: Conditions) -> Iterator[tuple[CellTruth, Floats]]:
    schedule, x = conditions.schedule, conditions.relative_temperature[:, None]
    since = conditions.schedule.seconds_into_run()[:, None]
    since = since / max(float(since.max()), 1.0)
    runs = np.unique(schedule.run)
    member = (schedule.run[:, None] == runs[None, :]).astype(np.float64)
    for order in range(12):
        waves, name = harmonic(conditions, order), str(order)
        yield CellTruth(order=name), waves
        yield CellTruth(order=name, temperature="linear"), waves * x
        yield CellTruth(order=name, temperature="quadratic"), np.column_stack([waves * x**2, waves * x**3])
        for split in np.linspace(-0.83, 0.83, 6):
            yield CellTruth(order=name, temperature="step"), waves * (x > split)
        yield CellTruth(order=name, direction="odd"), waves * schedule.direction[:, None]
        yield CellTruth(order=name, time="within_run"), np.column_stack([waves * since, waves * since**2])
        if order:
            between = np.column_stack([member * waves[:, :1], member * waves[:, 1:]])
            yield CellTruth(order=name, time="between_runs"), between
        yield CellTruth(order=name, speed="linear"), waves * schedule.velocity_deg_s[:, None]
        yield CellTruth(order=name, load="linear"), waves * schedule.load_nm[:, None]
