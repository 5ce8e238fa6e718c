"""The encoder a model was calibrated with: its counts, its identity and the settings that move its phase.

The correction belongs to a mechanical phase, and CiA 406 lets anybody move that phase (code sequence, scaling,
preset). Model file, configuration and the running node are therefore compared field by field.
"""

from dataclasses import dataclass, fields
from typing import Annotated

from trueangle.contract.document import Range
from trueangle.contract.units import ARCSEC_PER_TURN, DEG_PER_TURN

MAX_COUNTS_PER_REV = 2**32
Unsigned32 = Annotated[int, Range(minimum=0, maximum=2**32 - 1)]
SCALING_ON = 1 << 2
"""Bit 2 of 0x6000, scaling function control."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderSettings:
    """What an encoder's object dictionary says of it. None: not known, and then not compared.

    Sources: CiA 301 (0x1000, 0x1018), CiA 406 (0x6000 ... 0x650B).
    """

    device_type: Unsigned32 | None = None
    """0x1000; the low 16 bits are the profile number, 406 for an encoder."""
    vendor_id: Unsigned32 | None = None
    """0x1018:1"""
    product_code: Unsigned32 | None = None
    """0x1018:2"""
    revision_number: Unsigned32 | None = None
    """0x1018:3"""
    serial_number: Unsigned32 | None = None
    """0x1018:4, or 0x650B where 0x1018:4 is absent or 0."""
    operating_parameters: Unsigned32 | None = None
    """0x6000; bit 0 code sequence (0 clockwise), bit 2 scaling on."""
    units_per_revolution: Unsigned32 | None = None
    """0x6001, measuring units per revolution: counts of the position value in one turn."""
    total_range_units: Unsigned32 | None = None
    """0x6002, total measuring range in measuring units; 0 means 2^32."""
    preset_value: Unsigned32 | None = None
    """0x6003, in measuring units."""
    single_turn_resolution: Unsigned32 | None = None
    """0x6501"""
    distinguishable_revolutions: Unsigned32 | None = None
    """0x6502"""
    offset_value: Unsigned32 | None = None
    """0x6509, the difference that a preset made, in measuring units."""

    def differences_from(self, expected: "EncoderSettings") -> list[str]:
        """What differs from `expected`, one phrase a field, fields that `expected` leaves open not compared.

        A field that `expected` states and this one does not know is a difference: unknown is not equal.
        """
        found: list[str] = []
        for field in fields(self):
            want, got = getattr(expected, field.name), getattr(self, field.name)
            if want is not None and got != want:
                shown = "not readable" if got is None else str(got)
                found.append(f"{field.name} expected {want} found {shown}")
        return found

    @property
    def counts_per_rev(self) -> int | None:
        """Counts of the position value in one turn: 0x6001 with scaling on, 0x6501 with scaling off (CiA 406)."""
        if self.operating_parameters is not None and not self.operating_parameters & SCALING_ON:
            return self.single_turn_resolution
        return self.units_per_revolution

    def known(self) -> dict[str, int]:
        """The known fields by name."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name)) is not None}


def counts_to_deg(counts: int, counts_per_rev: int) -> float:
    """The angle in [0, 360) degrees of a position value, whole turns taken off in integers."""
    return (counts % counts_per_rev) * DEG_PER_TURN / counts_per_rev


def resolution_arcsec(counts_per_rev: int) -> float:
    """The angle of one count."""
    return ARCSEC_PER_TURN / counts_per_rev
