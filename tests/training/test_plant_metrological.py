"""The metrological plant against closed forms; its effects lie where they are said to lie."""

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
from trueangle_training.plant.metrological.grating_lines import (
    ARCSEC_PER_RAD,
    Head,
    Ruling,
    disc_displacement_arcsec,
    indicated_arcsec,
    screw_error,
)
from trueangle_training.plant.metrological.habits import with_habits, with_pauses
from trueangle_training.plant.metrological.interpolator import (
    TABLE_STEPS,
    Signals,
    interpolation_error_rad,
    looked_up_rad,
)
from trueangle_training.plant.metrological.joint_causes import softening
from trueangle_training.plant.metrological.polygon import Autocollimator, draw_reference, mounting
from trueangle_training.plant.metrological.scatter import creeping_zero, ringing, telegraph, turbulence
from trueangle_training.plant.metrological.soak import Probe, Soak, draw_soak, one_pole, slab_mean, swinging
from trueangle_training.plant.metrological.stops import stop_state
from trueangle_training.plant.metrological.surprises import changing
from trueangle_training.plant.metrological.world import PLANT, Laboratory, draw_world
from trueangle_training.plant.schedule import PlanName, Schedule, draw_schedule
from trueangle_training.plant.simulator_reach import CONTAINED, Span, cell_shares, containments, recalibrated_span
from trueangle_training.plant.wish import Stratum, Wish

TURN = np.linspace(0.0, 2.0 * np.pi, 3601)
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


# --- grating and interpolator


def test_a_shifted_disc_turns_its_lines_by_the_law_of_sines() -> None:
    shift = 0.01 * np.exp(0.4j) * ARCSEC_PER_RAD
    turned = disc_displacement_arcsec(
        TURN[:, None], centre_arcsec=np.full(TURN.size, shift), strain_arcsec=np.zeros(TURN.size, np.complex128)
    )[:, 0]
    # Points at unit distance from a centre that is e beside the axis: the largest angle at the axis is arcsin e.
    assert np.abs(turned).max() == pytest.approx(np.arcsin(0.01) * ARCSEC_PER_RAD, abs=2e-3)
    first = -0.01 * np.sin(TURN - 0.4) * ARCSEC_PER_RAD
    np.testing.assert_allclose(turned, first, atol=0.01**2 * ARCSEC_PER_RAD)


def test_a_sheared_disc_turns_its_lines_twice_a_turn() -> None:
    strain = 0.01 * np.exp(1j) * ARCSEC_PER_RAD
    turned = disc_displacement_arcsec(
        TURN[:, None], centre_arcsec=np.zeros(TURN.size, np.complex128), strain_arcsec=np.full(TURN.size, strain)
    )[:, 0]
    # arg(1 + s exp(-2ia)) is at most arcsin s.
    assert np.abs(turned).max() == pytest.approx(np.arcsin(0.01) * ARCSEC_PER_RAD, abs=2e-3)
    half = TURN.size // 2
    np.testing.assert_allclose(turned[:half], turned[half : 2 * half], atol=1e-6)


def read_of(lines: np.ndarray, *, at_deg: np.ndarray, lines_seen: int) -> np.ndarray:
    """Error of a head over displaced lines."""
    nowhere = np.zeros(at_deg.size, np.complex128)
    place = indicated_arcsec(
        at_deg * 3600.0,
        Head(lines_per_rev=lines.size, lines_seen=lines_seen),
        centre_arcsec=nowhere,
        strain_arcsec=nowhere,
        rulings=(Ruling(lines_arcsec=lines),),
    )
    return place - at_deg * 3600.0


def test_the_head_averages_over_the_lines_it_sees() -> None:
    lines, order, seen = 4000, 40, 51
    wave = np.cos(2.0 * np.pi * order * np.arange(lines) / lines)
    at_deg = np.arange(0, lines, 7) * 360.0 / lines
    # Mean of a cosine over equal steps (Dirichlet's kernel); lines ahead are read less.
    step = 2.0 * np.pi * order / lines
    kernel = np.sin(seen * step / 2.0) / (seen * np.sin(step / 2.0))
    assert 0.5 < kernel < 0.7
    expected = -kernel * np.cos(order * np.deg2rad(at_deg))
    np.testing.assert_allclose(read_of(wave, at_deg=at_deg, lines_seen=seen), expected, atol=1e-5)


def test_a_few_lines_far_off_count_less_than_their_mean() -> None:
    # Of 5 lines one is ahead by a third of the pitch: the phase of 4 + exp(2 pi i / 3).
    lines = np.zeros(1000)
    pitch_arcsec = 1296.0
    lines[500] = pitch_arcsec / 3.0
    found = read_of(lines, at_deg=np.array([180.0]), lines_seen=5)
    expected = -np.angle(4.0 + np.exp(2j * np.pi / 3.0)) * pitch_arcsec / (2.0 * np.pi)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # Their mean would be a fifteenth of the pitch.
    assert abs(float(found[0])) < 0.6 * pitch_arcsec / 15.0


def test_a_ruling_engines_screw_leaves_one_order_and_the_third_of_what_sticks() -> None:
    stick, order, lines = 0.2, 4, 9000
    spectrum = 2.0 * np.fft.rfft(screw_error(lines, order=order, phase_rad=0.3, stick=stick)) / lines
    # cos - s cos^3 = (1 - 3s/4) cos x - (s/4) cos 3x, and adding up divides each by its order.
    assert np.abs(spectrum[order]) == pytest.approx(1.0, abs=1e-4)
    assert np.abs(spectrum[3 * order]) == pytest.approx(stick / 12.0 / (1.0 - 0.75 * stick), abs=1e-4)
    rest = np.delete(np.abs(spectrum), [order, 3 * order])
    assert rest.max() < 1e-9


def test_the_table_of_the_interpolator_is_as_good_as_its_steps() -> None:
    angles = np.linspace(-np.pi + 1e-9, np.pi, 20_001)
    found = looked_up_rad(np.asarray(0.7 * np.exp(1j * angles), dtype=np.complex128))
    # Linear in between: h^2 / 8 times the largest curvature of the arctangent, 3 sqrt(3) / 8.
    np.testing.assert_allclose(found, angles, atol=1.01 / TABLE_STEPS**2 / 8.0 * 3.0 * np.sqrt(3.0) / 8.0)


@pytest.mark.parametrize(
    ("signals", "harmonic"),
    [
        (Signals(offset_cos=3e-3, offset_sin=4e-3), 1),
        (Signals(ellipse_cos=3e-3, ellipse_sin=4e-3), 2),
        (Signals(square=5e-3), 4),
    ],
)
def test_each_fault_of_the_signals_has_its_harmonic(signals: Signals, harmonic: int) -> None:
    phase = np.arange(1024) * 2.0 * np.pi / 1024
    spectrum = 2.0 * np.abs(np.fft.rfft(interpolation_error_rad(phase, signals))) / phase.size
    assert spectrum[harmonic] == pytest.approx(5e-3, abs=3e-5)
    # Their squares are left.
    assert np.delete(spectrum, harmonic).max() < 5e-3**2


# --- friction, heat, time


def test_an_elastic_stop_slips_at_its_threshold_and_back_after_twice_that() -> None:
    path = np.array([0.0, 0.2, 0.5, 3.0, 2.5, 2.0, 1.9, -4.0])
    # r = 0.5: held, at the limit, slipping, 0.5 back to the middle, 1.0 back to the other limit.
    np.testing.assert_allclose(stop_state(path, threshold_deg=0.5), [0.0, 0.4, 1.0, 1.0, 0.0, -1.0, -1.0, -1.0])


def test_a_lumped_mass_follows_a_step_exponentially() -> None:
    step = np.ones(300)
    step[0] = 0.0
    risen = one_pole(step, time_constant_s=100.0, start=0.0, step_s=1.0)
    at_s = np.arange(300.0)
    # The step rises within the first second, so it is one of half a second in.
    np.testing.assert_allclose(risen[2:], 1.0 - np.exp(-(at_s[2:] - 0.5) / 100.0), atol=2e-5)


def test_a_slab_warms_with_the_root_of_time_and_then_with_its_slowest_mode() -> None:
    constant_s = 2000.0
    at_s = np.arange(0.0, 8000.0, 2.0)
    risen = slab_mean(np.where(at_s > 0, 1.0, 0.0), time_constant_s=constant_s, start=0.0, step_s=2.0)
    early = np.searchsorted(at_s, 0.08 * constant_s)
    # Half space: mean = 2 sqrt(k t / pi) / l, and tau = 4 l^2 / (pi^2 k).
    assert risen[early] == pytest.approx(4.0 * np.sqrt(0.08 / np.pi**3), abs=0.01)
    late = at_s > constant_s
    slowest = 1.0 - 8.0 / np.pi**2 * np.exp(-(at_s[late] - 1.0) / constant_s)
    np.testing.assert_allclose(risen[late], slowest, atol=1e-4)


def test_the_chamber_overshoots_as_a_second_order_system() -> None:
    damping, step = 0.5, np.concatenate([np.zeros(3), np.ones(2000)])
    air = swinging(step, period_s=2000.0, damping=damping)
    assert air.max() - 1.0 == pytest.approx(np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2)), abs=1e-3)
    assert air[-1] == pytest.approx(1.0, abs=1e-4)


def test_motion_at_constant_speed_warms_to_speed_times_time_constant() -> None:
    grid_s = np.arange(0.0, 16_000.0, 8.0)
    soak = Soak(grid_s=grid_s, body_c=np.full(grid_s.size, 20.0), travel_deg=3.0 * grid_s, reading_s=grid_s)
    warm = soak.friction_heat(500.0)
    assert warm[-1] == pytest.approx(3.0 * 500.0, rel=1e-6)
    assert warm[np.searchsorted(grid_s, 500.0)] == pytest.approx(1500.0 * (1.0 - np.exp(-1.0)), rel=0.01)


def test_some_soaks_end_while_the_joint_is_under_way() -> None:
    short = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        plan = draw_schedule("paper", rng)
        soak = draw_soak(plan, rng)
        wanted = soak.at_readings(np.interp(soak.grid_s, plan.chamber_time_s, plan.chamber_c))
        short.append(np.abs(wanted - soak.temperature_c).max())
    assert max(short) > 3.0
    assert min(short) < 1.5


def test_a_probe_warms_itself_from_when_it_is_read_out() -> None:
    grid_s = np.arange(0.0, 4000.0, 8.0)
    soak = Soak(grid_s=grid_s, body_c=np.full(grid_s.size, 20.0), travel_deg=grid_s, reading_s=grid_s[:3])
    probe = Probe(time_constant_s=5.0, step_c=1e-6, bias_c=0.1, gain=1.0, warming_c=0.04, warming_s=30.0)
    said = probe.readings_c(soak, np.array([0.0, 30.0, 3000.0]))
    np.testing.assert_allclose(said - 20.1, [0.0, 0.04 * (1.0 - np.exp(-1.0)), 0.04], atol=2e-6)


def test_softening_glue_bends_by_the_square_at_first_and_straight_in_the_end() -> None:
    small, large = np.array([1.5]), np.array([300.0, 301.0])
    np.testing.assert_allclose(softening(small, width_k=30.0), (small / 15.0) ** 2, rtol=1e-3)
    np.testing.assert_allclose(np.diff(softening(large, width_k=30.0)), 2.0 * 30.0 / 15.0**2, rtol=1e-6)


def test_a_pause_makes_everything_after_it_later(schedule: Schedule) -> None:
    after, pauses_s = np.array([700, 20]), np.array([30.0, 60.0])
    waited = with_pauses(schedule, after=after, pauses_s=pauses_s)
    late = waited.time_s - schedule.time_s
    rows = np.arange(len(schedule))
    np.testing.assert_allclose(late, 60.0 * (rows > 20) + 30.0 * (rows > 700), atol=1e-6)
    np.testing.assert_allclose(waited.path_time_s[waited.reading_at], waited.time_s, atol=1e-6)


def test_an_operators_habits_keep_the_order_of_events(schedule: Schedule) -> None:
    kept = with_habits(schedule, np.random.default_rng(2))
    assert np.all(np.diff(kept.time_s) > 0)
    assert np.all(np.diff(kept.path_time_s) >= 0)
    assert kept.time_s[-1] > schedule.time_s[-1]


# --- reference


def test_a_faces_tilt_is_read_as_angle_when_the_cross_hair_is_rolled(schedule: Schedule) -> None:
    reference = draw_reference(schedule, np.random.default_rng(4))
    more = reference.rolled(0.01).error_arcsec(schedule) - reference.error_arcsec(schedule)
    tilt = reference.polygon.pyramidal_arcsec[schedule.face - 1]
    np.testing.assert_allclose(more, np.where(schedule.face > 0, 0.01 * tilt, 0.0), atol=1e-9)


def test_the_reference_alone_is_good_to_some_hundredths_of_an_arcsecond() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        plan = draw_schedule("paper", rng)
        assert np.std(draw_reference(plan, rng).error_arcsec(plan)) < 0.03


def test_the_shaft_stands_beside_a_face_by_the_operators_scatter(schedule: Schedule) -> None:
    reference = draw_reference(schedule, np.random.default_rng(4))
    # No more than an arcminute times the largest of two thousand normal draws.
    assert np.abs(reference.beside_arcsec).max() < 250.0
    assert np.all(reference.beside_arcsec[schedule.face == 0] == 0.0)


def test_an_autocollimator_without_faults_reads_the_angle() -> None:
    ideal = Autocollimator(gain=0.0, cubic_arcsec=0.0, fringe_arcsec=0.0, fringe_period_arcsec=2.0)
    np.testing.assert_array_equal(ideal.excess_arcsec(np.array([-60.0, 0.0, 5.0])), 0.0)
    bent = replace(ideal, gain=1e-3, cubic_arcsec=0.02)
    np.testing.assert_allclose(bent.excess_arcsec(np.array([60.0])), 0.06 + 0.02)


def test_a_polygon_is_mounted_anew_where_its_offset_changes(schedule: Schedule) -> None:
    for number in np.unique(mounting(schedule)):
        assert np.unique(schedule.polygon_offset[mounting(schedule) == number]).size == 1
    assert mounting(schedule).max() >= 7 * 2


# --- noise


def test_ringing_has_the_variance_and_the_correlation_of_its_poles() -> None:
    radius, turn = 0.6, 0.9
    drawn = ringing(60_000, radius=radius, turn_rad=turn, rng=np.random.default_rng(1))
    # About 20,000 independent values: three standard errors.
    assert drawn.var() == pytest.approx(1.0, abs=0.04)
    expected = 2.0 * radius * np.cos(turn) / (1.0 + radius**2)
    assert np.mean(drawn[1:] * drawn[:-1]) == pytest.approx(expected, abs=0.03)


def test_a_telegraph_forgets_twice_as_fast_as_it_switches() -> None:
    time_s = np.arange(0.0, 240_000.0, 4.0)
    drawn = telegraph(time_s, dwell_s=40.0, rng=np.random.default_rng(2))
    np.testing.assert_array_equal(np.abs(drawn), 1.0)
    assert np.mean(drawn[5:] * drawn[:-5]) == pytest.approx(np.exp(-2.0 * 20.0 / 40.0), abs=0.05)


def test_the_zero_creeps_from_each_runs_beginning_and_only_on_the_polygon(schedule: Schedule) -> None:
    drawn = np.array([creeping_zero(schedule, np.random.default_rng(seed)) for seed in range(300)])
    firsts = [np.flatnonzero(schedule.run == run)[0] for run in np.unique(schedule.run)]
    np.testing.assert_array_equal(drawn[:, firsts], 0.0)
    assert np.all(drawn[:, schedule.face == 0] == 0.0)
    row = int(np.flatnonzero(schedule.run == schedule.run[0])[-1])
    # Variance of 300 draws: standard error 8 %.
    assert drawn[:, row].var() == pytest.approx(schedule.seconds_into_run()[row] / 400.0, rel=0.25)


def test_turbulence_is_of_variance_1_and_heavy_tailed() -> None:
    drawn = np.concatenate([turbulence(8000, rng=np.random.default_rng(seed)) for seed in range(12)])
    assert drawn.var() == pytest.approx(1.0, abs=0.1)
    assert np.mean(drawn**4) / drawn.var() ** 2 > 3.3


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
