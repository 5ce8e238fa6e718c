"""The latest sample of one joint, kept from frames: position, temperature, sequence, each with its time.

Rules of this file: only what arrived is kept; a repeated sequence number refreshes nothing (a frozen or doubled
frame must grow old), and the first one alone is no sample; a node that leaves service takes its samples with it.
"""

from dataclasses import dataclass, field

from trueangle.core.clash import SenderWatch
from trueangle.core.frames import FrameLayout, Quantity
from trueangle.core.position import Mechanics, PositionTrack
from trueangle.core.sync_time import SampleTime, SyncHistory
from trueangle.core.temperature_watch import TemperatureLimits, TemperatureWatch

OLD_FRAMES = 64
"""Numbers so far behind the last one are old frames; a counter that starts anew there is believed when past it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleScale:
    """How the raw numbers of one joint become units."""

    counts_per_rev: int
    degc_per_unit: float
    offset_c: float
    sequence_modulus: int | None
    """2^bits of the sequence object; None where the node has none."""
    temperature_by_change: bool = False
    """The sensor sends only when the temperature changes: its node's life says that the last value holds."""
    synchronous: bool = True
    """The node sends one position a SYNC; else by itself."""
    position_period_ms: float | None = None
    """Of a node that sends by its timer; None: whenever the position changes."""
    mechanics: Mechanics = field(default_factory=Mechanics)
    temperature: TemperatureLimits = field(default_factory=TemperatureLimits)


class JointSample:
    """Mutable state of one joint, touched by the pipeline alone."""

    __slots__ = (
        "_backwards",
        "_sample_number",
        "_sample_time",
        "frames_lost",
        "frames_received",
        "frames_repeated",
        "position",
        "scale",
        "sequence",
        "temperature_c",
        "temperature_stamp_ns",
        "temperature_status",
        "temperature_watch",
        "two_senders",
        "watch",
    )

    def __init__(self, scale: SampleScale) -> None:
        self.scale = scale
        self.position = PositionTrack(scale.counts_per_rev, scale.mechanics)
        self.temperature_watch = TemperatureWatch(scale.temperature)
        self.frames_received = 0
        self.frames_lost = 0
        self.frames_repeated = 0
        self.watch = SenderWatch(
            scale.counts_per_rev, synchronous=scale.synchronous, period_ms=scale.position_period_ms
        )
        self.two_senders = False
        """A frame showed that two nodes send them; whoever acts on it takes it back."""
        self.forget()
        self.forget_temperature()

    def forget(self) -> None:
        """The encoder's node left service: no position that it told counts any more. Frame counters stay."""
        self.position.forget()
        self.sequence: int | None = None
        self._backwards: int | None = None
        """The last sequence number that went backwards."""
        self._sample_number = 0
        self._sample_time = SampleTime()
        self.watch.forget()

    def forget_temperature(self) -> None:
        """The sensor's node left service."""
        self.temperature_c: float | None = None
        self.temperature_stamp_ns: int | None = None
        self.temperature_status: int | None = None
        """What the sensor says of itself, 0 is good; None: not told."""
        self.temperature_watch.forget()

    def take_value(self, quantity: Quantity, value: int, stamp_ns: int) -> None:
        """A temperature, or its status, from a frame or by SDO."""
        if quantity is Quantity.TEMPERATURE:
            self.temperature_c = value * self.scale.degc_per_unit + self.scale.offset_c
            self.temperature_stamp_ns = stamp_ns
            self.temperature_watch.take(value, self.temperature_c, stamp_ns)
        elif quantity is Quantity.TEMPERATURE_STATUS:
            self.temperature_status = value
        elif quantity is Quantity.REFERENCE and value & self.scale.mechanics.reference_mask:
            self.position.set_referenced()

    def confirm_temperature(self, stamp_ns: int) -> None:
        """The sensor's node lives at this time; what that says of the last value depends on how it sends."""
        if self.scale.temperature_by_change and self.temperature_stamp_ns is not None:
            self.temperature_stamp_ns = max(self.temperature_stamp_ns, stamp_ns)

    def take(self, layout: FrameLayout, data: bytes, received_ns: int, syncs: SyncHistory) -> bool:
        """Decode one frame of the right length; True when a new position came with it."""
        values = layout.unpack.unpack(data)
        for place, quantity in layout.others:
            self.take_value(quantity, values[place], received_ns)
        if layout.position_at is None:
            return False
        position: int = values[layout.position_at]
        sequence: int | None = None if layout.sequence_at is None else values[layout.sequence_at]
        if self.watch.on_position(position, received_ns):
            self.two_senders = True
        if not self._is_new(sequence):
            return False
        stamp_ns = self._sample_time.stamp_ns(self._sample_number, syncs, received_ns)
        self.position.move_to(position, stamp_ns)
        # A head that missed a SYNC and one that is late look alike: both have the stamp of an older one.
        self.position.certain = stamp_ns == syncs.last_ns
        return True

    def _is_new(self, sequence: int | None) -> bool:
        """Count received, lost and repeated position frames by their sequence number."""
        modulus, step = self.scale.sequence_modulus, 1
        if sequence is not None and modulus is not None:
            if self.sequence is None:
                # A node that froze before it came into service sends this one for ever: the next one tells.
                self.sequence = sequence
                self.frames_received += 1
                return False
            step = (sequence - self.sequence) % modulus
            if step == 0:
                self.frames_repeated += 1
                return False
            if step >= modulus // 2:
                # Backwards: old frames come again, which end where the counter stands, or a counter that starts
                # anew far from there. The second of such a counter tells; until then nothing is believed.
                if (
                    modulus - step <= OLD_FRAMES
                    or self._backwards is None
                    or sequence != (self._backwards + 1) % modulus
                ):
                    self._backwards = sequence
                    self.frames_repeated += 1
                    return False
                step = 1
            self.frames_lost += step - 1
            self.sequence, self._backwards = sequence, None
        self._sample_number += step
        self.frames_received += 1
        return True
