"""Whether draws of their own in each run are draws at all: what follows the run's conditions is no chance.

A pattern with an amplitude of its own in each run imitates every effect of the same order. Its amplitudes betray
it: those of a lagging temperature follow the time since the last step, those of a bent response the temperature,
and all that moves one cause up and down keeps one phase, where a grating that is seated anew has a new phase too.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from trueangle_training.effects.conditions import Conditions

Floats = NDArray[np.float64]

FEWEST_RUNS = 12
SURE = 1e-3
"""Chance that amplitudes drawn at random follow the conditions as well."""
SURELY_ONE_PHASE = 1e-4
MOST_OF_IT = 0.6
"""Part of the amplitudes' variance that the conditions must explain."""
SAME_TEMPERATURE_C = 1.0


def are_no_draws(conditions: Conditions, curve_arcsec: Floats) -> bool:
    """Whether the order-1 amplitudes of the runs of a curve ([readings]) are too orderly to be drawn at random."""
    runs, first, unit = np.unique(conditions.run, return_index=True, return_inverse=True)
    if runs.size < FEWEST_RUNS:
        return False
    count = np.bincount(unit)
    turned = curve_arcsec * np.exp(-1j * np.radians(conditions.angle_deg))
    amplitude = (np.bincount(unit, weights=turned.real) + 1j * np.bincount(unit, weights=turned.imag)) / count
    if keep_one_phase(amplitude):
        return True
    if conditions.temperature_c is None:
        return False
    temperature_c = np.bincount(unit, weights=np.nan_to_num(conditions.temperature_c)) / count
    in_order = np.argsort(first)
    return follow_temperature(amplitude[in_order], temperature_c[in_order])


def keep_one_phase(amplitude: NDArray[np.complex128]) -> bool:
    """Whether amplitudes ([runs]) lie along one line.

    Of m amplitudes without a preferred phase W = 2 sqrt(det S) / tr S of their 2 by 2 scatter S is below w with
    probability w^(m - 2) (sphericity in the plane, Mauchly 1940).
    """
    about = amplitude - amplitude.mean()
    along, across = float(np.sum(about.real**2)), float(np.sum(about.imag**2))
    both = float(np.sum(about.real * about.imag))
    round_ = 2.0 * np.sqrt(max(along * across - both**2, 0.0)) / max(along + across, 1e-300)
    return round_ ** (amplitude.size - 2) < SURELY_ONE_PHASE


def follow_temperature(amplitude: NDArray[np.complex128], temperature_c: Floats) -> bool:
    """Whether amplitudes follow temperature and the place after its last step; both [runs], in order of time."""
    design = _design(temperature_c)
    simple = np.ones((amplitude.size, 1))
    rank = int(np.linalg.matrix_rank(design))
    left, whole = (_square_left(each, amplitude) for each in (design, simple))
    if amplitude.size - rank < 3 or rank < 2 or whole <= 0.0:
        return False
    explained, freedom = 2 * (rank - 1), 2 * (amplitude.size - rank)
    ratio = (whole - left) / explained / max(left / freedom, 1e-300)
    return left <= (1.0 - MOST_OF_IT) * whole and float(special.fdtrc(explained, freedom, ratio)) < SURE


def _design(temperature_c: Floats) -> Floats:
    """[runs, 6]: one, T, T^2, and the last step of temperature in the first, second and third run after it."""
    step = np.zeros((temperature_c.size, 3))
    last_step, since = 0.0, 0
    for i in range(1, temperature_c.size):
        change = temperature_c[i] - temperature_c[i - 1]
        if abs(change) > SAME_TEMPERATURE_C:
            last_step, since = change, 0
        else:
            since += 1
        if since < step.shape[1]:
            step[i, since] = last_step
    t = (temperature_c - temperature_c.mean()) / max(float(np.ptp(temperature_c)), SAME_TEMPERATURE_C)
    return np.column_stack([np.ones(temperature_c.size), t, t**2, step])


def _square_left(design: Floats, amplitude: NDArray[np.complex128]) -> float:
    return float(np.sum(np.abs(amplitude - design @ np.linalg.lstsq(design, amplitude, rcond=None)[0]) ** 2))
