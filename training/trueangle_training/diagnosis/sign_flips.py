"""Tests by flipping the signs of whole units, whatever the noise within a unit looks like.

The score of a column x in unit r is s_r = x_r' e_r, x and the errors e both outside the re-calibrated span P. If
nothing but noise is there, the signs of all s_r are free. Studentised by the units' own scatter,

    T = sum over columns of (sum_r f_r s_r)^2 / d(f) / sum_r s_r^2,   d(f) = 1 - |P F x|^2

for flips f; d(f) makes up for what the projection takes of a flipped column (Hemerik, Goeman and Finos 2020,
doi:10.1111/rssb.12369; De Santis et al. 2022, arXiv:2209.13918). The largest T over all columns gives the
family-wise p-value (Westfall and Young 1993). Where noise with a memory makes scores of neighbouring units alike,
the observed T is divided by what it exceeds that of independent units (`wander`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.recalibration import Projector
from trueangle_training.diagnosis.wander import excess

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SMALLEST_SHARE = 0.1
"""A unit carries a column when its share of the column's square is this part of an equal share or more."""
LEAST_LEFT_OF_A_FLIP = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """A tested shape outside the re-calibrated span."""

    columns: Floats
    """[readings, columns], orthonormal."""
    visible: float
    """Part of its square that is left outside the span, 0..1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlipTest:
    """Results of one family of blocks, arrays of shape [blocks]."""

    p_value: Floats
    """Family-wise."""
    own_p_value: Floats
    """Of each block by itself."""


def visible_block(columns: Floats, span: Projector, *, least_visible: float) -> Block | None:
    """The block outside the span; None where less than `least_visible` of it is."""
    return visible_blocks([columns], span, least_visible=least_visible)[0]


def visible_blocks(shapes: Sequence[Floats], span: Projector, *, least_visible: float) -> list[Block | None]:
    """`visible_block` of many shapes [readings, columns], projected together."""
    ends = np.cumsum([columns.shape[1] for columns in shapes])[:-1]
    outside = np.split(span.outside(np.concatenate(shapes, axis=1)), ends, axis=1)
    return [_block(*each, least_visible) for each in zip(shapes, outside, strict=True)]


def _block(columns: Floats, outside: Floats, least_visible: float) -> Block | None:
    whole = float(np.sum(columns**2))
    visible = float(np.sum(outside**2)) / whole if whole > 0.0 else 0.0
    if visible < least_visible:
        return None
    spread, vectors = np.linalg.eigh(outside.T @ outside)
    seen = spread > 1e-3 * float(spread[-1])
    return Block(columns=outside @ (vectors[:, seen] / np.sqrt(spread[seen])), visible=visible)


def carrying_units(block: Block, unit: Integers) -> Integers:
    """Numbers of the units that carry a block."""
    square = np.bincount(unit, weights=np.sum(block.columns**2, axis=1))
    return np.flatnonzero(square > SMALLEST_SHARE * float(square.sum()) / max(1, int(np.sum(square > 0))))


def flip_test(
    residual: Floats,
    blocks: list[Block],
    unit: Integers,
    span: Projector,
    *,
    flips: int,
    rng: np.random.Generator,
    time_s: Floats | None = None,
) -> FlipTest:
    """Test blocks on a residual outside the span; `unit`: [readings], numbered from 0.

    `time_s`: when the readings were taken, which tells what noise with a memory adds from unit to unit; None: the
    order of the readings is the clock.
    """
    width = np.array([block.columns.shape[1] for block in blocks])
    columns = np.concatenate([block.columns for block in blocks], axis=1)
    starts = np.concatenate([[0], np.cumsum(width)[:-1]])
    order = np.argsort(unit, kind="stable")
    units = int(unit.max()) + 1
    first = np.concatenate([[0], np.cumsum(np.bincount(unit))[:-1]])
    score = np.add.reduceat((columns * residual[:, None])[order], first, axis=0)
    signs = (2 * rng.integers(0, 2, size=(flips, units)) - 1).astype(np.float64)
    summed = signs @ score
    left = _left_of_flips(columns, unit, order, first, span, signs)
    scatter = np.maximum(np.add.reduceat(np.sum(score**2, axis=0), starts), 1e-300)
    observed = np.add.reduceat(np.sum(score, axis=0) ** 2, starts) / scatter
    flipped = np.add.reduceat(summed**2 / left, starts, axis=1) / scatter
    # Blocks of two columns reach larger T by chance than those of one: each is measured by its own flips first.
    scale = np.mean(flipped, axis=0)
    # What noise with a memory adds up over the units is not there in the flips; where it cancels, it is left so.
    beyond = np.maximum(np.maximum.reduceat(excess(columns, unit, time_s), starts), 1.0)
    observed, flipped = observed / (scale * beyond), flipped / scale
    own = (1.0 + np.sum(flipped >= observed, axis=0)) / (flips + 1.0)
    largest = np.sort(np.max(flipped, axis=1))
    above = flips - np.searchsorted(largest, observed, side="left")
    return FlipTest(p_value=(1.0 + above) / (flips + 1.0), own_p_value=own)


def _left_of_flips(
    columns: Floats, unit: Integers, order: Integers, first: Integers, span: Projector, signs: Floats
) -> Floats:
    """[flips, columns]: d(f), what the span leaves of each flipped column of length 1."""
    taken = np.zeros((signs.shape[0], columns.shape[1]))
    by_unit = np.stack([span.basis[rows].T @ columns[rows] for rows in np.split(order, first[1:])])
    for of_direction in by_unit.transpose(1, 0, 2):
        taken += (signs @ of_direction) ** 2
    for rows in _shared_groups(span.index, unit):
        inside = columns[rows] / np.sqrt(rows.size)
        inside_unit = np.zeros((signs.shape[1], columns.shape[1]))
        np.add.at(inside_unit, unit[rows], inside)
        taken += (signs @ inside_unit) ** 2
    return np.maximum(1.0 - taken, LEAST_LEFT_OF_A_FLIP)


def _shared_groups(group: Integers, unit: Integers) -> list[Integers]:
    """Readings of each offset that several units share: flipping whole units keeps the others."""
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    return [rows for rows in parts if np.unique(unit[rows]).size > 1]
