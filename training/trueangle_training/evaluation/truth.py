"""The true error of a model, where the joint is simulated, and the oracle that it is measured against."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN, wrap_deg
from trueangle_training.methods import FittedModel, TrainingReadings, distinct_angle_count
from trueangle_training.simulator.joint import SimulatedJoint

Floats = NDArray[np.float64]

ANGLE_STEP_DEG = 0.05
TEMPERATURE_STEP_C = 0.5
COVERAGE_FACTOR = 2.0
COVERAGE_STRIDE = 10
"""Every so many angles the uncertainty is asked for: it is as smooth as the error and dearer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueError:
    """How far a model is off, counted from the datum at the same temperature, without noise, in arcsec."""

    rmse_arcsec: float
    largest_arcsec: float
    seam_rmse_arcsec: float
    """Between the last measured place and the end of the turn."""
    over_oracle: float | None
    """RMSE over that of the oracle; None for the oracle itself."""
    coverage: float | None
    """Share of the grid where the error is at most 2 u; None: the model knows no uncertainty."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Oracle:
    """Least squares on the true shapes: a `FittedModel`."""

    orders: Floats
    degrees: Floats
    solution: Floats
    base_temperature_c: float
    datum_deg: float

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """E(θ, T) - E(datum, T), shape [n]."""
        shapes = _shapes(angle_deg, temperature_c, self.orders, self.degrees, self.base_temperature_c)
        datum_deg = np.full_like(angle_deg, self.datum_deg)
        at_datum = _shapes(datum_deg, temperature_c, self.orders, self.degrees, self.base_temperature_c)
        return (shapes - at_datum) @ self.solution

    @property
    def temperature_used(self) -> bool:
        """Always."""
        return True

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> None:
        """None: it is a yardstick."""


def oracle(readings: TrainingReadings, joint: SimulatedJoint) -> FittedModel:
    """Which orders and powers of temperature the joint has is known, their amplitudes and the runs' zeros are not.

    Orders that the measured places cannot tell from lower ones are left out: nothing could find them.
    """
    highest = (distinct_angle_count(readings.angle_deg) - 1) // 2
    terms = sorted({(term.order, term.degree) for effect in joint.effects for term in effect.terms})
    terms = [(order, degree) for order, degree in terms if order <= highest]
    orders = np.array([order for order, _ in terms], dtype=np.float64)
    degrees = np.array([degree for _, degree in terms], dtype=np.float64)
    base_c = joint.joint.base_temperature_c
    shapes = _shapes(readings.angle_deg, readings.temperature_c, orders, degrees, base_c)
    group = readings.offset_group
    design = np.concatenate([shapes, np.eye(int(group.max()) + 1)[group]], axis=1)
    solution: Floats = np.linalg.lstsq(design, readings.error_arcsec, rcond=None)[0].astype(np.float64)
    return _Oracle(
        orders=orders,
        degrees=degrees,
        solution=solution[: shapes.shape[1]],
        base_temperature_c=base_c,
        datum_deg=readings.datum_deg,
    )


def _shapes(angle_deg: Floats, temperature_c: Floats, orders: Floats, degrees: Floats, base_c: float) -> Floats:
    """Columns (T - T0)^d cos nθ, then the same with sin, shape [n, 2 terms]."""
    phase_rad = np.multiply.outer(wrap_deg(angle_deg), orders * (np.pi / 180.0))
    # Decades of kelvin keep the columns of one size.
    power = ((temperature_c - base_c) / 10.0)[:, None] ** degrees
    return np.concatenate([power * np.cos(phase_rad), power * np.sin(phase_rad)], axis=1)


def true_error(
    model: FittedModel,
    joint: SimulatedJoint,
    readings: TrainingReadings,
    *,
    oracle_rmse_arcsec: float | None = None,
    angle_step_deg: float = ANGLE_STEP_DEG,
) -> TrueError:
    """The model against the joint over the whole turn and the measured temperatures."""
    true_deg = np.arange(0.0, DEG_PER_TURN, angle_step_deg)
    lowest_c, highest_c = float(readings.temperature_c.min()), float(readings.temperature_c.max())
    steps = max(round((highest_c - lowest_c) / TEMPERATURE_STEP_C), 1)
    last_place_deg = float(wrap_deg(readings.angle_deg).max())
    seam = true_deg > last_place_deg
    off = np.empty((steps + 1, true_deg.size))
    covered: list[float] = []
    for k, temperature_c in enumerate(np.linspace(lowest_c, highest_c, steps + 1)):
        # The model sees what the encoder shows, not the true angle.
        indicated_deg = true_deg + joint.error_arcsec(true_deg, temperature_c) / ARCSEC_PER_DEG
        at_c = np.full_like(true_deg, temperature_c)
        truth = joint.error_from_datum_arcsec(true_deg, temperature_c, readings.datum_deg)
        off[k] = model.error_arcsec(indicated_deg, at_c) - truth
        spread = model.uncertainty_arcsec(indicated_deg[::COVERAGE_STRIDE], at_c[::COVERAGE_STRIDE])
        if spread is not None:
            covered.append(float(np.mean(np.abs(off[k, ::COVERAGE_STRIDE]) <= COVERAGE_FACTOR * spread)))
    rmse = float(np.sqrt(np.mean(off**2)))
    return TrueError(
        rmse_arcsec=rmse,
        largest_arcsec=float(np.abs(off).max()),
        seam_rmse_arcsec=float(np.sqrt(np.mean(off[:, seam] ** 2))) if seam.any() else 0.0,
        over_oracle=None if oracle_rmse_arcsec is None else rmse / oracle_rmse_arcsec,
        coverage=float(np.mean(covered)) if covered else None,
    )


def datum_drift_arcsec(joint: SimulatedJoint, readings: TrainingReadings) -> float:
    """RMS over the temperatures of E(datum, T) about its mean: what a campaign zeroed run by run cannot see."""
    temperature_c = np.linspace(float(readings.temperature_c.min()), float(readings.temperature_c.max()), 61)
    at_datum = joint.error_arcsec(np.full_like(temperature_c, readings.datum_deg), temperature_c)
    return float(np.std(at_datum))
