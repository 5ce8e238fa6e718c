"""From joint states to the register image: one immutable image per cycle.

Rules of this file: a register never holds a number that is not known. What is missing, not finite or out of the
register's range is served as the marker of its type; a corrected angle is served only with one of VALID, HELD and
RAW_SERVED, and none of them without a corrected angle. The fast blocks are packed every cycle; a detail block only
when somebody reads it, from the same states, so that all that is read of one image is of one cycle.
"""

import datetime
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from trueangle.contract.units import DEG_PER_TURN, MILLIARCSEC_PER_TURN
from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.register_fields import (
    BLOCK_STRIDE,
    DETAIL_IDENTITY,
    DETAIL_LIVE,
    DETAIL_REGISTERS,
    DETAIL_TAIL,
    DETAIL_USER,
    FAST_HEADER,
    FAST_REGISTERS,
    FAST_SLOT,
    FAST_TAIL,
    FIRST_DETAIL_BLOCK,
    MAP_VERSION,
    SLOTS,
    RegisterType,
    fast_slot_offset,
    group_of,
    struct_format,
)

_HEADER = struct.Struct(struct_format(FAST_HEADER))
_FAST = struct.Struct(struct_format(FAST_SLOT))
_LIVE = struct.Struct(struct_format(DETAIL_LIVE))
_IDENTITY = struct.Struct(struct_format(DETAIL_IDENTITY))
_FAST_TAIL = struct.Struct(struct_format(FAST_TAIL))
_DETAIL_TAIL = struct.Struct(struct_format(DETAIL_TAIL))
_USER = struct.Struct(struct_format(DETAIL_USER))

_VALID = int(StatusBit.VALID)
_STAND_INS = int(StatusBit.HELD | StatusBit.RAW_SERVED)
"""What may hold a corrected angle without VALID; beside VALID they would contradict it."""
_NO_ANGLE_BITS = ~(_VALID | _STAND_INS | int(StatusBit.LATENCY_COMPENSATED))
_CONFIGURED = int(StatusBit.CONFIGURED)
_ALL_VALID = int(ServiceBit.ALL_VALID)

_NAN = float("nan")
_NO_INT16 = -0x8000
_NO_INT32 = -0x8000_0000
_NO_UINT16 = 0xFFFF
_NO_UINT32 = 0xFFFF_FFFF
_UINT16_TOP = 0xFFFE
_UINT32_TOP = 0xFFFF_FFFE

_MAS_PER_DEG = 3_600_000.0
_FLOAT32_BOUND = 3.4e38
"""Below the largest binary32 number, 3.4028e38; a chained comparison with it also refuses NaN and infinity."""
_ANGLE_BOUND_DEG = 1e8
"""Beyond, binary64 no longer resolves a tenth of a milli-arcsecond: no angle in a turn can be told from it."""
_ROUNDS_BELOW_TURN_DEG = 360.0 - 0.6 / _MAS_PER_DEG
"""Angles below round to at most 1295999999 milli-arcseconds, whatever the last bit of the product."""
_FLOAT32_TURN_DEG = 360.0 - 2.0**-16
"""From here binary32 rounds to 360: its step below 360 is 2^-15 and the tie goes to the even 360."""


class JointState(NamedTuple):
    """What is served of one joint in one cycle. None: not known."""

    status: StatusBit
    sequence: int | None
    """Number of the sample; served modulo 65536."""
    corrected_deg: float | None
    """Within +-1e8; served reduced to [0, 360), and only with VALID, HELD or RAW_SERVED in `status`."""
    raw_deg: float | None
    """Within +-1e8; served reduced to [0, 360), whole turns are carried into `turns`."""
    correction_arcsec: float | None
    """corrected = raw + correction"""
    temperature_c: float | None
    age_ms: float | None
    """Age of the sample when published; negative is not known."""
    uncertainty_arcsec: float | None
    """Standard uncertainty (k = 1) of the corrected angle; negative is not known."""
    velocity_deg_s: float | None
    turns: int | None
    """Whole turns that belong to `raw_deg`."""
    raw_counts: int | None
    """0..2^32 - 1"""
    frames_received: int
    """Served modulo 2^32."""
    frames_lost: int
    """Served modulo 2^32."""
    user_zero_deg: float = 0.0
    """Taken off `corrected_deg` by whoever made this state; served reduced to [0, 360)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointIdentity:
    """What stays the same between configurations: which joint, which model, which encoder. None: not known."""

    slot: int
    """1..32"""
    node_id: int
    """CANopen node-id, 1..127"""
    model_id: bytes | None
    """First 8 bytes of the SHA-256 of the model file."""
    calibration_date: datetime.date | None
    calibration_due: datetime.date | None
    vendor_id: int | None
    """UNSIGNED32, as the following three: object 0x1018."""
    product_code: int | None
    revision_number: int | None
    serial_number: int | None

    def __post_init__(self) -> None:
        if not 1 <= self.slot <= SLOTS:
            raise ValueError(f"slot: expected 1..{SLOTS}, got {self.slot}")
        if not 1 <= self.node_id <= 127:
            raise ValueError(f"slot {self.slot}: node_id: expected 1..127, got {self.node_id}")
        if self.model_id is not None and len(self.model_id) != 8:
            raise ValueError(f"slot {self.slot}: model_id: expected 8 bytes, got {len(self.model_id)}")
        for name in ("vendor_id", "product_code", "revision_number", "serial_number"):
            number: int | None = getattr(self, name)
            if number is not None and not 0 <= number <= 0xFFFF_FFFF:
                raise ValueError(f"slot {self.slot}: {name}: expected 0..0xFFFFFFFF, got {number}")


class RegisterImage:
    """All registers of one cycle; reading never changes what is read."""

    __slots__ = ("_cycle", "_details", "_fast", "_joints", "_starts", "_states")

    def __init__(
        self,
        fast: bytes,
        starts: tuple[int, ...],
        *,
        cycle: int,
        joints: "Mapping[int, _FixedPart]",
        states: Mapping[int, JointState],
    ) -> None:
        """`fast`: the fast blocks, one behind the other; `starts`: where each begins, -1: not served."""
        self._fast, self._starts = fast, starts
        self._cycle, self._joints, self._states = cycle, joints, states
        self._details: dict[int, bytes] = {}

    @property
    def data(self) -> bytes:
        """The served blocks, one behind the other."""
        return self._fast + b"".join(self._detail(slot) for slot in self._joints)

    def read(self, address: int, count: int) -> bytes | None:
        """The bytes of `count` registers from 0-based `address`; None if they are not all of one served block."""
        block, offset = divmod(address, BLOCK_STRIDE)
        if count < 1 or block < 0:
            return None
        if block < FIRST_DETAIL_BLOCK:
            start = self._starts[block]
            if start < 0 or offset + count > FAST_REGISTERS:
                return None
            begin = start + 2 * offset
            return self._fast[begin : begin + 2 * count]
        slot = block - FIRST_DETAIL_BLOCK + 1
        if slot not in self._joints or offset + count > DETAIL_REGISTERS:
            return None
        return self._detail(slot)[2 * offset : 2 * (offset + count)]

    def _detail(self, slot: int) -> bytes:
        packed = self._details.get(slot)
        if packed is None:
            state = self._states.get(slot, _UNKNOWN)
            packed = self._details[slot] = _packed_detail(self._cycle, self._joints[slot], state)
        return packed


class _FixedPart(NamedTuple):
    """What does not change in a joint's detail block."""

    node_id: int
    identity: bytes


class RegisterMap:
    """The layout for one configuration of joints; builds an image per cycle."""

    def __init__(self, identities: Iterable[JointIdentity]) -> None:
        """Raises ValueError when a slot is named twice."""
        by_slot: dict[int, JointIdentity] = {}
        for identity in identities:
            if identity.slot in by_slot:
                raise ValueError(
                    f"slot {identity.slot}: expected one joint, got two; give each joint its own slot"
                )
            by_slot[identity.slot] = identity
        self._joints = {
            slot: _FixedPart(by_slot[slot].node_id, _identity_bytes(by_slot[slot])) for slot in sorted(by_slot)
        }
        self._template, self._starts = _fast_template(by_slot)
        self._fast_at = {slot: self._starts[group_of(slot)] + 2 * fast_slot_offset(slot) for slot in self._joints}
        self._groups_at = [self._starts[group] for group in sorted({group_of(slot) for slot in by_slot})]

    @property
    def slots(self) -> tuple[int, ...]:
        """The configured slots, ascending."""
        return tuple(self._joints)

    def image(
        self, *, cycle: int, heartbeat: int, service_status: int, states: Mapping[int, JointState]
    ) -> RegisterImage:
        """The registers of this cycle; a configured slot without a state is served as not valid and unknown.

        `cycle` is served modulo 2^32, `heartbeat` modulo 65536, `service_status` by its low 16 bits and
        without ALL_VALID when a corrected angle is withheld here. Raises ValueError for a state of a slot that is
        not configured.
        """
        if not states.keys() <= self._joints.keys():
            raise ValueError(f"slots: expected states of {self.slots}, got one of {sorted(states)}")
        cycle &= 0xFFFF_FFFF
        buffer = bytearray(self._template)
        not_valid = 0
        for slot, fast_at in self._fast_at.items():
            if not _pack_fast(buffer, fast_at, states.get(slot, _UNKNOWN)):
                not_valid |= 1 << slot - 1
        service_status &= 0xFFFF & ~_ALL_VALID if not_valid else 0xFFFF
        joints = len(self._joints)
        for start in self._groups_at:
            _HEADER.pack_into(
                buffer, start, MAP_VERSION, joints, cycle, heartbeat & 0xFFFF, not_valid, service_status
            )
            _FAST_TAIL.pack_into(buffer, start + 2 * FAST_REGISTERS - _FAST_TAIL.size, cycle)
        # A copy: whoever made the states may go on with the mapping.
        return RegisterImage(bytes(buffer), self._starts, cycle=cycle, joints=self._joints, states=dict(states))


_UNKNOWN = JointState(
    status=StatusBit.CONFIGURED,
    sequence=None,
    corrected_deg=None,
    raw_deg=None,
    correction_arcsec=None,
    temperature_c=None,
    age_ms=None,
    uncertainty_arcsec=None,
    velocity_deg_s=None,
    turns=None,
    raw_counts=None,
    frames_received=0,
    frames_lost=0,
)


def _pack_fast(buffer: bytearray, at: int, state: JointState) -> bool:
    """Write one joint's part of a fast block; True if its corrected angle is served as valid."""
    status, corrected = _shown(state)
    correction_arcsec, temperature_c = _float32(state.correction_arcsec), _float32(state.temperature_c)
    uncertainty_arcsec, age_ms = _unsigned(state.uncertainty_arcsec), _unsigned(state.age_ms)
    # Comparisons with NaN are false: what is not known takes the marker.
    _FAST.pack_into(
        buffer,
        at,
        status,
        _sequence(state.sequence),
        corrected[0],
        _angle(state.raw_deg)[0],
        round(correction_arcsec * 1e3) if -2.147e6 < correction_arcsec < 2.147e6 else _NO_INT32,
        round(temperature_c * 1e2) if -327.67 <= temperature_c <= 327.67 else _NO_INT16,
        _NO_UINT16 if age_ms != age_ms else round(min(age_ms, 65534.0)),
        _NO_UINT16 if uncertainty_arcsec != uncertainty_arcsec else round(min(uncertainty_arcsec * 1e2, 65534.0)),
    )
    return status & _VALID != 0


def _packed_detail(cycle: int, fixed: _FixedPart, state: JointState) -> bytes:
    """One joint's detail block."""
    status, (corrected_mas, corrected_deg, corrected_f32, _) = _shown(state)
    raw_mas, raw_deg, raw_f32, carry = _angle(state.raw_deg)
    age_ms = _unsigned(state.age_ms)
    live = _LIVE.pack(
        cycle,
        status,
        _sequence(state.sequence),
        fixed.node_id,
        corrected_mas,
        corrected_deg,
        corrected_f32,
        raw_mas,
        raw_deg,
        raw_f32,
        _float32(state.velocity_deg_s),
        _turns(state.turns, carry),
        _float32(state.temperature_c),
        _float32(state.correction_arcsec),
        _unsigned(state.uncertainty_arcsec),
        _NO_UINT32 if age_ms != age_ms else round(min(age_ms, 4294967294.0)),
        _counts(state.raw_counts),
        state.frames_received & 0xFFFF_FFFF,
        state.frames_lost & 0xFFFF_FFFF,
    )
    return live + fixed.identity + _USER.pack(_angle(state.user_zero_deg)[0]) + _DETAIL_TAIL.pack(cycle)


def _shown(state: JointState) -> "tuple[int, _Angle]":
    """The status word as served, and the corrected angle that it lets be seen."""
    status = int(state.status) & 0xFFFF_FFFF | _CONFIGURED
    if status & _VALID:
        status &= ~_STAND_INS
    corrected = _angle(state.corrected_deg) if status & (_VALID | _STAND_INS) else _NO_ANGLE
    return status if corrected[0] != _NO_INT32 else status & _NO_ANGLE_BITS, corrected


_Angle = tuple[int, float, float, int]
_NO_ANGLE: _Angle = (_NO_INT32, _NAN, _NAN, 0)


def _angle(angle_deg: float | None) -> _Angle:
    """Milli-arcseconds, degrees for FLOAT64, degrees for FLOAT32, and the whole turns taken off.

    The float is the angle from which the integer was rounded, so |float64 * 3.6e6 - int32| <= 0.5; where the
    integer wraps to 0 both are 0. The FLOAT32 value is 0 where binary32 would round up to 360.
    """
    if angle_deg is None:
        return _NO_ANGLE
    if 0.0 <= angle_deg < _ROUNDS_BELOW_TURN_DEG:
        # -0.0 + 0.0 is 0.0: the sign bit of zero is not served.
        deg = angle_deg + 0.0
        return round(deg * _MAS_PER_DEG), deg, deg if deg < _FLOAT32_TURN_DEG else 0.0, 0
    if not -_ANGLE_BOUND_DEG <= angle_deg <= _ANGLE_BOUND_DEG:
        return _NO_ANGLE
    turns, deg = divmod(angle_deg, DEG_PER_TURN)
    mas = round(deg * _MAS_PER_DEG)
    # A tiny negative angle leaves exactly 360.0 in binary64: the integer test catches it too.
    if mas >= MILLIARCSEC_PER_TURN:
        return 0, 0.0, 0.0, int(turns) + 1
    return mas, deg, deg if deg < _FLOAT32_TURN_DEG else 0.0, int(turns)


def _float32(number: float | None) -> float:
    """The number where a FLOAT32 can hold it, else NaN."""
    return number if number is not None and -_FLOAT32_BOUND < number < _FLOAT32_BOUND else _NAN


def _unsigned(number: float | None) -> float:
    """The number where it is not negative and a FLOAT32 can hold it, else NaN."""
    return number if number is not None and 0.0 <= number < _FLOAT32_BOUND else _NAN


def _sequence(sequence: int | None) -> int:
    return _NO_UINT16 if sequence is None else sequence & 0xFFFF


def _turns(turns: int | None, carry: int) -> int:
    if turns is None:
        return _NO_INT32
    turns += carry
    return turns if _NO_INT32 < turns < 0x8000_0000 else _NO_INT32


def _counts(counts: int | None) -> int:
    return counts if counts is not None and 0 <= counts <= 0xFFFF_FFFF else _NO_UINT32


def _fast_template(slots: Iterable[int]) -> tuple[bytes, tuple[int, ...]]:
    """The fast blocks with markers in all their slots; and where each of the possible blocks starts."""
    missing = tuple(field.type.missing for field in FAST_SLOT)
    empty_slot = _FAST.pack(0, *missing[1:])
    starts = [-1] * FIRST_DETAIL_BLOCK
    blocks = bytearray()
    for group in sorted({group_of(slot) for slot in slots}):
        starts[group] = len(blocks)
        slots_bytes = 2 * FAST_REGISTERS - _HEADER.size - _FAST_TAIL.size
        blocks += bytes(_HEADER.size) + empty_slot * (slots_bytes // _FAST.size) + bytes(_FAST_TAIL.size)
    return bytes(blocks), tuple(starts)


def _identity_bytes(identity: JointIdentity) -> bytes:
    numbers = (
        _yyyymmdd(identity.calibration_date),
        _yyyymmdd(identity.calibration_due),
        identity.vendor_id,
        identity.product_code,
        identity.revision_number,
        identity.serial_number,
    )
    model_id = RegisterType.BYTES8.missing if identity.model_id is None else identity.model_id
    return _IDENTITY.pack(model_id, *(_NO_UINT32 if number is None else number for number in numbers))


def _yyyymmdd(day: datetime.date | None) -> int | None:
    return None if day is None else day.year * 10_000 + day.month * 100 + day.day
