"""The PLC of the demo: a Modbus TCP client that knows nothing but the printed register table.

It reads the fast image and one joint's detail block after the other, and checks each answer as a careful PLC
programmer would: both cycle counters, and INT32 against FLOAT64. pymodbus' client is met here and nowhere else.
"""

import csv
import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient

from trueangle.contract.errors import TrueangleError

_TYPES = {"UINT16": "H", "INT16": "h", "UINT32": "I", "INT32": "i", "FLOAT32": "f", "FLOAT64": "d"}
VALID = 1
MILLIARCSEC_PER_DEG = 3_600_000


class PlcError(TrueangleError):
    """The server did not answer as its register table promises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Register:
    """One line of the register table."""

    address: int
    type: str
    registers: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What one answer said of one joint. None: the marker stood there."""

    slot: int
    valid: bool
    sequence: int
    corrected_deg: float | None
    raw_deg: float | None
    temperature_c: float | None
    age_ms: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Detail:
    """A joint's detail block: the counters of its frames and whether the answer was whole."""

    slot: int
    frames_received: int
    frames_lost: int
    torn: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FastImage:
    """All joints in one answer."""

    readings: tuple[Reading, ...]
    torn: bool


def parse_table(text: str) -> dict[str, Register]:
    """The register table as `trueangled registers --format csv` prints it, by name."""
    rows = csv.DictReader(io.StringIO(text))
    return {
        row["name"]: Register(
            address=int(row["address_0based"]), type=row["type"], registers=int(row["registers"])
        )
        for row in rows
    }


class Plc:
    """Reads a running daemon; every method is one request and one answer."""

    def __init__(self, host: str, port: int, table: dict[str, Register], slots: Sequence[int]) -> None:
        self._client = ModbusTcpClient(host, port=port, timeout=2.0)
        self._table = table
        self._slots = tuple(slots)
        self.reads = 0

    def connect(self) -> bool:
        """Open the connection; False where nobody listens yet."""
        return self._client.connect()

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def fast(self) -> FastImage:
        """The fast image of the first six slots."""
        first = self._table["group0.cycle_counter"]
        last = self._table["group0.cycle_counter_tail"]
        data = self._read(first.address, last.address + last.registers - first.address)
        readings = tuple(self._reading(data, first.address, slot) for slot in self._slots)
        head = self._value(data, first.address, "group0.cycle_counter")
        tail = self._value(data, first.address, "group0.cycle_counter_tail")
        return FastImage(readings=readings, torn=head != tail)

    def _reading(self, data: bytes, base: int, slot: int) -> Reading:
        def value(name: str) -> int:
            return int(self._value(data, base, f"slot{slot}.fast.{name}"))

        def angle(name: str) -> float | None:
            return None if value(name) == -(2**31) else value(name) / MILLIARCSEC_PER_DEG

        temperature = value("temperature")
        return Reading(
            slot=slot,
            valid=bool(value("status") & VALID),
            sequence=value("sequence"),
            corrected_deg=angle("corrected"),
            raw_deg=angle("raw"),
            temperature_c=None if temperature == -(2**15) else temperature / 100,
            age_ms=value("age"),
        )

    def detail(self, slot: int) -> Detail:
        """One joint's detail block."""
        first = self._table[f"slot{slot}.detail.cycle_counter"]
        last = self._table[f"slot{slot}.detail.cycle_counter_tail"]
        data = self._read(first.address, last.address + last.registers - first.address)

        def value(name: str) -> float:
            return self._value(data, first.address, f"slot{slot}.detail.{name}")

        milliarcsec, float64_deg = value("corrected"), value("corrected_float64")
        marked = milliarcsec == -(2**31)
        # Both registers come from one angle: the integer is the float rounded to a milli-arcsecond.
        agree = (
            float64_deg != float64_deg if marked else abs(float64_deg * MILLIARCSEC_PER_DEG - milliarcsec) <= 0.51
        )
        whole = value("cycle_counter") == value("cycle_counter_tail")
        return Detail(
            slot=slot,
            frames_received=int(value("frames_received")),
            frames_lost=int(value("frames_lost")),
            torn=not (agree and whole),
        )

    def _read(self, address: int, count: int) -> bytes:
        try:
            answer = self._client.read_input_registers(address, count=count)
        except ModbusException as error:
            raise PlcError(f"reading {count} registers at {address}: {error}") from error
        if answer.isError():
            raise PlcError(f"reading {count} registers at {address}: {answer}")
        self.reads += 1
        return struct.pack(f">{count}H", *answer.registers)

    def _value(self, data: bytes, base: int, name: str) -> float:
        register = self._table[name]
        return struct.unpack_from(f">{_TYPES[register.type]}", data, 2 * (register.address - base))[0]
