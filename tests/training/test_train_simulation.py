"""Training in simulation: a model must not learn what it cannot tell by angle and temperature."""

from pathlib import Path

import numpy as np
import pytest

from trueangle.contract.document import document_from_plain
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Joint, joint_from_document
from trueangle_training.train_simulation import simulated_calibration, without_unlearnable

KNOWN: dict[str, object] = {
    "eccentricity": {"amplitude_arcsec": 40, "phase_deg": 30},
    "thermal_eccentricity": {"amplitude_arcsec_per_k": 0.3, "phase_deg": 80},
}
HYSTERESIS: dict[str, object] = {"harmonics": [{"order": 0, "amplitude_arcsec": 5, "phase_deg": 0}]}
FACES_ARCSEC = [float(value) for value in 3.0 * np.sin(np.arange(23) ** 2)]


def made(effects: dict[str, object], **reference: object) -> Joint:
    plain = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": 16384, "counts_per_rev": 3276800},
        "reference": {"kind": "polygon", "faces": 23, **reference},
        "noise": {"repeatability_arcsec": 0.5},
        "effects": effects,
    }
    return joint_from_document(document_from_plain(plain, source="joint.yaml"))


def campaign_of(joint: Joint) -> tuple[np.ndarray, str]:
    campaign = simulated_calibration(joint, None, seed=1, source=Path("joint.yaml"))
    return campaign.error_arcsec, " ".join(campaign.notes)


@pytest.mark.parametrize(
    ("name", "settings", "why"),
    [
        ("reference_artefact", {"faces_arcsec": FACES_ARCSEC}, "the reference's own error"),
        ("hysteresis", HYSTERESIS, "it would need: direction"),
        ("windup", {"amplitude_arcsec": 3, "travel_deg": 20}, "it would need: travel"),
        ("index_drift", {"amplitude_arcsec": 3, "time_constant_s": 300}, "it would need: time"),
    ],
)
def test_what_is_no_function_of_angle_and_temperature_is_not_learned(
    name: str, settings: object, why: str
) -> None:
    plain, _ = campaign_of(made(KNOWN))
    errors, notes = campaign_of(made({**KNOWN, name: settings}))
    assert np.array_equal(errors, plain)
    assert f"not corrected by the model: {name} ({why}" in notes


def test_deviations_of_the_polygon_are_not_learned() -> None:
    plain, notes = campaign_of(made(KNOWN))
    errors, _ = campaign_of(made(KNOWN, polygon_arcsec=2.0))
    assert np.array_equal(errors, plain)
    assert "not corrected" not in notes


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("thermal_tilt", {"amplitude_arcsec_per_k": 0.1, "phase_deg": 0}),
        ("temperature_sensor_error", {"bias_c": 2.0}),
        ("noise_growth", {"arcsec_per_k": 0.1}),
    ],
)
def test_what_a_measured_campaign_would_teach_is_learned(name: str, settings: object) -> None:
    joint = made({**KNOWN, name: settings})
    learned, notes = without_unlearnable(joint)
    assert list(learned.effects) == list(joint.effects)
    assert notes == ()


def test_a_contradiction_in_what_is_left_out_is_told_all_the_same() -> None:
    with pytest.raises(ContractError, match="hysteresis"):
        campaign_of(made({**KNOWN, "hysteresis": {}}))
