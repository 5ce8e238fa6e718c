"""The figures of the diagnosis as SVG, drawn for a column as wide as a phone."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.diagnosis.curves import Curves
from trueangle_training.diagnosis.findings import Place, Step
from trueangle_training.diagnosis.wording import SMALLEST_PLACE, TIMES, condition_words, effect_words, percent
from trueangle_training.report.plots import ACCENT, FAINT, INK, SIZE_INCH, STYLE, temperature_colours

Floats = NDArray[np.float64]

MANY_POINTS = 300
"""From here on a scatter is a picture inside the drawing: a path for each point would be slow and large."""
MOST_ROWS = 14
MOST_COLUMNS = 9
FOLLOWED = ("always", "temperature", "direction", "time", "another", "speed", "load", "polygon", "scatter")
"""Columns of the map in this order, by what a cell's words begin with."""
SHADES = LinearSegmentedColormap.from_list("share", ["#f7f4ec", "#9dbbd6", ACCENT])
LIGHT_TEXT_FROM = 0.55
SHOWN_SHARE = 0.05
"""A smaller share of a cell that is not significant is not written out."""
BEFORE, AFTER = "#b3541e", ACCENT


@dataclass(frozen=True, slots=True, kw_only=True)
class _Margins:
    """Inches around the axes where their labels are known beforehand: measuring them takes half of the drawing."""

    left: float = 0.62
    right: float = 0.08
    bottom: float = 0.47
    top: float = 0.27


def _svg(draw: Callable[[Figure], None], *, height_inch: float, margins: _Margins | None = None) -> bytes:
    with mpl.rc_context(STYLE):
        width_inch = SIZE_INCH[0]
        figure = Figure(figsize=(width_inch, height_inch), layout="constrained" if margins is None else None)
        if margins is not None:
            figure.subplots_adjust(
                left=margins.left / width_inch,
                right=1.0 - margins.right / width_inch,
                bottom=margins.bottom / height_inch,
                top=1.0 - margins.top / height_inch,
                hspace=0.25,
            )
        FigureCanvasSVG(figure)
        draw(figure)
        data = io.BytesIO()
        # Without date and version the same numbers give the same bytes.
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None}, dpi=220)
    return data.getvalue()


def before_and_after(curves: Curves, *, by_direction: bool) -> bytes:
    """Residuals over the angle, without and with the causes, on one scale."""
    limit = (
        1.05 * float(np.abs(np.concatenate([curves.recalibrated_arcsec, curves.explained_arcsec])).max()) or 1.0
    )
    colours, legend = _colours(curves, by_direction=by_direction)
    angle_deg = wrap_deg(curves.angle_deg)

    def draw(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
        panels = ((upper, curves.recalibrated_arcsec, "before"), (lower, curves.explained_arcsec, "after"))
        for axes, values, title in panels:
            axes.axhline(0.0, color=INK, linewidth=0.6)
            axes.scatter(angle_deg, values, s=6, linewidths=0, c=colours, rasterized=values.size > MANY_POINTS)
            rms = float(np.sqrt(np.mean(values**2)))
            axes.set(ylabel="arcsec", ylim=(-limit, limit))
            axes.set_title(f"{title}: {rms:.3g} arcsec RMS", loc="left", fontsize=9.5)
        lower.set(xlabel="indicated angle / °", xlim=(-4, 364))
        lower.set_xticks(range(0, 361, 60))
        for label, colour in legend:
            upper.scatter([], [], s=14, color=colour, label=label)
        if legend:
            upper.legend(
                ncols=min(len(legend), 5), loc="lower right", bbox_to_anchor=(1.0, 1.12), handletextpad=0.1
            )

    return _svg(draw, height_inch=4.4, margins=_Margins(top=0.42))


def _colours(curves: Curves, *, by_direction: bool) -> tuple[list[str] | str, list[tuple[str, str]]]:
    if by_direction and curves.direction is not None:
        forwards = curves.direction > 0
        colours = np.where(forwards, AFTER, BEFORE).tolist()
        return colours, [("approached upwards", AFTER), ("downwards", BEFORE)]
    if curves.temperature_c is None or not np.isfinite(curves.temperature_c).any():
        return ACCENT, []
    lowest, highest = float(np.nanmin(curves.temperature_c)), float(np.nanmax(curves.temperature_c))
    if highest - lowest < 1.0:
        return ACCENT, []
    shades = temperature_colours(64)
    place = np.nan_to_num((curves.temperature_c - lowest) / (highest - lowest), nan=0.5)
    colours = [shades[round(63 * each)] for each in place.tolist()]
    middle = 0.5 * (lowest + highest)
    return colours, [
        (f"{lowest:.0f} °C", shades[0]),
        (f"{middle:.0f} °C", shades[32]),
        (f"{highest:.0f} °C", shades[63]),
    ]


def by_run(curves: Curves, *, floor_arcsec: float | None) -> bytes:
    """RMS of each run's residuals, without and with the causes."""
    runs, group = np.unique(curves.run, return_inverse=True)
    counts = np.bincount(group)

    def rms(values: Floats) -> Floats:
        return np.sqrt(np.bincount(group, weights=values**2) / counts)

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        places = np.arange(1, runs.size + 1)
        axes.plot(places, rms(curves.recalibrated_arcsec), "o", markersize=4, color=BEFORE, label="before")
        axes.plot(places, rms(curves.explained_arcsec), "s", markersize=3.5, color=AFTER, label="after")
        if floor_arcsec is not None:
            axes.axhline(floor_arcsec, color=INK, linewidth=0.9, linestyle="--", label="noise floor")
        axes.set(xlabel="run, in the order of the campaign", ylabel="RMS / arcsec")
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return _svg(draw, height_inch=2.6, margins=_Margins())


def waterfall(steps: Sequence[Step], *, ceiling: float | None) -> bytes:
    """What each cause closes of the structural gap, one after the other, with 95 % intervals."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        before = 0.0
        names = [*(effect_words(step.effect) for step in steps), "left"]
        for place, step in enumerate(steps):
            axes.barh(place, step.closure - before, left=before, color=AFTER, height=0.62)
            if step.interval is not None:
                low, high = step.interval
                spread = [[max(step.closure - low, 0.0)], [max(high - step.closure, 0.0)]]
                axes.errorbar(step.closure, place, xerr=spread, color=INK, capsize=3, linewidth=1.0)
            before = step.closure
        axes.barh(len(steps), 1.0 - before, left=before, color=FAINT, height=0.62)
        axes.axvline(1.0, color=INK, linewidth=0.7)
        if ceiling is not None:
            axes.axvline(ceiling, color=BEFORE, linewidth=1.0, linestyle="--", label="the most any fit closes")
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("part of the structural gap that is closed")
        axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")

    return _svg(draw, height_inch=1.3 + 0.4 * (len(steps) + 1))


def heat_map(places: Sequence[Place]) -> bytes | None:
    """Orders against what they follow, shaded by share of the structure; significant cells are framed."""
    table = _table(places)
    if not table.rows or not table.columns:
        return None

    shares = np.full((len(table.rows), len(table.columns)), np.nan)
    for (row, column), place in table.cells.items():
        if place.p_value is not None:
            shares[table.rows.index(row), table.columns.index(column)] = place.share

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.grid(visible=False)
        axes.pcolormesh(shares, cmap=SHADES, vmin=0.0, vmax=1.0, edgecolors="#fffdf8", linewidth=2.0)
        for (row, column), place in table.cells.items():
            _draw_cell(axes, table.columns.index(column), table.rows.index(row), place)
        axes.set(xlim=(0, len(table.columns)), ylim=(len(table.rows), 0))
        axes.set_xticks(
            [place + 0.5 for place in range(len(table.columns))], table.columns, rotation=40, ha="left"
        )
        axes.xaxis.tick_top()
        axes.set_yticks([place + 0.5 for place in range(len(table.rows))], table.rows)
        axes.tick_params(length=0)
        axes.set_ylabel("order, times a turn")
        for spine in axes.spines.values():
            spine.set_visible(False)

    return _svg(draw, height_inch=1.5 + 0.27 * len(table.rows))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    rows: list[str]
    columns: list[str]
    cells: dict[tuple[str, str], Place]


def _table(places: Sequence[Place]) -> _Table:
    """The most telling rows and columns of the map, in the order of the lattice."""
    cells: dict[tuple[str, str], Place] = {}
    for place in sorted(places, key=lambda each: (each.significant, each.share)):
        cells[place.cell.order, condition_words(place.cell)] = place

    def best(at: int, most: int) -> set[str]:
        weight: dict[str, tuple[bool, float]] = {}
        for key, place in cells.items():
            weight[key[at]] = max(weight.get(key[at], (False, 0.0)), (place.significant, place.share))
        return set(sorted(weight, key=lambda each: weight[each], reverse=True)[:most])

    rows, columns = best(0, MOST_ROWS), best(1, MOST_COLUMNS)
    return _Table(
        rows=sorted(rows, key=_order_rank),
        columns=sorted(columns, key=_column_rank),
        cells={key: place for key, place in cells.items() if key[0] in rows and key[1] in columns},
    )


def _column_rank(column: str) -> tuple[int, int, str]:
    first = column.split(TIMES)[0]
    known = [each for each, word in enumerate(FOLLOWED) if first.startswith(word)]
    return (known[0] if known else len(FOLLOWED), column.count(TIMES), column)


def _order_rank(order: str) -> tuple[int, int, str]:
    return (0, int(order), "") if order.isdigit() else (1, len(order), order)


def _draw_cell(axes: Axes, x: int, y: int, place: Place) -> None:
    if place.p_value is None:
        frame = Rectangle(
            (x + 0.1, y + 0.1), 0.8, 0.8, facecolor="none", edgecolor=FAINT, hatch="////", linewidth=0
        )
        axes.add_patch(frame)
    explains = place.significant and place.share >= SMALLEST_PLACE
    if explains:
        axes.add_patch(
            Rectangle((x + 0.05, y + 0.06), 0.9, 0.88, facecolor="none", edgecolor=BEFORE, linewidth=2.0)
        )
    if explains or (place.p_value is not None and place.share >= SHOWN_SHARE):
        colour = "white" if place.share > LIGHT_TEXT_FROM else INK
        text = percent(place.share).replace("less than ", "<").replace("more than ", ">").replace(" %", "")
        axes.text(x + 0.5, y + 0.53, text, ha="center", va="center", fontsize=7.5, color=colour)
