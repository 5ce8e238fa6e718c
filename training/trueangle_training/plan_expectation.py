"""What a plan may be expected to give: simulated campaigns on a described joint, fitted by `linear`.

Where no joint is described: what the orders of the shipped example joint that the plan cannot see would leave.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Plan
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.dataset import training_set
from trueangle_training.documents import load_joint
from trueangle_training.evaluation.truth import true_error
from trueangle_training.methods import UnsuitableReadingsError
from trueangle_training.methods.registry import load_method
from trueangle_training.methods.separable import harmonics
from trueangle_training.plan_design import one_temperature, orders_seen
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint

Floats = NDArray[np.float64]

METHOD = "linear"
ANGLE_STEP_DEG = 0.5
"""Fine enough for every order that a joint shows; ten times coarser than for a comparison of methods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """The true error of the corrected angle over the turn and the plan's temperatures, over noise seeds."""

    rmse_arcsec: float
    """Median over seeds."""
    lowest_arcsec: float
    highest_arcsec: float
    """RMSE of the luckiest and of the unluckiest seed."""
    largest_arcsec: float
    """Median over seeds of the largest error on the grid."""
    seeds: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenError:
    """What orders that a plan cannot see do to the corrected angle, from the datum, without noise."""

    above_rms_arcsec: float
    """Of the joint's orders that the plan does not see, together."""
    rmse_arcsec: float
    """Of the corrected angle over the turn: they are missing between the faces, and taken for lower ones."""


def unseen_error(error_arcsec: Callable[[Floats], Floats], plan: Plan) -> UnseenError:
    """Least squares of the orders that the plan sees, through noise-free readings at its stops.

    `error_arcsec` is the joint's error over angle in deg, shape [n], at one temperature.
    """
    mountings = {round(setup.offset_faces % 1.0, 6): setup for setup in one_temperature(plan)}
    stops_deg = [setup.stop_deg(plan.faces) for setup in mountings.values()]
    orders = tuple(range(1, orders_seen(plan).highest + 1))
    angle_deg = np.concatenate(stops_deg)
    zeros = np.kron(np.eye(len(stops_deg)), np.ones((plan.faces, 1)))
    design = np.concatenate([harmonics(angle_deg, orders), zeros], axis=1)
    solution = np.linalg.lstsq(design, error_arcsec(angle_deg), rcond=None)[0][: 2 * len(orders)]
    turn_deg = np.arange(0.0, DEG_PER_TURN, ANGLE_STEP_DEG)
    error = error_arcsec(turn_deg)
    off = harmonics(turn_deg, orders) @ solution - error
    spectrum = np.abs(np.fft.rfft(error)) / turn_deg.size
    above = float(np.sqrt(2.0 * np.sum(spectrum[len(orders) + 1 :] ** 2)))
    return UnseenError(above_rms_arcsec=above, rmse_arcsec=float(np.sqrt(np.mean((off - off[0]) ** 2))))


def example_joint() -> SimulatedJoint:
    """The shipped one, with orders 12 to 20 of 0.25 to 0.07 arcsec."""
    example = resources.files("trueangle_training.examples").joinpath("joint.yaml")
    with resources.as_file(example) as path:
        return simulated_joint(load_joint(path))


def expected_true_error(
    joint: SimulatedJoint, plan: Plan, *, seeds: range, progress: Callable[[], None] = lambda: None
) -> Expectation | str:
    """The median over noise seeds; a text where the plan does not suit the method: what it lacks."""
    rmse, largest = [], []
    for seed in seeds:
        campaign = simulate_campaign(joint, plan, seed)
        data = training_set(campaign, base_temperature_c=None, faces=plan.faces, free_offsets=True)
        try:
            model = load_method(METHOD).fit(data.readings).model
        except UnsuitableReadingsError as error:
            return "; ".join(str(fault) for fault in error.faults)
        truth = true_error(model, joint, data.readings, angle_step_deg=ANGLE_STEP_DEG)
        rmse.append(truth.rmse_arcsec)
        largest.append(truth.largest_arcsec)
        progress()
    return Expectation(
        rmse_arcsec=float(np.median(rmse)),
        lowest_arcsec=min(rmse),
        highest_arcsec=max(rmse),
        largest_arcsec=float(np.median(largest)),
        seeds=len(rmse),
    )
