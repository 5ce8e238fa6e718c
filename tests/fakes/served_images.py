"""Register images of a few joints, as the daemon would serve them."""

from collections.abc import Mapping

from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.health import ServiceBit
from trueangle.core.registers import JointState, RegisterImage, RegisterMap


def image_of(
    states: Mapping[int, JointState | None], *, cycle: int = 7, service: ServiceBit = ServiceBit.ALL_VALID
) -> RegisterImage:
    """One cycle with these joints by slot; None: a valid joint as `joint_state` has it."""
    made = RegisterMap([joint_identity(slot) for slot in states])
    full = {slot: joint_state() if state is None else state for slot, state in states.items()}
    return made.image(cycle=cycle, heartbeat=cycle, service_status=int(service), states=full)
