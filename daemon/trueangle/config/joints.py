"""Joints: encoder, heads, motion, model, and what stands in for an angle that is not valid."""

import enum
from dataclasses import dataclass, field
from typing import Annotated

from trueangle.config.nodes import (
    Index,
    Name,
    SequenceConfig,
    Subindex,
    Supervision,
    TemperatureConfig,
    TpdoConfig,
    check_bits,
)
from trueangle.contract.document import Range
from trueangle.contract.encoder import MAX_COUNTS_PER_REV, EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Hash
from trueangle.contract.transmission import Trigger

MAX_SLOT = 32


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
        check_bits(self.bits)


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

    bus: str | None = None
    """The joint's, or left out: only one SYNC makes heads sample at one time."""
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
