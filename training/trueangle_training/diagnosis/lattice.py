"""The fixed lattice of cells in which a gap is looked for, as columns of a campaign."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.diagnosis.problem import STEADY_C, Problem
from trueangle_training.diagnosis.shares import SAME_PLACE_DEG, within_run
from trueangle_training.effects.cells import Cell

Floats = NDArray[np.float64]

HIGHEST_ORDER = 60
HIGHEST_MIXED_ORDER = 11
"""Of orders that change with a condition: beyond them a joint is a joint, not a spectrum analyser."""
LAG_S = (300.0, 1200.0, 3600.0)
WINDOW_DEG = (4.0, 10.0)
NON_INTEGER_ORDERS = tuple(round(0.3 + 0.1 * k, 1) for k in range(57) if (3 + k) % 10)
MOST_WINDOWS = 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatticeBlock:
    """One shape of a cell; a cell may have several, such as windows at different angles."""

    cell: Cell
    columns: Floats
    """[readings, columns]"""


def lattice(problem: Problem) -> tuple[LatticeBlock, ...]:
    """All blocks of the lattice for which the campaign has the columns, the simplest cells first.

    Of cells that this plan cannot tell apart the simpler one stands for all.
    """
    return tuple(_blocks(problem))


def highest_order(problem: Problem) -> int:
    """The highest order that the angles can tell from the lower ones."""
    places = np.unique(np.rint(wrap_deg(problem.conditions.angle_deg) / SAME_PLACE_DEG)).size
    return int(np.clip((places - 1) // 2, 0, HIGHEST_ORDER))


def _blocks(problem: Problem) -> Iterator[LatticeBlock]:
    at = problem.conditions
    theta = np.radians(at.angle_deg)
    highest = highest_order(problem)
    mixed = min(highest, HIGHEST_MIXED_ORDER)

    def order(k: int) -> Floats:
        if k == 0:
            return np.ones((theta.size, 1))
        return np.column_stack([np.cos(k * theta), np.sin(k * theta)])

    for k in range(1, highest + 1):
        yield LatticeBlock(cell=Cell(order=str(k)), columns=order(k))
    if highest >= HIGHEST_ORDER:
        for factor in (1, 2, 4):
            name = "N" if factor == 1 else f"{factor}N"
            yield LatticeBlock(cell=Cell(order=name), columns=order(factor * at.lines_per_rev))
    yield from _thermal(problem, order, mixed)
    yield from _by_condition(problem, order, mixed)
    yield from _in_time(problem, order, mixed)
    for k in NON_INTEGER_ORDERS:
        columns = np.column_stack([np.cos(k * theta), np.sin(k * theta)])
        yield LatticeBlock(cell=Cell(order="non-integer"), columns=columns)
    yield from _windows(problem)
    yield from _faces(problem)


def _thermal(problem: Problem, order: Callable[[int], Floats], mixed: int) -> Iterator[LatticeBlock]:
    at = problem.conditions
    temperature = at.temperature_c
    if temperature is None or float(np.ptp(temperature)) < STEADY_C:
        return
    x = (temperature - float(temperature.mean())) / max(float(np.ptp(temperature)) / 2.0, 1e-9)
    levels = np.unique(np.rint(temperature / (2.0 * STEADY_C)))
    for k in range(mixed + 1):
        yield LatticeBlock(cell=Cell(order=str(k), temperature="linear"), columns=x[:, None] * order(k))
    if levels.size > 2:
        for k in range(mixed + 1):
            yield LatticeBlock(
                cell=Cell(order=str(k), temperature="quadratic"), columns=(x**2)[:, None] * order(k)
            )
        middles = (levels[1:] + levels[:-1]) * STEADY_C
        for k in range(min(mixed, 8) + 1):
            for middle in middles[: MOST_WINDOWS // 3]:
                step = np.where(temperature > middle, 1.0, -1.0)
                yield LatticeBlock(cell=Cell(order=str(k), temperature="step"), columns=step[:, None] * order(k))
    if at.time_s is not None:
        for k in range(2):
            for lag_s in LAG_S:
                lag = _lagged(temperature, at.time_s, lag_s) - temperature
                if float(np.std(lag)) > 1e-3:
                    columns = lag[:, None] * order(k)
                    yield LatticeBlock(cell=Cell(order=str(k), temperature="lagged"), columns=columns)


def _lagged(temperature: Floats, time_s: Floats, lag_s: float) -> Floats:
    """First-order lag of the temperature through the whole campaign; between readings it moves linearly."""
    order = np.argsort(time_s, kind="stable")
    seen, step = temperature[order], np.diff(time_s[order])
    out = np.empty_like(seen)
    state = float(seen[0])
    out[0] = state
    for i, wait in enumerate(step.tolist(), start=1):
        kept = float(np.exp(-max(wait, 0.0) / lag_s))
        state = float(seen[i]) + (state - float(seen[i])) * kept
        out[i] = state
    back = np.empty_like(out)
    back[order] = out
    return back


def _by_condition(problem: Problem, order: Callable[[int], Floats], mixed: int) -> Iterator[LatticeBlock]:
    at = problem.conditions
    if at.direction is not None and np.unique(at.direction).size > 1:
        for k in range(mixed + 1):
            cell = Cell(order=str(k), direction="odd")
            yield LatticeBlock(cell=cell, columns=at.direction[:, None] * order(k))
    if at.velocity_deg_s is not None and float(np.ptp(at.velocity_deg_s)) > 0.0:
        scale = float(np.abs(at.velocity_deg_s).max())
        for k in range(min(mixed, 3) + 1):
            for speed in (at.velocity_deg_s, np.abs(at.velocity_deg_s)):
                cell = Cell(order=str(k), speed="linear")
                yield LatticeBlock(cell=cell, columns=(speed / scale)[:, None] * order(k))
    if at.load_nm is not None and float(np.ptp(at.load_nm)) > 0.0:
        load = at.load_nm / float(np.abs(at.load_nm).max())
        for k in range(min(mixed, 3) + 1):
            yield LatticeBlock(cell=Cell(order=str(k), load="linear"), columns=load[:, None] * order(k))


def _in_time(problem: Problem, order: Callable[[int], Floats], mixed: int) -> Iterator[LatticeBlock]:
    at = problem.conditions
    place = within_run(problem)
    for k in range(min(mixed, 2) + 1):
        yield LatticeBlock(cell=Cell(order=str(k), time="within_run"), columns=place[:, None] * order(k))
    travel = 1.0 - np.exp(-2.0 * (place + 1.0))
    yield LatticeBlock(cell=Cell(order="0", time="within_run"), columns=travel[:, None])
    runs, index = np.unique(at.run, return_inverse=True)
    if runs.size < 2:
        return
    clock = index.astype(np.float64) if at.time_s is None else at.time_s
    z = (2.0 * clock - clock.min() - clock.max()) / max(float(np.ptp(clock)), 1e-9)
    for k in range(min(mixed, 6) + 1):
        for change in (z, z**2):
            cell = Cell(order=str(k), time="between_runs")
            yield LatticeBlock(cell=cell, columns=change[:, None] * order(k))


def _windows(problem: Problem) -> Iterator[LatticeBlock]:
    angle = wrap_deg(problem.conditions.angle_deg)
    places = np.unique(np.rint(angle / SAME_PLACE_DEG)) * SAME_PLACE_DEG
    if places.size > MOST_WINDOWS:
        places = np.linspace(0.0, 360.0, MOST_WINDOWS, endpoint=False)
    for width in WINDOW_DEG:
        for middle in places:
            away = np.mod(angle - middle + 180.0, 360.0) - 180.0
            bump = np.exp(-4.0 * np.log(2.0) * (away / width) ** 2)
            if float(bump.max()) > 0.5:
                yield LatticeBlock(cell=Cell(order="localized"), columns=bump[:, None])


def _faces(problem: Problem) -> Iterator[LatticeBlock]:
    face = problem.conditions.face
    if face is None or not (face > 0).any():
        return
    labels = np.unique(face[face > 0])
    yield LatticeBlock(
        cell=Cell(order="0", frame="polygon"), columns=(face[:, None] == labels[None, :]).astype(np.float64)
    )
