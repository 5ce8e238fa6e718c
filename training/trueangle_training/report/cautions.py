"""What the reader must know, in plain words: each caution has a title, what was seen, and what to do."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trueangle.contract.units import DEG_PER_TURN, wrap_deg
from trueangle_training.evaluation.datum_drift import shows_datum_drift
from trueangle_training.evaluation.held_out import HeldOutKind
from trueangle_training.evaluation.reading_noise import held_out_caution
from trueangle_training.methods import distinct_angle_count
from trueangle_training.report.budget import Budget
from trueangle_training.report.inputs import ReportInputs, ReportReadings
from trueangle_training.report.residuals import DriftedRun, Outlier, Residuals
from trueangle_training.temperature_places import lines_text, places_by_temperature, places_sentence
from trueangle_training.temperature_units import base_temperature_warnings

FEWEST_TEMPERATURES = 5
WIDEST_STEP_C = 10.0
ROWS_SHOWN = 12
LOWEST_COVERAGE = 0.90
HIGHEST_ORDER = 11
WORST_MISFIT = 1.3
"""Residual over the noise of repeats; a sound fit of some hundred readings is at 0.9 to 1.1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Caution:
    """One warning or note."""

    title: str
    text: str
    warning: bool = True
    """False: to be known of every such calibration, nothing is wrong."""


def cautions(
    inputs: ReportInputs,
    report: ReportReadings,
    found: Residuals,
    budget: Budget,
    *,
    far_off: tuple[Outlier, ...],
    drifted: tuple[DriftedRun, ...],
    covered: float | None,
) -> tuple[Caution, ...]:
    """Warnings first, then notes."""
    listed = [
        *_identity(inputs),
        *_missing_statements(inputs, budget),
        *_outliers(far_off),
        *_drift(drifted),
        *_misfit(found),
        *_coverage(covered),
        *_not_judged(inputs),
        *_temperatures(inputs, found),
        *_places(inputs, report),
        *_base_temperature(inputs, report),
        *_held_out(inputs, found),
        *_aliasing(inputs, report),
        *_ranges(inputs, report),
        *_datum(report, found),
    ]
    return tuple(sorted(listed, key=lambda caution: not caution.warning))


def _identity(inputs: ReportInputs) -> Iterator[Caution]:
    metadata = inputs.metadata
    if not inputs.of_training:
        yield Caution(
            title="Other readings than those of the training",
            text="The model was trained on another file. The residuals below are therefore an independent "
            "check, if the campaign is one of the same joint.",
            warning=False,
        )
    if metadata.encoder_settings.serial_number is None:
        yield Caution(
            title="No serial number",
            text="The model does not name its encoder's serial number, so nobody can tell it from another's. "
            "State encoder.settings.serial_number in JOINT.yaml and train again.",
        )
    due = metadata.calibration.due
    if due is None:
        yield Caution(
            title="No due date", text="Nothing says when to calibrate again (train --due).", warning=False
        )
    elif due < inputs.made_on.isoformat():
        yield Caution(title="Past due", text=f"The calibration was due on {due}.")


def _missing_statements(inputs: ReportInputs, budget: Budget) -> Iterator[Caution]:
    reference = inputs.metadata.reference.standard_uncertainty_arcsec
    if reference is None:
        yield Caution(
            title="Reference uncertainty not stated",
            text="No corrected angle is better than its reference. All figures here leave it out.",
        )
    if not budget.model_knows:
        yield Caution(
            title="No uncertainty from this method",
            text="The model file serves no uncertainty; the budget has its error at held-out data or readings. "
            "Choose linear or fe-gabpnn for an uncertainty that also holds between the readings.",
        )


def _outliers(far_off: tuple[Outlier, ...]) -> Iterator[Caution]:
    if not far_off:
        return
    lines = "; ".join(
        f"line {each.row} ({each.angle_deg:.1f}°, {each.temperature_c:.1f} °C): {each.residual_arcsec:+.2f}″"
        for each in far_off[:ROWS_SHOWN]
    )
    more = f"; … {len(far_off)} in all" if len(far_off) > ROWS_SHOWN else ""
    yield Caution(
        title=f"{len(far_off)} reading{'s' if len(far_off) > 1 else ''} far from all others",
        text=f"{lines}{more}. Look them up in the notes of the measurement; nothing was left out.",
    )


def _drift(drifted: tuple[DriftedRun, ...]) -> Iterator[Caution]:
    if drifted:
        runs = "; ".join(
            f"run {each.run} at {each.temperature_c:.0f} °C by {each.amplitude_arcsec:.2f}″" for each in drifted
        )
        yield Caution(
            title="Repeats differ from each other",
            text=f"Beyond the noise of the readings, in the first harmonic: {runs}. The polygon's clamp, the "
            "soak or the bearing may have moved between the runs.",
        )


def _misfit(found: Residuals) -> Iterator[Caution]:
    if found.noise_from_repeats and found.rms_arcsec > WORST_MISFIT * found.noise_arcsec:
        yield Caution(
            title="The model does not follow the readings",
            text=f"It leaves {found.rms_arcsec:.2f}″ RMS where repeats scatter by {found.noise_arcsec:.2f}″ "
            "only: part of the error at the measured places is still there. Compare methods (trueangle compare).",
        )


def _coverage(covered: float | None) -> Iterator[Caution]:
    if covered is not None and covered < LOWEST_COVERAGE:
        yield Caution(
            title="The served uncertainty is too small for these readings",
            text=f"Only {100 * covered:.1f} % of the residuals lie within twice the uncertainty; about 95 % "
            "should.",
        )


def _not_judged(inputs: ReportInputs) -> Iterator[Caution]:
    """Only where temperature matters: there is nothing else to leave out by."""
    metadata = inputs.metadata
    if metadata.temperature_used and metadata.errors.held_out_rmse_arcsec is None:
        yield Caution(
            title="Not judged at left-out temperatures",
            text="No figure here says how wrong the model is at temperatures that it was not trained on "
            "(train --held-out temperature, or trueangle compare).",
        )


def _temperatures(inputs: ReportInputs, found: Residuals) -> Iterator[Caution]:
    if not inputs.temperature_known or not inputs.metadata.temperature_used:
        yield Caution(
            title="No temperature",
            text="The correction does not follow temperature: it holds near the temperature of the calibration "
            "only.",
        )
        return
    count = found.temperature_c.size
    widest_c = float(np.max(np.diff(found.temperature_c), initial=0.0))
    if count < FEWEST_TEMPERATURES:
        yield Caution(
            title=f"Only {count} temperature{'s' if count > 1 else ''}",
            text="How the error bends between and beyond them is assumed, not seen. Five or more, the ends of "
            "the use among them, show a knee.",
        )
    elif widest_c > WIDEST_STEP_C:
        yield Caution(
            title="Wide step between temperatures",
            text=f"{widest_c:.0f} K between neighbours: a knee in between would not be seen.",
        )


def _places(inputs: ReportInputs, report: ReportReadings) -> Iterator[Caution]:
    if not inputs.temperature_known or not inputs.metadata.temperature_used:
        return
    partly = [
        each for each in places_by_temperature(report.readings, report.row) if each.missing or not each.whole
    ]
    if not partly:
        return
    listed = "; ".join(
        f"{each.temperature_c:.1f} °C ({lines_text(each.rows)}): {places_sentence(each).replace(' deg', '°')}"
        for each in partly[:ROWS_SHOWN]
    )
    more = f"; … {len(partly)} temperatures in all" if len(partly) > ROWS_SHOWN else ""
    yield Caution(
        title="Places of the turn missing at some temperatures",
        text=f"{listed}{more}. Measure them, or look whether the lines were lost.",
    )


def _base_temperature(inputs: ReportInputs, report: ReportReadings) -> Iterator[Caution]:
    if inputs.joint is None or not inputs.temperature_known:
        return
    run_mean_c = report.readings.run_mean_temperature_c()
    for text in base_temperature_warnings(
        run_mean_c, inputs.joint.base_temperature_c, source=inputs.campaign.source
    ):
        yield Caution(title="Far from the joint's base temperature", text=f"{text.replace('degC', '°C')}.")


def _held_out(inputs: ReportInputs, found: Residuals) -> Iterator[Caution]:
    errors = inputs.metadata.errors
    if errors.held_out_rmse_arcsec is None or errors.held_out_kind != HeldOutKind.TEMPERATURE.value:
        return
    text = held_out_caution(errors.held_out_rmse_arcsec, found.noise_arcsec or None)
    if text is not None:
        yield Caution(
            title="Far off at left-out temperatures",
            text=f"{text[0].upper()}{text[1:]}.".replace(" arcsec", "″").replace("degC", "°C"),
        )


def _aliasing(inputs: ReportInputs, report: ReportReadings) -> Iterator[Caution]:
    places = distinct_angle_count(report.readings.angle_deg)
    if places >= 2 * (2 * HIGHEST_ORDER + 1):
        return
    highest = (places - 1) // 2
    folded = places // 2 + 1
    faces = inputs.metadata.reference.faces
    on = f"{faces} faces" if faces == places else f"{places} places"
    yield Caution(
        title=f"Harmonics above order {highest} are not seen",
        text=f"On {on} of the turn order {folded} reads exactly like order {places - folded}, and so on: "
        "such an error is corrected as if it were the lower one, and is wrong between the faces. Repeats "
        "shifted by a third of the face pitch would show it (trueangle plan).",
    )


def _ranges(inputs: ReportInputs, report: ReportReadings) -> Iterator[Caution]:
    valid = inputs.metadata.valid_angle_deg
    if valid.maximum - valid.minimum < DEG_PER_TURN:
        yield Caution(
            title="Part of the turn only",
            text=f"Calibrated from {valid.minimum:.1f}° to {valid.maximum:.1f}°; the daemon flags other angles.",
        )
    if report.left_out:
        yield Caution(
            title="Readings without temperature", text=f"{report.left_out} readings are not shown.", warning=False
        )


def _datum(report: ReportReadings, found: Residuals) -> Iterator[Caution]:
    readings = report.readings
    datum = f"{wrap_deg(readings.datum_deg):.4g}°"
    if shows_datum_drift(readings):
        yield Caution(
            title="The datum's own drift",
            text=f"Errors are counted from {datum} at the same temperature. Runs share a zero here, so the "
            f"campaign shows how the datum itself moves: {_datum_drift(report, found)}. The correction does not "
            "contain it.",
            warning=False,
        )
        return
    yield Caution(
        title="The datum's own drift is not seen",
        text=f"Every run has a zero of its own (Eq. 11: its first face), so errors are counted from {datum} at "
        "the same temperature. A drift that is the same at all angles stays in the corrected angle; only a plan "
        "that keeps one zero over all temperatures shows it (trueangle plan --one-zero).",
        warning=False,
    )


def _datum_drift(report: ReportReadings, found: Residuals) -> str:
    """Mean of what is left at each temperature, from the first one: only the common zero makes them comparable."""
    counts = np.bincount(found.temperature_group)
    means = np.bincount(found.temperature_group, weights=report.left_arcsec) / counts
    return ", ".join(
        f"{mean - means[0]:+.2f}″ at {temperature_c:.0f} °C"
        for mean, temperature_c in zip(means[1:], found.temperature_c[1:], strict=True)
    )
