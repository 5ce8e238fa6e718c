"""Where the gap lies: a fixed lattice of cells, tested with the run as the statistical unit.

Cells that eight runs or more carry are tested by flipping the signs of whole runs; cells of fewer runs by flipping
blocks within a run that are longer than the noise remembers, as told by the other runs. The two families share 5 %
by a weighted Bonferroni bound, Holm's steps inside the second. Where neither is possible a cell is not testable
and the number of runs that would test it is given.

The shares rest on what was found: its members' own cells first, what they leave cell by cell in the order of what
each explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.findings import Place
from trueangle_training.diagnosis.lattice import LatticeBlock, lattice
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import Projector, recalibration_span
from trueangle_training.diagnosis.scatter_map import scatter_places
from trueangle_training.diagnosis.sign_flips import Block, carrying_units, flip_test, visible_blocks
from trueangle_training.effects.cells import Cell

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_VISIBLE = 0.02
FEWEST_RUNS = 8
"""2^(1-8) = 0.008: with fewer runs no cell could be significant once others are looked at too."""
LEVEL = 0.05
WEIGHT_OF_RUNS = 0.8
"""Part of the level for the cells tested by whole runs, where there are cells of both families."""
WEIGHT_OF_MEANS = 0.6
"""Part of the level for the cells of the mean; the map of the scatter has a fifth. They add up to less than 1
because flips of 21 runs are a little liberal: 17 alarms at 5 % on 200 campaigns of coloured noise."""
FLIPS = 999
FLIPS_OF_MANY = 399
MANY_NUMBERS = 3_000_000
FEWEST_BLOCKS = 12
MEMORY_OF_BLOCKS = 3.0
"""A block is this many times as long as the noise remembers."""
SHORTEST_BLOCK = 3
HIGHEST_LOOKED_UP = 11
MOST_PICKS = 6
LEAST_SHARE = 0.01
NEARLY_AS_MUCH = 0.9
LEAST_NEAREST = 0.5
"""Of a part's energy."""


class CellFit(Enum):
    """How much the cell says of the shape."""

    WHOLE = "whole"
    """All: one order, one condition."""
    ANY_ORDER = "any order"
    """All but the order: the curve's orders are looked up run by run."""
    HINT = "hint"
    """Little: the lattice tells where the curve lies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Elsewhere:
    """Another cell in which a shape may lie as well."""

    cell: Cell
    carried: float
    """Share of the shape, 0 to 1, that the cell's own shape could carry."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundPart:
    """A shape that the attribution found."""

    cell: Cell
    fit: CellFit
    curve_arcsec: Floats
    """[readings]"""
    elsewhere: Elsewhere | None = None
    """None: no other cell comes near."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tested:
    lattice: LatticeBlock
    block: Block
    runs: Integers


def where(
    problem: Problem,
    *,
    floor_arcsec2: float,
    rng: np.random.Generator,
    found: Sequence[FoundPart] = (),
) -> tuple[Place, ...]:
    """All cells that can be looked at under this plan, the largest share, or what could be in its place, first.

    `problem.error_arcsec` should be cleaned of outliers; `floor_arcsec2`: variance of one reading.
    """
    span = recalibration_span(problem)
    residual = span.outside(problem.error_arcsec)
    unit = np.unique(problem.conditions.run, return_inverse=True)[1].astype(np.int64)
    tested: list[_Tested] = []
    cells = lattice(problem)
    blocks = visible_blocks([each.columns for each in cells], span, least_visible=LEAST_VISIBLE)
    for each, block in zip(cells, blocks, strict=True):
        if block is not None:
            tested.append(_Tested(lattice=each, block=block, runs=carrying_units(block, unit)))
    if not tested:
        return ()
    p_values = _p_values(residual, tested, unit, span, rng, problem.conditions.time_s)
    # Of noise alone nothing has a share: without a finding only significant cells have.
    shown = [
        each
        for each, p_value in zip(tested, p_values, strict=True)
        if found or (p_value is not None and p_value <= LEVEL)
    ]
    shares = (
        cell_shares(
            residual,
            tested_blocks(shown),
            span,
            floor_arcsec2=floor_arcsec2,
            found=found,
            orders=[order_shares(part, problem.conditions.angle_deg, unit) for part in found],
        )
        if shown
        else {}
    )
    places = [
        *_places(tested, p_values, shares, could_carry(found, tested_blocks(tested), span)),
        *scatter_places(problem, residual, unit, found_any=bool(found), rng=rng),
    ]
    return tuple(sorted(places, key=_rank))


def _rank(place: Place) -> tuple[float, float, bool, float]:
    return (-max(place.share, place.could_carry), -place.share, place.p_value is None, place.p_value or 0.0)


def could_carry(
    found: Sequence[FoundPart], blocks: Sequence[tuple[Cell, Block]], span: Projector
) -> dict[Cell, float]:
    """Share of all that was found which a cell could carry instead of the cell that it was laid to.

    Of a part with no likely other cell, the cell of the lattice that comes nearest, if it carries half of it.
    """
    seen = [span.outside(part.curve_arcsec) for part in found]
    energy = np.array([float(curve @ curve) for curve in seen])
    whole = max(float(energy.sum()), 1e-300)
    shares: dict[Cell, float] = {}
    for part, curve, own in zip(found, seen, energy, strict=True):
        other = part.elsewhere or _nearest(part.cell, curve, blocks)
        if other is not None and own > 0.0:
            shares[other.cell] = min(1.0, shares.get(other.cell, 0.0) + other.carried * float(own) / whole)
    return shares


def _nearest(own: Cell, curve: Floats, blocks: Sequence[tuple[Cell, Block]]) -> Elsewhere | None:
    energy = max(float(curve @ curve), 1e-300)
    best: Elsewhere | None = None
    for cell, block in blocks:
        if cell == own:
            continue
        carried = float(np.sum((block.columns.T @ curve) ** 2)) / energy
        if carried > max(LEAST_NEAREST, best.carried if best else 0.0):
            best = Elsewhere(cell=cell, carried=min(1.0, carried))
    return best


def tested_blocks(tested: Sequence[_Tested]) -> list[tuple[Cell, Block]]:
    """Cells and what is visible of them."""
    return [(each.lattice.cell, each.block) for each in tested]


def _places(
    tested: Sequence[_Tested],
    p_values: list[float | None],
    shares: dict[Cell, float],
    instead: dict[Cell, float],
) -> list[Place]:
    """One place a cell: its smallest p, its share, what it could carry instead of others."""
    best: dict[Cell, float | None] = {}
    needed: dict[Cell, int] = {}
    for each, p_value in zip(tested, p_values, strict=True):
        cell = each.lattice.cell
        if p_value is None:
            best.setdefault(cell, None)
            needed[cell] = FEWEST_RUNS
        else:
            before = best.get(cell)
            best[cell] = p_value if before is None else min(before, p_value)
    for cell in (*shares, *instead):
        best.setdefault(cell, None)
    return [
        Place(
            cell=cell,
            share=shares.get(cell, 0.0),
            could_carry=instead.get(cell, 0.0),
            p_value=p_value,
            significant=p_value is not None and p_value <= LEVEL,
            runs_needed=needed.get(cell) if p_value is None else None,
        )
        for cell, p_value in best.items()
    ]


def _p_values(
    residual: Floats,
    tested: Sequence[_Tested],
    unit: Integers,
    span: Projector,
    rng: np.random.Generator,
    time_s: Floats | None,
) -> list[float | None]:
    """Family-wise p-value of each block; None: not testable."""
    p_values: list[float | None] = [None] * len(tested)
    by_runs = [i for i, each in enumerate(tested) if each.runs.size >= FEWEST_RUNS]
    by_blocks = _by_blocks(
        residual, [(i, tested[i]) for i in set(range(len(tested))) - set(by_runs)], unit, span, rng, time_s
    )
    weight = WEIGHT_OF_RUNS if by_blocks and by_runs else 1.0
    if by_runs:
        blocks = [tested[i].block for i in by_runs]
        size = sum(block.columns.shape[1] for block in blocks) * int(unit.max() + 1) * (span.basis.shape[1] + 1)
        flips = FLIPS if size < MANY_NUMBERS else FLIPS_OF_MANY
        test = flip_test(residual, blocks, unit, span, flips=flips, rng=rng, time_s=time_s)
        for i, p_value in zip(by_runs, test.p_value, strict=True):
            p_values[i] = min(1.0, float(p_value) / (weight * WEIGHT_OF_MEANS))
    rest = WEIGHT_OF_MEANS * (1.0 - weight if by_runs else 1.0)
    largest = 0.0
    for rank, (i, p_value) in enumerate(sorted(by_blocks.items(), key=lambda item: item[1])):
        largest = max(largest, p_value * (len(by_blocks) - rank) / rest)
        p_values[i] = min(1.0, largest)
    return p_values


def _by_blocks(
    residual: Floats,
    tested: Sequence[tuple[int, _Tested]],
    unit: Integers,
    span: Projector,
    rng: np.random.Generator,
    time_s: Floats | None,
) -> dict[int, float]:
    """Own p-values of blocks that few runs carry, by flipping parts of these runs; too few parts: missing."""
    chosen: dict[tuple[int, ...], list[tuple[int, _Tested]]] = {}
    for i, each in tested:
        chosen.setdefault(tuple(each.runs.tolist()), []).append((i, each))
    found: dict[int, float] = {}
    for runs, blocks in chosen.items():
        parts = _parts(residual, np.array(runs, dtype=np.int64), unit)
        if parts is None or int(parts.max()) < FEWEST_BLOCKS:
            continue
        # The other runs are not cut: what little of a shape they carry would be one score of slow noise.
        inside = [
            replace(each.block, columns=np.where(parts[:, None] > 0, each.block.columns, 0.0))
            for _, each in blocks
        ]
        test = flip_test(residual, inside, parts, span, flips=FLIPS, rng=rng, time_s=time_s)
        found |= {i: float(p) for (i, _), p in zip(blocks, test.own_p_value, strict=True)}
    return found


def _parts(residual: Floats, runs: Integers, unit: Integers) -> Integers | None:
    """[readings]: number of the part each reading is in; 0 in other runs. None: no other run to learn from."""
    length = 0.0
    for run in runs:
        rows = int(np.sum(unit == run))
        memory = [
            _memory(residual[unit == other])
            for other in range(int(unit.max()) + 1)
            if other not in runs and 0.5 * rows <= int(np.sum(unit == other)) <= 2.0 * rows
        ]
        if not memory:
            return None
        length = max(length, float(np.median(memory)))
    size = max(SHORTEST_BLOCK, int(np.ceil(MEMORY_OF_BLOCKS * length)))
    parts = np.zeros(unit.size, dtype=np.int64)
    count = 0
    for run in runs:
        rows = np.flatnonzero(unit == run)
        blocks = np.minimum(np.arange(rows.size) // size, max(rows.size // size - 1, 0))
        parts[rows] = count + 1 + blocks
        count = int(parts[rows].max())
    return parts


def _memory(values: Floats) -> float:
    """Integrated correlation length of a run's residual in readings, 1 for white noise."""
    centred = values - float(values.mean())
    power = np.abs(np.fft.rfft(centred, 2 * centred.size)) ** 2
    correlation = np.fft.irfft(power)[: centred.size // 2]
    if correlation.size < 3 or correlation[0] <= 0.0:
        return float(values.size)
    correlation = correlation / correlation[0]
    negative = np.flatnonzero(correlation < 0.05)
    end = int(negative[0]) if negative.size else correlation.size
    return 1.0 + 2.0 * float(np.sum(correlation[1:end]))


def cell_shares(
    residual: Floats,
    blocks: Sequence[tuple[Cell, Block]],
    span: Projector,
    *,
    floor_arcsec2: float,
    found: Sequence[FoundPart],
    orders: Sequence[dict[Cell, float]],
) -> dict[Cell, float]:
    """Share of the structural part in each cell; cells that are not listed have none.

    `orders`: of each found part what `order_shares` says.
    """
    target, noise = residual, floor_arcsec2
    energy: dict[Cell, float] = {}
    if found:
        curves = [span.outside(part.curve_arcsec) for part in found]
        target, noise = np.sum(curves, axis=0), 0.0
        whole = float(target @ target)
        order = np.argsort([-float(curve @ curve) for curve in curves])
        for i in order:
            if found[i].fit is CellFit.HINT:
                continue
            curve = curves[i]
            length = float(curve @ curve)
            gain = float(curve @ target) ** 2 / max(length, 1e-300)
            if gain > LEAST_SHARE * whole:
                parts = orders[i] if found[i].fit is CellFit.ANY_ORDER else {found[i].cell: 1.0}
                for cell, part in parts.items():
                    energy[cell] = energy.get(cell, 0.0) + part * gain
                target = target - curve * (float(curve @ target) / length)
    total = float(target @ target) + sum(energy.values())
    _pick(target, blocks, noise, energy, least=LEAST_SHARE * total)
    kept = sum(energy.values())
    return {cell: value / kept for cell, value in energy.items()} if kept > 0.0 else {}


def order_shares(part: FoundPart, angle_deg: Floats, unit: Integers) -> dict[Cell, float]:
    """The part's cell at each order 1 to 11, with the share of the curve's energy there, run by run; sums to 1."""
    runs = int(unit.max()) + 1
    energy: dict[Cell, float] = {}
    for order in range(1, HIGHEST_LOOKED_UP + 1):
        turned = part.curve_arcsec * np.exp(-1j * np.radians(order * angle_deg))
        sums = np.bincount(unit, weights=turned.real, minlength=runs) ** 2
        sums += np.bincount(unit, weights=turned.imag, minlength=runs) ** 2
        energy[replace(part.cell, order=str(order))] = float(np.sum(sums / np.bincount(unit, minlength=runs)))
    whole = sum(energy.values())
    return {cell: value / whole for cell, value in energy.items()} if whole > 0.0 else {part.cell: 1.0}


def _pick(
    target: Floats, blocks: Sequence[tuple[Cell, Block]], noise: float, energy: dict[Cell, float], *, least: float
) -> None:
    """Orthogonal matching: the cell that explains most, then the next of what it leaves."""
    width = np.array([block.columns.shape[1] for _, block in blocks])
    columns = np.concatenate([block.columns for _, block in blocks], axis=1)
    starts = np.concatenate([[0], np.cumsum(width)[:-1]])
    for _ in range(MOST_PICKS):
        explained = np.add.reduceat((columns.T @ target) ** 2, starts) - width * (
            2.0 * noise + 0.006 * float(target @ target)
        )
        if float(explained.max()) <= 0.0:
            return
        # Of cells that the plan hardly tells apart the one that comes first in the lattice, the simpler one.
        best = int(np.flatnonzero(explained >= NEARLY_AS_MUCH * float(explained.max()))[0])
        gain = float(np.sum((blocks[best][1].columns.T @ target) ** 2)) - width[best] * noise
        # Twice the logarithm of the number of cells is what the best of them explains of pure noise.
        if gain < max(least, noise * 2.0 * np.log(len(blocks))):
            return
        cell, block = blocks[best]
        energy[cell] = energy.get(cell, 0.0) + gain
        target = target - block.columns @ (block.columns.T @ target)


def without_found(problem: Problem, found: Sequence[FoundPart]) -> Problem:
    """The problem with what was found taken off."""
    return replace(problem, error_arcsec=problem.error_arcsec - sum(part.curve_arcsec for part in found))
