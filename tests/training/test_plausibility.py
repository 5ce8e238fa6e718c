"""What is refused although the training itself went well."""

from pathlib import Path

import numpy as np
import pytest

import trueangle_training.examples
from trueangle.contract.errors import ContractError
from trueangle_training.dataset import TrainingSet, training_set
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.plausibility import check_model
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint

EXAMPLES = Path(trueangle_training.examples.__file__).parent


class Curve:
    """An error model given by a formula."""

    def __init__(self, truth: SimulatedJoint, extra_arcsec: float, order: int) -> None:
        self._truth, self._extra_arcsec, self._order = truth, extra_arcsec, order

    def error_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
        true = self._truth.error_from_datum_arcsec(angle_deg, temperature_c, 0.0)
        return true + self._extra_arcsec * np.sin(np.radians(self._order * angle_deg))


@pytest.fixture(scope="module")
def truth() -> SimulatedJoint:
    return simulated_joint(load_joint(EXAMPLES / "joint.yaml"))


@pytest.fixture(scope="module")
def data(truth: SimulatedJoint) -> TrainingSet:
    campaign = simulate_campaign(truth, load_plan(EXAMPLES / "plan.yaml"), 1)
    return training_set(campaign, base_temperature_c=20.0, parameters=81, validation_fraction=0.1)


def test_the_true_curve_is_plausible(data: TrainingSet, truth: SimulatedJoint) -> None:
    check_model(Curve(truth, 0.0, 1), data, source="CALIBRATION.csv")


def test_a_model_that_swings_between_the_readings_is_refused(data: TrainingSet, truth: SimulatedJoint) -> None:
    # Order 23 vanishes on all 23 faces (within the 30" that the stops are off): the residuals cannot show it.
    with pytest.raises(ContractError, match="inside the valid ranges"):
        check_model(Curve(truth, 200.0, 23), data, source="CALIBRATION.csv")


def test_a_model_that_explains_nothing_is_refused(data: TrainingSet, truth: SimulatedJoint) -> None:
    with pytest.raises(ContractError, match="leaves less than half of the raw error"):
        check_model(Curve(truth, 60.0, 1), data, source="CALIBRATION.csv")


def test_a_model_that_is_not_a_number_is_refused(data: TrainingSet, truth: SimulatedJoint) -> None:
    with pytest.raises(ContractError, match="nan"):
        check_model(Curve(truth, np.nan, 1), data, source="CALIBRATION.csv")
