"""Noise of a laboratory: a resonance, a switching level, a creeping zero, turbulent air, and misread digits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Noise of a campaign, arrays of shape [n]."""

    usual_arcsec: Floats
    """Without what is grossly wrong."""
    gross_arcsec: Floats
    """0 nearly everywhere."""


def ringing(size: int, *, radius: float, turn_rad: float, rng: np.random.Generator) -> Floats:
    """AR(2) with poles radius exp(+-i turn), stationary, variance 1, shape [size].

    Its variance over the draws' is (1 - b) / ((1 + b) ((1 - b)^2 - a^2)), a = 2 r cos t, b = -r^2
    (Box and Jenkins, Time Series Analysis, 3.2.4).
    """
    a, b = 2.0 * radius * np.cos(turn_rad), -(radius**2)
    variance = (1.0 - b) / ((1.0 + b) * ((1.0 - b) ** 2 - a**2))
    settling = 64
    drawn = rng.normal(size=size + settling)
    out = np.asarray(lfilter([1.0], [1.0, -a, -b], drawn), dtype=np.float64)
    return out[settling:] / np.sqrt(variance)


def telegraph(time_s: Floats, *, dwell_s: float, rng: np.random.Generator) -> Floats:
    """+1 or -1, switching at random with a mean stay of `dwell_s` on either side, shape [n]."""
    gaps = np.diff(time_s, prepend=time_s[0])
    switches = rng.random(time_s.size) < 0.5 * -np.expm1(-2.0 * np.maximum(gaps, 0.0) / dwell_s)
    return float(rng.choice([-1.0, 1.0])) * np.where(np.cumsum(switches) % 2 == 0, 1.0, -1.0)


def creeping_zero(schedule: Schedule, rng: np.random.Generator) -> Floats:
    """A random walk in time that starts anew where the autocollimator is nulled for a run; 1 after 400 s, [n]."""
    out = np.zeros(len(schedule))
    for run in np.unique(schedule.run):
        rows = np.flatnonzero(schedule.run == run)
        gaps = np.diff(schedule.time_s[rows], prepend=schedule.time_s[rows[0]])
        out[rows] = np.cumsum(rng.normal(size=rows.size) * np.sqrt(gaps / 400.0))
    return np.where(schedule.face > 0, out, 0.0)


def turbulence(size: int, *, rng: np.random.Generator) -> Floats:
    """Intermittent: log-normal level with a memory of some readings, variance 1, shape [size]."""
    depth, memory = float(rng.uniform(0.2, 0.6)), float(rng.uniform(3.0, 12.0))
    kept = float(np.exp(-1.0 / memory))
    level = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.normal(size=size + 64))[64:]
    return rng.normal(size=size) * np.exp(depth * np.asarray(level) - depth**2)


def draw_scatter(schedule: Schedule, rng: np.random.Generator) -> Scatter:
    """Level and mixture differ from campaign to campaign."""
    size = len(schedule)
    level = float(np.exp(rng.uniform(np.log(0.3), np.log(1.0))))
    ring, switch = float(rng.uniform(0.02, 0.2)), float(rng.uniform(0.0, 0.12))
    creep = float(rng.uniform(0.05, 0.3))
    air = turbulence(size, rng=rng)
    swing = ringing(size, radius=float(rng.uniform(0.2, 0.75)), turn_rad=float(rng.uniform(0.1, 2.0)), rng=rng)
    popcorn = telegraph(schedule.time_s, dwell_s=float(rng.uniform(15.0, 90.0)), rng=rng)
    usual = np.sqrt(1.0 - ring - switch) * air + np.sqrt(ring) * swing + np.sqrt(switch) * popcorn
    usual = usual + creep * creeping_zero(schedule, rng)
    return Scatter(usual_arcsec=level * usual, gross_arcsec=_gross(size, level, rng))


def _gross(size: int, level: float, rng: np.random.Generator) -> Floats:
    """Digits of whole arcseconds misread, by ten at most, and a door that slams."""
    out = np.zeros(size)
    misread = rng.random(size) < float(rng.uniform(0.001, 0.008))
    count = int(misread.sum())
    out[misread] = rng.choice([-1.0, 1.0], size=count) * rng.choice([1.0, 2.0, 3.0, 5.0, 10.0], size=count)
    for _ in range(int(rng.integers(0, 4))):
        start, length = int(rng.integers(0, max(size - 8, 1))), int(rng.integers(2, 8))
        decay = np.exp(-np.arange(length) / 2.0)
        out[start : start + length] += level * rng.uniform(3.0, 9.0) * rng.normal(size=length) * decay
    return out
