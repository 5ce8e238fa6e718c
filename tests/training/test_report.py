"""The calibration report: figures against closed forms, warnings where a fault is planted and only there."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from tests.fakes.report_inputs import (
    NOISE_ARCSEC,
    SLOPE_ARCSEC_PER_C,
    TEMPERATURES_C,
    KnownModel,
    made_campaign,
    made_inputs,
)

from trueangle.contract.joint import TemperatureSensor
from trueangle.contract.metadata import (
    FitErrors,
    ReferenceRecord,
)
from trueangle_training import report_command
from trueangle_training.documents import load_joint
from trueangle_training.report.budget import uncertainty_budget
from trueangle_training.report.cautions import Caution, cautions
from trueangle_training.report.harmonics import harmonics_by_temperature
from trueangle_training.report.inputs import ReportInputs, report_readings
from trueangle_training.report.plots import contour_label_places
from trueangle_training.report.residuals import coverage, drifted_runs, outliers, residuals
from trueangle_training.report.writing import report_page

EXAMPLES = Path(report_command.__file__).parent / "examples"


def listed(inputs: ReportInputs) -> tuple[Caution, ...]:
    report = report_readings(inputs)
    found = residuals(report)
    return cautions(
        inputs,
        report,
        found,
        uncertainty_budget(inputs, report, found),
        far_off=outliers(report, found),
        drifted=drifted_runs(report, found),
        covered=coverage(report, found, NOISE_ARCSEC),
    )


def titles(inputs: ReportInputs) -> set[str]:
    return {caution.title for caution in listed(inputs)}


def test_residuals_are_the_noise_about_the_true_model() -> None:
    found = residuals(report_readings(made_inputs()))
    # 345 readings less 15 zeros: the standard deviation is known to 1 / sqrt(2 * 330) = 4 %.
    assert found.rms_arcsec == pytest.approx(NOISE_ARCSEC, rel=0.12)
    assert found.temperature_c.tolist() == list(TEMPERATURES_C)


def test_harmonics_and_their_uncertainty_are_those_of_the_closed_form() -> None:
    report = report_readings(made_inputs())
    entries = harmonics_by_temperature(report, residuals(report))
    assert [entry.temperature_c for entry in entries] == list(TEMPERATURES_C)
    for entry in entries:
        first = entry.orders[0]
        sine = SLOPE_ARCSEC_PER_C * (entry.temperature_c - 20.0)
        # sqrt(2 / 69) of the noise for equal faces.
        assert first.amplitude_uncertainty_arcsec == pytest.approx(NOISE_ARCSEC * (2 / 69) ** 0.5, rel=0.13)
        assert first.amplitude_arcsec == pytest.approx(np.hypot(50.0, sine), abs=0.4)
        assert (first.phase_deg + 180) % 360 - 180 == pytest.approx(np.degrees(np.arctan2(sine, 50.0)), abs=0.5)
        assert first.phase_uncertainty_deg is not None
        assert np.radians(first.phase_uncertainty_deg) * first.amplitude_arcsec == pytest.approx(
            first.amplitude_uncertainty_arcsec, rel=1e-6
        )
    noise_only = [h for entry in entries for h in entry.orders[2:]]
    assert sum(h.phase_uncertainty_deg is None for h in noise_only) > len(noise_only) / 2


def test_budget_takes_reference_and_sensor_out_of_the_served_uncertainty_and_adds_up() -> None:
    joint = load_joint(EXAMPLES / "joint.yaml")
    joint = replace(joint, temperature_sensor=TemperatureSensor(standard_uncertainty_c=0.5))
    inputs = made_inputs(joint=joint)
    report = report_readings(inputs)
    budget = uncertainty_budget(inputs, report, residuals(report))
    by_name = {line.name: line.uncertainty_arcsec for line in budget.contributions}
    # dE/dT = 0.3 sin θ, RMS 0.3 / sqrt(2); times 0.5 K.
    sensor = SLOPE_ARCSEC_PER_C / 2**0.5 * 0.5
    assert by_name["Temperature sensor"] == pytest.approx(sensor, rel=1e-6)
    assert by_name["Reference angle"] == 0.125
    assert by_name["Model"] == pytest.approx((0.3**2 - 0.125**2 - sensor**2) ** 0.5, rel=1e-6)
    assert budget.expanded_arcsec == pytest.approx(0.6, rel=1e-9)
    resolution = next(line for line in budget.reading if line.name == "Resolution")
    assert resolution.uncertainty_arcsec == pytest.approx(1_296_000 / 3_276_800 / 12**0.5)
    assert not resolution.counted


@dataclass(frozen=True, slots=True, kw_only=True)
class UnevenModel(KnownModel):
    """Its uncertainty is four times as large half-way round as at 0."""

    def uncertainty_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
        return 0.5 - 0.3 * np.cos(np.radians(angle_deg)) + 0.0 * temperature_c


def test_the_first_page_headlines_the_largest_uncertainty_and_labels_the_rms() -> None:
    inputs = made_inputs(model=UnevenModel())
    report = report_readings(inputs)
    budget = uncertainty_budget(inputs, report, residuals(report))
    # RMS of 0.5 - 0.3 cos: sqrt(0.25 + 0.045); its largest is 0.8, reached half a degree off 180 at the latest.
    assert budget.expanded_arcsec == pytest.approx(2 * 0.295**0.5, rel=1e-4)
    assert budget.largest_expanded_arcsec == pytest.approx(1.6, rel=1e-4)
    scatter = budget.combined_reading_arcsec**2 - budget.combined_arcsec**2
    assert budget.largest_expanded_reading_arcsec == pytest.approx(2 * (0.64 + scatter) ** 0.5, rel=1e-4)
    cover = " ".join(report_page(inputs).split("</section>")[0].split())
    assert "1.60″ <small>at most</small>" in cover
    assert "1.09″ RMS over them" in cover
    without = " ".join(report_page(made_inputs(model=KnownModel(u_arcsec=None))).split("</section>")[0].split())
    assert "″ <small>RMS</small>" in without[without.index("Expanded uncertainty") :]


def test_a_model_that_was_not_judged_at_left_out_temperatures_says_so_on_the_first_page() -> None:
    inputs = made_inputs()
    unjudged = replace(inputs, metadata=replace(inputs.metadata, errors=FitErrors()))
    assert "Not judged at left-out temperatures" in titles(unjudged)
    assert "not judged at left-out temperatures" in report_page(unjudged).split("</section>")[0]
    assert "not judged" not in report_page(inputs)


def test_contour_labels_keep_off_the_border_and_each_other() -> None:
    angles, temperatures = np.linspace(0.0, 360.0, 50), np.linspace(10.0, 40.0, 20)
    level = np.linspace(0.0, 360.0, 200)
    crossing = [np.column_stack([level, np.full(200, at_c)]) for at_c in (20.0, 21.0, 30.0)]
    at_the_edge = np.column_stack([np.full(20, 358.0), temperatures])
    short = np.array([[100.0, 35.0], [110.0, 35.0]])
    places = contour_label_places([*crossing, at_the_edge, short], angles, temperatures)
    assert [number for number, _, _ in places] == [0, 1, 2]
    assert all(0.07 * 360 < angle < 0.93 * 360 for _, angle, _ in places)
    scaled = [np.array([angle / 360.0, (at_c - 10.0) / 30.0]) for _, angle, at_c in places]
    apart = [np.hypot(*(one - other)) for k, one in enumerate(scaled) for other in scaled[:k]]
    assert min(apart) > 0.13


def test_a_model_without_uncertainty_has_its_held_out_error_or_the_scatter_in_its_place() -> None:
    inputs = made_inputs(model=KnownModel(u_arcsec=None))
    held_out = replace(inputs.metadata, errors=FitErrors(held_out_rmse_arcsec=4.0))
    report = report_readings(inputs)
    found = residuals(report)
    worse = uncertainty_budget(replace(inputs, metadata=held_out), report, found)
    assert worse.combined_arcsec == pytest.approx(np.hypot(4.0, 0.125))
    inputs = replace(inputs, metadata=replace(inputs.metadata, errors=FitErrors()))
    budget = uncertainty_budget(inputs, report, found)
    assert budget.combined_arcsec == pytest.approx(np.hypot(found.rms_arcsec, 0.125))
    assert "No uncertainty from this method" in titles(inputs)


@pytest.mark.parametrize("seed", range(5))
def test_a_sound_campaign_gets_only_what_holds_for_every_plain_plan(seed: int) -> None:
    # The limits leave about one false alarm in a hundred such campaigns.
    assert titles(made_inputs(made_campaign(seed))) == {
        "Harmonics above order 11 are not seen",
        "The datum's own drift is not seen",
    }


def test_an_outlier_is_named_by_its_line() -> None:
    campaign = made_campaign()
    error_arcsec = campaign.error_arcsec.copy()
    error_arcsec[100] += 8.0
    (found,) = [
        c for c in listed(made_inputs(replace(campaign, error_arcsec=error_arcsec))) if "far from" in c.title
    ]
    assert "line 102 (125.2°, 15.0 °C): +" in found.text
    assert found.warning


def test_a_run_whose_eccentricity_differs_is_named() -> None:
    campaign = made_campaign()
    moved = 1.5 * np.cos(np.radians(campaign.angle_deg)) * (campaign.run == 5)
    changed = replace(campaign, error_arcsec=campaign.error_arcsec + moved)
    (found,) = [c for c in listed(made_inputs(changed)) if c.title == "Repeats differ from each other"]
    assert "run 5 at 15 °C" in found.text


def test_a_model_that_fits_badly_is_told_and_hides_neither_outlier_nor_drift() -> None:
    campaign = made_campaign()
    rad = np.radians(campaign.angle_deg)
    error_arcsec = campaign.error_arcsec + 3.0 * np.cos(5 * rad) + 1.5 * np.cos(rad) * (campaign.run == 5)
    error_arcsec[100] += 8.0
    changed = made_inputs(replace(campaign, error_arcsec=error_arcsec))
    assert {
        "The model does not follow the readings",
        "Repeats differ from each other",
        "1 reading far from all others",
    } <= titles(changed)


def test_a_zero_of_a_run_is_no_drift() -> None:
    campaign = made_campaign()
    changed = replace(campaign, error_arcsec=campaign.error_arcsec + 9.0 * (campaign.run == 5))
    assert "Repeats differ from each other" not in titles(made_inputs(changed))


def test_what_is_missing_is_said() -> None:
    inputs = made_inputs()
    metadata = replace(
        inputs.metadata,
        reference=ReferenceRecord(kind="not stated"),
        encoder=None,
        calibration=replace(inputs.metadata.calibration, due="2025-05-31"),
    )
    seen = titles(replace(inputs, metadata=metadata))
    assert {"Reference uncertainty not stated", "No serial number", "Past due"} <= seen
    few = made_campaign()
    keep = few.temperature_c is not None and few.temperature_c < 18
    columns = {
        name: getattr(few, name)[keep] for name in ("angle_deg", "error_arcsec", "run", "zero_group", "row")
    }
    assert few.temperature_c is not None
    assert "Only 2 temperatures" in titles(
        made_inputs(replace(few, **columns, temperature_c=few.temperature_c[keep]))
    )
    shared = replace(made_campaign(), zero_group=np.ones(345, dtype=np.int64), sha256="c" * 64)
    assert {"The datum's own drift", "Other readings than those of the training"} <= titles(made_inputs(shared))


def test_runs_with_one_zero_show_the_drift_of_the_datum() -> None:
    campaign = made_campaign()
    assert campaign.temperature_c is not None
    drifting = campaign.error_arcsec + 2.0 * (campaign.temperature_c == 30.0)
    shared = replace(campaign, zero_group=np.ones(345, dtype=np.int64), error_arcsec=drifting)
    (found,) = [c for c in listed(made_inputs(shared)) if c.title == "The datum's own drift"]
    value = float(found.text.split("″ at 30 °C")[0].split(" ")[-1])
    # Means of 69 readings of 0.5": 0.09" between two of them.
    assert value == pytest.approx(2.0, abs=0.3)


def test_too_small_an_uncertainty_is_told() -> None:
    inputs = made_inputs(model=KnownModel(u_arcsec=0.01))
    report = report_readings(inputs)
    found = residuals(report)
    # Half the residuals lie within 0.67 sigma: 2 x 0.17 / 0.5.
    assert coverage(report, found, 0.17) == pytest.approx(0.5, abs=0.1)
