"""Would `trueangle train` take a campaign of this plan? Asked before anybody measures for days."""

from dataclasses import replace

import numpy as np

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Plan, PlanZero
from trueangle_training.dataset import training_set
from trueangle_training.methods.coefficients import reduce_to_coefficients
from trueangle_training.simulator.schedule import run_setups

MOST_TEMPERATURES, MOST_REPEATS = 8, 4
"""More of them only add to what is known, and to the time that looking takes."""
ECCENTRICITY_ARCSEC, THERMAL_ARCSEC_PER_K, NOISE_ARCSEC = 50.0, 0.3, 0.5
"""Of a usual joint: whether readings suffice does not depend on what they show."""
SOURCE = "a campaign of this plan"


def training_obstacle(plan: Plan) -> str | None:
    """Why the training refuses it, as it would say so; None: it does not."""
    campaign = _made_up_campaign(_thinned(plan))
    try:
        data = training_set(campaign, base_temperature_c=None, faces=plan.faces, free_offsets=True)
        reduce_to_coefficients(data.readings)
    except ContractError as error:
        return "; ".join(str(fault) for fault in error.faults)
    return None


def _thinned(plan: Plan) -> Plan:
    """As few temperatures and repeats as show the same, the ends of the range among them."""
    count = len(plan.temperatures_c)
    kept = np.unique(np.linspace(0, count - 1, min(count, MOST_TEMPERATURES)).round().astype(np.int64))
    return replace(
        plan,
        temperatures_c=tuple(plan.temperatures_c[index] for index in kept.tolist()),
        repeats=min(plan.repeats, MOST_REPEATS),
    )


def _made_up_campaign(plan: Plan) -> Campaign:
    rng = np.random.default_rng(0)
    setups = tuple(run_setups(plan))
    angle_deg = np.concatenate([setup.stop_deg(plan.faces) for setup in setups])
    temperature_c = np.repeat([setup.temperature_c for setup in setups], plan.faces)
    run = np.repeat([setup.run for setup in setups], plan.faces).astype(np.int64)
    rad = np.radians(angle_deg)
    error_arcsec = ECCENTRICITY_ARCSEC * np.cos(rad) + THERMAL_ARCSEC_PER_K * temperature_c * np.sin(rad)
    error_arcsec = error_arcsec + rng.normal(0.0, NOISE_ARCSEC, angle_deg.size)
    return Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        run=run,
        zero_group=np.ones_like(run) if plan.zero is PlanZero.ONE else run,
        row=np.arange(2, run.size + 2, dtype=np.int64),
        source=SOURCE,
        sha256="",
        temperature_c=temperature_c,
    )
