"""The daemon's configuration: one YAML file, typed and checked as a whole before anything is opened.

Every fault is reported with file and line; unknown keys are faults. Units stand in the key names.
"""

import enum
import ipaddress
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import yaml

from trueangle.contract.document import Pattern, Range, read_document, structure
from trueangle.contract.encoder import MAX_COUNTS_PER_REV, EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Hash
from trueangle.core.frames import Trigger

SCHEMA_VERSION = 1
MAX_SLOT = 32
MAX_CONFIG_BYTES = 200_000
"""32 joints with every key take 30 kB; parsing more would only take time."""

Name = Annotated[str, Pattern(regex=r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,31}", meaning="1 to 32 letters, digits, . _ -")]
Index = Annotated[int, Range(minimum=0x1000, maximum=0xFFFF)]
Subindex = Annotated[int, Range(minimum=0, maximum=254)]
_MAPPABLE_BITS = (8, 16, 32)
BAUDRATES = (1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600)
"""What serial lines and adapters run at."""


class Right(enum.Enum):
    """What a role may do over Modbus."""

    READ = "read"
    COMMAND = "command"
    """Read as well."""


class Parity(enum.Enum):
    """Parity of a serial line."""

    NONE = "none"
    EVEN = "even"
    ODD = "odd"


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsConfig:
    """Modbus/TCP Security: TLS 1.2 or later, and every client shows a certificate of `client_ca`.

    Files are relative to the configuration file; `credential:NAME` is taken from systemd ($CREDENTIALS_DIRECTORY).
    """

    certificate: str
    """PEM, with the intermediate certificates behind it."""
    private_key: str
    """PEM, not encrypted."""
    client_ca: str
    """PEM: the authorities whose client certificates are accepted."""
    host: str | None = None
    """Left out: that of the plain server."""
    port: Annotated[int, Range(minimum=0, maximum=65535)] = 802
    """Below 1024 a socket unit of systemd opens it, as the daemon has no capability."""
    roles: Mapping[str, Right] = field(default_factory=dict[str, Right])
    """Role in the certificate (OID 1.3.6.1.4.1.50316.802.1) to right. Empty: every accepted certificate may read.
    Otherwise a certificate without one of these roles may do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RtuConfig:
    """Modbus RTU on a serial line, beside TCP."""

    device: str
    baudrate: int = 19_200
    parity: Parity = Parity.EVEN
    stop_bits: Annotated[int, Range(minimum=1, maximum=2)] = 1
    unit_id: Annotated[int, Range(minimum=1, maximum=247)] = 1
    silence_ms: Annotated[float, Range(minimum=0.1, maximum=100)] | None = None
    """Longer than t3.5, for adapters that hand over a frame in pieces."""

    def __post_init__(self) -> None:
        if self.baudrate not in BAUDRATES:
            expected = f"one of {', '.join(str(rate) for rate in BAUDRATES)}"
            raise ContractError([Fault(where="baudrate", expected=expected, found=str(self.baudrate))])


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusConfig:
    """The Modbus servers. They only read unless `commands` is true; bind them to the PLC's network by choice."""

    host: str = "127.0.0.1"
    port: Annotated[int, Range(minimum=0, maximum=65535)] = 5020
    """0 takes a free port and logs it."""
    unit_id: Annotated[int, Range(minimum=1, maximum=247)] = 1
    """Answered beside 0 and 255."""
    max_connections: Annotated[int, Range(minimum=1, maximum=1000)] = 32
    max_connections_per_address: Annotated[int, Range(minimum=1, maximum=1000)] = 8
    idle_timeout_s: Annotated[float, Range(minimum=1, maximum=86400)] = 60.0
    allow: tuple[str, ...] = ()
    """Networks (192.0.2.0/24) and addresses that may connect; empty: all. It keeps out mistakes, not attackers."""
    plain_tcp: bool = True
    """False: no server without TLS."""
    tls: TlsConfig | None = None
    rtu: RtuConfig | None = None
    commands: bool = False
    """Preset, clear fault and reference angle, for peers whose role is mapped to command."""
    insecure_commands: bool = False
    """Commands also over plain TCP and RTU, from anybody who reaches them."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        for i, network in enumerate(self.allow):
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                expected = "an address or a network such as 192.0.2.0/24"
                faults.append(Fault(where=f"allow[{i}]", expected=expected, found=str(error)))
        if not self.plain_tcp and self.tls is None and self.rtu is None:
            faults.append(Fault(where="plain_tcp", expected="tls or rtu where it is false", found="no server"))
        if self.insecure_commands and not self.commands:
            faults.append(Fault(where="insecure_commands", expected="commands: true with it", found="false"))
        secure = self.tls is not None and Right.COMMAND in self.tls.roles.values()
        if self.commands and not secure and not self.insecure_commands:
            expected = "a role of tls.roles mapped to command, or insecure_commands: true"
            faults.append(Fault(where="commands", expected=expected, found="nobody who may command"))
        if faults:
            raise ContractError(faults)

    @property
    def networks(self) -> "tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]":
        """`allow`, parsed."""
        return tuple(ipaddress.ip_network(network) for network in self.allow)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConfig:
    """One CAN bus, opened through python-can."""

    name: Name
    interface: str
    """python-can's name of the interface: socketcan, socketcand, slcan, pcan, ..."""
    channel: str
    bitrate: Annotated[int, Range(minimum=10_000, maximum=1_000_000)] | None = None
    """Only where the interface sets it; SocketCAN's is set when the interface is brought up."""
    options: Mapping[str, str | int | float | bool] = field(default_factory=dict[str, str | int | float | bool])
    """Further arguments of the python-can interface, such as host and port of a socketcand."""
    sync_period_ms: Annotated[float, Range(minimum=0.5, maximum=10_000)] | None = None
    """The daemon sends SYNC at this period; left out, another node does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TpdoConfig:
    """What makes a node send a value."""

    trigger: Trigger = Trigger.SYNC
    """sync: with SYNC; timer: by its own event timer; event: on change, and by the event timer."""
    period_ms: Annotated[int, Range(minimum=1, maximum=65_535)] | None = None
    """The event timer, 0x1800:5 or 0x6200; the value is sent at the latest after so long."""
    transmission_type: Annotated[int, Range(minimum=254, maximum=255)] = 255
    """Of timer and event: 255 is the profile's own event, 254 the maker's."""

    def __post_init__(self) -> None:
        if self.trigger is Trigger.SYNC and self.period_ms is not None:
            expected = "no period with trigger sync"
            raise ContractError([Fault(where="period_ms", expected=expected, found=str(self.period_ms))])
        if self.trigger is Trigger.TIMER and self.period_ms is None:
            raise ContractError([Fault(where="trigger", expected="period_ms with trigger timer", found="none")])


class Supervision(enum.Enum):
    """How it is known that a node lives."""

    HEARTBEAT = "heartbeat"
    POLL = "poll"
    """It has no heartbeat (0x1017): it is asked by SDO."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureStatusConfig:
    """What the sensor's electronics say of the temperature: anything but 0 is a broken sensor."""

    index: Index
    """0x6150 of CiA 404."""
    subindex: Subindex
    bits: int = 8
    poll_ms: Annotated[int, Range(minimum=10, maximum=3_600_000)] | None = None
    """Read by SDO so often; left out, it is mapped beside the temperature."""

    def __post_init__(self) -> None:
        _check_bits(self.bits)


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureConfig:
    """The object that holds the joint's temperature: never guessed, CANopen knows no common one."""

    index: Index
    subindex: Subindex
    bits: int = 16
    signed: bool = True
    degc_per_unit: Annotated[float, Range(minimum=1e-9, maximum=1000)]
    """0.01 for CiA 404 with two decimal digits (0x6132 = 2)."""
    offset_c: float = 0.0
    every_syncs: Annotated[int, Range(minimum=1, maximum=240)] = 20
    """The node sends it with every that-many SYNC."""
    minimum_c: float = -55.0
    maximum_c: float = 125.0
    """A value outside is a broken sensor, not a temperature (defaults: range of the DS18B20)."""
    stale_s: Annotated[float, Range(minimum=0.01, maximum=3600)] = 10.0
    frozen_s: Annotated[float, Range(minimum=1, maximum=864_000)] | None = None
    """The very same raw value for longer is a frozen sensor; left out, not looked for."""
    max_rate_c_per_s: Annotated[float, Range(minimum=0.001, maximum=1000)] | None = None
    """A temperature that changes faster is a broken sensor; left out, not looked for."""
    node_id: Annotated[int, Range(minimum=1, maximum=127)] | None = None
    """The node on the joint's bus that measures it; left out, the encoder does."""
    tpdo: TpdoConfig = field(default_factory=TpdoConfig)
    poll_ms: Annotated[int, Range(minimum=10, maximum=3_600_000)] | None = None
    """Read by SDO so often instead of being mapped: for units that cannot map it."""
    status: TemperatureStatusConfig | None = None
    check_digits: bool = True
    """Compare degc_per_unit with the node's decimal digits, 0x6132 (index 0x7130 or 0x9130 of CiA 404)."""

    def __post_init__(self) -> None:
        _check_bits(self.bits)
        polled = [("poll_ms", self.poll_ms)]
        polled += [("status.poll_ms", self.status.poll_ms)] if self.status is not None else []
        for where, poll_ms in polled:
            if poll_ms is not None and self.stale_s * 1000 <= poll_ms:
                expected = f"less than stale_s ({self.stale_s:g} s)"
                raise ContractError([Fault(where=where, expected=expected, found=f"{poll_ms} ms")])
        if self.digits is not None and not math.isclose(self.degc_per_unit, 10.0**-self.digits):
            expected = "1, 0.1, 0.01, ... as CiA 404 has it, or check_digits: false"
            raise ContractError([Fault(where="degc_per_unit", expected=expected, found=f"{self.degc_per_unit:g}")])
        if 0x6000 <= self.index <= 0x65FF:
            found = f"0x{self.index:04X}, an object of the encoder profile CiA 406"
            raise ContractError([Fault(where="index", expected="the object of a temperature", found=found)])
        if self.maximum_c <= self.minimum_c:
            expected = f"more than minimum_c ({self.minimum_c:g})"
            raise ContractError([Fault(where="maximum_c", expected=expected, found=f"{self.maximum_c:g}")])

    @property
    def digits(self) -> int | None:
        """The decimal digits that the node must have in 0x6132 (CiA 404); None: not to be compared."""
        if not self.check_digits or self.index not in (0x7130, 0x9130):
            return None
        return max(0, round(-math.log10(self.degc_per_unit)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceConfig:
    """An optional manufacturer object that counts the samples, mapped beside the position: shows lost frames."""

    index: Index
    subindex: Subindex
    bits: int = 16

    def __post_init__(self) -> None:
        _check_bits(self.bits)


def _check_bits(bits: int) -> None:
    if bits not in _MAPPABLE_BITS:
        raise ContractError([Fault(where="bits", expected="8, 16 or 32", found=str(bits))])


@dataclass(frozen=True, slots=True, kw_only=True)
class GearRatioConfig:
    """So many turns of the encoder's shaft are so many turns of the joint."""

    motor_turns: Annotated[int, Range(minimum=1, maximum=1_000_000)]
    joint_turns: Annotated[int, Range(minimum=1, maximum=1_000_000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceConfig:
    """The object by which an encoder without an absolute zero tells that it has passed its reference."""

    index: Index
    subindex: Subindex
    bits: int = 8
    mask: Annotated[int, Range(minimum=1, maximum=0xFFFF_FFFF)] = 1
    """Any of these bits set: passed."""

    def __post_init__(self) -> None:
        _check_bits(self.bits)


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderConfig:
    """The encoder expected at this node; what is left out is not compared."""

    counts_per_rev: Annotated[int, Range(minimum=2, maximum=MAX_COUNTS_PER_REV)]
    settings: EncoderSettings = field(default_factory=EncoderSettings)
    direction: Annotated[int, Range(minimum=-1, maximum=1)] = 1
    """-1: the joint's angle grows where the counts fall. As at the calibration: it turns the model's input."""
    gear_ratio: GearRatioConfig | None = None
    """Where the encoder sits on the motor. As at the calibration."""
    absolute: bool = True
    """False: not referenced until `reference` says so, or a person does."""
    reference: ReferenceConfig | None = None
    """Mapped beside the position."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        if self.direction == 0:
            faults.append(Fault(where="direction", expected="1 or -1", found="0"))
        if self.absolute and self.reference is not None:
            expected = "none with an absolute encoder, or absolute: false"
            faults.append(Fault(where="reference", expected=expected, found="one"))
        if self.gear_ratio is not None:
            range_units = self.settings.total_range_units
            if range_units is None:
                expected = "settings.total_range_units with a gear, to follow its turns"
                faults.append(Fault(where="gear_ratio", expected=expected, found="none"))
            elif self.absolute and range_units == self.counts_per_rev:
                expected = "a multi-turn encoder, or absolute: false"
                faults.append(Fault(where="gear_ratio", expected=expected, found="a range of one turn"))
        if faults:
            raise ContractError(faults)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadConfig:
    """A further reading head on the joint's shaft: a node of its own on the joint's bus."""

    node_id: Annotated[int, Range(minimum=1, maximum=127)]
    mounting_deg: Annotated[float, Range(minimum=-360, maximum=360)]
    """What it reads less what the joint's own node reads at the same place of the shaft."""
    encoder: EncoderConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionConfig:
    """What the joint can do; a position that moves faster is not believed."""

    max_speed_deg_s: Annotated[float, Range(minimum=0.001, maximum=1e6)] = 3600.0
    margin_deg: Annotated[float, Range(minimum=0, maximum=180)] = 0.1
    """Noise, and the play of a gear."""
    jitter_ms: Annotated[float, Range(minimum=0, maximum=1000)] = 10.0
    """How far the times of two samples may be off: bus load, gateways."""
    settle_samples: Annotated[int, Range(minimum=1, maximum=100_000)] = 10
    """Consistent samples before an absolute encoder is believed again after a spike."""


class StandIn(enum.Enum):
    """What a corrected register holds without VALID."""

    MARKER = "marker"
    HOLD = "hold"
    """The last good angle, through silence."""
    RAW = "raw"
    """The angle without correction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WhenNotValidConfig:
    """What the corrected registers hold without VALID."""

    policy: StandIn = StandIn.MARKER
    hold_ms: Annotated[float, Range(minimum=1, maximum=60_000)] | None = None
    """Greatest age of a held angle, counted from its sample."""
    allow_raw: bool = False
    """Must be said for policy raw."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        if (self.policy is StandIn.HOLD) != (self.hold_ms is not None):
            expected = "hold_ms with policy hold and only with it"
            faults.append(Fault(where="hold_ms", expected=expected, found=f"policy {self.policy.value}"))
        if (self.policy is StandIn.RAW) != self.allow_raw:
            expected = "allow_raw: true with policy raw and only with it"
            faults.append(Fault(where="allow_raw", expected=expected, found=f"policy {self.policy.value}"))
        if faults:
            raise ContractError(faults)


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyConfig:
    """The corrected angle is moved on by the velocity to the moment of publication."""

    max_ms: Annotated[float, Range(minimum=0.1, maximum=100)]
    """Only samples up to this age."""


MAX_FURTHER_HEADS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class JointConfig:
    """One joint: its node, its encoder, its temperature, its model, its place in the registers."""

    slot: Annotated[int, Range(minimum=1, maximum=MAX_SLOT)]
    """Place in the register map; said, not counted, so that a new joint moves no address."""
    name: Name
    bus: str
    node_id: Annotated[int, Range(minimum=1, maximum=127)]
    model: str
    """Path of the model file, relative to the configuration file."""
    model_sha256: Hash | None = None
    """Pins the very file; any other is refused."""
    encoder: EncoderConfig
    temperature: TemperatureConfig
    sequence: SequenceConfig | None = None
    stale_ms: Annotated[float, Range(minimum=1, maximum=60_000)] = 50.0
    """A position older than this is not served as corrected."""
    heartbeat_ms: Annotated[int, Range(minimum=10, maximum=10_000)] = 200
    """The heartbeat asked of the node; with supervision poll, how often it is asked by SDO."""
    supervision: Supervision = Supervision.HEARTBEAT
    tpdo: TpdoConfig = field(default_factory=TpdoConfig)
    """What makes the encoder send its position."""
    configure: bool = True
    """False: the node is never written to; what it is set to must already be right."""
    eds: str | None = None
    """Path of the encoder's EDS, relative to the configuration file: wrong objects are told before the start."""
    further_heads: tuple[HeadConfig, ...] = ()
    """Reading heads beside the joint's own node, at most three; their angles are averaged."""
    max_head_difference_arcsec: Annotated[float, Range(minimum=0.1, maximum=100_000)] = 1800.0
    """Of a head from the mean of all; more is a fault."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    zero_deg: Annotated[float, Range(minimum=-360, maximum=360)] = 0.0
    """The user's zero, taken off the corrected angle; never off the model's input."""
    when_not_valid: WhenNotValidConfig = field(default_factory=WhenNotValidConfig)
    max_uncertainty_arcsec: Annotated[float, Range(minimum=0.001, maximum=100_000)] | None = None
    """Standard uncertainty (k = 1) above which the angle is not valid; one that is not known is above."""
    serve_past_due: bool = False
    """A calibration past due is shown, and no reason against the angle."""
    latency_compensation: LatencyConfig | None = None

    def __post_init__(self) -> None:
        period_ms = self.tpdo.period_ms
        if self.tpdo.trigger is Trigger.EVENT and period_ms is None:
            # A position that stands still could not be told from a dead encoder.
            expected = "period_ms, for the time in which the position does not change"
            raise ContractError([Fault(where="tpdo", expected=expected, found="none")])
        if period_ms is not None and self.stale_ms <= period_ms:
            expected = f"more than tpdo.period_ms ({period_ms})"
            raise ContractError([Fault(where="stale_ms", expected=expected, found=f"{self.stale_ms:g}")])
        if len(self.further_heads) > MAX_FURTHER_HEADS:
            found = str(len(self.further_heads))
            expected = f"at most {MAX_FURTHER_HEADS}"
            raise ContractError([Fault(where="further_heads", expected=expected, found=found)])
        if self.further_heads and self.tpdo.trigger is not Trigger.SYNC:
            # Only SYNC makes heads sample at one time; a fused angle of two times is none.
            expected = "trigger sync with several reading heads"
            raise ContractError([Fault(where="tpdo", expected=expected, found=self.tpdo.trigger.value)])


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
