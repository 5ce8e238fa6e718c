"""From the configuration to what each node is asked to send: TPDOs, polled objects, proofs of life.

Rules of this file: one plan a node, whatever it serves: the encoder of one joint, temperatures of any number of
joints. TPDO 1 holds the position; temperatures follow, those of one trigger packed together.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from trueangle.config import DaemonConfig, JointConfig, Supervision, TemperatureConfig, TpdoConfig
from trueangle.config.nodes import ANALOGUE_INPUTS
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.transmission import Trigger
from trueangle.core.frames import (
    POSITION_OBJECT,
    ExpectedValue,
    MappedObject,
    NodePlan,
    PolledObject,
    Quantity,
    TpdoPlan,
)

TPDO_BASES = (0x180, 0x280, 0x380, 0x480)
"""COB-IDs of the pre-defined connection set, plus the node-id (CiA 301, 7.3.3)."""
MAX_TPDO_BITS = 64
DECIMAL_DIGITS = 0x6132
"""CiA 404, decimal digits of the process value."""
ANALOGUE_INTERRUPT = 0x6423
"""CiA 401, global interrupt enable: without it, as by default, no change of an analogue input is sent."""


def node_plan(joint: JointConfig) -> NodePlan:
    """The plan of this joint's encoder as if no other joint shared the bus."""
    return _plan(joint.node_id, joint, [joint] if _temperature_node(joint) == (joint.bus, joint.node_id) else [])


def node_plans(joints: Iterable[JointConfig], bus: str) -> list[NodePlan]:
    """The plans of all nodes of this bus, the encoders' first; ContractError where a node has too few TPDOs."""
    joints = tuple(joints)
    here = [joint for joint in joints if joint.bus == bus]
    encoders = {joint.node_id: joint for joint in here}
    warm: dict[int, list[JointConfig]] = {}
    for joint in joints:
        sensor_bus, node_id = _temperature_node(joint)
        if sensor_bus == bus:
            warm.setdefault(node_id, []).append(joint)
    node_ids = dict.fromkeys((*encoders, *warm))
    plans = [_plan(node_id, encoders.get(node_id), warm.get(node_id, [])) for node_id in node_ids]
    return plans + [plan for joint in here for plan in head_plans(joint)]


def head_plans(joint: JointConfig) -> list[NodePlan]:
    """The plans of the joint's further reading heads: set up as its own node is, without the temperature."""
    own = replace(joint, further_heads=())
    return [
        replace(_plan(head.node_id, replace(own, node_id=head.node_id, encoder=head.encoder), []), head=number)
        for number, head in enumerate(joint.further_heads, start=1)
    ]


def plan_faults(config: DaemonConfig, *, source: str) -> list[Fault]:
    """What no node could be set up to do."""
    faults: list[Fault] = []
    for bus in config.buses:
        try:
            node_plans(config.joints, bus.name)
        except ContractError as error:
            faults += [
                Fault(where=f"{source}, {fault.where}", expected=fault.expected, found=fault.found)
                for fault in error.faults
            ]
    return faults


def _temperature_node(joint: JointConfig) -> tuple[str, int]:
    """Bus and node-id of the node that measures the joint's temperature."""
    config = joint.temperature
    return config.bus or joint.bus, joint.node_id if config.node_id is None else config.node_id


def _plan(node_id: int, encoder: JointConfig | None, warm: Iterable[JointConfig]) -> NodePlan:
    # The encoder's own temperature first: its COB-ID does not depend on other joints.
    warm = sorted(warm, key=lambda joint: joint is not encoder)
    served = [encoder] if encoder is not None else warm
    tpdos: list[TpdoPlan] = []
    if encoder is not None:
        tpdos.append(_tpdo(1, node_id, encoder.tpdo, 1, _position(encoder)))
    packed = _packed(warm, own_slot=None if encoder is None else encoder.slot)
    free = TPDO_BASES[len(tpdos) :]
    if len(packed) > len(free):
        expected = f"temperatures that fit into {len(free)} frames of 8 bytes"
        raise ContractError([Fault(where=f"node {node_id}", expected=expected, found=f"{len(packed)} frames")])
    for trigger, every_syncs, mapping in packed:
        tpdos.append(_tpdo(len(tpdos) + 1, node_id, trigger, every_syncs, mapping))
    return NodePlan(
        slot=None if encoder is None else encoder.slot,
        node_id=node_id,
        tpdos=tuple(tpdos),
        heartbeat_ms=min(joint.heartbeat_ms for joint in served),
        polled=any(joint.supervision is Supervision.POLL for joint in served),
        as_found=any(not joint.configure for joint in served),
        polls=tuple(polled for joint in warm for polled in _polls(joint, encoder)),
        expected=tuple(wanted for joint in warm for wanted in _expected(joint.temperature)),
    )


def _tpdo(
    number: int, node_id: int, sent: TpdoConfig, every_syncs: int, mapping: tuple[MappedObject, ...]
) -> TpdoPlan:
    by_sync = sent.trigger is Trigger.SYNC
    return TpdoPlan(
        number=number,
        cob_id=TPDO_BASES[number - 1] + node_id,
        transmission_type=every_syncs if by_sync else sent.transmission_type,
        mapping=mapping,
        event_timer_ms=sent.period_ms,
    )


def _position(joint: JointConfig) -> tuple[MappedObject, ...]:
    index, subindex = POSITION_OBJECT
    mapped = [MappedObject(index=index, subindex=subindex, bits=32, quantity=Quantity.POSITION)]
    beside = ((joint.sequence, Quantity.SEQUENCE), (joint.encoder.reference, Quantity.REFERENCE))
    for config, quantity in beside:
        if config is not None:
            mapped.append(
                MappedObject(index=config.index, subindex=config.subindex, bits=config.bits, quantity=quantity)
            )
    return tuple(mapped)


def _temperature(joint: JointConfig, slot: int | None) -> MappedObject:
    config = joint.temperature
    return MappedObject(
        index=config.index,
        subindex=config.subindex,
        bits=config.bits,
        quantity=Quantity.TEMPERATURE,
        signed=config.signed,
        slot=slot,
    )


def _status(joint: JointConfig, slot: int | None) -> MappedObject | None:
    config = joint.temperature.status
    if config is None:
        return None
    return MappedObject(
        index=config.index,
        subindex=config.subindex,
        bits=config.bits,
        quantity=Quantity.TEMPERATURE_STATUS,
        slot=slot,
    )


def _packed(
    warm: Sequence[JointConfig], *, own_slot: int | None
) -> list[tuple[TpdoConfig, int, tuple[MappedObject, ...]]]:
    """Mapped temperatures, of one trigger packed together; the encoder's own joint has its frame to itself."""
    frames: list[tuple[tuple[bool, TpdoConfig, int], list[MappedObject]]] = []
    for joint in warm:
        config = joint.temperature
        own = joint.slot == own_slot
        slot = None if own else joint.slot
        mapping = [] if config.poll_ms is not None else [_temperature(joint, slot)]
        status = _status(joint, slot)
        if status is not None and config.status is not None and config.status.poll_ms is None:
            mapping.append(status)
        if not mapping:
            continue
        kind = (own, config.tpdo, config.every_syncs)
        bits = sum(mapped.bits for mapped in mapping)
        for there, filled in frames:
            if there == kind and bits + sum(mapped.bits for mapped in filled) <= MAX_TPDO_BITS:
                filled += mapping
                break
        else:
            frames.append((kind, mapping))
    return [(kind[1], kind[2], tuple(mapping)) for kind, mapping in frames]


def _polls(joint: JointConfig, encoder: JointConfig | None) -> list[PolledObject]:
    """What is read by SDO: what cannot be mapped, and the first value of a sensor that tells only of changes."""
    config = joint.temperature
    slot = None if encoder is not None and encoder.slot == joint.slot else joint.slot
    by_change = config.tpdo.trigger is Trigger.EVENT
    polls: list[PolledObject] = []
    status = _status(joint, slot)
    if status is not None and config.status is not None and (by_change or config.status.poll_ms is not None):
        polls.append(PolledObject(value=status, period_ms=config.status.poll_ms))
    if by_change or config.poll_ms is not None:
        polls.append(PolledObject(value=_temperature(joint, slot), period_ms=config.poll_ms))
    return polls


def _expected(config: TemperatureConfig) -> list[ExpectedValue]:
    expected: list[ExpectedValue] = []
    if config.digits is not None:
        meaning = f"decimal digits of a temperature with degc_per_unit {config.degc_per_unit:g}"
        expected.append(
            ExpectedValue(index=DECIMAL_DIGITS, subindex=config.subindex, value=config.digits, meaning=meaning)
        )
    if config.index in ANALOGUE_INPUTS and config.tpdo.trigger is Trigger.EVENT and config.poll_ms is None:
        meaning = "analogue inputs that send their changes"
        expected.append(ExpectedValue(index=ANALOGUE_INTERRUPT, subindex=0, value=1, meaning=meaning))
    return expected
