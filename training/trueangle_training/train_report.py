"""What `trueangle train` tells the user: every figure with what it does and does not mean."""

from collections.abc import Iterator

import numpy as np

from trueangle.contract.metadata import ModelMetadata
from trueangle_training.dataset import TrainingSet, centred_rms
from trueangle_training.evaluation.baselines import BaselineScore
from trueangle_training.evaluation.datum_drift import shows_datum_drift
from trueangle_training.evaluation.held_out import HeldOut
from trueangle_training.evaluation.reading_noise import held_out_caution, reading_noise
from trueangle_training.methods import Fit
from trueangle_training.methods.choice import Choice
from trueangle_training.uncertainty import UncertaintyBudget, total_uncertainty_arcsec

HELD_OUT_NOTE = "(each temperature in turn was not trained on; runs centred, noise of the readings included)"
IN_SAMPLE_NOTE = "(the readings it was trained on: says little about other angles and temperatures)"
SERVED_NOTE = "(the same readings as they would be served: each run's first reading adds its noise to the run)"
DATUM_UNSEEN = "a drift that is the same at all angles: runs zeroed one by one (Eq. 11) cannot show it"
DATUM_SHOWN = (
    "by runs of different temperatures that share a zero: see the report; the correction does not contain it, it "
    "counts from the datum at the same temperature"
)
GRID_ANGLES, GRID_TEMPERATURES = 360, 13


def report_lines(
    metadata: ModelMetadata,
    data: TrainingSet,
    fit: Fit,
    held_out: HeldOut | None,
    baselines: tuple[BaselineScore, ...],
    budget: UncertaintyBudget,
    *,
    source: str,
) -> Iterator[str]:
    """Lines of name and text."""
    readings = data.readings
    angle, temperature = metadata.valid_angle_deg, metadata.valid_temperature_c
    left = readings.error_arcsec - fit.model.error_arcsec(readings.angle_deg, readings.temperature_c)
    noise = reading_noise(readings)
    rows = [
        ("joint", metadata.joint),
        ("method", f"{metadata.method}, seed {metadata.seed}"),
        ("readings", f"{len(readings)} in {np.unique(readings.run).size} runs of {source}"),
        ("raw RMS", f"{data.raw_rms_arcsec:.2f} arcsec, from the datum at {metadata.datum_deg:.4g} deg"),
    ]
    if held_out is not None and held_out.rmse_arcsec is not None:
        largest = held_out.largest_arcsec or 0.0
        rows.append(
            ("left-out temp.", f"{held_out.rmse_arcsec:.2f} arcsec RMS, at most {largest:.2f} {HELD_OUT_NOTE}")
        )
        rows += [("not held out", text) for text in held_out.refused]
        far = held_out_caution(held_out.rmse_arcsec, None if noise is None else noise.sigma_arcsec)
        rows += [] if far is None else [("caution", far)]
    if noise is not None and noise.from_repeats:
        text = f"{noise.sigma_arcsec:.2f} arcsec of one reading: the floor of every figure of readings"
        rows.append(("repeatability", text))
    rows += [
        ("in-sample RMSE", f"{centred_rms(left, readings):.2f} arcsec {IN_SAMPLE_NOTE}"),
        *(("baseline", _baseline_text(each)) for each in baselines),
        ("from the datum", f"{float(np.sqrt(np.mean(left**2))):.2f} arcsec {SERVED_NOTE}"),
        ("uncertainty", _uncertainty_text(metadata, fit, budget)),
        ("datum's drift", DATUM_SHOWN) if shows_datum_drift(readings) else ("not visible", DATUM_UNSEEN),
        ("valid angles", f"{angle.minimum:g} .. {angle.maximum:g} deg"),
        ("valid temp.", f"{temperature.minimum:g} .. {temperature.maximum:g} degC"),
        # Warnings were told before the training.
        *(("note", note) for note in metadata.notes if note not in data.warnings),
    ]
    return (f"{name:<17}{text}" for name, text in rows)


def _baseline_text(score: BaselineScore) -> str:
    """What the figures of the model are to be held against."""
    left_out = "" if score.left_out_rmse_arcsec is None else f"left-out temp. {score.left_out_rmse_arcsec:.2f}, "
    return f"{score.name}: {left_out}in-sample {score.in_sample_rmse_arcsec:.2f} arcsec RMS"


def _uncertainty_text(metadata: ModelMetadata, fit: Fit, budget: UncertaintyBudget) -> str:
    """RMS and maximum over the valid ranges, and what is in it."""
    valid_c = metadata.valid_temperature_c
    angle_deg, temperature_c = (
        axis.ravel()
        for axis in np.meshgrid(
            np.arange(GRID_ANGLES, dtype=np.float64) + 0.5,
            np.linspace(valid_c.minimum, valid_c.maximum, GRID_TEMPERATURES),
        )
    )
    total = total_uncertainty_arcsec(fit.model, budget, angle_deg, temperature_c)
    reference = (
        f"reference {budget.reference_arcsec:.3g} arcsec"
        if budget.reference_arcsec
        else "reference not stated, not in it"
    )
    sensor = (
        f"sensor {budget.temperature_c:.3g} degC times dE/dT"
        if budget.temperature_c
        else "temperature sensor not stated, not in it"
    )
    if total is None:
        return f"none from this method; {reference}; no corrected angle is better than its reference"
    rms = float(np.sqrt(np.mean(total**2)))
    return f"{rms:.2f} arcsec RMS, at most {float(total.max()):.2f}, k = 1 from the datum ({reference}; {sensor})"


def choice_lines(choice: Choice) -> Iterator[str]:
    """What `auto` saw: left-out temperatures, intervals, cost."""
    yield "method           left-out temperature, RMSE in arcsec [95 %]    minus chosen [95 %]      s a training"
    for candidate in choice.candidates:
        rmse, over = candidate.rmse, candidate.over_best
        difference = "chosen" if over is None else f"{over.value:+.3f} [{over.low:+.3f}, {over.high:+.3f}]"
        figures = f"{rmse.value:.3f} [{rmse.low:.3f}, {rmse.high:.3f}]"
        yield f"{candidate.name:<17}{figures:<46}{difference:<25}{candidate.seconds:.2f}"
    for text in choice.refused:
        yield f"not suited       {text}"
