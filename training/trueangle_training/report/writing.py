"""The report put together: figures and tables into one page that needs nothing beside itself."""

import base64
import math
from dataclasses import dataclass

import numpy as np

from trueangle_training.evaluation.held_out import repeatability_arcsec
from trueangle_training.hidden_node_sweep import HiddenNodeSweep
from trueangle_training.html_page import Markup, page
from trueangle_training.report import plots
from trueangle_training.report.budget import Budget, uncertainty_budget
from trueangle_training.report.cautions import cautions
from trueangle_training.report.harmonics import TemperatureHarmonics, harmonics_by_temperature
from trueangle_training.report.inputs import ReportInputs, ReportReadings, report_readings
from trueangle_training.report.residuals import Residuals, coverage, drifted_runs, outliers, residuals

FEW_TEMPERATURES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure of the page."""

    address: Markup
    """A data address: the picture itself."""
    title: str
    caption: str
    words: str
    """For those who cannot see it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HarmonicRow:
    """One order over all temperatures."""

    order: int
    amplitude_arcsec: float
    """Of the mean vector."""
    uncertainty_arcsec: float
    """k = 1, of one temperature's amplitude."""
    phase_deg: float
    change_arcsec: float | None
    """Largest departure of the vector from its mean; None: one temperature."""
    change_matters: bool


def report_page(inputs: ReportInputs) -> str:
    """The page as HTML; the same inputs give the same text."""
    report = report_readings(inputs)
    found = residuals(report)
    budget = uncertainty_budget(inputs, report, found)
    by_temperature = harmonics_by_temperature(report, found)
    noise = repeatability_arcsec(report.readings)
    far_off, drifted = outliers(report, found), drifted_runs(report, found)
    covered = coverage(report, found, found.rms_arcsec if noise is None else noise)
    listed = cautions(inputs, report, found, budget, far_off=far_off, drifted=drifted, covered=covered)
    error = report.readings.error_arcsec
    return page(
        "report.html.j2",
        {
            "inputs": inputs,
            "metadata": inputs.metadata,
            "settings": inputs.metadata.encoder_settings.known(),
            "readings": len(report.readings),
            "runs": int(np.unique(report.readings.run).size),
            "temperatures_c": found.temperature_c.tolist() if inputs.temperature_known else [],
            "raw_low_arcsec": float(error.min()),
            "raw_high_arcsec": float(error.max()),
            "raw_rms_arcsec": float(np.sqrt(np.mean(error**2))),
            "residual_rms_arcsec": found.rms_arcsec,
            "residual_largest_arcsec": found.largest_arcsec,
            "repeatability_arcsec": noise,
            "covered": covered,
            "budget": budget,
            "cautions": listed,
            "pictures": _pictures(inputs, report, found, budget, by_temperature, noise),
            "harmonics": _harmonic_rows(by_temperature),
            "by_temperature": by_temperature,
            "comparison": inputs.comparison,
            "same_campaign": inputs.comparison is None
            or inputs.comparison.campaign_sha256 == inputs.campaign.sha256,
            "campaign_notes": (*inputs.campaign.notes, *inputs.metadata.notes),
        },
    )


def _picture(svg: bytes, title: str, caption: str, words: str) -> Picture:
    # The only value that is not escaped: letters of base 64.
    address = Markup("data:image/svg+xml;base64,") + base64.b64encode(svg).decode()
    return Picture(address=address, title=title, caption=caption, words=words)


def _pictures(
    inputs: ReportInputs,
    report: ReportReadings,
    found: Residuals,
    budget: Budget,
    by_temperature: tuple[TemperatureHarmonics, ...],
    noise_arcsec: float | None,
) -> dict[str, tuple[Picture, ...]]:
    return {
        "errors": _error_pictures(inputs, report, found, budget),
        "maps": _map_pictures(inputs),
        "harmonics": _harmonic_pictures(by_temperature),
        "sweep": () if inputs.sweep is None else (_sweep_picture(inputs.sweep, noise_arcsec),),
    }


def _sweep_picture(sweep: HiddenNodeSweep, noise_arcsec: float | None) -> Picture:
    left_out = ", ".join(label.replace("degC", "°C") for label in sweep.temperatures)
    return _picture(
        plots.sweep_curve(sweep, noise_arcsec),
        "Error by number of nodes",
        f"RMSE at temperatures that were left out of the training one by one ({left_out}), noise of the readings "
        "included; bars: twice the standard error over these temperatures. All points share the "
        f"readings, so the bars move together. Method {sweep.method}: {sweep.setting}.",
        "Left-out RMSE over hidden nodes: "
        + ", ".join(f"{point.hidden_nodes}: {point.rmse_arcsec:.2f}″" for point in sweep.points),
    )


def _error_pictures(
    inputs: ReportInputs, report: ReportReadings, found: Residuals, budget: Budget
) -> tuple[Picture, ...]:
    error = report.readings.error_arcsec
    pictures = [
        _picture(
            plots.error_curves(report, found, known=inputs.temperature_known),
            "Before correction",
            "Mean measured error at each place of the turn, one line a temperature.",
            f"Measured error over angle, from {error.min():.1f} to {error.max():.1f} arcsec.",
        ),
        _picture(
            plots.residual_points(report, found, budget),
            "After correction",
            "Every reading less the model, the zero of each run taken off; colours by temperature as before.",
            f"Residuals over angle, {found.rms_arcsec:.2f} arcsec RMS, at most {found.largest_arcsec:.2f}.",
        ),
    ]
    if inputs.temperature_known:
        pictures.append(
            _picture(
                plots.residuals_by_temperature(report, found),
                "Residuals by run",
                "Each point is the RMS of one run. A temperature that stands out is one that the model does not "
                "fit.",
                "RMS of the residuals of each run over its temperature.",
            )
        )
    return tuple(pictures)


def _map_pictures(inputs: ReportInputs) -> tuple[Picture, ...]:
    pictures: list[Picture] = []
    if not inputs.metadata.temperature_used:
        pictures.append(
            _picture(
                plots.error_curve(inputs),
                "Error of the encoder",
                "The model's error over angle: what the correction takes off. Temperature is not used.",
                "The modelled error over angle.",
            )
        )
    else:
        pictures.append(
            _picture(
                plots.error_map(inputs, from_middle=False),
                "Error of the encoder",
                "The model's error over angle and temperature: what the correction takes off.",
                "Map of the modelled error over angle and temperature.",
            )
        )
        pictures.append(
            _picture(
                plots.error_map(inputs, from_middle=True),
                "What temperature adds",
                "The same less the error at the middle temperature.",
                "Map of the change of the modelled error with temperature.",
            )
        )
    uncertainty = plots.uncertainty_map(inputs)
    if uncertainty is not None:
        pictures.append(
            _picture(
                uncertainty,
                "Expanded uncertainty",
                "U (k = 2) of the corrected angle as the model file serves it, from the datum, where it is 0.",
                "Served expanded uncertainty over angle.",
            )
        )
    return tuple(pictures)


def _harmonic_pictures(by_temperature: tuple[TemperatureHarmonics, ...]) -> tuple[Picture, ...]:
    if not by_temperature:
        return ()
    pictures = [
        _picture(
            plots.amplitudes(by_temperature),
            "Harmonics",
            "Amplitude of each order at each temperature; bars: twice the standard uncertainty.",
            "Amplitudes of the harmonics by temperature; the table gives the numbers.",
        )
    ]
    if len(by_temperature) >= FEW_TEMPERATURES:
        pictures.append(
            _picture(
                plots.thermal_change(by_temperature),
                "Their change with temperature",
                "Cosine and sine parts of the first orders, less their means; bars: twice the standard "
                "uncertainty.",
                "Change of the first harmonics with temperature.",
            )
        )
    return tuple(pictures)


def _harmonic_rows(by_temperature: tuple[TemperatureHarmonics, ...]) -> tuple[HarmonicRow, ...]:
    if not by_temperature:
        return ()
    rows: list[HarmonicRow] = []
    for place in range(min(len(entry.orders) for entry in by_temperature)):
        each = [entry.orders[place] for entry in by_temperature]
        vectors = np.array([complex(h.cosine_arcsec, h.sine_arcsec) for h in each])
        uncertainty = max(h.amplitude_uncertainty_arcsec for h in each)
        mean = complex(vectors.mean())
        change = float(np.abs(vectors - mean).max()) if len(each) > 1 else None
        # The largest of several noise vectors is beyond 3 u in few per cent of the orders.
        matters = change is not None and change > 3.0 * uncertainty
        rows.append(
            HarmonicRow(
                order=each[0].order,
                amplitude_arcsec=abs(mean),
                uncertainty_arcsec=uncertainty,
                phase_deg=math.degrees(math.atan2(mean.imag, mean.real)) % 360.0,
                change_arcsec=change,
                change_matters=matters,
            )
        )
    return tuple(rows)
