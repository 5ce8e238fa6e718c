"""The metrological plant as a whole: its effects lie where they are said to lie, its cases are what was asked."""

import ast
import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueangle.contract.calibration import read_campaign
from trueangle_training.plant import metrological
from trueangle_training.plant.cases import Case, draw_case
from trueangle_training.plant.defect import AtSize
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.listing import Listing
from trueangle_training.plant.metrological.chain import Part, signs
from trueangle_training.plant.metrological.surprises import changing
from trueangle_training.plant.metrological.world import PLANT, Laboratory, draw_world
from trueangle_training.plant.schedule import PlanName, Schedule, draw_schedule
from trueangle_training.plant.simulator_reach import CONTAINED, Span, cell_shares, containments, recalibrated_span
from trueangle_training.plant.wish import Stratum, Wish

PLAIN = Listing(constant=(), thermal=())
WITHOUT_CURVE = ("quantisation", "noise_growth", "temperature_sensor_error")
WITH_CURVE = tuple(name for name in PLANT.library if name not in WITHOUT_CURVE)


@pytest.fixture(scope="module")
def paper() -> Laboratory:
    return draw_world("paper", np.random.default_rng(3)).with_listing(PLAIN)


@pytest.fixture(scope="module")
def rich() -> Laboratory:
    return draw_world("rich", np.random.default_rng(3)).with_listing(PLAIN)


@pytest.fixture(scope="module")
def rich_span(rich: Laboratory) -> Span:
    return recalibrated_span(rich.conditions, rich.listing)


@pytest.fixture(scope="module")
def schedule() -> Schedule:
    return draw_schedule("rich", np.random.default_rng(5))


def curve_of(world: Laboratory, name: str, *, size: float = 1.0, seed: int = 7) -> np.ndarray:
    defect = world.defect(name, np.random.default_rng(seed))
    return world.curve_arcsec((AtSize(defect=defect, size=size),)) - world.curve_arcsec(())


# --- the plant as a whole


@pytest.mark.parametrize(("plan", "seeds"), [("paper", 12), ("rich", 2)])
def test_nothing_structural_is_left_of_a_joint_without_a_defect(plan: PlanName, seeds: int) -> None:
    for seed in range(seeds):
        world = draw_world(plan, np.random.default_rng(seed))
        span = recalibrated_span(world.conditions, world.listing)
        left = np.std(span.outside(world.curve_arcsec(())))
        assert left < 0.03 * world.noise_of_one_reading(), seed


@pytest.mark.parametrize("name", WITH_CURVE)
def test_an_effect_grows_from_nothing_to_about_an_arcsecond(name: str, rich: Laboratory) -> None:
    assert 0.2 < np.abs(curve_of(rich, name)).max() < 12.0
    if name != "count_loss":  # the least that can be lost is one count
        np.testing.assert_allclose(curve_of(rich, name, size=0.0), 0.0, atol=1e-6)


LATTICE = (
    "eccentricity",
    "grating_tilt",
    "graduation_error",
    "thermal_eccentricity",
    "thermal_tilt",
    "thermal_graduation",
    "hysteresis",
    "read_latency",
    "load_deflection",
    "run_to_run_eccentricity",
)
"""Effects whose cells the judge has columns for."""


@pytest.mark.parametrize("name", WITH_CURVE)
def test_an_effect_lies_where_it_is_said_to_lie(name: str, rich: Laboratory) -> None:
    # What temperature does from 20 degC on has a constant part at the middle of the range; it is listed here.
    constant = tuple(range(1, 12)) if name.startswith("thermal") else ()
    world = rich.with_listing(Listing(constant=constant, thermal=()))
    span = recalibrated_span(world.conditions, world.listing)
    defect = world.defect(name, np.random.default_rng(7))
    curve = curve_of(world, name)
    carried = containments(curve, world.conditions, span, base_arcsec=world.curve_arcsec(()))
    # Some have several orders, places or events, of which the judge's shapes hold one at a time.
    parts = {"thermal_graduation": 2, "count_loss": 6}.get(name, 1)
    assert carried[name] > 0.9 / parts
    if name in LATTICE:
        shares = cell_shares(curve, world.conditions, span)
        assert sum(shares.get(cell, 0.0) for cell in defect.cells) > 0.9


@pytest.mark.parametrize("family", PLANT.unknown["rich"])
def test_an_unknown_family_scales_and_no_effect_could_carry_it(
    family: str, rich: Laboratory, rich_span: Span
) -> None:
    once, twice = curve_of(rich, family, size=0.5), curve_of(rich, family)
    assert np.abs(twice).max() > 0.5
    # Where the place read moves by a line, another line's jitter comes into the head's window.
    np.testing.assert_allclose(twice, 2.0 * once, atol=0.02)
    assert np.median(np.abs(twice - 2.0 * once)) < 1e-3
    assert not rich.defect(family, np.random.default_rng(7)).in_library
    assert max(containments(twice, rich.conditions, rich_span).values()) < 0.75


@pytest.mark.parametrize(("family", "faces"), [("chuck_grips", 23), ("smeared_face", 1)])
def test_what_sits_on_the_polygon_goes_with_its_faces(family: str, faces: int, rich: Laboratory) -> None:
    curve, plan = curve_of(rich, family), rich.conditions.schedule
    assert np.all(np.abs(curve[plan.face == 0]) < 1e-9)
    moved = {int(face) for face in plan.face[np.abs(curve) > 1e-9]}
    assert len(moved) == faces
    # Nothing of it stays with a face: that would be the library's reference_artefact besides.
    stays = [curve[plan.face == face].mean() for face in range(1, 24)]
    assert np.abs(stays).max() < 0.1 * np.abs(curve).max()
    # At one place of the shaft another face gives another value once the polygon is re-mounted.
    offsets = np.unique(plan.polygon_offset[plan.face > 0])
    if faces == 1:
        (touched,) = moved
        places = {round(float(at) % 360.0) for at in plan.angle_deg[plan.face == touched]}
        assert len(places) >= offsets.size


def test_a_course_keeps_nothing_that_stays_or_goes_straight() -> None:
    x = np.linspace(-1.0, 1.0, 200)
    left = changing(np.exp(x), x)
    assert np.mean(left) == pytest.approx(0.0, abs=1e-12)
    assert np.mean(left * x) == pytest.approx(0.0, abs=1e-12)
    assert np.mean(left**2) == pytest.approx(1.0)


def test_contributions_of_two_causes_add_up(paper: Laboratory) -> None:
    rng = np.random.default_rng(4)
    parts: list[Part] = [
        AtSize(defect=paper.defect(name, rng), size=1.0).part for name in ("eccentricity", "thermal_lag")
    ]
    plain = signs(paper.bench, []).error_arcsec
    apart = sum((signs(paper.bench, [part]).error_arcsec - plain for part in parts), np.zeros(plain.size))
    np.testing.assert_allclose(signs(paper.bench, parts).error_arcsec - plain, apart, atol=1e-4)


def test_a_late_reading_errs_by_speed_times_delay(rich: Laboratory) -> None:
    plain = signs(rich.bench, []).error_arcsec
    late = signs(rich.bench, [Part(delay_s=20e-6)]).error_arcsec - plain
    expected = -rich.conditions.schedule.velocity_deg_s * 20e-6 * 3600.0
    # Cogging of the drive; and the lines' jitter is met at another place, by 0.04 arcsec over some lines.
    np.testing.assert_allclose(late, expected, rtol=0.0081, atol=0.02)


def test_a_sensors_bias_shows_only_where_re_calibration_takes_it_up(paper: Laboratory) -> None:
    for constant, seen in (((1, 2), True), ((2,), False)):
        listed = paper.with_listing(Listing(constant=constant, thermal=(1,)))
        shown_c = [
            replace(listed, probe=replace(listed.probe, bias_c=bias_c))
            .measured((), np.random.default_rng(3))
            .temperature_c
            for bias_c in (0.0, 5.0)
        ]
        assert bool(np.any(shown_c[0] != shown_c[1])) is seen


# --- cases


def case_of(name: str, *, stratum: Stratum = "single", enr: float = 2.0, seed: int = 5) -> Case:
    """A seed further on where this one's plan makes the case ambiguous."""
    for tried in range(seed, seed + 6):
        with contextlib.suppress(CaseNotFoundError):
            return draw_case(Wish(seed=tried, plan="paper", stratum=stratum, names=(name,), enr=enr, plant="C"))
    raise AssertionError(f"{name}: six plans in a row that cannot hold it")


def test_the_same_wish_gives_the_same_bytes_and_another_seed_other_ones() -> None:
    first, again, other = (case_of("windup", seed=seed) for seed in (5, 5, 6))
    assert (first.measured_csv, first.joint_yaml) == (again.measured_csv, again.joint_yaml)
    assert first.truth.to_plain() == again.truth.to_plain()
    assert first.measured_csv != other.measured_csv


@pytest.mark.parametrize("name", ["thermal_tilt", "thermal_lag", "subdivision_error", "run_to_run_eccentricity"])
@pytest.mark.parametrize("enr", [0.2, 5.0])
def test_an_effect_has_the_size_that_was_asked_for(name: str, enr: float) -> None:
    truth = case_of(name, enr=enr).truth
    assert truth.plant == "C"
    assert truth.effects[0].visible
    assert truth.effects[0].enr == pytest.approx(enr, rel=0.02)
    assert name in truth.effects[0].accepted_names


@pytest.mark.parametrize("family", PLANT.unknown["paper"])
def test_a_case_of_an_unknown_family_expects_unknown(family: str) -> None:
    truth = case_of(family, stratum="unknown").truth
    assert truth.expected == "unknown"
    assert max(truth.effects[0].contained_in.values(), default=0.0) < CONTAINED


@pytest.mark.parametrize("name", ["noise_growth", "quantisation"])
def test_scatter_comes_at_the_size_that_the_truth_says(name: str, paper: Laboratory) -> None:
    defect, size = paper.defect(name, np.random.default_rng(2)), 8.0
    sized = AtSize(defect=defect, size=size)
    more = paper.measured((sized,), np.random.default_rng(1)).error_arcsec
    plain = paper.measured((), np.random.default_rng(1)).error_arcsec
    group = paper.conditions.schedule.zero_group
    added = more - plain
    for number in np.unique(group):
        added[group == number] -= added[group == number].mean()
    # 462 degrees of freedom; a coarse lattice is not quite uniform over the places read.
    assert np.sqrt(np.sum(added**2) / 462.0) == pytest.approx(
        np.sqrt(np.mean(paper.scatter_arcsec(sized) ** 2)), rel=0.15
    )


def test_files_are_read_by_the_product_and_angles_are_whole_counts() -> None:
    case = case_of("index_drift")
    campaign = read_campaign(case.measured_csv.encode(), source="measured.csv")
    assert len(campaign) == case.truth.structure_arcsec.size
    counts = int(case.joint_yaml.split("counts_per_rev: ")[1].split("}")[0])
    lattice = campaign.angle_deg / 360.0 * counts
    np.testing.assert_allclose(lattice, np.round(lattice), atol=1e-2)


def test_the_plant_imports_nothing_of_the_other_plants() -> None:
    own = "trueangle_training.plant.metrological"
    folder = Path(metrological.__file__).parent
    others = {
        f"trueangle_training.plant.{each.name}"
        for each in folder.parent.iterdir()
        if each.is_dir() and each.name not in ("metrological", "__pycache__")
    }
    assert others
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert not any(name.startswith(other) for other in others), (path.name, name)
                if name.split(".")[0] in ("trueangle", "trueangle_training"):
                    assert name.startswith((own, "trueangle_training.plant")), (path.name, name)
