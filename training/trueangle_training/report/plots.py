"""The report's figures as SVG: drawn for a column as wide as a phone, so that their letters can be read there."""

import io
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from trueangle.contract.units import wrap_deg
from trueangle_training.hidden_node_sweep import HiddenNodeSweep
from trueangle_training.report.budget import Budget
from trueangle_training.report.harmonics import TemperatureHarmonics
from trueangle_training.report.inputs import ReportInputs, ReportReadings
from trueangle_training.report.residuals import Residuals

Floats = NDArray[np.float64]

SIZE_INCH = (4.6, 3.0)
INK, FAINT = "#2b2d2f", "#d9d5cb"
ACCENT = "#1f4e79"
STYLE: dict[Any, Any] = {
    "svg.fonttype": "path",
    "svg.hashsalt": "trueangle",
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}
MAP_ANGLES, MAP_TEMPERATURES = 241, 61
SHOWN_ORDERS = (1, 2, 3)
LABEL_BORDER, LABEL_APART, LABEL_LENGTH = 0.07, 0.13, 0.2
"""In parts of a map's sides: half a label, a label and some air, the shortest line that has one."""
MINUS = "\N{MINUS SIGN}"
LABEL_BOX: dict[str, Any] = {"boxstyle": "round,pad=0.15", "facecolor": "#fffdf8", "alpha": 0.8, "linewidth": 0}


def _svg(draw: Callable[[Axes], None], *, height_inch: float = SIZE_INCH[1]) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(SIZE_INCH[0], height_inch), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.add_subplot())
        data = io.BytesIO()
        # Without date and version the same numbers give the same bytes.
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None}, dpi=150)
    return data.getvalue()


def temperature_colours(count: int) -> list[str]:
    """From cold to warm, dark enough on paper and told apart by the colour-blind."""
    shades = mpl.colormaps["plasma"](np.linspace(0.02, 0.78, max(count, 1)))
    return [to_hex(shade) for shade in shades]


def error_curves(report: ReportReadings, found: Residuals, *, known: bool) -> bytes:
    """Mean measured error over angle, one line a temperature: Fig. 7 of Jia et al. 2020.

    `known`: whether the campaign has temperatures.
    """
    readings = report.readings
    colours = temperature_colours(found.temperature_c.size)

    def draw(axes: Axes) -> None:
        for group, temperature_c in enumerate(found.temperature_c.tolist()):
            angle_deg, mean = place_means(report, readings.error_arcsec, found.temperature_group == group)
            label = f"{temperature_c:.0f} °C" if known else "all readings"
            axes.plot(angle_deg, mean, marker=".", markersize=3, color=colours[group], label=label)
        _angle_axis(axes, "error / arcsec")
        axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.2, columnspacing=1.0)

    return _svg(draw, height_inch=3.3)


def place_means(report: ReportReadings, values: Floats, here: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Angles within 0.5 deg are one place: their means, rising."""
    angle_deg = wrap_deg(report.readings.angle_deg[here] + 0.5) - 0.5
    order = np.argsort(angle_deg)
    angle_deg, values = angle_deg[order], values[here][order]
    place = np.concatenate([[0], np.cumsum(np.diff(angle_deg) > 0.5)])
    counts = np.bincount(place)
    return np.bincount(place, weights=angle_deg) / counts, np.bincount(place, weights=values) / counts


def residual_points(report: ReportReadings, found: Residuals, budget: Budget) -> bytes:
    """Residuals over angle, coloured by temperature, with twice the standard uncertainty of a reading."""
    colours = np.array(temperature_colours(found.temperature_c.size))
    limit = budget.expanded_reading_arcsec

    def draw(axes: Axes) -> None:
        axes.axhspan(-limit, limit, color=FAINT, alpha=0.5, linewidth=0, label="U (k = 2) of one reading, RMS")
        axes.scatter(
            wrap_deg(report.readings.angle_deg),
            found.centred_arcsec,
            s=7,
            linewidths=0,
            c=colours[found.temperature_group].tolist(),
        )
        axes.axhline(0.0, color=INK, linewidth=0.6)
        _angle_axis(axes, "residual / arcsec")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return _svg(draw)


def residuals_by_temperature(report: ReportReadings, found: Residuals) -> bytes:
    """RMS of the residuals of each run over its temperature."""
    readings = report.readings
    runs = np.unique(readings.run)
    rms = [float(np.sqrt(np.mean(found.centred_arcsec[readings.run == run] ** 2))) for run in runs]
    at_c = [float(readings.temperature_c[readings.run == run].mean()) for run in runs]

    def draw(axes: Axes) -> None:
        axes.axhline(found.rms_arcsec, color=FAINT, linewidth=2, label="all readings")
        axes.plot(at_c, rms, linestyle="none", marker="o", markersize=4, color=ACCENT, label="one run")
        axes.set(xlabel="temperature / °C", ylabel="residual RMS / arcsec")
        axes.set_ylim(bottom=0.0)
        axes.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return _svg(draw)


def error_map(inputs: ReportInputs, *, from_middle: bool) -> bytes:
    """The model's error over angle and temperature; `from_middle`: less that at the middle temperature."""
    valid_deg, valid_c = inputs.metadata.valid_angle_deg, inputs.metadata.valid_temperature_c
    angles = np.linspace(valid_deg.minimum, valid_deg.maximum, MAP_ANGLES)
    temperatures = np.linspace(valid_c.minimum, valid_c.maximum, MAP_TEMPERATURES)
    angle_deg, temperature_c = np.meshgrid(angles, temperatures)
    error = -inputs.model.correction_arcsec(angle_deg.ravel(), temperature_c.ravel()).reshape(angle_deg.shape)
    if from_middle:
        error = error - error[MAP_TEMPERATURES // 2]
    limit = float(np.abs(error).max()) or 1.0

    def draw(axes: Axes) -> None:
        axes.grid(visible=False)
        mesh = axes.pcolormesh(
            angles, temperatures, error, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="gouraud", rasterized=True
        )
        levels = [level for level in MaxNLocator(6).tick_values(-limit, limit) if abs(level) < limit]
        lines = axes.contour(angles, temperatures, error, levels=levels, colors=INK, linewidths=0.5)
        # matplotlib's own labels are cut at the border and unreadable where the map is dark.
        drawn = [(level, line) for level, of_level in zip(levels, lines.allsegs, strict=True) for line in of_level]
        for index, angle, at_c in contour_label_places([line for _, line in drawn], angles, temperatures):
            axes.text(
                angle,
                at_c,
                f"{drawn[index][0]:g}".replace("-", MINUS),
                fontsize=7.5,
                ha="center",
                va="center",
                bbox=LABEL_BOX,
            )
        _angle_axis(axes, "temperature / °C")
        axes.figure.colorbar(mesh, ax=axes, label="arcsec", pad=0.02, aspect=28)

    return _svg(draw)


def contour_label_places(
    lines: list[Floats], angles: Floats, temperatures: Floats
) -> list[tuple[int, float, float]]:
    """Number of the line, angle and temperature: near its middle, off the border and off other labels.

    `lines` [points, 2] each, angle and temperature; short lines and lines along the border get no label.
    """
    low = np.array([angles[0], temperatures[0]])
    span = np.array([angles[-1] - angles[0], temperatures[-1] - temperatures[0]])
    chosen: list[Floats] = []
    places: list[tuple[int, float, float]] = []
    for number, line in enumerate(lines):
        scaled = (line - low) / span
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(scaled, axis=0).T))])
        if along[-1] < LABEL_LENGTH:
            continue
        inside = np.flatnonzero(((scaled > LABEL_BORDER) & (scaled < 1.0 - LABEL_BORDER)).all(axis=1))
        for index in inside[np.argsort(np.abs(along[inside] - along[-1] / 2.0), kind="stable")]:
            if all(float(np.hypot(*(scaled[index] - other))) > LABEL_APART for other in chosen):
                chosen.append(scaled[index])
                places.append((number, float(line[index, 0]), float(line[index, 1])))
                break
    return places


def error_curve(inputs: ReportInputs) -> bytes:
    """The error of a model that ignores temperature."""
    valid_deg = inputs.metadata.valid_angle_deg
    angle_deg = np.linspace(valid_deg.minimum, valid_deg.maximum, 4 * MAP_ANGLES)
    error = -inputs.model.correction_arcsec(angle_deg, np.zeros_like(angle_deg))

    def draw(axes: Axes) -> None:
        axes.plot(angle_deg, error, color=ACCENT)
        _angle_axis(axes, "error / arcsec")

    return _svg(draw)


def uncertainty_map(inputs: ReportInputs) -> bytes | None:
    """Served standard uncertainty over angle, lowest, middle and highest temperature; None: none is served."""
    valid_deg, valid_c = inputs.metadata.valid_angle_deg, inputs.metadata.valid_temperature_c
    angle_deg = np.linspace(valid_deg.minimum, valid_deg.maximum, 2 * MAP_ANGLES)
    used = inputs.metadata.temperature_used
    temperatures = np.linspace(valid_c.minimum, valid_c.maximum, 3 if used else 1)
    curves = [inputs.model.uncertainty_arcsec(angle_deg, np.full_like(angle_deg, at_c)) for at_c in temperatures]

    def draw(axes: Axes) -> None:
        for curve, at_c, colour in zip(curves, temperatures, temperature_colours(len(curves)), strict=True):
            if curve is not None:
                axes.plot(angle_deg, 2.0 * curve, color=colour, linewidth=0.9, label=f"{at_c:.0f} °C")
        _angle_axis(axes, "U (k = 2) / arcsec")
        axes.set_ylim(bottom=0.0)
        if used:
            axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return None if curves[0] is None else _svg(draw)


def amplitudes(by_temperature: tuple[TemperatureHarmonics, ...]) -> bytes:
    """Amplitude of each order at each temperature, logarithmic, with twice its uncertainty."""
    colours = temperature_colours(len(by_temperature))

    def draw(axes: Axes) -> None:
        for place, (entry, colour) in enumerate(zip(by_temperature, colours, strict=True)):
            shift = (place - (len(by_temperature) - 1) / 2) * 0.09
            axes.errorbar(
                [each.order + shift for each in entry.orders],
                [each.amplitude_arcsec for each in entry.orders],
                yerr=[2.0 * each.amplitude_uncertainty_arcsec for each in entry.orders],
                linestyle="none",
                marker=".",
                markersize=4,
                linewidth=0.7,
                color=colour,
                label=f"{entry.temperature_c:.0f} °C",
            )
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.05)
        axes.set(xlabel="order of the harmonic", ylabel="amplitude / arcsec")
        axes.set_xticks([each.order for each in by_temperature[0].orders])
        if len(by_temperature) > 1:
            axes.legend(
                ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.0, columnspacing=1.0
            )

    return _svg(draw, height_inch=3.3)


def thermal_change(by_temperature: tuple[TemperatureHarmonics, ...]) -> bytes:
    """How far the vector of the first orders moves from its mean over the temperatures."""
    at_c = [entry.temperature_c for entry in by_temperature]

    def draw(axes: Axes) -> None:
        for order, marker, colour in zip(SHOWN_ORDERS, "osD", (ACCENT, "#b3541e", "#4d6b2c"), strict=True):
            each = [entry.orders[order - 1] for entry in by_temperature if len(entry.orders) >= order]
            if len(each) != len(at_c):
                continue
            for values, style, part in (
                (np.array([h.cosine_arcsec for h in each]), "-", "cos"),
                (np.array([h.sine_arcsec for h in each]), "--", "sin"),
            ):
                axes.errorbar(
                    at_c,
                    values - values.mean(),
                    yerr=[2.0 * h.amplitude_uncertainty_arcsec for h in each],
                    linestyle=style,
                    marker=marker,
                    markersize=3,
                    linewidth=0.9,
                    color=colour,
                    label=f"{order}, {part}",
                )
        axes.set(xlabel="temperature / °C", ylabel="change of coefficient / arcsec")
        axes.legend(
            ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), title="order, part", title_fontsize=8.0
        )

    return _svg(draw, height_inch=3.3)


def sweep_curve(sweep: HiddenNodeSweep, repeatability_arcsec: float | None) -> bytes:
    """RMSE at left-out temperatures over the number of hidden nodes: Fig. 8 of Jia et al. 2020, held out."""
    nodes = [point.hidden_nodes for point in sweep.points]

    def draw(axes: Axes) -> None:
        if repeatability_arcsec is not None:
            axes.axhline(repeatability_arcsec, color=FAINT, linewidth=2, label="repeatability of one reading")
        axes.errorbar(
            nodes,
            [point.rmse_arcsec for point in sweep.points],
            yerr=[2.0 * point.standard_error_arcsec for point in sweep.points],
            marker="o",
            markersize=4,
            capsize=3,
            color=ACCENT,
            label="left-out temperatures",
        )
        axes.set(xlabel="hidden nodes", ylabel="RMSE / arcsec")
        axes.set_xticks(nodes)
        axes.set_ylim(bottom=0.0)
        axes.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return _svg(draw)


def _angle_axis(axes: Axes, ylabel: str) -> None:
    axes.set(xlabel="indicated angle / °", ylabel=ylabel)
    if axes.get_xlim()[1] > 200:
        axes.set_xlim(-4, 364)
        axes.set_xticks(range(0, 361, 60))
