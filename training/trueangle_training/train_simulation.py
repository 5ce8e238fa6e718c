"""A campaign to train on from a joint that is only described, for `trueangle train --from-simulator`."""

from dataclasses import replace
from pathlib import Path

from trueangle.contract.calibration import Campaign
from trueangle.contract.document import Node
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import SCHEMA_VERSION, Joint, Plan, ReferenceKind
from trueangle_training.documents import load_plan
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.effect import Nature, Stage
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

TEMPERATURES_C = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
REPEATS = 3
SHOWN_TO_THE_MODEL = "temperature_sensor_error"
NOTE = "trained in simulation, not on a measurement: as good as the joint's description, see trueangle diagnose"


def simulated_calibration(joint: Joint, plan: Path | None, *, seed: int, source: Path) -> Campaign:
    """The campaign of the plan on the joint; without a plan, of one whose repeats are shifted.

    `source` is the joint's file, for messages. ContractError where joint or plan cannot be simulated.
    """
    faults: list[Fault] = []
    simulated = loaded = None
    learnable, left_out = without_unlearnable(joint)
    try:
        # All of the joint is looked at, so that a contradiction in what is left out is told as well.
        simulated_joint(joint)
        simulated = simulated_joint(learnable)
    except ContractError as error:
        faults += error.faults
    try:
        loaded = default_plan(joint, source) if plan is None else load_plan(plan)
    except ContractError as error:
        faults += error.faults
    if faults or simulated is None or loaded is None:
        raise ContractError(faults)
    campaign = simulate_campaign(simulated, loaded, max(seed, 0))
    return replace(campaign, source=f"simulation of {source}", notes=(*campaign.notes, NOTE, *left_out))


def without_unlearnable(joint: Joint) -> tuple[Joint, tuple[str, ...]]:
    """The joint without what a model of angle and temperature must not learn, and a note of it.

    The error of the polygon's faces would be taken off angles that are right, and hysteresis as it is upwards
    would be doubled downwards. Scatter stays: it is what a measured campaign would have. So does the temperature
    sensor's error: the model will be asked with what the same sensor shows.
    """
    kept: dict[str, Node] = {}
    reasons: list[str] = []
    for name, node in joint.effects.items():
        effect = EFFECTS[name]
        if effect.nature is Nature.MEAN and effect.missing_input is not None and name != SHOWN_TO_THE_MODEL:
            own = effect.stage is Stage.REFERENCE
            why = "the reference's own error" if own else f"it would need: {effect.missing_input}"
            reasons.append(f"{name} ({why})")
        else:
            kept[name] = node
    reference = replace(joint.reference, polygon_arcsec=0.0)
    if not reasons:
        return replace(joint, reference=reference), ()
    note = f"not simulated for training, so not corrected by the model: {', '.join(reasons)}"
    return replace(joint, reference=reference, effects=kept), (note,)


def default_plan(joint: Joint, source: Path) -> Plan:
    """Seven temperatures, three repeats shifted by a third of the joint's face pitch: higher orders are seen."""
    reference = joint.reference
    if reference.kind is not ReferenceKind.POLYGON or reference.faces is None:
        fault = Fault(
            where=f"{source}, reference.kind",
            expected="a polygon, or --plan PLAN.yaml beside --from-simulator",
            found=reference.kind.value,
            advice="say with --plan at which angles and temperatures the simulated joint is to be read",
        )
        raise ContractError([fault])
    return Plan(
        schema_version=SCHEMA_VERSION,
        faces=reference.faces,
        temperatures_c=TEMPERATURES_C,
        repeats=REPEATS,
        shift_faces=1.0 / REPEATS,
    )
