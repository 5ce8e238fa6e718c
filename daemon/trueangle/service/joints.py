"""What the composition root makes of each joint: its checked model, what the master and the pipeline need of it.

Nothing here is kept: configuration and model files in, frozen values out. All of it may run in a worker thread
while the service goes on.
"""

import datetime
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trueangle.config import DaemonConfig, JointConfig, load_config
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Interval
from trueangle.contract.transmission import Trigger
from trueangle.core.health import Limits
from trueangle.core.pipeline import JointChannel
from trueangle.core.registers import JointIdentity
from trueangle.core.sample import SampleScale
from trueangle.edges.can_bus import bus_faults
from trueangle.edges.can_master.eds import eds_objections, load_eds
from trueangle.edges.onnx_model import OnnxModel, load_model
from trueangle.process_data import node_plan, plan_faults
from trueangle.serving_settings import count_differences, served_as_configured

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedJoint:
    """One joint of the configuration with its checked model."""

    config: JointConfig
    model: OnnxModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Loaded:
    """A configuration that may be served: the file was legal, every model was replayed."""

    config: DaemonConfig
    joints: tuple[LoadedJoint, ...]


def load(path: Path) -> Loaded:
    """The configuration file with all its models; ContractError with the faults of the first step that has any."""
    config = load_config(path)
    check_buses(config, source=str(path))
    return Loaded(config=config, joints=load_joints(config, base=path.parent, source=str(path)))


def state_directory(config: DaemonConfig, environment: Mapping[str, str]) -> Path | None:
    """Where state outlives the process: as configured, else the first of $STATE_DIRECTORY; None: nowhere."""
    if config.state_directory is not None:
        return Path(config.state_directory)
    first = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(first) if first else None


def check_buses(config: DaemonConfig, *, source: str) -> None:
    """ContractError where a bus can never be opened as it is configured; a bus that is only absent is no fault."""
    faults: list[Fault] = []
    for i, bus in enumerate(config.buses):
        faults += bus_faults(bus, where=f"{source}, buses[{i}]")
    faults += plan_faults(config, source=source)
    if faults:
        raise ContractError(faults)


def load_joints(config: DaemonConfig, *, base: Path, source: str) -> tuple[LoadedJoint, ...]:
    """Load and check every model file of the configuration; ContractError with the faults of all of them.

    Model paths are relative to `base`, the configuration file's directory.
    """
    faults = _data_sheet_faults(config, base)
    loaded: list[LoadedJoint] = []
    for i, joint in enumerate(config.joints):
        try:
            model = load_model(base / joint.model, pinned_sha256=joint.model_sha256)
        except ContractError as error:
            faults += error.faults
            continue
        faults += _model_against_config(model, joint, f"{source}, joints[{i}]")
        loaded.append(LoadedJoint(config=joint, model=model))
    faults += _models_used_twice(loaded, source)
    if faults:
        raise ContractError(faults)
    return tuple(loaded)


def _data_sheet_faults(config: DaemonConfig, base: Path) -> list[Fault]:
    """Data sheets that cannot be read; where one disagrees with the plan, the node itself has the last word."""
    faults: list[Fault] = []
    for joint in config.joints:
        if joint.eds is None:
            continue
        try:
            sheet = load_eds(base / joint.eds, joint.node_id)
        except ContractError as error:
            faults += error.faults
            continue
        for objection in eds_objections(node_plan(joint), sheet):
            _log.warning("event=eds_disagrees joint=%r eds=%s reason=%r", joint.name, joint.eds, objection)
    return faults


def _models_used_twice(loaded: list[LoadedJoint], source: str) -> list[Fault]:
    """A model belongs to one encoder on one shaft: on a second joint it is the wrong one."""
    faults: list[Fault] = []
    first: dict[str, str] = {}
    for joint in loaded:
        name = joint.config.name
        if joint.model.sha256 in first:
            found = f"{joint.config.model} is also that of {first[joint.model.sha256]}"
            faults.append(Fault(where=f"{source}, joint {name}", expected="a model of its own", found=found))
        first.setdefault(joint.model.sha256, name)
    return faults


def _model_against_config(model: OnnxModel, joint: JointConfig, where: str) -> list[Fault]:
    """Model and configuration must mean the same encoder."""
    encoder = model.metadata.encoder
    faults: list[Fault] = []
    if encoder is not None and encoder.counts_per_rev != joint.encoder.counts_per_rev:
        expected = f"counts_per_rev {encoder.counts_per_rev} as at the calibration of {joint.model}"
        faults.append(Fault(where=where, expected=expected, found=str(joint.encoder.counts_per_rev)))
    configured = joint.encoder.settings.known()
    for name, value in model.metadata.encoder_settings.known().items():
        if name in configured and configured[name] != value:
            expected = f"{name} {value} as at the calibration of {joint.model}"
            faults.append(Fault(where=where, expected=expected, found=str(configured[name])))
    return faults


def encoder_differences(joint: LoadedJoint, found: EncoderSettings) -> list[str]:
    """Why this encoder must not be corrected with this model; empty where it may."""
    differences = count_differences(joint.config.encoder, found)
    for expected in (joint.config.encoder.settings, joint.model.metadata.encoder_settings):
        differences += [text for text in found.differences_from(expected) if text not in differences]
    return differences


def joint_channel(joint: LoadedJoint) -> JointChannel:
    """What the pipeline needs of a joint."""
    config, metadata = joint.config, joint.model.metadata
    channel = JointChannel(
        slot=config.slot,
        bus=config.bus,
        plan=node_plan(config),
        scale=SampleScale(
            counts_per_rev=config.encoder.counts_per_rev,
            degc_per_unit=config.temperature.degc_per_unit,
            offset_c=config.temperature.offset_c,
            sequence_modulus=None if config.sequence is None else 1 << config.sequence.bits,
            temperature_by_change=config.temperature.by_change,
            synchronous=config.tpdo.trigger is Trigger.SYNC,
            position_period_ms=config.tpdo.period_ms if config.tpdo.trigger is Trigger.TIMER else None,
        ),
        limits=Limits(
            stale_ms=config.stale_ms,
            temperature_stale_s=config.temperature.stale_s,
            sensor_range_c=Interval(minimum=config.temperature.minimum_c, maximum=config.temperature.maximum_c),
            model_angle_deg=metadata.valid_angle_deg,
            model_temperature_c=metadata.valid_temperature_c,
        ),
        model=joint.model,
        temperature_node=config.temperature.node_id,
        temperature_bus=config.temperature.bus,
        temperature_has_status=config.temperature.status is not None,
    )
    return served_as_configured(channel, config, metadata.calibration)


def joint_identity(joint: LoadedJoint) -> JointIdentity:
    """What the registers say of joint, model and encoder."""
    calibration = joint.model.metadata.calibration
    settings = joint.model.metadata.encoder_settings
    return JointIdentity(
        slot=joint.config.slot,
        node_id=joint.config.node_id,
        model_id=bytes.fromhex(joint.model.sha256)[:8],
        calibration_date=datetime.date.fromisoformat(calibration.date),
        calibration_due=None if calibration.due is None else datetime.date.fromisoformat(calibration.due),
        vendor_id=settings.vendor_id,
        product_code=settings.product_code,
        revision_number=settings.revision_number,
        serial_number=settings.serial_number,
    )
