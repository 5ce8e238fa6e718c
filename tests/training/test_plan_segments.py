"""Segments of a plan and all that effects depend on, in the simulator, against closed forms."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.training.library_conditions import BASE_C, joint_of, rich_conditions

import trueangle_training.examples
from trueangle.contract.calibration import Campaign, campaign_to_csv, read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Joint, Plan, plan_from_document
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.effects import EFFECTS, modelled_columns
from trueangle_training.effects.conditions import Timeline, conditions_of
from trueangle_training.effects.heat import BetweenRuns, first_order, lagged_temperature_c, motion_heat_deg_s
from trueangle_training.effects.library.quantisation import coarser_counts_per_rev
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint
from trueangle_training.simulator.trajectory import LiveJoint, Trajectory

EXAMPLES = Path(trueangle_training.examples.__file__).parent
FINE = {"encoder": {"lines_per_rev": 1000, "counts_per_rev": 2**31}}
"""Counts of 0.0006 arcsec, out of the way of closed forms."""
FINE_ARCSEC = 0.0013


def plan_of(*segments: dict[str, Any], **others: Any) -> Plan:
    values = {
        "schema_version": 1,
        "faces": 23,
        "temperatures_c": [],
        "repeats": 1,
        "temperature_jitter_c": 0.0,
        "segments": list(segments),
    }
    return plan_from_document(document_from_plain({**values, **others}, source="made in code"))


def measured(effects: dict[str, Any], plan: Plan, seed: int = 0, **others: Any) -> Campaign:
    return simulate_campaign(simulated_joint(joint_of(effects, **{**FINE, **others})), plan, seed)


def values(array: np.ndarray | None) -> np.ndarray:
    assert array is not None
    return array


def test_the_rich_example_has_about_six_thousand_readings_and_every_column() -> None:
    joint, plan = load_joint(EXAMPLES / "joint.yaml"), load_plan(EXAMPLES / "rich-plan.yaml")
    campaign = simulate_campaign(simulated_joint(joint), plan, 1)
    assert 5_500 <= len(campaign) <= 6_500
    text = campaign_to_csv(campaign)
    assert text == campaign_to_csv(simulate_campaign(simulated_joint(joint), plan, 1))
    again = read_campaign(text.encode(), source="C.csv")
    assert not again.notes
    for name in ("temperature_c", "time_s", "direction", "velocity_deg_s", "load_nm", "face", "polygon_offset"):
        np.testing.assert_array_equal(getattr(again, name), getattr(campaign, name))
    assert np.all(np.diff(values(campaign.time_s)) >= 0)


def test_the_rich_example_shows_every_effect_that_is_a_curve() -> None:
    joint = joint_of({"thermal_eccentricity": {"amplitude_arcsec_per_k": 0.5, "phase_deg": 30}})
    plan = load_plan(EXAMPLES / "rich-plan.yaml")
    conditions = conditions_of(simulate_campaign(simulated_joint(joint), plan, 1), joint)
    groups = np.unique(conditions.zero_group)
    offsets = (conditions.zero_group[:, None] == groups).astype(np.float64)
    modelled, _ = modelled_columns(joint_of({}), conditions)
    basis = np.linalg.qr(np.column_stack([offsets, modelled]))[0]
    visible: dict[str, float] = {}
    for name, entry in EFFECTS.items():
        for shape in list(entry.hypotheses(conditions))[::9]:
            left = shape.main - basis @ (basis.T @ shape.main)
            share = float(np.sum(left**2) / max(np.sum(shape.main**2), 1e-300))
            visible[name] = max(visible.get(name, 0.0), share)
    # Below 1 % an effect counts as invisible.
    assert {name for name, share in visible.items() if share < 0.01} == set()
    assert set(visible) == set(EFFECTS) - {"quantisation", "noise_growth"}


def test_both_directions_in_one_run_share_a_zero_and_show_the_gap() -> None:
    hysteresis = {"hysteresis": {"harmonics": [{"order": 0, "amplitude_arcsec": 3.0, "phase_deg": 0}]}}
    plan = plan_of({"kind": "polygon", "temperatures_c": [20], "directions": [1, -1], "one_run": True})
    campaign = measured(hysteresis, plan)
    assert set(campaign.run.tolist()) == {1}
    assert set(campaign.zero_group.tolist()) == {1}
    assert values(campaign.direction).tolist() == [1] * 23 + [-1] * 23
    assert values(campaign.face).tolist() == [*range(1, 24), *range(23, 0, -1)]
    np.testing.assert_allclose(campaign.error_arcsec, np.repeat([0.0, -6.0], 23), atol=FINE_ARCSEC)
    apart = measured(hysteresis, plan_of({"kind": "polygon", "temperatures_c": [20], "directions": [1, -1]}))
    assert set(apart.run.tolist()) == {1, 2}
    np.testing.assert_allclose(apart.error_arcsec, 0.0, atol=FINE_ARCSEC)


def test_sweeps_share_one_zero_keep_their_turns_and_move() -> None:
    sweep = {"kind": "sweep", "directions": [1, -1], "turns": 2.5, "from_deg": 30.0, "degrees_per_reading": 1.5}
    plan = plan_of(
        {**sweep, "temperatures_c": [20], "speeds_deg_s": [10, 30]},
        {"kind": "polygon", "temperatures_c": [20]},
        {**sweep, "temperatures_c": [40], "speeds_deg_s": [60]},
    )
    campaign = measured({"eccentricity": {"amplitude_arcsec": 50, "phase_deg": 30}}, plan)
    n = 600
    swept = values(campaign.face) == 0
    assert np.sum(swept) == 6 * n
    assert set(campaign.zero_group[swept].tolist()) == {1}
    assert campaign.zero_group[~swept].tolist() == [5] * 23
    assert np.unique(campaign.run).tolist() == [1, 2, 3, 4, 5, 6, 7]
    true_deg = np.tile(np.concatenate([30 + 1.5 * np.arange(n), 30 + 1.5 * np.arange(n)[::-1]]), 3)
    error = 50 * np.cos(np.radians(true_deg - 30))
    np.testing.assert_allclose(campaign.error_arcsec[swept], error - error[0], atol=FINE_ARCSEC)
    np.testing.assert_allclose(campaign.angle_deg[swept] * 3600, true_deg * 3600 + error, atol=FINE_ARCSEC)
    assert values(campaign.velocity_deg_s)[swept][::n].tolist() == [10, -10, 30, -30, 60, -60]
    seconds = np.diff(values(campaign.time_s)[swept][: n + 1])
    np.testing.assert_allclose(seconds, 0.15)


def test_stop_and_go_stands_still_at_each_reading() -> None:
    plan = plan_of(
        {"kind": "sweep", "temperatures_c": [20], "degrees_per_reading": 2.0, "seconds_per_reading": 10.0}
    )
    campaign = measured({}, plan)
    assert len(campaign) == 180
    assert not values(campaign.velocity_deg_s).any()
    np.testing.assert_allclose(np.diff(values(campaign.time_s)), 10.0)


def test_latency_shows_at_two_speeds_and_in_both_directions() -> None:
    plan = plan_of(
        {
            "kind": "sweep",
            "temperatures_c": [20],
            "directions": [1, -1],
            "speeds_deg_s": [10, 30],
            "seconds_per_reading": 0.5,
        }
    )
    campaign = measured({"read_latency": {"latency_s": 0.0002}}, plan)
    expected = -0.0002 * values(campaign.velocity_deg_s) * 3600
    np.testing.assert_allclose(campaign.error_arcsec, expected - expected[0], atol=FINE_ARCSEC)


def test_loads_change_inside_a_run() -> None:
    compliance = {"harmonics": [{"order": 0, "amplitude_arcsec_per_nm": 0.5, "phase_deg": 180}]}
    plan = plan_of({"kind": "polygon", "temperatures_c": [20], "loads_nm": [0, 20, -10], "one_run": True})
    campaign = measured({"load_deflection": compliance}, plan)
    assert values(campaign.load_nm)[::23].tolist() == [0, 20, -10]
    np.testing.assert_allclose(campaign.error_arcsec, np.repeat([0.0, -10.0, 5.0], 23), atol=FINE_ARCSEC)
    assert measured({}, plan_of({"kind": "polygon", "temperatures_c": [20]})).load_nm is None


def test_the_references_error_stays_with_the_faces_and_the_gratings_with_the_shaft() -> None:
    pattern = [float(face % 5) for face in range(1, 24)]
    plan = plan_of(
        *({"kind": "polygon", "temperatures_c": [20], "polygon_offset": offset} for offset in (0, 5, 17.5))
    )
    campaign = measured({"reference_artefact": {"faces_arcsec": pattern}}, plan)
    face = values(campaign.face)
    assert values(campaign.polygon_offset)[::23].tolist() == [0, 5, 17]
    assert campaign.angle_deg[46] == pytest.approx(0.5 * 360 / 23, abs=1e-6)
    expected = (face % 5).astype(np.float64).reshape(3, 23)
    expected -= expected[:, :1]
    np.testing.assert_allclose(campaign.error_arcsec.reshape(3, 23), expected, atol=FINE_ARCSEC)
    # The encoder itself shows the true angle: nothing of it is in the counts.
    stop = np.arange(23) * 360 / 23
    np.testing.assert_allclose(campaign.angle_deg[:23], stop, atol=1e-6)


def test_an_uncertain_polygon_has_its_own_fixed_deviations() -> None:
    reference = {"kind": "polygon", "faces": 23, "polygon_arcsec": 0.8}
    plan = plan_of({"kind": "polygon", "temperatures_c": [20, 40]})
    squares = []
    for seed in range(60):
        campaign = measured({}, plan, seed, reference=reference)
        runs = campaign.error_arcsec.reshape(2, 23)
        np.testing.assert_allclose(runs[0], runs[1], atol=FINE_ARCSEC)
        squares.append(np.var(runs[0], ddof=1))
    # 60 x 22 degrees of freedom: 3.9 % of the variance; three of them allowed.
    assert np.mean(squares) == pytest.approx(0.64, rel=0.12)


def test_a_ramp_warms_the_joint_during_the_run_and_goes_back_before_the_next() -> None:
    plan = plan_of(
        {"kind": "polygon", "temperatures_c": [20], "repeats": 2, "turns": 10, "ramp_c_per_h": 12.0, "soak_h": 2}
    )
    campaign = measured({"thermal_eccentricity": {"amplitude_arcsec_per_k": 1.0, "phase_deg": 0}}, plan)
    since_h = np.arange(230) * 15.0 / 3600
    temperature_c = np.tile(20 + 12 * since_h, 2)
    np.testing.assert_allclose(values(campaign.temperature_c), temperature_c, atol=1e-9)
    assert values(campaign.time_s)[[0, 230]].tolist() == [7200.0, 7200.0 + 230 * 15 + 7200.0]
    stop_rad = np.radians(np.tile(np.arange(230) * 360 / 23, 2))
    expected = (temperature_c - 20) * np.cos(stop_rad)
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=FINE_ARCSEC)


@pytest.mark.parametrize("chamber_c_per_h", [None, 30.0])
def test_a_lagging_joint_forgets_the_chambers_step_with_its_time_constant(chamber_c_per_h: float | None) -> None:
    lag = {
        "time_constant_s": 3600.0,
        "harmonics": [{"order": 0, "amplitude_arcsec_per_k": 2.0, "phase_deg": 0}],
    }
    plan = plan_of(temperatures_c=[30], repeats=2, soak_h=1.0, zero="one", chamber_c_per_h=chamber_c_per_h)
    campaign = measured({"thermal_lag": lag}, plan)
    time_s = values(campaign.time_s)
    if chamber_c_per_h is None:
        behind_k = -10.0 * np.exp(-time_s / 3600)
    else:
        # Along the ramp of 20 minutes the joint falls behind by rate x constant x (1 - exp(-t / constant)).
        at_end_k = -30.0 * (1 - np.exp(-1 / 3))
        behind_k = at_end_k * np.exp(-(time_s - 1200) / 3600)
    np.testing.assert_allclose(campaign.error_arcsec, 2.0 * (behind_k - behind_k[0]), atol=FINE_ARCSEC)


def test_a_chamber_that_is_too_slow_for_the_soak_is_refused() -> None:
    plan = plan_of(temperatures_c=[20, 40], soak_h=0.5, chamber_c_per_h=10.0)
    with pytest.raises(ContractError, match=r"expected at least 2 h to 40 degC, found 0\.5 h"):
        measured({}, plan)


def test_motion_heats_and_rest_cools_across_runs() -> None:
    heating = {
        "time_constant_s": 500.0,
        "harmonics": [{"order": 0, "amplitude_arcsec_per_deg_s": 0.1, "phase_deg": 0}],
    }
    plan = plan_of(
        {
            "kind": "sweep",
            "temperatures_c": [20],
            "speeds_deg_s": [60],
            "turns": 100,
            "degrees_per_reading": 60.0,
            "soak_h": 0,
        },
        {
            "kind": "sweep",
            "temperatures_c": [20],
            "degrees_per_reading": 30.0,
            "seconds_per_reading": 60.0,
            "soak_h": 0,
        },
    )
    campaign = measured({"self_heating": heating}, plan)
    time_s = values(campaign.time_s)
    moved = 60 * (1 - np.exp(-time_s[:600] / 500))
    at_rest = moved[-1] * np.exp(-(time_s[600] - time_s[599]) / 500)
    # 30 deg in 60 s: a joint that is turned from stop to stop does not cool down altogether.
    rested = 0.5 + (at_rest - 0.5) * np.exp(-(time_s[600:] - time_s[600]) / 500)
    expected = 0.1 * np.concatenate([moved, rested])
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=FINE_ARCSEC)
    # The diagnosis, which only has the readings, infers the same heat here.
    joint = joint_of({}, **FINE)
    inferred = motion_heat_deg_s(conditions_of(campaign, joint), 500.0)
    np.testing.assert_allclose(values(inferred) * 0.1, expected, atol=1e-6)


def test_heat_inferred_from_readings_is_the_simulators_where_the_chamber_steps() -> None:
    joint, plan = joint_of({}), plan_of(temperatures_c=[10, 30, 40], repeats=2, soak_h=2.0)
    conditions = conditions_of(simulate_campaign(simulated_joint(joint), plan, 0), joint)
    times = np.array([0, 0, 7200, 7200 + 45 * 15, 7200 + 45 * 15, 14400 + 46 * 15], dtype=np.float64)
    levels = np.array([20, 10, 10, 10, 30, 30], dtype=np.float64)
    known = Timeline(time_s=times, temperature_c=levels)
    inferred = values(lagged_temperature_c(conditions, 3000.0, BetweenRuns.STEP))
    at_30 = values(conditions.time_s) == times[-1]
    expected = 10 + 10 * np.exp(-times[3] / 3000)
    expected = 30 + (expected - 30) * np.exp(-(times[-1] - times[3]) / 3000)
    assert inferred[at_30][0] == pytest.approx(expected, abs=1e-9)
    with_line = replace(conditions.rows(at_30), timeline=known)
    assert values(lagged_temperature_c(with_line, 3000.0, BetweenRuns.RAMP))[0] == pytest.approx(
        expected, abs=1e-9
    )
    ramped = values(lagged_temperature_c(conditions, 3000.0, BetweenRuns.RAMP))
    assert np.abs(ramped - inferred).max() > 1.0


def test_first_order_states_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(2)
    kept, inflow = rng.uniform(0, 1, 1000), rng.normal(size=1000)
    kept[rng.integers(0, 1000, 20)] = 0.0
    state, expected = 0.0, []
    for a, b in zip(kept.tolist(), inflow.tolist(), strict=True):
        state = a * state + b
        expected.append(state)
    np.testing.assert_allclose(first_order(kept, inflow), expected, atol=1e-12)


def test_subdivision_error_follows_the_scale_not_the_shaft() -> None:
    effects = {
        "eccentricity": {"amplitude_arcsec": 500, "phase_deg": 0},
        "subdivision_error": {"harmonics": [{"per_line": 1, "amplitude_arcsec": 5, "phase_deg": 0}]},
    }
    plan = plan_of({"kind": "polygon", "temperatures_c": [20]})
    campaign = measured(effects, plan)
    stop_deg = np.arange(23) * 360 / 23
    eccentric = 500 * np.cos(np.radians(stop_deg))
    # A line is 1296 arcsec: 500 arcsec of eccentricity move its phase by more than a third of a turn.
    line = 5 * np.cos(2 * np.pi * (stop_deg * 3600 + eccentric) / 1296)
    expected = eccentric + line
    np.testing.assert_allclose(campaign.error_arcsec, expected - expected[0], atol=FINE_ARCSEC)


def test_a_coarse_readout_stands_on_its_lattice() -> None:
    joint = joint_of({"quantisation": {"counts_per_rev": 50_000}}, noise={"repeatability_arcsec": 30.0})
    plan = plan_of({"kind": "polygon", "temperatures_c": [20], "repeats": 10})
    campaign = simulate_campaign(simulated_joint(joint), plan, 4)
    counts = campaign.angle_deg * 50_000 / 360
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    assert coarser_counts_per_rev(conditions_of(campaign, joint)) == 50_000
    healthy = joint_of({}, noise={"repeatability_arcsec": 30.0})
    for seed in range(5):
        fine = simulate_campaign(simulated_joint(healthy), plan, seed)
        assert coarser_counts_per_rev(conditions_of(fine, healthy)) is None


def test_a_wrong_sensor_shows_another_temperature_and_leaves_the_angles_alone() -> None:
    thermal = {"thermal_eccentricity": {"amplitude_arcsec_per_k": 1.0, "phase_deg": 0}}
    wrong = {**thermal, "temperature_sensor_error": {"bias_c": 1.0, "gain": 0.05}}
    plan = plan_of(temperatures_c=[10, 40])
    sensor: dict[str, Any] = {"temperature_sensor": {"resolution_c": 0.5}}
    right, shown = measured(thermal, plan, **sensor), measured(wrong, plan, **sensor)
    np.testing.assert_array_equal(shown.angle_deg, right.angle_deg)
    np.testing.assert_array_equal(shown.error_arcsec, right.error_arcsec)
    assert values(right.temperature_c)[::23].tolist() == [10.0, 40.0]
    assert values(shown.temperature_c)[::23].tolist() == [10.5, 42.0]


def test_an_effect_more_leaves_the_noise_as_it_was() -> None:
    noisy: dict[str, Any] = {"noise": {"repeatability_arcsec": 0.7}}
    plan = plan_of(temperatures_c=[10, 30], repeats=3)
    plain = measured({}, plan, 5, **noisy)
    seated = {"run_to_run_eccentricity": {"amplitude_arcsec": 4.0}}
    more = measured(seated, plan, 5, **noisy)
    both = measured(
        {**seated, "index_drift": {"amplitude_arcsec": 2.0, "time_constant_s": 300.0}}, plan, 5, **noisy
    )
    drift = 2.0 * (1 - np.exp(-np.tile(np.arange(23) * 15.0, 6) / 300))
    np.testing.assert_allclose(both.error_arcsec - more.error_arcsec, drift, atol=FINE_ARCSEC)
    rad = np.radians(np.arange(23) * 360 / 23)
    waves = np.column_stack([np.cos(rad), np.sin(rad), np.ones(23)])
    seating = (more.error_arcsec - plain.error_arcsec).reshape(6, 23).T
    left = seating - waves @ np.linalg.lstsq(waves, seating, rcond=None)[0]
    assert np.abs(left).max() < FINE_ARCSEC
    assert np.abs(seating).max() > 1.0


def test_a_plan_without_segments_draws_run_by_run_jitter_noise_autocollimator() -> None:
    joint = load_joint(EXAMPLES / "joint.yaml")
    plan = replace(load_plan(EXAMPLES / "plan.yaml"), directions=(1, -1))
    campaign = simulate_campaign(simulated_joint(joint), plan, 8)
    simulated = simulated_joint(joint)
    rng = np.random.default_rng(8)
    counts_per_rev = joint.encoder.counts_per_rev
    rows = iter(range(0, len(campaign), 23))
    for set_c in plan.temperatures_c:
        for direction in (1, -1) * plan.repeats:
            temperature_c = set_c + rng.uniform(-0.1, 0.1)
            noise, autocollimator = rng.normal(0.0, 0.63, size=23), rng.normal(0.0, 0.125, size=23)
            true_deg = (direction * np.arange(23) % 23) * 360 / 23
            indicated = true_deg + (simulated.error_arcsec(true_deg, temperature_c) + noise) / 3600
            counts = np.rint(indicated * counts_per_rev / 360)
            error = (counts * 360 / counts_per_rev - true_deg) * 3600 - autocollimator
            run = slice(row := next(rows), row + 23)
            np.testing.assert_array_equal(np.rint(campaign.angle_deg[run] * counts_per_rev / 360), counts)
            np.testing.assert_allclose(campaign.error_arcsec[run], error - error[0], atol=1e-9)


def test_a_plan_of_sweeps_needs_no_polygon() -> None:
    reference = {"kind": "encoder"}
    plan = plan_of({"kind": "sweep", "temperatures_c": [20], "speeds_deg_s": [10], "seconds_per_reading": 0.1})
    campaign = measured({}, plan, reference=reference)
    assert len(campaign) == 360
    with pytest.raises(ContractError, match="expected polygon to simulate, found encoder"):
        measured({}, plan_of({"kind": "polygon", "temperatures_c": [20]}), reference=reference)


def test_more_readings_than_fit_are_refused() -> None:
    sweep = {"kind": "sweep", "temperatures_c": [20], "speeds_deg_s": [10], "turns": 1000}
    with pytest.raises(ContractError, match="at most 2000000 readings"):
        measured({}, plan_of({**sweep, "degrees_per_reading": 0.001}))
    with pytest.raises(ContractError, match="at most 2000000 readings"):
        measured({}, plan_of({**sweep, "degrees_per_reading": 1.0, "repeats": 1000}))


def live(joint: Joint) -> LiveJoint:
    trajectory = Trajectory(start_deg=0, speed_deg_s=10, start_c=10, end_c=30, ramp_s=5)
    return LiveJoint(simulated=simulated_joint(joint), trajectory=trajectory, sample_period_s=0.01, seed=1)


def test_a_live_joint_knows_angle_and_temperature_only() -> None:
    defect = {"localized_defect": {"defects": [{"centre_deg": 0, "fwhm_deg": 5, "amplitude_arcsec": 9}]}}
    assert live(joint_of(defect)).error_arcsec(0) > 8.5
    joint = joint_of({**defect, "hysteresis": {"harmonics": []}, "noise_growth": {"arcsec_per_nm": 1}})
    with pytest.raises(ContractError) as caught:
        live(joint)
    assert [fault.found.split(",")[0] for fault in caught.value.faults] == ["hysteresis", "noise_growth"]
    with pytest.raises(ContractError, match="hysteresis, which depends on direction"):
        simulated_joint(joint).error_arcsec(np.zeros(1), BASE_C)
    assert len(rich_conditions().rows(np.arange(3))) == 3
