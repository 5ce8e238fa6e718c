"""The parts of the metrological plant against closed forms: grating, interpolator, heat, reference, noise."""

from dataclasses import replace

import numpy as np
import pytest

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
from trueangle_training.plant.schedule import Schedule, draw_schedule

TURN = np.linspace(0.0, 2.0 * np.pi, 3601)


@pytest.fixture(scope="module")
def schedule() -> Schedule:
    return draw_schedule("rich", np.random.default_rng(5))


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
