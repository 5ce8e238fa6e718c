"""`trueangle plan`: what a plan can see, what it takes, and a sheet that comes back as a campaign."""

import argparse
import csv
import datetime
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import trueangle_training.examples
from trueangle.contract.calibration import read_campaign
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Plan, PlanZero
from trueangle_training import errors_command, plan_command
from trueangle_training.command import Register, Surroundings
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.plan_command import shift_faces, temperatures_c
from trueangle_training.plan_design import coefficient_noise, orders_seen, plan_time, recommended_shift, shifted
from trueangle_training.plan_expectation import unseen_error
from trueangle_training.plan_sheet import sheet_csv
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

JOINT = Path(trueangle_training.examples.__file__).parent / "joint.yaml"
PLAN = Plan(schema_version=1, faces=23, temperatures_c=(10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0), repeats=3)


def run_command(register: Register, arguments: list[str]) -> str:
    """What the command writes to its output."""
    parser = argparse.ArgumentParser()
    register(parser.add_subparsers())
    parsed = parser.parse_args(arguments)
    out = io.StringIO()
    surroundings = Surroundings(today=datetime.date(2025, 3, 1), out=out, err=io.StringIO())
    assert parsed.run(parsed, surroundings) == 0
    return out.getvalue()


def test_equal_faces_show_orders_up_to_half_their_number() -> None:
    assert (orders_seen(PLAN).highest, orders_seen(PLAN).places) == (11, 23)
    assert orders_seen(replace(PLAN, faces=24)).highest == 11
    assert orders_seen(replace(PLAN, faces=36)).highest == 17


def test_thirds_show_all_orders_below_the_number_of_faces() -> None:
    # Order 23 has one value at all faces of a mounting: its zero takes it up, whatever the shift.
    assert (orders_seen(shifted(PLAN, 1 / 3)).highest, orders_seen(shifted(PLAN, 1 / 3)).places) == (22, 69)
    assert orders_seen(shifted(replace(PLAN, repeats=2), 0.5)).highest == 22
    assert orders_seen(shifted(PLAN, 2.0)).highest == 11


def test_noise_of_a_coefficient_is_that_of_least_squares() -> None:
    noise = coefficient_noise(PLAN, 0.65)
    angle_rad = np.tile(2 * np.pi * np.arange(23) / 23, 21)
    design = np.column_stack([np.ones(483), np.cos(3 * angle_rad), np.sin(3 * angle_rad)])
    covariance = 0.65**2 * np.linalg.inv(design.T @ design)
    assert noise.steady_arcsec == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-9)
    assert noise.one_temperature_arcsec == pytest.approx(noise.steady_arcsec * 7**0.5, rel=1e-9)


def test_time_of_the_papers_campaign() -> None:
    # Jia et al. 2020, section 4.1: within 30 min to install, 4 h a temperature, three repeats within 20 min.
    time = plan_time(PLAN)
    assert (time.setup_h, time.soak_h, time.remounts) == (0.5, 28.0, 0)
    assert time.reading_h == pytest.approx(483 * 15 / 3600)
    turned = plan_time(shifted(PLAN, 1 / 3), remount_min=10)
    assert turned.remounts == 20
    assert turned.total_h - time.total_h == pytest.approx(20 * 10 / 60)


@pytest.mark.parametrize(("repeats", "shift"), [(1, 0.0), (2, 0.5), (3, 1 / 3), (6, 1 / 3)])
def test_recommended_shift(repeats: int, shift: float) -> None:
    assert recommended_shift(repeats) == shift


def test_temperatures_with_dots() -> None:
    assert temperatures_c("10,15,...,40") == PLAN.temperatures_c
    assert temperatures_c("40,30,...,0,5") == (40.0, 30.0, 20.0, 10.0, 0.0, 5.0)
    assert temperatures_c("20") == (20.0,)


@pytest.mark.parametrize(
    "text", ["", "10,...", "...,40", "10,...,40", "10,15,...,41", "10,10,...,40", "10,x", "5,5"]
)
def test_temperatures_that_make_no_list_are_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        temperatures_c(text)


def test_shifts_by_name_and_by_number() -> None:
    assert [shift_faces(text) for text in ("none", "half", "third", "1.5")] == [0.0, 0.5, 1 / 3, 1.5]
    for text in ("-1", "nan", "quarter"):
        with pytest.raises(argparse.ArgumentTypeError):
            shift_faces(text)


def test_plan_is_written_and_explained(tmp_path: Path) -> None:
    path, sheet = tmp_path / "plan.yaml", tmp_path / "sheet.html"
    arguments = ["plan", "--faces", "23", "--temperatures", "10,15,...,40", "-o", str(path), "--sheet", str(sheet)]
    out = run_command(plan_command.register, arguments)
    assert load_plan(path) == shifted(PLAN, 1 / 3)
    assert "orders seen      1 to 22, from 69 places" in out
    assert "483 in 21 runs of 23 faces" in out
    assert sheet.read_text().count("<section") == 21


def test_plain_plan_is_told_what_a_shift_would_give(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    arguments = ["plan", "--faces", "23", "--temperatures", "10,40", "--shift", "none", "-o", str(path)]
    out = run_command(plan_command.register, arguments)
    assert "orders up to 22 with as many readings" in out
    assert "fewer than three temperatures" in out


def test_one_zero_plan(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    start = ["plan", "--faces", "23", "--temperatures", "10,40", "--one-zero", "-o", str(path)]
    assert "one for all temperatures" in run_command(plan_command.register, start)
    assert load_plan(path).zero is PlanZero.ONE
    assert load_plan(path).shift_faces == 0.0
    with pytest.raises(ContractError, match="0 beside zero: one"):
        run_command(plan_command.register, [*start, "--shift", "third"])


def test_expectation_on_a_described_joint_favours_shifted_repeats(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    start = ["plan", "--faces", "23", "--temperatures", "10,15,...,40", "-o", str(path), "--joint", str(JOINT)]
    out = run_command(plan_command.register, start)
    expected = [float(line.split(": ")[1].split()[0]) for line in out.splitlines() if "arcsec RMS" in line]
    # The example joint has orders 12 to 20 of 0.53" RMS together, which a plain plan mistakes for lower ones.
    assert len(expected) == 2
    assert expected[0] < expected[1]
    assert out.count("medians and range of 10 noise seeds") == 2


def test_without_a_joint_the_gain_of_a_shift_is_that_of_the_example_and_says_so(tmp_path: Path) -> None:
    start = ["plan", "--faces", "23", "--temperatures", "10,20,30", "-o", str(tmp_path / "plan.yaml")]
    out = run_command(plan_command.register, start)
    assert "on a joint like the shipped example-joint, whose orders above 11 are 0.32 arcsec RMS together" in out
    plain = float(re.findall(r"together: ([\d.]+) arcsec RMS", out)[0])
    with_shift = float(re.findall(r"shifted by 0.333 of the face pitch: ([\d.]+)", out)[0])
    assert plain > 0.3
    assert with_shift < 0.05


def test_unseen_orders_are_missing_between_the_faces_and_taken_for_lower_ones_at_them() -> None:
    def error_arcsec(angle_deg: np.ndarray) -> np.ndarray:
        return 30.0 * np.cos(np.radians(angle_deg)) + 0.4 * np.sin(np.radians(14.0 * angle_deg))

    found = unseen_error(error_arcsec, PLAN)
    assert found.above_rms_arcsec == pytest.approx(0.4 / 2**0.5, rel=1e-6)
    # On 23 faces sin 14 θ reads as -sin 9 θ: both are wrong, 0.4 / sqrt(2) each, and neither shifts the datum.
    assert found.rmse_arcsec == pytest.approx(0.4, rel=1e-6)
    assert unseen_error(error_arcsec, shifted(PLAN, 1 / 3)).rmse_arcsec < 1e-9


def test_all_faults_at_once(tmp_path: Path) -> None:
    arguments = [
        "plan",
        "--faces",
        "2",
        "--temperatures",
        "10,20",
        "--repeats",
        "0",
        "-o",
        str(tmp_path / "p.yaml"),
    ]
    arguments += ["--sheet", str(tmp_path / "sheet.pdf"), "--remount-min", "-1", "--joint", str(tmp_path / "none")]
    with pytest.raises(ContractError) as caught:
        run_command(plan_command.register, arguments)
    places = str(caught.value)
    for place in ("--sheet", "--remount-min", "faces", "repeats", "none"):
        assert place in places
    assert not (tmp_path / "p.yaml").exists()


@pytest.mark.parametrize(
    "plan",
    [
        PLAN,
        shifted(PLAN, 1 / 3),
        replace(PLAN, shift_faces=7.5, directions=(1, -1)),
        replace(PLAN, zero=PlanZero.ONE),
    ],
    ids=["plain", "thirds", "whole and half, both ways", "one zero"],
)
def test_a_sheet_filled_in_comes_back_as_the_campaign(plan: Plan, tmp_path: Path) -> None:
    """An operator who writes the simulated encoder's angles into the sheet gets the simulated errors back."""
    joint = load_joint(JOINT)
    quiet = replace(joint, reference=replace(joint.reference, autocollimator_arcsec=0.0))
    simulated = simulate_campaign(simulated_joint(quiet), plan, 3)
    assert simulated.temperature_c is not None
    lines = sheet_csv(plan, "a title").splitlines()
    start = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    rows = list(csv.DictReader(lines[start:]))
    assert len(rows) == len(simulated)
    for k, row in enumerate(rows):
        row["angle_deg"], row["autocollimator_arcsec"] = repr(float(simulated.angle_deg[k])), "0"
        row["temperature_c"] = repr(float(simulated.temperature_c[k]))
    raw, campaign_path = tmp_path / "raw.csv", tmp_path / "campaign.csv"
    with raw.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    options = ["--one-zero"] if plan.zero is PlanZero.ONE else []
    out = run_command(
        errors_command.register, ["errors", str(raw), "--joint", str(JOINT), "-o", str(campaign_path), *options]
    )
    assert "no polygon certificate" in out
    campaign = read_campaign(campaign_path.read_bytes(), source="campaign.csv")
    # The simulator's and eq. (11)'s roundings: 1e-13 deg each.
    np.testing.assert_allclose(campaign.error_arcsec, simulated.error_arcsec, atol=1e-8)
    np.testing.assert_array_equal(campaign.run, simulated.run)
    np.testing.assert_array_equal(campaign.face, simulated.face)
    np.testing.assert_array_equal(campaign.zero_group, simulated.zero_group)


class _Loads(HTMLParser):
    """Whatever a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [tag] if tag in ("script", "link", "iframe") else []
        self.found += [f"{tag} {name}" for name, value in attrs if name in ("src", "href") and value]


def test_the_sheet_fetches_nothing_and_escapes_its_title(tmp_path: Path) -> None:
    path, sheet = tmp_path / "<b>plan.yaml", tmp_path / "sheet.html"
    arguments = ["plan", "--faces", "5", "--temperatures", "10,20", "-o", str(path), "--sheet", str(sheet)]
    run_command(plan_command.register, arguments)
    text = sheet.read_text()
    loads = _Loads()
    loads.feed(text)
    assert loads.found == []
    assert "Calibration plan &lt;b&gt;plan" in text
