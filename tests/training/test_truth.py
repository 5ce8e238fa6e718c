"""The true error of a model on a simulated joint, and the oracle."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import trueangle_training.examples
from trueangle_training.dataset import training_set
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.evaluation.truth import datum_drift_arcsec, oracle, true_error
from trueangle_training.methods import TrainingReadings
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint

Floats = NDArray[np.float64]
EXAMPLES = Path(trueangle_training.examples.__file__).parent
COARSE_DEG = 0.5


@pytest.fixture(scope="module")
def joint() -> SimulatedJoint:
    return simulated_joint(load_joint(EXAMPLES / "joint.yaml"))


@pytest.fixture(scope="module")
def readings(joint: SimulatedJoint) -> TrainingReadings:
    campaign = simulate_campaign(joint, load_plan(EXAMPLES / "plan.yaml"), 1)
    return training_set(campaign, base_temperature_c=None, free_offsets=True).readings


@dataclass(frozen=True, slots=True, kw_only=True)
class TheJoint:
    """The joint itself as a function of the true angle, plus an error of its own; u is fixed."""

    joint: SimulatedJoint
    extra_arcsec: float = 0.0
    sigma_arcsec: float | None = None
    datum_deg: float = 0.0
    temperature_used: bool = True

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        # From indicated back to true: two fixed-point steps are exact to 1e-9 deg.
        true_deg = angle_deg
        for _ in range(3):
            true_deg = angle_deg - self.joint.error_arcsec(true_deg, temperature_c) / 3600.0
        whole = self.joint.error_from_datum_arcsec(true_deg, temperature_c, 0.0)
        return whole + self.extra_arcsec * np.sin(np.radians(angle_deg))

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        return None if self.sigma_arcsec is None else np.full_like(angle_deg, self.sigma_arcsec)


def test_the_joint_itself_has_no_true_error(joint: SimulatedJoint, readings: TrainingReadings) -> None:
    found = true_error(TheJoint(joint=joint), joint, readings, angle_step_deg=COARSE_DEG)
    assert found.rmse_arcsec < 1e-6
    assert found.largest_arcsec < 1e-6


def test_a_known_error_is_found_with_its_size_seam_and_coverage(
    joint: SimulatedJoint, readings: TrainingReadings
) -> None:
    model = TheJoint(joint=joint, extra_arcsec=2.0, sigma_arcsec=0.5)
    found = true_error(model, joint, readings, oracle_rmse_arcsec=0.5, angle_step_deg=COARSE_DEG)
    assert found.rmse_arcsec == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert found.largest_arcsec == pytest.approx(2.0, rel=1e-3)
    assert found.over_oracle == pytest.approx(found.rmse_arcsec / 0.5)
    # After face 23, at 344.3 deg: mean square of 2 sin over the last 15.7 deg of the turn.
    last = np.arange(344.5, 360.0, COARSE_DEG)
    assert found.seam_rmse_arcsec == pytest.approx(
        float(np.sqrt(np.mean((2.0 * np.sin(np.radians(last))) ** 2))), rel=0.05
    )
    # |2 sin θ| <= 2 x 0.5 for |sin θ| <= 1/2: a third of the turn.
    assert found.coverage == pytest.approx(1.0 / 3.0, abs=0.01)


def test_a_model_without_uncertainty_covers_nothing_rather_than_everything(
    joint: SimulatedJoint, readings: TrainingReadings
) -> None:
    assert true_error(TheJoint(joint=joint), joint, readings, angle_step_deg=COARSE_DEG).coverage is None


def test_the_oracle_is_limited_by_noise_and_by_what_the_plan_cannot_see(
    joint: SimulatedJoint, readings: TrainingReadings
) -> None:
    yardstick = oracle(readings, joint)
    found = true_error(yardstick, joint, readings, angle_step_deg=COARSE_DEG)
    # Harmonics 12 to 20 fold onto 11 to 3 and are missing between the faces: sqrt(sum A²) = 0.44 arcsec RMS of a
    # difference of the two, and 0.2 of noise; 0.52 measured. Without its knowledge no method is far below.
    assert 0.35 < found.rmse_arcsec < 0.75
    assert np.all(yardstick.error_arcsec(np.array([0.0]), np.array([33.0])) == 0.0)


def test_the_datum_drifts_as_the_joints_thermal_terms_say(
    joint: SimulatedJoint, readings: TrainingReadings
) -> None:
    # E(0, T) in closed form: the terms' amplitudes and phases of the shipped joint, independent of the simulator.
    tau = (np.linspace(readings.temperature_c.min(), readings.temperature_c.max(), 61) - 20.0) / 20.0
    linear = 7.14 * np.cos(np.radians(81)) + 0.6 * np.cos(np.radians(40)) + 0.2 * np.cos(np.radians(160))
    at_datum = linear * tau + 0.8 * np.cos(np.radians(150)) * tau**2
    assert datum_drift_arcsec(joint, readings) == pytest.approx(float(np.std(at_datum)), rel=1e-6)
