"""The joint behind the paper's figures, drawn from its formula alone, and a polygon campaign on it.

An independent few lines of NumPy: nothing of the laboratory is used. The error is
E(θ, T) = Re sum over n of (c0_n + c1_n τ + c2_n τ²)* e^{i n θ}, τ = (T - 20) / 20, which is |c| cos(n θ - arg c).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# fmt: off
STEADY = {
    1: (72.75, -64), 2: (7.1, 90), 3: (2.5, -101), 4: (0.60, -132), 5: (0.45, -24), 6: (0.30, 14),
    7: (0.25, -59), 8: (0.48, 179), 9: (0.59, 158), 10: (0.59, 174), 11: (0.54, 49),
}
"""Order: amplitude in arcsec, phase in degrees."""
ABOVE_11 = {
    12: (0.25, 26), 13: (0.21, -95), 14: (0.18, -119), 15: (0.15, 144), 16: (0.13, -171),
    17: (0.11, 142), 18: (0.09, 146), 19: (0.08, 78), 20: (0.07, -60),
}
# fmt: on
LINEAR = {1: (7.14, 81), 2: (0.6, 40), 3: (0.2, -160)}
QUADRATIC = {1: (0.8, 150)}

NOISE_ARCSEC = 0.63
FACES = 23
TEMPERATURES_C = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
REPEATS = 3


def joint_error_arcsec(angle_deg: Floats, temperature_c: Floats, *, above_11: bool = True) -> Floats:
    """The true error, noise-free and not yet zeroed."""
    tau = (temperature_c - 20.0) / 20.0
    total = np.zeros(np.broadcast_shapes(angle_deg.shape, temperature_c.shape))
    steady = {**STEADY, **ABOVE_11} if above_11 else STEADY
    for terms, power in ((steady, 0), (LINEAR, 1), (QUADRATIC, 2)):
        for order, (amplitude_arcsec, phase_deg) in terms.items():
            total = total + amplitude_arcsec * tau**power * np.cos(np.radians(order * angle_deg - phase_deg))
    return total


@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonCampaign:
    """Readings of all runs, each of shape [readings]."""

    angle_deg: Floats
    error_arcsec: Floats
    temperature_c: Floats
    run: NDArray[np.int64]


def polygon_campaign(
    seed: int,
    *,
    noise_arcsec: float = NOISE_ARCSEC,
    faces: int = FACES,
    temperatures_c: tuple[float, ...] = TEMPERATURES_C,
    angle_jitter_deg: float = 0.0,
    above_11: bool = True,
) -> PolygonCampaign:
    """Three runs at each temperature over a regular polygon, zeroed at the first face of each run, eq. (11)."""
    rng = np.random.default_rng(seed)
    face_deg = np.arange(faces) * 360.0 / faces
    angles, errors, temperatures, runs = [], [], [], []
    for run, set_c in enumerate(np.repeat(temperatures_c, REPEATS)):
        temperature_c = np.full(faces, set_c + rng.uniform(-0.1, 0.1))
        angle_deg = face_deg + rng.uniform(-angle_jitter_deg, angle_jitter_deg, faces)
        error_arcsec = joint_error_arcsec(angle_deg, temperature_c, above_11=above_11)
        error_arcsec = error_arcsec + rng.normal(0.0, noise_arcsec, faces)
        angles.append(angle_deg)
        errors.append(error_arcsec - error_arcsec[0])
        temperatures.append(temperature_c)
        runs.append(np.full(faces, run))
    return PolygonCampaign(
        angle_deg=np.concatenate(angles),
        error_arcsec=np.concatenate(errors),
        temperature_c=np.concatenate(temperatures),
        run=np.concatenate(runs),
    )


def true_grid(*, above_11: bool = True) -> tuple[Floats, Floats, Floats]:
    """Angle, temperature and the true error counted from the datum (0 deg), on 0.5 deg by 1 degC, flattened."""
    angle_deg, temperature_c = np.meshgrid(np.arange(0.0, 360.0, 0.5), np.arange(10.0, 40.5, 1.0))
    datum = joint_error_arcsec(np.zeros_like(temperature_c), temperature_c, above_11=above_11)
    error_arcsec = joint_error_arcsec(angle_deg, temperature_c, above_11=above_11) - datum
    return angle_deg.ravel(), temperature_c.ravel(), error_arcsec.ravel()
