"""Simulated joints and campaigns against closed forms, Eq. (11), and the statistics they must have."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trueangle_training.examples
from trueangle.contract.calibration import campaign_to_csv, read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Joint, Plan, PlanZero, Reference, ReferenceKind, joint_from_document
from trueangle_training.documents import dump_joint, dump_plan, load_joint, load_plan
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

EXAMPLES = Path(trueangle_training.examples.__file__).parent
PITCH_DEG = 360 / 23


@pytest.fixture(scope="module")
def joint() -> Joint:
    return load_joint(EXAMPLES / "joint.yaml")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return load_plan(EXAMPLES / "plan.yaml")


def noise_free(counts_per_rev: int = 2**31) -> Joint:
    """One eccentricity; counts so fine (0.0006") that quantisation is out of the way."""
    return joint_from_document(
        document_from_plain(
            {
                "schema_version": 1,
                "encoder": {"lines_per_rev": 16384, "counts_per_rev": counts_per_rev},
                "reference": {"kind": "polygon", "faces": 23},
                "effects": {
                    "eccentricity": {"amplitude_arcsec": 50, "phase_deg": 30},
                    "thermal_tilt": {"amplitude_arcsec_per_k": 0.5, "phase_deg": 0},
                },
            },
            source="made in code",
        )
    )


def plan_of(**changes: object) -> Plan:
    plan = Plan(
        schema_version=1,
        faces=23,
        temperatures_c=(10.0, 20.0, 40.0),
        repeats=3,
        temperature_jitter_c=0.0,
    )
    return replace(plan, **changes)  # pyright: ignore[reportArgumentType]


def closed_form_arcsec(angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
    """The joint of `noise_free`, written out."""
    return 50 * np.cos(np.radians(angle_deg - 30)) + 0.5 * (temperature_c - 20) * np.cos(np.radians(2 * angle_deg))


def test_shipped_example_lies_where_the_paper_lies(joint: Joint, plan: Plan) -> None:
    campaign = simulate_campaign(simulated_joint(joint), plan, 1)
    assert len(campaign) == 483
    mean_arcsec = campaign.error_arcsec.reshape(7, 3, 23).mean(axis=1)
    # Jia et al. 2020, section 4.2: means of three from -110.2" to 43.9", moved by temperature by -9.7" to 7.0".
    # Allowed: 2", three times the scatter 0.65" of a zero shared by each run.
    assert mean_arcsec.min() == pytest.approx(-110.2, abs=2.0)
    assert mean_arcsec.max() == pytest.approx(43.9, abs=2.0)
    thermal_arcsec = mean_arcsec - mean_arcsec[2]
    assert thermal_arcsec.min() == pytest.approx(-9.7, abs=2.0)
    assert thermal_arcsec.max() == pytest.approx(7.0, abs=2.0)
    # The joint's error counted from its datum is 59" RMS; a whole run moves by up to 2".
    assert np.sqrt(np.mean(campaign.error_arcsec**2)) == pytest.approx(59.0, abs=1.0)


def test_documents_survive_a_round_trip(joint: Joint, plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "joint.yaml").write_text(dump_joint(joint))
    (tmp_path / "plan.yaml").write_text(dump_plan(plan))
    again = load_joint(tmp_path / "joint.yaml")
    assert replace(again, effects={}) == replace(joint, effects={})
    assert {n: e.plain() for n, e in again.effects.items()} == {n: e.plain() for n, e in joint.effects.items()}
    assert load_plan(tmp_path / "plan.yaml") == plan


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"schema_version: [1\n", "line 2"),
        (b"schema_version: 1\nfaces: \xff\n", "line 2: expected UTF-8 text, found byte 0xff"),
        (b"", "an empty file"),
    ],
)
def test_a_broken_document_is_named_with_its_line(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(content)
    with pytest.raises(ContractError, match=complaint) as caught:
        load_plan(path)
    assert str(path) in str(caught.value)


def test_eq_11_gives_the_error_from_the_first_stop_at_the_same_temperature() -> None:
    simulated = simulated_joint(noise_free())
    campaign = simulate_campaign(simulated, plan_of(), 0)
    assert campaign.temperature_c is not None
    assert campaign.face is not None
    true_deg = (campaign.face - 1).astype(np.float64) * PITCH_DEG
    expected = closed_form_arcsec(true_deg, campaign.temperature_c)
    expected -= closed_form_arcsec(np.zeros(1), campaign.temperature_c)
    # Two roundings to counts of 0.0006".
    np.testing.assert_allclose(campaign.error_arcsec, expected, atol=0.0007)
    from_datum = simulated.error_from_datum_arcsec(true_deg, campaign.temperature_c, 0.0)
    np.testing.assert_allclose(from_datum, expected, atol=1e-9)


def test_indicated_angle_is_the_true_angle_plus_the_error() -> None:
    campaign = simulate_campaign(simulated_joint(noise_free()), plan_of(), 0)
    assert campaign.temperature_c is not None
    assert campaign.face is not None
    true_deg = (campaign.face - 1).astype(np.float64) * PITCH_DEG
    expected_deg = true_deg + closed_form_arcsec(true_deg, campaign.temperature_c) / 3600
    np.testing.assert_allclose(campaign.angle_deg * 3600, expected_deg * 3600, atol=0.0004)


def test_a_first_stop_below_zero_is_not_wrapped_to_360() -> None:
    effects = {"eccentricity": {"amplitude_arcsec": 50, "phase_deg": 180}}
    node = document_from_plain(effects, source="made in code")
    joint = replace(noise_free(), effects=dict(node.value))  # pyright: ignore[reportArgumentType, reportCallIssue]
    campaign = simulate_campaign(simulated_joint(joint), plan_of(), 0)
    np.testing.assert_allclose(campaign.angle_deg[::23] * 3600, -50.0, atol=0.001)
    assert campaign.angle_deg.max() < 360


def test_every_run_begins_with_zero_error_and_counts_are_whole(joint: Joint, plan: Plan) -> None:
    campaign = simulate_campaign(simulated_joint(joint), plan, 5)
    assert np.all(campaign.error_arcsec[::23] == 0.0)
    counts = campaign.angle_deg * joint.encoder.counts_per_rev / 360
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_scatter_of_a_reading_is_noise_autocollimator_and_quantisation(joint: Joint, plan: Plan) -> None:
    simulated = simulated_joint(joint)
    many = replace(plan, temperatures_c=(20.0,), repeats=400, temperature_jitter_c=0.0)
    campaign = simulate_campaign(simulated, many, 9)
    true_deg = np.tile(np.arange(23.0) * PITCH_DEG, 400)
    left = campaign.error_arcsec - simulated.error_from_datum_arcsec(true_deg, 20.0, 0.0)
    runs = left.reshape(400, 23)
    # One reading: 0.63" noise, 0.125" autocollimator, 0.3955" counts: the root of their squares is 0.652".
    # The first reading's scatter is the offset of each run. Standard errors over 400 runs: 3.5 % of the offset's
    # 0.652", 0.8 % of the 22 x 400 readings' own; four of them allowed.
    offset = runs[:, 1:].mean(axis=1)
    assert np.std(offset) == pytest.approx(0.652 * np.sqrt(1 + 1 / 22), rel=0.14)
    within = runs[:, 1:] - offset[:, None]
    assert np.sqrt(np.sum(within**2) / (400 * 21)) == pytest.approx(0.652, rel=0.035)


def test_same_seed_gives_the_same_bytes_and_another_seed_others(joint: Joint, plan: Plan) -> None:
    simulated = simulated_joint(joint)
    first = campaign_to_csv(simulate_campaign(simulated, plan, 3))
    assert first == campaign_to_csv(simulate_campaign(simulated, plan, 3))
    assert first != campaign_to_csv(simulate_campaign(simulated, plan, 4))


def test_written_and_read_again_a_campaign_is_the_same(joint: Joint, plan: Plan) -> None:
    campaign = simulate_campaign(simulated_joint(joint), replace(plan, directions=(1, -1)), 3)
    data = campaign_to_csv(campaign).encode()
    again = read_campaign(data, source=campaign.source)
    assert again.sha256 == campaign.sha256
    for name in ("angle_deg", "error_arcsec", "temperature_c", "run", "zero_group", "face", "direction", "row"):
        np.testing.assert_array_equal(getattr(again, name), getattr(campaign, name))


def test_temperature_is_shown_in_sensor_steps_within_the_jitter(joint: Joint, plan: Plan) -> None:
    campaign = simulate_campaign(simulated_joint(joint), plan, 2)
    assert campaign.temperature_c is not None
    shown = campaign.temperature_c.reshape(7, 3, 23)
    assert np.all(np.ptp(shown, axis=2) == 0.0)
    np.testing.assert_array_equal(shown / 0.0625, np.round(shown / 0.0625))
    set_point = np.array(plan.temperatures_c)[:, None, None]
    assert np.abs(shown - set_point).max() <= 0.1 + 0.0625 / 2 + 1e-9
    assert np.unique(shown).size > 7


def test_time_counts_soaking_and_readings() -> None:
    plan = plan_of(soak_h=4.0, seconds_per_reading=15.0)
    campaign = simulate_campaign(simulated_joint(noise_free()), plan, 0)
    assert campaign.time_s is not None
    assert campaign.time_s[0] == 4 * 3600
    assert campaign.time_s[22] == 4 * 3600 + 22 * 15
    assert campaign.time_s[23] == 4 * 3600 + 23 * 15
    assert campaign.time_s[3 * 23] == 8 * 3600 + 3 * 23 * 15


def test_downwards_the_run_begins_at_the_same_stop() -> None:
    plan = plan_of(directions=(1, -1), repeats=1, temperatures_c=(20.0,))
    campaign = simulate_campaign(simulated_joint(noise_free()), plan, 0)
    assert campaign.face is not None
    assert campaign.direction is not None
    assert campaign.face[:23].tolist() == list(range(1, 24))
    assert campaign.face[23:].tolist() == [1, *range(23, 1, -1)]
    assert campaign.direction.tolist() == [1] * 23 + [-1] * 23
    upwards = dict(zip(campaign.face[:23].tolist(), campaign.error_arcsec[:23].tolist(), strict=True))
    downwards = dict(zip(campaign.face[23:].tolist(), campaign.error_arcsec[23:].tolist(), strict=True))
    assert upwards == downwards


def test_whole_shifts_rename_the_faces_and_keep_the_angles() -> None:
    campaign = simulate_campaign(simulated_joint(noise_free()), plan_of(shift_faces=7.0), 0)
    assert campaign.face is not None
    assert campaign.polygon_offset is not None
    assert campaign.polygon_offset.reshape(9, 23)[:3, 0].tolist() == [0, 7, 14]
    stop = np.tile(np.arange(23), 9)
    np.testing.assert_array_equal(campaign.face, (stop - campaign.polygon_offset) % 23 + 1)
    runs = campaign.error_arcsec.reshape(3, 3, 23)
    np.testing.assert_allclose(runs[:, 1], runs[:, 0], atol=1e-9)


@pytest.mark.parametrize("shift_faces", [1 / 3, 23 + 1 / 3, 7.5])
def test_broken_shifts_move_the_stops(shift_faces: float) -> None:
    campaign = simulate_campaign(simulated_joint(noise_free()), plan_of(shift_faces=shift_faces), 0)
    assert campaign.face is not None
    assert campaign.polygon_offset is not None
    assert campaign.temperature_c is not None
    for repeat in range(3):
        rows = slice(repeat * 23, (repeat + 1) * 23)
        turned = repeat * shift_faces
        assert np.all(campaign.polygon_offset[rows] == int(turned) % 23)
        true_deg = np.mod((campaign.face[rows] - 1 + turned) * PITCH_DEG, 360.0)
        assert true_deg[0] == pytest.approx((turned % 1.0) * PITCH_DEG, abs=1e-9)
        expected = closed_form_arcsec(true_deg, campaign.temperature_c[rows])
        np.testing.assert_allclose(campaign.error_arcsec[rows], expected - expected[0], atol=0.0007)


@settings(max_examples=25, deadline=None)
@given(
    faces=st.integers(3, 40),
    repeats=st.integers(1, 4),
    shift_faces=st.floats(0, 50),
    directions=st.sampled_from([(1,), (-1,), (1, -1)]),
)
def test_every_run_visits_each_face_once_inside_one_turn(
    faces: int, repeats: int, shift_faces: float, directions: tuple[int, ...]
) -> None:
    joint = replace(noise_free(), reference=Reference(kind=ReferenceKind.POLYGON, faces=faces))
    plan = plan_of(faces=faces, repeats=repeats, shift_faces=shift_faces, directions=directions)
    campaign = simulate_campaign(simulated_joint(joint), plan, 0)
    assert campaign.face is not None
    for run in np.unique(campaign.run):
        of_run = campaign.run == run
        assert sorted(campaign.face[of_run].tolist()) == list(range(1, faces + 1))
        # 0.03 deg: the errors of up to 60" that are indicated on top of the true angles.
        assert campaign.angle_deg[of_run].min() > -0.03
        assert campaign.angle_deg[of_run].max() < 360.03


def test_a_plan_for_another_polygon_is_refused(joint: Joint) -> None:
    with pytest.raises(ContractError, match="polygon with 23 faces, found 24"):
        simulate_campaign(simulated_joint(joint), plan_of(faces=24), 0)


def test_a_joint_with_a_reference_encoder_is_refused(joint: Joint) -> None:
    other = replace(joint, reference=Reference(kind=ReferenceKind.ENCODER))
    with pytest.raises(ContractError, match="expected polygon to simulate, found encoder"):
        simulate_campaign(simulated_joint(other), plan_of(), 0)


def test_one_zero_keeps_the_datums_drift_in_the_errors() -> None:
    plan = plan_of(zero=PlanZero.ONE, temperature_jitter_c=0.0)
    campaign = simulate_campaign(simulated_joint(noise_free()), plan, 0)
    assert campaign.temperature_c is not None
    assert set(campaign.zero_group.tolist()) == {1}
    assert set(campaign.run.tolist()) == set(range(1, 10))
    true_deg = np.tile(np.arange(23) * PITCH_DEG, 9)
    expected = closed_form_arcsec(true_deg, campaign.temperature_c)
    assert np.ptp(expected[::23]) > 0.5
    np.testing.assert_allclose(campaign.error_arcsec, expected - expected[0], atol=0.0007)


@pytest.mark.parametrize(("listed", "found"), [(22, "22 deviations"), (24, "24 deviations"), (1, "1 deviation")])
def test_a_reference_artefact_with_another_number_of_faces_is_refused(listed: int, found: str) -> None:
    artefact = document_from_plain({"faces_arcsec": [0.1] * listed}, source="joint.yaml")
    other = replace(noise_free(), effects={"reference_artefact": artefact})
    with pytest.raises(ContractError, match=f"expected 23 deviations, one for each face .*, found {found}"):
        simulated_joint(other)
