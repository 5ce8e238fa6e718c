"""Campaigns without temperatures: harmonics of the angle, a free zero for every group, their number by evidence.

The error of reading i is sum over n = 1..N of c_n cos nθ_i + s_n sin nθ_i plus the zero of its group. N is the
number with the smallest leave-one-out error, which least squares gives without refitting: with the hat matrix
H = X (X'X)⁻¹ X' reading i is missed by r_i / (1 - H_ii) (Allen, Technometrics 16, 1974). The uncertainty is
that of the coefficients, s² (X'X)⁻¹ with s² = sum r² / (readings - unknowns), which holds what lies above N.

The model keeps the two inputs of every model and ignores the second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import Fault
from trueangle_training.dataset import ANY_TEMPERATURE_C, TrainingSet, training_set
from trueangle_training.methods import (
    Fit,
    Progress,
    TrainingReadings,
    UnsuitableReadingsError,
    distinct_angle_count,
    no_progress,
)
from trueangle_training.methods.separable import CoefficientSpread, SeparableModel, TemperatureBasis, harmonics

Floats = NDArray[np.float64]

HIGHEST_ORDER = 60
"""Beyond it no joint shows anything that a campaign could tell from its noise."""
WORST_CONDITION = 30.0
LITTLE_BETTER = 1.01
"""The fewest harmonics whose leave-one-out error is within this factor of the smallest."""
NOTE = "no temperature in the campaign: the correction does not follow it and holds near that of the calibration"


def angle_only_set(campaign: Campaign, *, faces: int | None = None) -> TrainingSet:
    """`training_set` for a campaign without temperatures; ContractError lists every fault."""
    return training_set(campaign, base_temperature_c=None, faces=faces, free_offsets=True, temperature_used=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleHarmonics:
    """The `Method` for readings whose temperature is not known."""

    name: str = "angle-only"
    summary: str = "harmonics of the angle, as many as the readings support; temperature ignored"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Least squares; deterministic, the seed changes nothing. UnsuitableReadingsError where nothing fits."""
        progress(0, 1)
        orders, solution, covariance, press_rms = _best_fit(readings)
        progress(1, 1)
        size = 2 * orders
        spread = CoefficientSpread(
            orders=tuple(range(1, orders + 1)),
            nodes_c=np.array([ANY_TEMPERATURE_C]),
            factor_arcsec=np.asarray(np.linalg.cholesky(covariance[:size, :size])[:, None, :], dtype=np.float64),
        )
        model = SeparableModel(
            orders=tuple(range(1, orders + 1)),
            basis=TemperatureBasis(centre_c=ANY_TEMPERATURE_C, scale_c=1.0),
            weights_arcsec=solution[None, :size],
            datum_deg=readings.datum_deg,
            temperature_used=False,
            spreads=(spread,),
        )
        scatter = f"scatter of one reading about {orders} harmonics {press_rms:.3g} arcsec, left out one by one"
        settings = {"highest_order": orders, "leave_one_out_rmse_arcsec": press_rms}
        return Fit(model=model, notes=(NOTE, scatter), settings=settings)


def _best_fit(readings: TrainingReadings) -> tuple[int, Floats, Floats, float]:
    """Number of harmonics, solution and covariance of their coefficients, leave-one-out RMSE."""
    places = distinct_angle_count(readings.angle_deg)
    group = readings.offset_group
    zeros = np.eye(int(group.max()) + 1)[group]
    tried: list[tuple[float, Floats, Floats]] = []
    for orders in range(1, min((places - 1) // 2, HIGHEST_ORDER) + 1):
        waves = harmonics(readings.angle_deg, tuple(range(1, orders + 1)))
        design = np.concatenate([waves, zeros], axis=1)
        # One reading more than unknowns would be left out without a residual to speak of.
        if design.shape[0] <= design.shape[1] + 1 or np.linalg.cond(design) > WORST_CONDITION:
            break
        orthogonal, triangle = np.linalg.qr(design)
        solution: Floats = np.linalg.solve(triangle, orthogonal.T @ readings.error_arcsec).astype(np.float64)
        leverage = np.minimum(np.sum(orthogonal**2, axis=1), 1.0 - 1e-9)
        residual = readings.error_arcsec - design @ solution
        variance = float(residual @ residual) / (design.shape[0] - design.shape[1])
        left_out = residual / (1.0 - leverage)
        press_rms = float(np.sqrt(np.mean(left_out**2)))
        inverse = np.linalg.inv(triangle)
        covariance: Floats = (inverse @ inverse.T * variance).astype(np.float64)
        tried.append((press_rms, solution, covariance))
    if not tried:
        expected = "readings at five or more places all around the turn, more than unknowns"
        found = f"{len(readings)} readings at {places} places"
        raise UnsuitableReadingsError([Fault(where="angle_deg", expected=expected, found=found)])
    best = min(press_rms for press_rms, _, _ in tried)
    chosen = next(place for place, (press_rms, _, _) in enumerate(tried) if press_rms <= LITTLE_BETTER * best)
    press_rms, solution, covariance = tried[chosen]
    return chosen + 1, solution, covariance, press_rms
