"""Presets as they are kept: which zero the user gave which joint, made with which encoder and which model."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from trueangle.contract.document import Range, document_from_plain, plain, structure
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Hash
from trueangle.contract.units import MILLIARCSEC_PER_TURN

SCHEMA_VERSION = 1
MAX_PRESETS_BYTES = 100_000
"""32 presets take 8 kB."""

_Unsigned32 = Annotated[int, Range(minimum=0, maximum=0xFFFF_FFFF)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PresetBinding:
    """Encoder, model and mechanics with which a preset was made; on any other it means another angle."""

    model_sha256: Hash
    vendor_id: _Unsigned32 | None = None
    """Object 0x1018 as read from the node, as the following; None: the node does not tell."""
    product_code: _Unsigned32 | None = None
    serial_number: _Unsigned32 | None = None
    preset_value: _Unsigned32 | None = None
    """0x6003 of the encoder: moved, its own zero has moved."""
    offset_value: _Unsigned32 | None = None
    """0x6509"""
    operating_parameters: _Unsigned32 | None = None
    """0x6000: another code sequence turns the angle round."""
    units_per_revolution: _Unsigned32 | None = None
    """0x6001"""
    total_range_units: _Unsigned32 | None = None
    """0x6002"""
    mechanics: str = ""
    """What the configuration says of direction, gear and further heads; empty: one head, direct, direction 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """One joint's zero."""

    slot: Annotated[int, Range(minimum=1, maximum=32)]
    user_zero_mas: Annotated[int, Range(minimum=0, maximum=MILLIARCSEC_PER_TURN - 1)]
    """Taken off the corrected angle, after the model."""
    binding: PresetBinding


@dataclass(frozen=True, slots=True, kw_only=True)
class _PresetFile:
    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    presets: tuple[Preset, ...]
    seal: Hash
    """SHA-256 of the presets: one flipped bit in a zero is a wrong angle that looks right."""

    def __post_init__(self) -> None:
        slots = [preset.slot for preset in self.presets]
        faults = [
            Fault(where=f"presets[{i}].slot", expected="one preset a slot", found=f"{slot} again")
            for i, slot in enumerate(slots)
            if slots.index(slot) < i
        ]
        if not faults and self.seal != _seal(self.presets):
            advice = "the file was damaged or edited: restore it, or remove it to begin without presets"
            faults = [Fault(where="seal", expected="the SHA-256 of the presets", found="another", advice=advice)]
        if faults:
            raise ContractError(faults)


def _seal(presets: tuple[Preset, ...]) -> str:
    text = json.dumps([plain(preset) for preset in presets], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def presets_text(presets: Iterable[Preset]) -> str:
    """The file's text; `read_presets` gives the same presets again."""
    ordered = tuple(sorted(presets, key=lambda one: one.slot))
    file = _PresetFile(schema_version=SCHEMA_VERSION, presets=ordered, seal=_seal(ordered))
    return json.dumps(plain(file), indent=1) + "\n"


def read_presets(text: str, *, source: str) -> tuple[Preset, ...]:
    """The presets of a file; ContractError with every fault.

    A damaged file is never read as "no presets": the joints would be served with another zero than their users'.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        advice = "restore it, or remove it to begin without presets"
        fault = Fault(where=source, expected="a file of presets (JSON)", found=str(error), advice=advice)
        raise ContractError([fault]) from error
    return structure(_PresetFile, document_from_plain(value, source=source)).presets
