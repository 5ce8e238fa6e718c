"""What a plan may be expected to give: simulated campaigns on a described joint, fitted by `linear`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueangle.contract.joint import Plan
from trueangle_training.dataset import training_set
from trueangle_training.evaluation.truth import true_error
from trueangle_training.methods import UnsuitableReadingsError
from trueangle_training.methods.registry import load_method
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import SimulatedJoint

METHOD = "linear"
ANGLE_STEP_DEG = 0.5
"""Fine enough for every order that a joint shows; ten times coarser than for a comparison of methods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """The true error of the corrected angle over the turn and the plan's temperatures, means over seeds."""

    rmse_arcsec: float
    standard_error_arcsec: float | None
    """Of the mean over seeds; None: one seed."""
    largest_arcsec: float
    """Mean over seeds of the largest error on the grid."""
    seeds: int


def expected_true_error(
    joint: SimulatedJoint, plan: Plan, *, seeds: range, progress: Callable[[], None] = lambda: None
) -> Expectation | str:
    """The mean over noise seeds; a text where the plan does not suit the method: what it lacks."""
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
    spread = float(np.std(rmse, ddof=1) / len(rmse) ** 0.5) if len(rmse) > 1 else None
    return Expectation(
        rmse_arcsec=float(np.mean(rmse)),
        standard_error_arcsec=spread,
        largest_arcsec=float(np.mean(largest)),
        seeds=len(rmse),
    )
