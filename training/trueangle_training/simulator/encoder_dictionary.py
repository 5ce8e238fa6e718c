"""The object dictionary of the simulated encoder: CiA 301 communication, CiA 406 encoder, CiA 404 temperature."""

from dataclasses import dataclass

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.objectdictionary.datatypes import (
    INTEGER16,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
)

from trueangle.contract.encoder import EncoderSettings

Address = tuple[int, int]

POSITION: Address = (0x6004, 0)
TEMPERATURE: Address = (0x7130, 1)
TEMPERATURE_STATUS: Address = (0x6150, 1)
SEQUENCE: Address = (0x2100, 0)
PRESET: Address = (0x6003, 0)
OFFSET: Address = (0x6509, 0)

MAPPABLE_BITS = {POSITION: 32, TEMPERATURE: 16, TEMPERATURE_STATUS: 8, SEQUENCE: 16}
"""Objects that a TPDO may carry, with their length."""
TPDO_COUNT = 2
MAX_MAPPED = 8
DEVICE_TYPE_SINGLE_TURN = 0x0001_0196
"""0x1000: profile 406 in the low word, single-turn absolute rotary encoder in the high one (CiA 406)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entry:
    address: Address
    name: str
    data_type: int
    default: int | str
    writable: bool = False


def encoder_dictionary(node_id: int, settings: EncoderSettings, name: str) -> canopen.ObjectDictionary:
    """The dictionary with its power-on values; what `settings` leaves open has a plain single-turn default."""
    dictionary = canopen.ObjectDictionary()
    entries = (*_communication(node_id, settings, name), *_process_data(node_id), *_encoder(settings))
    for entry in entries:
        index, subindex = entry.address
        variable = ODVariable(entry.name, index, subindex)
        variable.data_type = entry.data_type
        variable.access_type = "rw" if entry.writable else "ro"
        variable.default = entry.default  # pyright: ignore[reportAttributeAccessIssue] - strings are served too
        variable.pdo_mappable = entry.address in MAPPABLE_BITS
        if not _is_composite(index):
            dictionary.add_object(variable)
            continue
        if index not in dictionary:
            kind = ODArray if index == 0x1003 else ODRecord
            dictionary.add_object(kind(f"object_{index:04x}", index))
        dictionary[index].add_member(variable)  # pyright: ignore[reportAttributeAccessIssue]
    return dictionary


def _is_composite(index: int) -> bool:
    return index in (0x1003, 0x1018, 0x6132, 0x6150, 0x7130) or 0x1800 <= index < 0x1B00


def _communication(node_id: int, settings: EncoderSettings, name: str) -> list[_Entry]:
    identity = (
        settings.vendor_id or 0,
        settings.product_code or 0,
        settings.revision_number or 0,
        settings.serial_number or 0,
    )
    device_type = DEVICE_TYPE_SINGLE_TURN if settings.device_type is None else settings.device_type
    return [
        _Entry(address=(0x1000, 0), name="device type", data_type=UNSIGNED32, default=device_type),
        _Entry(address=(0x1001, 0), name="error register", data_type=UNSIGNED8, default=0),
        _Entry(address=(0x1003, 0), name="errors", data_type=UNSIGNED8, default=0, writable=True),
        _Entry(address=(0x1003, 1), name="last error", data_type=UNSIGNED32, default=0),
        _Entry(address=(0x1008, 0), name="device name", data_type=VISIBLE_STRING, default=name),
        _Entry(address=(0x1014, 0), name="EMCY COB-ID", data_type=UNSIGNED32, default=0x80 + node_id),
        _Entry(address=(0x1017, 0), name="heartbeat", data_type=UNSIGNED16, default=0, writable=True),
        _Entry(address=(0x1018, 0), name="identity", data_type=UNSIGNED8, default=4),
        *(
            _Entry(address=(0x1018, sub), name=f"identity {sub}", data_type=UNSIGNED32, default=value)
            for sub, value in enumerate(identity, start=1)
        ),
    ]


def _process_data(node_id: int) -> list[_Entry]:
    """Two TPDOs as many units leave the factory: both carry the position, event driven, without a timer."""
    position = POSITION[0] << 16 | POSITION[1] << 8 | MAPPABLE_BITS[POSITION]
    entries: list[_Entry] = []
    for n in range(TPDO_COUNT):
        communication, mapping = 0x1800 + n, 0x1A00 + n
        cob_id = 0x4000_0180 + 0x100 * n + node_id
        entries += [
            _Entry(address=(communication, 0), name="highest", data_type=UNSIGNED8, default=5),
            _Entry(address=(communication, 1), name="COB-ID", data_type=UNSIGNED32, default=cob_id, writable=True),
            _Entry(address=(communication, 2), name="type", data_type=UNSIGNED8, default=255, writable=True),
            _Entry(address=(communication, 3), name="inhibit", data_type=UNSIGNED16, default=0, writable=True),
            _Entry(address=(communication, 5), name="timer", data_type=UNSIGNED16, default=0, writable=True),
            _Entry(address=(mapping, 0), name="count", data_type=UNSIGNED8, default=1, writable=True),
            *(
                _Entry(
                    address=(mapping, sub),
                    name=f"entry {sub}",
                    data_type=UNSIGNED32,
                    default=position if sub == 1 else 0,
                    writable=True,
                )
                for sub in range(1, MAX_MAPPED + 1)
            ),
        ]
    return entries


def _encoder(settings: EncoderSettings) -> list[_Entry]:
    resolution = settings.single_turn_resolution or settings.units_per_revolution or 1 << 20
    units = settings.units_per_revolution or resolution
    numbers: list[tuple[Address, str, int, int, bool]] = [
        (SEQUENCE, "sample sequence number", UNSIGNED16, 0, False),
        ((0x6000, 0), "operating parameters", UNSIGNED16, settings.operating_parameters or 0, True),
        ((0x6001, 0), "units per revolution", UNSIGNED32, units, True),
        ((0x6002, 0), "total range", UNSIGNED32, settings.total_range_units or units, True),
        (PRESET, "preset value", UNSIGNED32, settings.preset_value or 0, True),
        (POSITION, "position value", UNSIGNED32, 0, False),
        ((0x6500, 0), "operating status", UNSIGNED16, settings.operating_parameters or 0, False),
        ((0x6501, 0), "single-turn resolution", UNSIGNED32, resolution, False),
        ((0x6502, 0), "distinguishable revolutions", UNSIGNED16, settings.distinguishable_revolutions or 1, False),
        ((0x6503, 0), "alarms", UNSIGNED16, 0, False),
        ((0x6504, 0), "supported alarms", UNSIGNED16, 1, False),
        ((0x6505, 0), "warnings", UNSIGNED16, 0, False),
        ((0x6506, 0), "supported warnings", UNSIGNED16, 0, False),
        (OFFSET, "offset value", UNSIGNED32, settings.offset_value or 0, False),
        ((0x650B, 0), "serial number", UNSIGNED32, settings.serial_number or 0, False),
        ((0x6132, 0), "digits highest", UNSIGNED8, 1, False),
        ((0x6132, 1), "decimal digits", UNSIGNED8, 2, False),
        ((0x6150, 0), "status highest", UNSIGNED8, 1, False),
        (TEMPERATURE_STATUS, "temperature status", UNSIGNED8, 0, False),
        ((0x7130, 0), "temperature highest", UNSIGNED8, 1, False),
        (TEMPERATURE, "temperature", INTEGER16, 0, False),
    ]
    return [
        _Entry(address=address, name=name, data_type=data_type, default=default, writable=writable)
        for address, name, data_type, default, writable in numbers
    ]
