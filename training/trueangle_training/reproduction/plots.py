"""Figures 7 to 10 of the paper as PNG images."""

import io
from collections.abc import Callable

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from trueangle_training.reproduction.experiment import NoiseSeedResult
from trueangle_training.reproduction.nominal_campaign import NominalCampaign
from trueangle_training.reproduction.summary import ExperimentSummary

SIZE_INCH = (6.4, 4.0)
DOTS_PER_INCH = 120


def figure_images(
    campaign: NominalCampaign, first: NoiseSeedResult, summary: ExperimentSummary
) -> dict[str, bytes]:
    """File name to image; Figs. 7, 9 and 10 show the first noise seed, Fig. 8 all."""
    residuals = f"first noise seed ({first.seed}), in-sample"
    return {
        "figure-7.png": _image(lambda axes: _figure_7(axes, campaign, first)),
        "figure-8.png": _image(lambda axes: _figure_8(axes, summary)),
        "figure-9.png": _image(
            lambda axes: _residuals(axes, first.network_residuals, f"FE-GABPNN, one trial, {residuals}")
        ),
        "figure-10.png": _image(
            lambda axes: _residuals(axes, first.polynomial_residuals, f"2-D polynomial, {residuals}")
        ),
    }


def _image(draw: Callable[[Axes], None]) -> bytes:
    figure = Figure(figsize=SIZE_INCH, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure.add_subplot())
    data = io.BytesIO()
    # Without the library's version and date the same numbers give the same bytes.
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()


def _figure_7(axes: Axes, campaign: NominalCampaign, first: NoiseSeedResult) -> None:
    for temperature_c, mean_error in zip(campaign.temperature_c, first.mean_error, strict=True):
        axes.plot(campaign.angle_deg, mean_error, marker=".", linewidth=0.8, label=f"{temperature_c:g} °C")
    axes.set(xlabel="angle / deg", ylabel="mean error / arcsec", title="Simulated: error before compensation")
    axes.legend(fontsize="small", ncols=2)


def _figure_8(axes: Axes, summary: ExperimentSummary) -> None:
    nodes = [nodes for nodes, _ in summary.figure_8]
    values = [mean.value for _, mean in summary.figure_8]
    errors = [mean.standard_error or 0.0 for _, mean in summary.figure_8]
    axes.errorbar(nodes, values, yerr=errors, marker="o", capsize=3)
    axes.set(xlabel="hidden nodes", ylabel="in-sample RMSE / arcsec", title="Simulated: RMSE over hidden nodes")


def _residuals(axes: Axes, residuals: tuple[float, ...], title: str) -> None:
    axes.plot(residuals, marker=".", linestyle="none", markersize=3)
    axes.set(xlabel="reading", ylabel="residual / arcsec", title=title)
