"""Whether the scores of units stay independent when the noise wanders from unit to unit.

Flipping the signs of units asks that a column's scores in different units be uncorrelated. Noise with a 1/f
spectrum remembers across units: a column of order 0 under one zero adds up what the datum wanders, one that turns
with the angle averages it out. What the memory does to a column is known before any error is read: with the
covariance K of flicker noise, first-order processes with one time constant a decade (van der Ziel 1950),

    excess = x' K x / sum over units of x_u' K_uu x_u

is the variance of the sum of the scores over that of scores that are independent. At 1 flips are right, above it
they find structure in noise, below it they are cautious.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FLICKER_SHARE = 0.3
"""Part of the variance that has a memory; the rest is white."""
MOST_PIECES = 1200
SHORTEST_MEMORY_S = 10.0


def excess(columns: Floats, unit: Integers, time_s: Floats | None) -> Floats:
    """[columns]: variance of the summed scores over that of independent units, of columns [readings, columns].

    `unit`: [readings], from 0; `time_s`: None where no clock was read, then the order of the readings is one.
    """
    clock = np.arange(unit.size, dtype=np.float64) if time_s is None else time_s - float(time_s.min())
    piece, middle, owner = _pieces(clock, unit)
    sums = np.stack([np.bincount(piece, weights=column, minlength=middle.size) for column in columns.T], axis=1)
    memory = _flicker(middle, shortest=1.0 if time_s is None else SHORTEST_MEMORY_S)
    white = (1.0 - FLICKER_SHARE) * np.sum(columns**2, axis=0)
    together = np.sum(sums * (memory @ sums), axis=0)
    own = np.zeros(columns.shape[1])
    for number in np.unique(owner):
        rows = np.flatnonzero(owner == number)
        own += np.sum(sums[rows] * (memory[np.ix_(rows, rows)] @ sums[rows]), axis=0)
    return (white + FLICKER_SHARE * together) / np.maximum(white + FLICKER_SHARE * own, 1e-300)


def _pieces(clock: Floats, unit: Integers) -> tuple[Integers, Floats, Integers]:
    """[readings]: piece of neighbours in time within a unit; [pieces]: mean time and unit of each."""
    order = np.lexsort((clock, unit))
    start = np.flatnonzero(np.diff(unit[order], prepend=-1))
    place = np.arange(unit.size) - np.repeat(start, np.diff(np.append(start, unit.size)))
    new = place % max(1, -(-unit.size // MOST_PIECES)) == 0
    piece = np.empty(unit.size, dtype=np.int64)
    piece[order] = np.cumsum(new) - 1
    count = np.bincount(piece)
    return piece, np.bincount(piece, weights=clock) / count, unit[order][new]


def _flicker(time: Floats, *, shortest: float) -> Floats:
    """[times, times]: correlation of 1/f noise, equal parts of each decade up to the whole span."""
    apart = np.abs(time[:, None] - time[None, :])
    decades = max(1, int(np.ceil(np.log10(max(float(np.ptp(time)) / shortest, 1.0)))))
    return np.mean([np.exp(-apart / (shortest * 10.0**k)) for k in range(decades + 1)], axis=0)
