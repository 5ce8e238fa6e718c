"""The daemon's configuration: one YAML file, typed and checked as a whole before anything is opened.

Every fault is reported with file and line; unknown keys are faults. Units stand in the key names.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import yaml

from trueangle.config.joints import (
    EncoderConfig,
    JointConfig,
    MotionConfig,
)
from trueangle.config.modbus import ModbusConfig, Parity, Right, RtuConfig, TlsConfig
from trueangle.config.nodes import (
    ENCODER_PROFILE,
    BusConfig,
    Supervision,
    TemperatureConfig,
    TpdoConfig,
)
from trueangle.contract.document import Pattern, Range, read_document, structure
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.transmission import Trigger

__all__ = [
    "BusConfig",
    "DaemonConfig",
    "EncoderConfig",
    "JointConfig",
    "MetricsConfig",
    "ModbusConfig",
    "MotionConfig",
    "Parity",
    "RecordConfig",
    "Right",
    "RtuConfig",
    "Supervision",
    "TemperatureConfig",
    "TlsConfig",
    "TpdoConfig",
    "load_config",
    "parse_config",
]

SCHEMA_VERSION = 1
MAX_CONFIG_BYTES = 200_000
"""32 joints with every key take 30 kB; parsing more would only take time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConfig:
    """Recording inside the daemon: one CSV file after the other for each joint, bounded in total."""

    directory: Annotated[str, Pattern(regex=r"/.*", meaning="an absolute path")]
    """It must exist and be writable by the service."""
    max_bytes: Annotated[int, Range(minimum=100_000, maximum=10**13)] = 1_000_000_000
    """Of all recorded files together; the oldest is deleted first."""
    rotate_bytes: Annotated[int, Range(minimum=10_000, maximum=10**12)] = 20_000_000
    rotate_s: Annotated[float, Range(minimum=1, maximum=31_622_400)] | None = None
    """A new file at least this often; left out: by size alone."""
    joints: tuple[str, ...] = ()
    """Names; left out: every joint."""
    every_ms: Annotated[int, Range(minimum=10, maximum=3_600_000)] = 100

    def __post_init__(self) -> None:
        if 2 * self.rotate_bytes > self.max_bytes:
            expected = f"at most half of max_bytes ({self.max_bytes})"
            raise ContractError([Fault(where="rotate_bytes", expected=expected, found=str(self.rotate_bytes))])


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsConfig:
    """Metrics for Prometheus, over plain HTTP: whoever reaches the port reads them."""

    host: str = "127.0.0.1"
    port: Annotated[int, Range(minimum=0, maximum=65535)]
    """0 takes a free one and logs it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonConfig:
    """The whole configuration file."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    buses: tuple[BusConfig, ...]
    joints: tuple[JointConfig, ...]
    modbus: ModbusConfig = field(default_factory=ModbusConfig)
    record: RecordConfig | None = None
    metrics: MetricsConfig | None = None
    """Left out: none are served."""
    state_directory: str | None = None
    """Where presets are kept; left out: systemd's StateDirectory=, and nowhere without it."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        if not self.buses:
            faults.append(Fault(where="buses", expected="at least one bus", found="none"))
        if not self.joints:
            faults.append(Fault(where="joints", expected="at least one joint", found="none"))
        faults += _repeated("buses", "name", [bus.name for bus in self.buses], "a name of its own")
        faults += _repeated("joints", "name", [j.name for j in self.joints], "a name of its own")
        slots = [j.slot for j in self.joints]
        faults += _repeated("joints", "slot", slots, "registers of its own")
        nodes = [f"node {j.node_id} on bus {j.bus}" for j in self.joints]
        faults += _repeated("joints", "node_id", nodes, "a node of its own")
        faults += _heads_on_taken_nodes(self.joints)
        faults += _heads_on_other_buses(self.joints)
        faults += _sensors_that_cannot_be(self.joints, {bus.name for bus in self.buses})
        ways = [f"{bus.interface} {bus.channel} {dict(bus.options)}" for bus in self.buses]
        faults += _repeated("buses", "channel", ways, "a bus of its own")
        names = {bus.name for bus in self.buses}
        periods = {bus.name: bus.sync_period_ms for bus in self.buses}
        for i, joint in enumerate(self.joints):
            if joint.bus not in names:
                expected = f"one of the buses: {', '.join(sorted(names))}"
                faults.append(Fault(where=f"joints[{i}].bus", expected=expected, found=joint.bus))
            period_ms = periods.get(joint.bus) if joint.tpdo.trigger is Trigger.SYNC else None
            if period_ms is not None and joint.stale_ms <= period_ms:
                expected = f"more than the sync_period_ms of its bus ({period_ms:g})"
                where = f"joints[{i}].stale_ms"
                faults.append(Fault(where=where, expected=expected, found=f"{joint.stale_ms:g}"))
        faults += _unknown_recorded(self.record, {joint.name for joint in self.joints})
        if faults:
            raise ContractError(faults)


def _heads_on_taken_nodes(joints: tuple[JointConfig, ...]) -> list[Fault]:
    faults: list[Fault] = []
    taken = {(joint.bus, joint.node_id) for joint in joints}
    for i, joint in enumerate(joints):
        for k, head in enumerate(joint.further_heads):
            if (joint.bus, head.node_id) in taken:
                where = f"joints[{i}].further_heads[{k}].node_id"
                found = f"{head.node_id}, which is another head's"
                faults.append(Fault(where=where, expected="a node of its own", found=found))
            taken.add((joint.bus, head.node_id))
    return faults


def _heads_on_other_buses(joints: tuple[JointConfig, ...]) -> list[Fault]:
    """Heads are averaged over one sample, and only one SYNC makes two nodes sample at one time."""
    return [
        Fault(
            where=f"joints[{i}].further_heads[{k}].bus",
            expected=f"the joint's own bus, {joint.bus}: heads on two buses have no SYNC in common, so the angles "
            "that would be averaged are not of one moment",
            found=head.bus,
        )
        for i, joint in enumerate(joints)
        for k, head in enumerate(joint.further_heads)
        if head.bus not in (None, joint.bus)
    ]


def _sensors_that_cannot_be(joints: tuple[JointConfig, ...], buses: set[str]) -> list[Fault]:
    """Temperatures on a bus that is not there, of a further reading head, in an object that an encoder has."""
    faults: list[Fault] = []
    encoders = {(joint.bus, joint.node_id) for joint in joints}
    heads = {(joint.bus, head.node_id) for joint in joints for head in joint.further_heads}
    for i, joint in enumerate(joints):
        sensor = joint.temperature
        if sensor.bus is not None and sensor.bus not in buses:
            expected = f"one of the buses: {', '.join(sorted(buses))}"
            faults.append(Fault(where=f"joints[{i}].temperature.bus", expected=expected, found=sensor.bus))
        if (sensor.bus or joint.bus, sensor.node_id) in heads:
            expected = "a node that is no further reading head: of those only the position is read"
            where = f"joints[{i}].temperature.node_id"
            faults.append(Fault(where=where, expected=expected, found=str(sensor.node_id)))
        if sensor.index in ENCODER_PROFILE and (sensor.bus or joint.bus, sensor.node_id) in encoders:
            expected = f"the object of a temperature: node {sensor.node_id} is an encoder"
            found = f"0x{sensor.index:04X}, an object of the encoder profile CiA 406"
            faults.append(Fault(where=f"joints[{i}].temperature.index", expected=expected, found=found))
    return faults


def _unknown_recorded(record: RecordConfig | None, names: set[str]) -> list[Fault]:
    expected = f"one of the joints: {', '.join(sorted(names))}"
    return [
        Fault(where=f"record.joints[{i}]", expected=expected, found=name)
        for i, name in enumerate(() if record is None else record.joints)
        if name not in names
    ]


def _repeated(group: str, key: str, values: list[str] | list[int], expected: str) -> list[Fault]:
    return [
        Fault(
            where=f"{group}[{i}].{key}",
            expected=expected,
            found=f"{value}, which is also that of {group}[{values.index(value)}]",  # pyright: ignore[reportArgumentType]
        )
        for i, value in enumerate(values)
        if values.index(value) < i  # pyright: ignore[reportArgumentType]
    ]


def parse_config(text: str, *, source: str) -> DaemonConfig:
    """The configuration in this YAML text; ContractError with every fault, by file and line."""
    document = read_document(text, source=source, loader=yaml.SafeLoader, syntax_error=yaml.YAMLError)
    return structure(DaemonConfig, document)


def load_config(path: Path) -> DaemonConfig:
    """The configuration file; ContractError also where it cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_CONFIG_BYTES + 1)
        if len(data) > MAX_CONFIG_BYTES:
            found = "a larger file"
            raise ContractError(
                [Fault(where=str(path), expected=f"at most {MAX_CONFIG_BYTES} bytes", found=found)]
            )
        text = data.decode("utf-8-sig")
    except OSError as error:
        found = error.strerror or str(error)
        raise ContractError([Fault(where=str(path), expected="a readable file", found=found)]) from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        where = f"{path} line {line}"
        raise ContractError([Fault(where=where, expected="UTF-8 text", found="other bytes")]) from error
    return parse_config(text, source=str(path))
