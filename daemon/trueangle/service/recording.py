"""The recorder that a configuration asks for."""

from pathlib import Path

from trueangle.config import DaemonConfig
from trueangle.core.recording import RecordedJoint
from trueangle.edges.recorder import Recorder, RecordLimits


def recorded_joints(config: DaemonConfig) -> tuple[RecordedJoint, ...]:
    """The joints that are recorded: those named, else all."""
    names = () if config.record is None else config.record.joints
    return tuple(
        RecordedJoint(slot=joint.slot, name=joint.name)
        for joint in config.joints
        if not names or joint.name in names
    )


def recorder_of(config: DaemonConfig) -> Recorder | None:
    """None where nothing is to be recorded."""
    record = config.record
    if record is None:
        return None
    limits = RecordLimits(max_bytes=record.max_bytes, rotate_bytes=record.rotate_bytes, rotate_s=record.rotate_s)
    return Recorder(Path(record.directory), recorded_joints(config), limits, every_s=record.every_ms * 1e-3)
