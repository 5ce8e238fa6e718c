"""The calibration report: figures against closed forms, warnings where a fault is planted and only there."""

import argparse
import datetime
import hashlib
import io
import json
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from trueangle.contract.calibration import Campaign
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import JointEncoder, TemperatureSensor
from trueangle.contract.metadata import (
    SIGN_CONVENTION,
    CalibrationRecord,
    FitErrors,
    Interval,
    ModelMetadata,
    Probes,
    ReferenceRecord,
)
from trueangle_training import cli, report_command
from trueangle_training.command import Surroundings
from trueangle_training.documents import load_joint
from trueangle_training.hidden_node_sweep import HiddenNodeSweep, SweepPoint, sweep_json
from trueangle_training.model_file import model_inputs
from trueangle_training.report.budget import uncertainty_budget
from trueangle_training.report.cautions import Caution, cautions
from trueangle_training.report.compared import read_comparison
from trueangle_training.report.harmonics import harmonics_by_temperature
from trueangle_training.report.inputs import ReportInputs, report_readings
from trueangle_training.report.plots import contour_label_places
from trueangle_training.report.residuals import coverage, drifted_runs, outliers, residuals
from trueangle_training.report.writing import report_page

EXAMPLES = Path(report_command.__file__).parent / "examples"
SHA256 = "a" * 64
NOISE_ARCSEC = 0.5
FACES, RUNS_A_TEMPERATURE = 23, 3
TEMPERATURES_C = (10.0, 15.0, 20.0, 25.0, 30.0)
SLOPE_ARCSEC_PER_C = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownModel:
    """Corrects eccentricity that turns with temperature; serves a constant uncertainty or none."""

    u_arcsec: float | None = 0.3

    def correction_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
        return -true_error_arcsec(angle_deg, temperature_c)

    def uncertainty_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray | None:
        return None if self.u_arcsec is None else np.full(angle_deg.shape, self.u_arcsec)


def true_error_arcsec(angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
    rad = np.radians(angle_deg)
    thermal = SLOPE_ARCSEC_PER_C * (temperature_c - 20.0) * np.sin(rad)
    return 50.0 * (np.cos(rad) - 1.0) + thermal


def made_campaign(seed: int = 0, *, source: str = "campaign.csv") -> Campaign:
    rng = np.random.default_rng(seed)
    runs = len(TEMPERATURES_C) * RUNS_A_TEMPERATURE
    angle_deg = np.tile(np.arange(FACES) * 360.0 / FACES, runs)
    temperature_c = np.repeat(TEMPERATURES_C, RUNS_A_TEMPERATURE * FACES)
    error_arcsec = true_error_arcsec(angle_deg, temperature_c) + rng.normal(0.0, NOISE_ARCSEC, angle_deg.size)
    run = np.repeat(np.arange(1, runs + 1), FACES)
    return Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        run=run,
        zero_group=run,
        row=np.arange(2, run.size + 2),
        source=source,
        sha256=SHA256,
        temperature_c=temperature_c,
    )


def made_inputs(campaign: Campaign | None = None, **changes: object) -> ReportInputs:
    settings = EncoderSettings(serial_number=1234567, units_per_revolution=3276800)
    inputs = model_inputs(Interval(minimum=0.0, maximum=360.0), Interval(minimum=10.0, maximum=30.0))
    metadata = ModelMetadata(
        schema_version=1,
        joint="elbow",
        method="linear",
        method_settings={},
        inputs=inputs,
        sign_convention=SIGN_CONVENTION,
        temperature_used=True,
        datum_deg=0.0,
        calibration=CalibrationRecord(
            id="elbow-1", file_sha256=SHA256, readings=345, date="2025-03-01", due="2026-03-01"
        ),
        reference=ReferenceRecord(
            kind="polygon", standard_uncertainty_arcsec=0.125, faces=FACES, certificate_id="P-17"
        ),
        errors=FitErrors(held_out_rmse_arcsec=0.55, held_out_kind="leave-one-temperature-out"),
        seed=0,
        versions={"numpy": "2.0"},
        probes=Probes(angle_deg=(0.0,), temperature_c=(20.0,), correction_arcsec=(0.0,)),
        encoder=JointEncoder(lines_per_rev=16384, counts_per_rev=3276800, settings=settings),
    )
    made = ReportInputs(
        campaign=made_campaign() if campaign is None else campaign,
        model=KnownModel(),
        metadata=metadata,
        model_file="elbow.onnx",
        model_sha256="b" * 64,
        made_on=datetime.date(2025, 6, 1),
    )
    return replace(made, **changes)  # pyright: ignore[reportArgumentType]


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


class Seen(HTMLParser):
    """Tags and addresses of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.without_words = 0
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")
        ]
        self.without_words += tag == "img" and not dict(attrs).get("alt")


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


def made_sweep(setting: str = "one training a point") -> HiddenNodeSweep:
    points = [
        SweepPoint(
            hidden_nodes=nodes, rmse_arcsec=rmse, standard_error_arcsec=0.02, at_temperature_arcsec=(rmse, rmse)
        )
        for nodes, rmse in ((5, 1.104), (20, 0.907))
    ]
    return HiddenNodeSweep(
        method="linear", setting=setting, temperatures=("10.0 degC", "30.0 degC"), points=tuple(points)
    )


def test_the_sweep_is_shown_with_what_it_is() -> None:
    text = report_page(made_inputs(sweep=made_sweep()))
    assert "left out of the training one by one (10.0 °C, 30.0 °C)" in text
    assert "one training a point" in text
    assert '<td class="n">0.907</td>' in text
    assert "Hidden nodes" not in report_page(made_inputs())


def test_the_page_needs_nothing_beside_itself() -> None:
    sweep = made_sweep()
    text = report_page(made_inputs(sweep=sweep))
    seen = Seen(text)
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(seen.tags)
    assert len(seen.addresses) == 9
    assert all(address.startswith("data:image/svg+xml;base64,") for address in seen.addresses)
    assert seen.without_words == 0
    assert "@import" not in text
    assert "url(" not in text
    assert text == report_page(made_inputs(sweep=sweep))


def test_text_from_files_is_escaped() -> None:
    evil = '<script>alert(1)</script>"><img src=x onerror=y>'
    inputs = made_inputs(made_campaign(source=evil))
    metadata = replace(
        inputs.metadata,
        joint=evil,
        method=evil,
        versions={evil: evil},
        notes=(evil,),
        calibration=replace(inputs.metadata.calibration, id=evil),
        reference=replace(inputs.metadata.reference, kind=evil, certificate_id=evil),
        errors=FitErrors(held_out_rmse_arcsec=1.0, held_out_kind=evil),
    )
    document = {"format": 1, "methods": [{"name": evil, "in_sample_rmse": 1.0}]}
    comparison = read_comparison(json.dumps(document).encode(), source=evil)
    text = report_page(replace(inputs, metadata=metadata, model_file=evil, comparison=comparison))
    assert "script" not in Seen(text).tags
    assert not any(address == "x" for address in Seen(text).addresses)
    assert text.count("&lt;script&gt;alert(1)") >= 10


def test_an_angle_only_campaign_is_reported_without_temperatures() -> None:
    inputs = made_inputs(replace(made_campaign(), temperature_c=None))
    metadata = replace(inputs.metadata, temperature_used=False)
    text = report_page(replace(inputs, metadata=metadata))
    assert "not measured" in text
    assert "the model ignores temperature" in text
    assert "What temperature adds" not in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "expected a JSON document"),
        ('{"format": 2, "methods": []}', "format 1, found format 2"),
        ("[1]", "found list"),
        ('{"format": 1, "methods": [3]}', "expected a list of methods"),
    ],
)
def test_what_is_no_comparison_is_refused(text: str, expected: str) -> None:
    with pytest.raises(ContractError, match=expected):
        read_comparison(text.encode(), source="compare.json")


def test_a_sweep_of_a_comparison_is_shown_or_passed_over_as_a_whole() -> None:
    whole = {
        "linear": sweep_json(made_sweep()),
        "gap": {"points": [{"hidden_nodes": 3, "rmse": 1.0}, {"hidden_nodes": 4, "rmse": 1.0}]},
        "one": {"points": [{"hidden_nodes": 3, "rmse": 1.0, "standard_error": 0.1}]},
        "odd": {"points": 3},
        "worse": 4,
    }
    read = read_comparison(json.dumps({"format": 1, "methods": [], "hidden_nodes": whole}).encode(), source="c")
    assert read.sweeps == (made_sweep(),)
    assert read.sweep("linear") == made_sweep()
    assert read.sweep("gap") is None


def run_report(arguments: list[str]) -> str:
    parser = argparse.ArgumentParser()
    report_command.register(parser.add_subparsers())
    parsed = parser.parse_args(["report", *arguments])
    out = io.StringIO()
    assert parsed.run(parsed, Surroundings(today=datetime.date(2025, 6, 1), out=out, err=io.StringIO())) == 0
    return out.getvalue()


def test_from_files_to_a_report(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "linear", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model), "--calibrated", "2025-03-01"]) == 0
    assert str(page) in run_report([str(model), str(campaign), "--joint", joint, "-o", str(page)])
    text = page.read_text()
    assert "readings it was trained on" in text
    assert "483 in 21 runs" in text
    assert "Hidden nodes" not in text


def test_a_report_takes_the_sweep_of_a_comparison_of_its_campaign_and_else_makes_one(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "fe-bpnn", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model), "--report", str(page)]) == 0
    assert "Hidden nodes" not in page.read_text()
    run_report([str(model), str(campaign), "-o", str(page)])
    made = page.read_text()
    assert "Method fe-bpnn: one training a point, random starts; the model itself has 20." in made
    assert "30: " in made
    document = {
        "format": 1,
        "calibration": {"sha256": hashlib.sha256(campaign.read_bytes()).hexdigest()},
        "methods": [],
        "hidden_nodes": {"fe-bpnn": sweep_json(made_sweep("made before"))},
    }
    compare = tmp_path / "compare.json"
    compare.write_text(json.dumps(document))
    run_report([str(model), str(campaign), "--compare", str(compare), "-o", str(page)])
    assert "Method fe-bpnn: made before." in page.read_text()


def test_a_campaign_unfit_for_training_is_reported_without_a_sweep(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "fe-gabpnn", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model)]) == 0
    lines = campaign.read_text().splitlines(keepends=True)
    campaign.write_text("".join(lines[: 3 + 2 * FACES]))
    run_report([str(model), str(campaign), "-o", str(page)])
    assert "Hidden nodes" not in page.read_text()


def test_all_faulty_files_are_named_at_once(tmp_path: Path) -> None:
    (tmp_path / "m.onnx").write_bytes(b"no model")
    (tmp_path / "c.csv").write_text("angle_deg\n1\n")
    (tmp_path / "compare.json").write_text("[]")
    files = [str(tmp_path / "m.onnx"), str(tmp_path / "c.csv")]
    with pytest.raises(ContractError) as caught:
        run_report([*files, "--compare", str(tmp_path / "compare.json"), "-o", str(tmp_path / "no" / "r.html")])
    for place in ("m.onnx: expected an ONNX model file", "c.csv", "compare.json", "r.html"):
        assert place in str(caught.value)
