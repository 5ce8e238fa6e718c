"""Patterns without physics: what competes with the library from the first step, so that `unknown` can win.

Each pattern lives in one cell. A plain pattern (one order times one condition) is left out where an effect of the
library lives in the same cell; with that effect withheld it comes back and catches it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.axes import Axes, axes_of
from trueangle_training.effects.cells import Cell, Direction, Slope, Temperature, Time
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Stage

Floats = NDArray[np.float64]

HIGHEST_ORDER = 11
HIGHEST_DENSE_ORDER = 60
DENSE_READINGS = 150
"""Readings against a reference encoder from which orders beyond the polygon's can be seen."""
MOST_RUNS_DRAWN = 60
"""With more runs than this a pattern with a draw in each run has too many columns to be compared."""
FEW_RUNS = 25
"""Up to this many runs the finer grids of patterns with a draw in each run are searched."""
PERIODS_IN_CAMPAIGN = (2.0, 3.0, 4.5, 7.0, 10.0, 15.0)
PERIODS_IN_RUN = (0.7, 1.0, 1.5, 2.3, 3.5, 5.3)
STEPS_IN_RUN = 24
"""Places of a run where a step is tried."""
ODD_RUN_FAMILY = "one odd run"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Factor:
    """What an order is multiplied with."""

    name: str
    columns: Floats
    """[readings, columns]"""
    temperature: Temperature = "constant"
    direction: Direction = "even"
    time: Time = "constant"
    speed: Slope = "constant"
    load: Slope = "constant"

    def cell(self, order: str) -> Cell:
        return Cell(
            order=order,
            temperature=self.temperature,
            direction=self.direction,
            time=self.time,
            speed=self.speed,
            load=self.load,
        )


def generic_hypotheses(conditions: Conditions, library: Mapping[str, LibraryEffect]) -> Iterator[Hypothesis]:
    """All patterns that this plan can show."""
    axes = axes_of(conditions)
    # A sensor's error is one given pattern within its cells, it does not fill them.
    taken = frozenset(
        cell for effect in library.values() if effect.stage is not Stage.SENSOR for cell in effect.cells
    )
    for pattern in (
        *_plain(axes, conditions, taken),
        *_line_orders_together(axes, conditions, library),
        *_bent_in_temperature(axes),
        *_squared_in_temperature(axes, conditions, library),
        *_crossed(axes),
        *_warming_with_speed(axes, taken),
        *_drawn_by_run(axes, library),
        *_steps_in_runs(axes, library),
        *_in_time(axes),
        *_at_places(axes, conditions, library),
    ):
        if pattern.main.shape[1] > 0 and np.isfinite(pattern.main).all():
            yield pattern


def orders_seen(conditions: Conditions) -> int:
    """Highest order that the plan's angles resolve, at most 60."""
    face = conditions.face
    dense = len(conditions) if conditions.faces is None else (0 if face is None else int(np.sum(face == 0)))
    if dense >= DENSE_READINGS:
        return HIGHEST_DENSE_ORDER
    return HIGHEST_ORDER if conditions.faces is None else max(1, min(HIGHEST_ORDER, (conditions.faces - 1) // 2))


def _pattern(
    label: str,
    cell: Cell,
    main: Floats,
    *,
    family: str,
    nature: Nature = Nature.MEAN,
    wiggle: Floats | None = None,
    wiggle_size: float = 0.0,
) -> Hypothesis:
    return Hypothesis(
        effect=None,
        label=label,
        cell=cell,
        main=main,
        coefficients=tuple(f"column_{i}_arcsec" for i in range(main.shape[1])),
        wiggle=np.empty((main.shape[0], 0)) if wiggle is None else wiggle,
        wiggle_size=wiggle_size,
        family=family,
        nature=nature,
    )


def _times(factor: Floats, columns: Floats) -> Floats:
    """[readings, products]: every column of the one times every column of the other."""
    return (factor[:, :, None] * columns[:, None, :]).reshape(columns.shape[0], -1)


def _factors(axes: Axes, conditions: Conditions) -> Iterator[_Factor]:
    """The conditions whose product with an order is a cell of its own."""
    yield _Factor(name="constant", columns=np.ones((axes.angle_rad.size, 1)))
    if axes.temperature is not None and conditions.temperature_c is not None:
        # About the temperature at which an effect of the library vanishes, or it would leave a constant part.
        above_c = conditions.temperature_c - conditions.base_temperature_c
        yield _Factor(name="linear in temperature", columns=above_c[:, None], temperature="linear")
    if axes.direction is not None:
        yield _Factor(name="odd in direction", columns=axes.direction[:, None], direction="odd")
    if axes.speed is not None and axes.velocity is not None:
        yield _Factor(name="times speed", columns=axes.speed[:, None], speed="linear")
        if float(axes.velocity.min()) < 0:
            yield _Factor(name="times velocity", columns=axes.velocity[:, None], speed="linear", direction="odd")
    if axes.load is not None:
        yield _Factor(name="times load", columns=axes.load[:, None], load="linear")
    yield _Factor(name="drifting within the run", columns=axes.within_run[:, None], time="within_run")
    if axes.runs > 2:
        c = axes.campaign
        yield _Factor(
            name="drifting over the campaign", columns=np.column_stack([c, c**2 - 1 / 3]), time="between_runs"
        )


def _plain(axes: Axes, conditions: Conditions, taken: frozenset[Cell]) -> Iterator[Hypothesis]:
    highest = orders_seen(conditions)
    lines = conditions.lines_per_rev
    for factor in _factors(axes, conditions):
        constant = factor.name == "constant"
        named = [(str(k), float(k)) for k in range((highest if constant else min(highest, HIGHEST_ORDER)) + 1)]
        if constant:
            named += [("N", float(lines)), ("2N", 2.0 * lines), ("4N", 4.0 * lines)]
        for name, order in named:
            cell = factor.cell(name)
            if cell in taken or (constant and order == 0):
                continue
            yield _pattern(
                f"order {name}, {factor.name}",
                cell,
                _times(factor.columns, axes.cosine_sine(order)),
                family=f"an order {factor.name}",
            )


def _line_orders_together(
    axes: Axes, conditions: Conditions, library: Mapping[str, LibraryEffect]
) -> Iterator[Hypothesis]:
    """Signals are seldom wrong in one way only: one multiple of the lines leaves the rest to any wide pattern."""
    if "subdivision_error" in library:
        return
    for multiples in ((1, 2), (1, 2, 4)):
        waves = [axes.cosine_sine(float(each * conditions.lines_per_rev)) for each in multiples]
        yield _pattern(
            f"{len(multiples)} multiples of the lines",
            Cell(order="N"),
            np.column_stack(waves),
            family="line orders",
        )


def _bent_in_temperature(axes: Axes) -> Iterator[Hypothesis]:
    """Not a straight line in temperature: a kink, a step, a curve, a phase that wanders."""
    x, level = axes.temperature, axes.temperature_level
    if x is None:
        return
    for order in range(HIGHEST_ORDER + 1):
        waves = axes.cosine_sine(order)
        family = "an order bent in temperature"
        smooth = np.column_stack([x**2 - 1 / 3, x**3 - 0.6 * x])
        cell = Cell(order=str(order), temperature="quadratic")
        yield _pattern(f"order {order}, curved in temperature", cell, _times(smooth, waves), family=family)
        yield _pattern(
            f"order {order}, curved in temperature", cell, _times((x**2 - 1 / 3)[:, None], waves), family=family
        )
        for kink in (-0.5, 0.0, 0.5):
            bend = np.abs(x - kink)[:, None]
            yield _pattern(f"order {order}, kink in temperature", cell, _times(bend, waves), family=family)
        edges = (-0.6, -0.2, 0.2, 0.6) if level is None else _level_edges(x, level)
        for edge in edges:
            step = (x > edge).astype(np.float64)[:, None]
            yield _pattern(
                f"order {order}, step in temperature",
                Cell(order=str(order), temperature="step"),
                _times(step, waves),
                family="an order stepping in temperature",
            )
        if 3 <= order <= 8 and level is not None:
            free = (level[:, None] == np.arange(int(level.max()) + 1)).astype(np.float64)
            yield _pattern(
                f"order {order}, free at each temperature", cell, _times(free, waves), family="an order free in T"
            )


def _squared_in_temperature(
    axes: Axes, conditions: Conditions, library: Mapping[str, LibraryEffect]
) -> Iterator[Hypothesis]:
    """A parabola about the temperature at which drift vanishes: beside a straight line others are blind."""
    if axes.temperature is None or conditions.temperature_c is None or "thermal_nonlinearity" in library:
        return
    squared = ((conditions.temperature_c - conditions.base_temperature_c) ** 2)[:, None]
    for order in range(HIGHEST_ORDER + 1):
        yield _pattern(
            f"order {order}, squared in temperature",
            Cell(order=str(order), temperature="quadratic"),
            _times(squared, axes.cosine_sine(order)),
            family="an order squared in temperature",
        )


def _level_edges(x: Floats, level: NDArray[np.int64]) -> list[float]:
    low = [float(x[level == i].max()) for i in range(int(level.max()))]
    high = [float(x[level == i + 1].min()) for i in range(int(level.max()))]
    return [0.5 * (a + b) for a, b in zip(low, high, strict=True)]


def _crossed(axes: Axes) -> Iterator[Hypothesis]:
    """Two conditions at once."""
    x, d, load, speed = axes.temperature, axes.direction, axes.load, axes.speed
    pairs: list[tuple[str, Floats, Cell]] = []
    if x is not None and d is not None:
        pairs.append(
            ("temperature times direction", x * d, Cell(order="0", temperature="linear", direction="odd"))
        )
    if x is not None and load is not None:
        pairs.append(("temperature times load", x * load, Cell(order="0", temperature="linear", load="linear")))
    if x is not None and speed is not None:
        pairs.append(("temperature times speed", x * speed, Cell(order="0", temperature="linear", speed="linear")))
    if d is not None and load is not None:
        pairs.append(("direction times load", d * load, Cell(order="0", direction="odd", load="linear")))
    if speed is not None:
        pairs.append(("square of the speed", speed**2, Cell(order="0", speed="linear")))
    if load is not None:
        pairs.append(("square of the load", load**2, Cell(order="0", load="linear")))
    for label, product, cell in pairs:
        for order in (0, 1, 2):
            placed = Cell(
                order=str(order),
                temperature=cell.temperature,
                direction=cell.direction,
                speed=cell.speed,
                load=cell.load,
            )
            columns = _times(product[:, None], axes.cosine_sine(order))
            yield _pattern(f"order {order}, {label}", placed, columns, family=label)


def _warming_with_speed(axes: Axes, taken: frozenset[Cell]) -> Iterator[Hypothesis]:
    """What builds up within the run, the more the faster it turns."""
    if axes.speed is None:
        return
    rising = axes.speed[:, None] * np.column_stack([np.ones_like(axes.within_run), axes.within_run])
    for order in (0, 1, 2):
        cell = Cell(order=str(order), time="within_run", speed="linear")
        if cell not in taken:
            yield _pattern(
                f"order {order}, building up within the run with speed",
                cell,
                _times(rising, axes.cosine_sine(order)),
                family="building up within the run with speed",
            )


def _drawn_by_run(axes: Axes, library: Mapping[str, LibraryEffect]) -> Iterator[Hypothesis]:
    """A draw of its own in each run, one odd run, a step between runs."""
    if axes.runs < 2:
        return
    one_hot = (axes.run_index[:, None] == np.arange(axes.runs)).astype(np.float64)
    if axes.runs <= MOST_RUNS_DRAWN:
        for order in range(2 if "run_to_run_eccentricity" in library else 1, 6):
            cell = Cell(order=str(order), time="between_runs")
            columns = _times(one_hot, axes.cosine_sine(order))
            yield _pattern(
                f"order {order}, drawn anew in each run",
                cell,
                columns,
                family="an order drawn in each run",
                nature=Nature.RANDOM,
            )
        slopes = one_hot * axes.within_run[:, None]
        cell = Cell(order="0", time="within_run")
        yield _pattern(
            "slope drawn anew in each run", cell, slopes, family="a slope drawn in each run", nature=Nature.RANDOM
        )
    for run in range(axes.runs if axes.runs >= 3 else 0):
        here = one_hot[:, run : run + 1]
        for highest in (3, 6) if axes.runs <= FEW_RUNS else (5,):
            waves = np.column_stack([axes.cosine_sine(k) for k in range(1, highest + 1)])
            columns = here * np.column_stack([waves, axes.within_run])
            yield _pattern(
                f"run {run} unlike the others, orders to {highest}",
                Cell(order="1", time="between_runs"),
                columns,
                family=ODD_RUN_FAMILY,
                nature=Nature.EVENT,
            )
    for order in range(1, 6 if axes.runs <= FEW_RUNS else 4):
        for run in range(2, axes.runs - 1) if axes.runs <= MOST_RUNS_DRAWN else ():
            later = (axes.run_index >= run).astype(np.float64)[:, None]
            yield _pattern(
                f"order {order}, step before run {run}",
                Cell(order=str(order), time="between_runs"),
                _times(later, axes.cosine_sine(order)),
                family="an order stepping between runs",
            )


def _steps_in_runs(axes: Axes, library: Mapping[str, LibraryEffect]) -> Iterator[Hypothesis]:
    """All that comes after some reading of one run is shifted."""
    if "count_loss" in library or not 2 <= axes.runs <= FEW_RUNS:
        return
    for run in range(axes.runs):
        here = axes.run_index == run
        order = np.sort(axes.within_run[here])
        places = np.linspace(0, order.size - 1, min(order.size, STEPS_IN_RUN) + 1)[1:-1]
        for edge in np.unique(order[np.rint(places).astype(np.int64)]):
            yield _pattern(
                f"step in run {run}",
                Cell(order="0", time="within_run"),
                (here & (axes.within_run >= edge)).astype(np.float64)[:, None],
                family="a step in a run",
                nature=Nature.EVENT,
            )


def _in_time(axes: Axes) -> Iterator[Hypothesis]:
    """Oscillations with a period in time, free in phase in each run, and a curve within the run."""
    u = axes.within_run
    yield _pattern(
        "curve in time within the run",
        Cell(order="0", time="within_run"),
        np.column_stack([u, u**2 - 1 / 3]),
        family="a curve in time within the run",
    )
    if 2 <= axes.runs <= MOST_RUNS_DRAWN:
        one_hot = (axes.run_index[:, None] == np.arange(axes.runs)).astype(np.float64)
        for cycles in PERIODS_IN_RUN if axes.runs <= FEW_RUNS else PERIODS_IN_RUN[1::2]:
            phase = np.pi * cycles * u
            columns = _times(one_hot, np.column_stack([np.cos(phase), np.sin(phase)]))
            yield _pattern(
                f"oscillation, {cycles:g} periods a run",
                Cell(order="0", time="within_run"),
                columns,
                family="an oscillation in time",
                nature=Nature.RANDOM,
            )
    for cycles in PERIODS_IN_CAMPAIGN:
        phase = np.pi * cycles * axes.campaign
        columns = np.column_stack([np.cos(phase), np.sin(phase)])
        yield _pattern(
            f"oscillation, {cycles:g} periods a campaign",
            Cell(order="0", time="between_runs"),
            columns,
            family="an oscillation in time",
        )


def _at_places(axes: Axes, conditions: Conditions, library: Mapping[str, LibraryEffect]) -> Iterator[Hypothesis]:
    """Bumps wider than a defect and, with their effect withheld, narrow ones, other frequencies, face patterns."""
    widths = (25.0, 45.0, 90.0) if "localized_defect" in library else (5.0, 12.0, 25.0, 45.0, 90.0)
    degrees = np.degrees(axes.angle_rad)
    for width in widths:
        for centre in np.arange(0.0, 360.0, max(width / 2.0, 8.0)):
            away = (degrees - centre + 180.0) % 360.0 - 180.0
            bump = np.exp(-4.0 * np.log(2.0) * (away / width) ** 2)[:, None]
            yield _pattern(
                f"bump at {centre:g} deg, {width:g} deg wide", Cell(order="localized"), bump, family="a bump"
            )
    yield from _changing_bumps(axes, degrees)
    if "bearing_wobble" not in library:
        for frequency in np.arange(0.3, 6.0, 0.1):
            if abs(frequency - round(frequency)) > 0.05:
                yield _pattern(
                    f"order {frequency:.1f}",
                    Cell(order="non-integer"),
                    axes.cosine_sine(float(frequency)),
                    family="a non-integer order",
                )
    if "reference_artefact" not in library and conditions.face is not None:
        faces = np.unique(conditions.face[conditions.face > 0])
        pattern = (conditions.face[:, None] == faces).astype(np.float64)
        yield _pattern(
            "pattern over the faces", Cell(order="1", frame="polygon"), pattern, family="a pattern over the faces"
        )


def _changing_bumps(axes: Axes, degrees: Floats) -> Iterator[Hypothesis]:
    """A bump that grows, shrinks or wanders with temperature or over the campaign."""
    changes: list[tuple[str, Floats, Cell]] = []
    if axes.temperature is not None:
        changes.append(("with temperature", axes.temperature, Cell(order="localized", temperature="linear")))
    if axes.runs > 2:
        changes.append(("over the campaign", axes.campaign, Cell(order="localized", time="between_runs")))
    for label, factor, cell in changes:
        for width in (12.0, 25.0, 45.0):
            for centre in np.arange(0.0, 360.0, max(width / 2.0, 12.0)):
                away = (degrees - centre + 180.0) % 360.0 - 180.0
                bump = np.exp(-4.0 * np.log(2.0) * (away / width) ** 2)
                yield _pattern(
                    f"bump at {centre:g} deg, {width:g} deg wide, changing {label}",
                    cell,
                    (factor * bump)[:, None],
                    family=f"a bump changing {label}",
                    wiggle=(factor * bump * away / width)[:, None],
                    wiggle_size=0.7,
                )
