"""Scatter of the readings: Ornstein-Uhlenbeck processes through the whole campaign, heavy tails, bursts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Noise of a campaign, arrays of shape [n]."""

    usual_arcsec: Floats
    """Without outliers."""
    outlier_arcsec: Floats
    """0 where there is none."""

    @property
    def total_arcsec(self) -> Floats:
        """Both."""
        return self.usual_arcsec + self.outlier_arcsec


def ornstein_uhlenbeck(time_s: Floats, *, time_constant_s: float, rng: np.random.Generator) -> Floats:
    """A stationary process of variance 1 at unequal times, shape [n]: exact transition from time to time."""
    draws = rng.normal(size=time_s.size)
    kept = np.exp(-np.diff(time_s, prepend=time_s[0]) / time_constant_s)
    new = np.sqrt(1.0 - kept**2)
    out = np.empty_like(draws)
    state = float(draws[0])
    out[0] = state
    for i, (k, n, d) in enumerate(
        zip(kept[1:].tolist(), new[1:].tolist(), draws[1:].tolist(), strict=True), start=1
    ):
        state = k * state + n * d
        out[i] = state
    return out


def draw_noise(schedule: Schedule, rng: np.random.Generator) -> Noise:
    """Noise of one campaign: level, colour, tails and bursts differ from campaign to campaign."""
    size = len(schedule)
    level = float(np.exp(rng.uniform(np.log(0.3), np.log(1.0))))
    degrees = float(rng.uniform(4.0, 12.0))
    white = rng.standard_t(degrees, size=size) * np.sqrt((degrees - 2.0) / degrees)
    coloured = np.zeros(size)
    share = float(rng.uniform(0.05, 0.35))
    for time_constant_s in (20.0, 200.0, 2000.0, 20000.0):
        weight = np.sqrt(share / 4.0) * float(rng.uniform(0.7, 1.3))
        constant = time_constant_s * float(rng.uniform(0.6, 1.6))
        coloured += weight * ornstein_uhlenbeck(schedule.time_s, time_constant_s=constant, rng=rng)
    runs, which = np.unique(schedule.run, return_inverse=True)
    run_level = np.exp(rng.normal(0.0, 0.12, size=runs.size))[which]
    usual = level * run_level * (np.sqrt(1.0 - share) * white + coloured)
    return Noise(usual_arcsec=usual, outlier_arcsec=level * _outliers(size, rng))


def _outliers(size: int, rng: np.random.Generator) -> Floats:
    """In units of the noise: single ones and bursts of neighbouring readings."""
    out = np.zeros(size)
    single = rng.random(size) < float(rng.uniform(0.002, 0.01))
    out[single] = rng.choice([-1.0, 1.0], size=int(single.sum())) * rng.uniform(5.0, 30.0, size=int(single.sum()))
    for _ in range(int(rng.integers(0, 3))):
        start = int(rng.integers(0, max(size - 6, 1)))
        if rng.random() < 0.5:
            # A knock: two or three readings the same way.
            length = int(rng.integers(2, 4))
            out[start : start + length] = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 8.0, size=length)
        else:
            # Somebody works next door.
            length = int(rng.integers(3, 7))
            out[start : start + length] = rng.uniform(3.0, 6.0) * rng.normal(size=length)
    return out
