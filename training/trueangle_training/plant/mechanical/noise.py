"""Scatter of the readings: fractional noise, a mixture's tails, stick-slip bursts and single misreadings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Noise of a campaign, arrays of shape [n]."""

    usual_arcsec: Floats
    rare_arcsec: Floats
    """Bursts and misreadings; 0 where there is none."""


def fractional(white: Floats, *, memory: float) -> Floats:
    """(1 - B)^-d of white noise, scaled to variance 1, shape [n]; d = `memory`, 0 to below 0.5.

    Weights psi_0 = 1, psi_k = psi_k-1 (k - 1 + d) / k (Hosking 1981). `white` [2 n]: as much noise again runs
    before the first reading.
    """
    k = np.arange(1, white.size)
    weights = np.concatenate([[1.0], np.cumprod((k - 1.0 + memory) / k)])
    coloured = fftconvolve(white, weights)[: white.size]
    half = white.size // 2
    return coloured[half:] / float(np.sqrt(np.sum(weights[: half + 1] ** 2)))


def mixture(size: int, *, share: float, wider: float, rng: np.random.Generator) -> Floats:
    """Normal draws of variance 1 in all, a share of which is so many times wider than the rest."""
    wide = np.where(rng.random(size) < share, wider, 1.0)
    return rng.normal(size=size) * wide / np.sqrt(1.0 + share * (wider**2 - 1.0))


def draw_noise(schedule: Schedule, rng: np.random.Generator) -> Noise:
    """Level, colour, tails and bursts differ from campaign to campaign."""
    size = len(schedule)
    level = float(np.exp(rng.uniform(np.log(0.3), np.log(1.0))))
    quick = mixture(size, share=float(rng.uniform(0.03, 0.12)), wider=float(rng.uniform(1.8, 2.8)), rng=rng)
    slow = fractional(rng.normal(size=2 * size), memory=float(rng.uniform(0.15, 0.4)))
    share = float(rng.uniform(0.05, 0.35))
    runs, which = np.unique(schedule.run, return_inverse=True)
    run_level = np.sqrt(rng.gamma(18.0, 1.0 / 18.0, size=runs.size))[which]
    usual = level * run_level * (np.sqrt(1.0 - share) * quick + np.sqrt(share) * slow)
    return Noise(usual_arcsec=usual, rare_arcsec=level * (_misread(size, rng) + _stick_slip(size, rng)))


def _misread(size: int, rng: np.random.Generator) -> Floats:
    """Single readings far off, in units of the noise."""
    wrong = rng.random(size) < float(rng.uniform(0.002, 0.008))
    far = rng.exponential(6.0, size=size) + 5.0
    return np.where(wrong, rng.choice([-1.0, 1.0], size=size) * np.minimum(far, 30.0), 0.0)


def _stick_slip(size: int, rng: np.random.Generator) -> Floats:
    """A seal sticks over a few readings: a tooth that rises and breaks off, in units of the noise."""
    out = np.zeros(size)
    for _ in range(int(rng.poisson(1.0))):
        length = int(rng.integers(2, 6))
        start = int(rng.integers(0, max(size - length, 1)))
        tooth = np.linspace(0.3, 1.0, length) * float(rng.uniform(3.0, 7.0))
        out[start : start + length] += float(rng.choice([-1.0, 1.0])) * tooth[: size - start]
    return out
