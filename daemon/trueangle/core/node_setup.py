"""What a CANopen encoder node is asked, told and asked again: which objects, which values, in which order.

The order of `tpdo_writes` is that of CiA 301, 7.5.2.36: a mapping may be changed only while the PDO is invalid
(bit 31 of its COB-ID) and its entry count is 0. Nothing counts as set because it was written:
`tpdo_differences` compares what the node reads back.
"""

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import TpdoPlan

Address = tuple[int, int]
"""Index and subindex of an object."""

COB_INVALID = 1 << 31
"""Bit 31 of 0x1800:1: the PDO does not exist."""
COB_NO_RTR = 1 << 30
"""Bit 30 of 0x1800:1. Left as the node has it: units without RTR refuse to clear it (abort 0x06090030)."""
STANDARD_TPDOS = range(1, 5)
"""The TPDOs that every profile may use by default (CiA 301, pre-defined connection set)."""
HEARTBEAT_PRODUCER: Address = (0x1017, 0)
ERROR_REGISTER: Address = (0x1001, 0)
ALARMS: Address = (0x6503, 0)

ENCODER_OBJECTS: Mapping[str, Address] = {
    "device_type": (0x1000, 0),
    "vendor_id": (0x1018, 1),
    "product_code": (0x1018, 2),
    "revision_number": (0x1018, 3),
    "serial_number": (0x1018, 4),
    "operating_parameters": (0x6000, 0),
    "units_per_revolution": (0x6001, 0),
    "total_range_units": (0x6002, 0),
    "preset_value": (0x6003, 0),
    "single_turn_resolution": (0x6501, 0),
    "distinguishable_revolutions": (0x6502, 0),
    "offset_value": (0x6509, 0),
}
"""Field of EncoderSettings to object, in the order of reading."""
PHASE_OBJECTS = (
    "operating_parameters",
    "units_per_revolution",
    "total_range_units",
    "preset_value",
    "offset_value",
)
"""What moves the phase or the scale of the position, asked again and again in service."""
PROFILE_SERIAL: Address = (0x650B, 0)


class NodeState(enum.Enum):
    """Where a node stands in its life cycle. Process data count only in RUNNING and REFUSED."""

    UNKNOWN = "unknown"
    IDENTIFYING = "identifying"
    CONFIGURING = "configuring"
    STARTING = "starting"
    RUNNING = "running"
    REFUSED = "refused"
    """Set up and sending, but not the encoder, or not set, as it was at calibration: raw only."""
    LOST = "lost"
    """Silent, rebooted, stopped, or its bus is down."""
    FAULT = "fault"
    """Answers, but refuses its set-up or reports an error."""
    CLASH = "clash"
    """Two nodes answer to its node-id: no frame tells whose it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeReport:
    """What the master knows of a node."""

    state: NodeState
    settings: EncoderSettings | None = None
    """As read at this bring-up; None before it was read."""
    reason: str = ""
    """Why it is LOST, FAULT or REFUSED; empty otherwise."""
    silent: bool = False
    """Out of service for silence or with its bus, and not heard of since: what it said before was true."""
    head: int = 0
    """Which reading head of its joint the node is."""

    @property
    def in_service(self) -> bool:
        """Whether the node's mapping is verified and the node has confirmed that it is operational."""
        return self.state in (NodeState.RUNNING, NodeState.REFUSED)


@dataclass(frozen=True, slots=True, kw_only=True)
class SdoWrite:
    """One expedited SDO download."""

    address: Address
    value: int
    size: int
    """Bytes, 1, 2 or 4."""

    def __str__(self) -> str:
        return f"{shown(self.address)} = 0x{self.value:X}"


CYCLIC_TIMER: Address = (0x6200, 0)
"""The event timer of TPDO 1 where a unit has no 0x1800:5 (CiA 406)."""
_EVENT_TIMER_SUBINDEX = 5
_EVENT_TYPES = (254, 255)
"""The maker's event and the profile's: with the event timer running, both send in time."""


def shown(address: Address) -> str:
    """An object as people write it: 0x1A00:1."""
    return f"0x{address[0]:04X}:{address[1]}"


def settings_from(values: Mapping[Address, int | None]) -> EncoderSettings:
    """Encoder settings from the values read; the serial number of 0x650B stands in for an absent or zero one."""
    found = {name: values.get(address) for name, address in ENCODER_OBJECTS.items()}
    if not found["serial_number"]:
        found["serial_number"] = values.get(PROFILE_SERIAL) or found["serial_number"]
    return EncoderSettings(**found)


def cob_address(tpdo_number: int) -> Address:
    """The object that holds a TPDO's COB-ID."""
    return (0x1800 + tpdo_number - 1, 1)


def event_timer_addresses(tpdo: TpdoPlan) -> tuple[Address, ...]:
    """Where the event timer of this TPDO may be; the first that the node has counts. Empty: none is wanted."""
    if tpdo.event_timer_ms is None:
        return ()
    standard: Address = (0x1800 + tpdo.number - 1, 5)
    return (standard, CYCLIC_TIMER) if tpdo.number == 1 else (standard,)


def tpdo_writes(
    tpdo: TpdoPlan, found_cob: int, event_timer: tuple[Address, int] | None = None
) -> tuple[SdoWrite, ...]:
    """The downloads that set up one TPDO, given the COB-ID entry that the node has now.

    `event_timer` is the object that the node has for it and its size in bytes, where one is to be set.

    The PDO is switched off with the bits that it has: bits 0..29 may not change while it is valid.
    """
    communication, mapping = 0x1800 + tpdo.number - 1, 0x1A00 + tpdo.number - 1
    entries = tuple(
        SdoWrite(address=(mapping, position), value=mapped.entry, size=4)
        for position, mapped in enumerate(tpdo.mapping, start=1)
    )
    timer: tuple[SdoWrite, ...] = ()
    if event_timer is not None and tpdo.event_timer_ms is not None:
        address, size = event_timer
        timer = (SdoWrite(address=address, value=tpdo.event_timer_ms, size=size),)
    return (
        SdoWrite(address=(communication, 1), value=found_cob | COB_INVALID, size=4),
        SdoWrite(address=(mapping, 0), value=0, size=1),
        *entries,
        SdoWrite(address=(mapping, 0), value=len(entries), size=1),
        SdoWrite(address=(communication, 2), value=tpdo.transmission_type, size=1),
        *timer,
        SdoWrite(address=(communication, 1), value=tpdo.cob_id | (found_cob & COB_NO_RTR), size=4),
    )


def tpdo_readback(tpdo: TpdoPlan) -> dict[Address, int]:
    """What the node must read back after `tpdo_writes`, the RTR bit of the COB-ID left out."""
    communication, mapping = 0x1800 + tpdo.number - 1, 0x1A00 + tpdo.number - 1
    expected = {
        (communication, 1): tpdo.cob_id,
        (communication, 2): tpdo.transmission_type,
        (mapping, 0): len(tpdo.mapping),
    }
    for position, mapped in enumerate(tpdo.mapping, start=1):
        expected[mapping, position] = mapped.entry
    return expected


def readback_differences(expected: Mapping[Address, int], found: Mapping[Address, int | None]) -> list[str]:
    """One phrase for each object that does not read back as it must; not readable is a difference."""
    differences: list[str] = []
    for address, want in expected.items():
        got = found.get(address)
        if got is None or not _serves(address, want, got):
            differences.append(
                f"{shown(address)} expected 0x{want:X} found {'nothing' if got is None else f'0x{got:X}'}"
            )
    return differences


def _serves(address: Address, want: int, got: int) -> bool:
    """Whether the value found does what the wanted one would."""
    index, subindex = address
    if 0x1800 <= index < 0x1A00:
        if subindex == 1:
            return got & ~COB_NO_RTR == want
        if subindex == 2 and want in _EVENT_TYPES:
            return got in _EVENT_TYPES
        if subindex == _EVENT_TIMER_SUBINDEX:
            return 0 < got <= want
    return 0 < got <= want if address == CYCLIC_TIMER else got == want
