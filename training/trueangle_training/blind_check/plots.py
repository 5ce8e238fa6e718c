"""The check's pictures as SVG."""

import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from trueangle_training.report.plots import ACCENT, FAINT, INK, SIZE_INCH, STYLE

Json = dict[str, Any]

SHADES = LinearSegmentedColormap.from_list("share", ["#fffdf8", "#9dbbd6", ACCENT])
WARM = "#b3541e"
LIGHT_TEXT_FROM = 0.55
CELL_INCH = 0.27
DASHES = {"paper": "-", "rich": "--"}
LOOKS = {"told": (ACCENT, "o", "named rightly"), "caught": (WARM, "s", "unknown caught")}


def _svg(draw: Callable[[Axes], None], *, width_inch: float = SIZE_INCH[0], height_inch: float = 3.3) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_inch, height_inch), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.add_subplot())
        data = io.BytesIO()
        # Without date and version the same numbers give the same bytes.
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None})
    return data.getvalue()


def reliability(rows: Sequence[Json]) -> bytes:
    """What was right over what was stated, with exact intervals; the area of a point is its cases."""

    def draw(axes: Axes) -> None:
        axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1.2, zorder=1)
        most = max(row["cases"] for row in rows)
        for row in rows:
            low, high = row["interval"]
            axes.plot([row["stated"]] * 2, [low, high], color=ACCENT, linewidth=1.0, zorder=2)
            size = 12.0 + 90.0 * row["cases"] / most
            axes.scatter([row["stated"]], [row["right"]], s=size, color=ACCENT, zorder=3)
            axes.annotate(
                str(row["cases"]), (row["stated"], row["right"]), (5, -9), textcoords="offset points", fontsize=7
            )
        axes.set(xlim=(0, 1.03), ylim=(0, 1.03), xlabel="stated probability of the class", ylabel="share right")

    return _svg(draw)


def detection(by_plan: Mapping[str, Sequence[Json]]) -> bytes:
    """Shares over the effect-to-noise ratio, one line a plan."""

    def draw(axes: Axes) -> None:
        ticks: set[float] = set()
        for plan, rows in by_plan.items():
            for key, (colour, marker, words) in LOOKS.items():
                here = [row for row in rows if key in row]
                if not here:
                    continue
                ratios = [row["enr"] for row in here]
                ticks |= set(ratios)
                shares = [row[key]["hits"] / row[key]["cases"] for row in here]
                axes.plot(
                    ratios,
                    shares,
                    DASHES[plan],
                    color=colour,
                    marker=marker,
                    markersize=4,
                    label=f"{words}, {plan}",
                )
                for ratio, row in zip(ratios, here, strict=True):
                    axes.plot([ratio] * 2, row[key]["interval"], color=colour, linewidth=0.8, alpha=0.6)
        axes.set_xscale("log")
        axes.set_xticks(sorted(ticks), [f"{tick:g}" for tick in sorted(ticks)])
        axes.minorticks_off()
        axes.set(ylim=(0, 1.03), xlabel="effect-to-noise ratio", ylabel="share of cases")
        axes.legend(loc="lower right")

    return _svg(draw)


def closure(points: Sequence[Json]) -> bytes:
    """Stated closure over true closure, strong effects dark."""

    def draw(axes: Axes) -> None:
        true = np.array([point["true"] for point in points])
        said = np.array([point["stated"] for point in points])
        strong = np.array([point["enr"] >= 1 for point in points], dtype=np.bool_)
        low = float(np.clip(min(true.min(), said.min()), -0.5, 0.8)) - 0.03
        axes.plot([low, 1], [low, 1], color=FAINT, linewidth=1.2)
        for chosen, colour, words in ((~strong, "#9dbbd6", "ENR below 1"), (strong, ACCENT, "ENR from 1")):
            if chosen.any():
                axes.plot(
                    true[chosen].clip(low), said[chosen].clip(low), ".", color=colour, markersize=5, label=words
                )
        axes.set(xlim=(low, 1.02), ylim=(low, 1.02), xlabel="true closure", ylabel="stated closure")
        axes.legend(loc="upper left")

    return _svg(draw)


def confusion(table: Json) -> bytes:
    """Counts, each row shaded by its own share."""
    counts = np.array(table["counts"], dtype=np.float64)
    shares = counts / counts.sum(axis=1, keepdims=True)

    def draw(axes: Axes) -> None:
        axes.grid(visible=False)
        axes.imshow(shares, cmap=SHADES, vmin=0.0, vmax=1.0, aspect="auto")
        for y, x in np.argwhere(counts > 0):
            colour = "white" if shares[y, x] > LIGHT_TEXT_FROM else INK
            axes.text(x, y, f"{counts[y, x]:.0f}", ha="center", va="center", fontsize=7, color=colour)
        axes.set_xticks(range(len(table["answers"])), [_words(name) for name in table["answers"]], rotation=90)
        axes.set_yticks(range(len(table["truths"])), [_words(name) for name in table["truths"]])
        axes.set_xticks(np.arange(counts.shape[1] + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(counts.shape[0] + 1) - 0.5, minor=True)
        axes.grid(which="minor", color=FAINT, linewidth=0.4)
        axes.tick_params(which="both", length=0, labelsize=8)
        axes.xaxis.tick_top()

    width = 2.0 + CELL_INCH * counts.shape[1] * 1.15
    return _svg(draw, width_inch=width, height_inch=1.9 + CELL_INCH * counts.shape[0])


def _words(name: str) -> str:
    return name.replace("_", " ")
