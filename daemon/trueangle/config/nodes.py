"""Buses, nodes and the objects on them: what the CANopen side is told."""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from trueangle.contract.document import Pattern, Range
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.transmission import Trigger

Name = Annotated[str, Pattern(regex=r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,31}", meaning="1 to 32 letters, digits, . _ -")]
Index = Annotated[int, Range(minimum=0x1000, maximum=0xFFFF)]
Subindex = Annotated[int, Range(minimum=0, maximum=254)]
_MAPPABLE_BITS = (8, 16, 32)
ENCODER_PROFILE = range(0x6000, 0x6600)
"""Objects of CiA 406; none of them is a temperature on an encoder."""
ANALOGUE_INPUTS = range(0x6400, 0x6404)
"""CiA 401, analogue inputs of 8, 16, 32 bits and float; on an encoder the limits of its work area."""


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
        check_bits(self.bits)


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
    """The node that measures it; left out, the encoder does."""
    bus: str | None = None
    """The bus of that node; left out, the joint's."""
    tpdo: TpdoConfig = field(default_factory=TpdoConfig)
    poll_ms: Annotated[int, Range(minimum=10, maximum=3_600_000)] | None = None
    """Read by SDO so often instead of being mapped: for units that cannot map it."""
    status: TemperatureStatusConfig | None = None
    check_digits: bool = True
    """Compare degc_per_unit with the node's decimal digits, 0x6132 (index 0x7130 or 0x9130 of CiA 404)."""

    def __post_init__(self) -> None:
        check_bits(self.bits)
        polled = [("poll_ms", self.poll_ms), ("tpdo.period_ms", self.tpdo.period_ms)]
        polled += [("status.poll_ms", self.status.poll_ms)] if self.status is not None else []
        for where, poll_ms in polled:
            if poll_ms is not None and self.stale_s * 1000 <= poll_ms:
                expected = f"less than stale_s ({self.stale_s:g} s)"
                raise ContractError([Fault(where=where, expected=expected, found=f"{poll_ms} ms")])
        if self.digits is not None and not math.isclose(self.degc_per_unit, 10.0**-self.digits):
            expected = "1, 0.1, 0.01, ... as CiA 404 has it, or check_digits: false"
            raise ContractError([Fault(where="degc_per_unit", expected=expected, found=f"{self.degc_per_unit:g}")])
        analogue = self.index in ANALOGUE_INPUTS and self.node_id is not None
        if self.index in ENCODER_PROFILE and not analogue:
            found = f"0x{self.index:04X}, an object of the encoder profile CiA 406"
            raise ContractError([Fault(where="index", expected="the object of a temperature", found=found)])
        if self.bus is not None and self.node_id is None:
            expected = "node_id with bus: which node there measures it"
            raise ContractError([Fault(where="bus", expected=expected, found="none")])
        if self.maximum_c <= self.minimum_c:
            expected = f"more than minimum_c ({self.minimum_c:g})"
            raise ContractError([Fault(where="maximum_c", expected=expected, found=f"{self.maximum_c:g}")])

    @property
    def by_change(self) -> bool:
        """The node owes no frame while the temperature does not change."""
        return self.tpdo.trigger is Trigger.EVENT and self.tpdo.period_ms is None and self.poll_ms is None

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
        check_bits(self.bits)


def check_bits(bits: int) -> None:
    if bits not in _MAPPABLE_BITS:
        raise ContractError([Fault(where="bits", expected="8, 16 or 32", found=str(bits))])
