"""From the counts of one reading head to the joint's angle: direction, gear, turns, velocity, jumps, reference.

Rules of this file: angles come from whole numbers, so no turn ever rounds away. A position is *not believed* from
the sample on which it moved faster than the joint can. Then either a second jump brings it back to where the joint
can have got to since, and it is believed again after `settle_samples` consistent samples (a spike); or it stays
where it went, and nothing that this encoder says can tell a moved phase from a moved shaft: not believed until the
node has been identified anew (`forget`) or a person clears it. An encoder without an absolute zero is referenced
only by its reference, and no longer after a jump. Where the counts' range is no whole number of the joint's turns
and has run over, only a person knows the turn, also after the node has left and come back.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from trueangle.contract.units import DEG_PER_TURN


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """What a joint can do between two samples."""

    max_speed_deg_s: float
    """Of the joint."""
    margin_deg: float = 0.1
    """Noise, and the play of a gear."""
    jitter_ms: float = 10.0
    """How far the known times of two samples may be off; a stalled link and a missed SYNC show as this."""
    settle_samples: int = 10
    """Consistent samples after a spike has come back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanics:
    """How an encoder sits on its joint, and what it can know."""

    direction: int = 1
    """-1: the joint's angle grows where the counts fall."""
    motor_turns: int = 1
    """Turns of the encoder's shaft in `joint_turns` turns of the joint."""
    joint_turns: int = 1
    range_counts: int | None = None
    """Where the counts start again at 0 (0x6002); None: not known, only whole revolutions are."""
    absolute: bool = True
    """False: its zero is known only once it has passed its reference."""
    reference_mask: int = 0
    """Bits of the reference object of which any says that it has."""
    motion: MotionLimits | None = None
    """None: jumps are not looked for."""

    @property
    def geared(self) -> bool:
        """Whether the encoder sits on another shaft than the joint's."""
        return self.motor_turns != self.joint_turns


class PositionTrack:
    """Mutable state of one reading head."""

    __slots__ = (
        "_anchor_counts",
        "_anchor_stamp_ns",
        "_counts_per_rev",
        "_counts_per_turn",
        "_deg_per_count",
        "_jump_deg",
        "_modulus",
        "_range_loses_phase",
        "_range_lost",
        "_settled",
        "_step",
        "_unwraps",
        "_wraps",
        "certain",
        "interval_s",
        "jumped",
        "mechanics",
        "position_counts",
        "raw_deg",
        "referenced",
        "stamp_ns",
        "turns",
        "velocity_change_deg_s",
        "velocity_deg_s",
    )

    def __init__(self, counts_per_rev: int, mechanics: Mechanics) -> None:
        """`counts_per_rev`: of the encoder's own shaft, 2 to 2^32."""
        self.mechanics, self._counts_per_rev = mechanics, counts_per_rev
        self._step = mechanics.direction * mechanics.joint_turns
        self._counts_per_turn = counts_per_rev * mechanics.motor_turns
        self._deg_per_count = self._step * DEG_PER_TURN / self._counts_per_turn
        self._range_lost = False
        """The range ran over: the counts alone tell no angle any more."""
        self.set_range(mechanics.range_counts)
        self.forget()

    def set_range(self, range_counts: int | None) -> None:
        """The node told its total range (0x6002); None: it has not, or has none."""
        mechanics, per_rev = self.mechanics, self._counts_per_rev
        self._modulus = range_counts or per_rev
        # The turns of a single-turn encoder are not counted here: a start would begin them at 0 again.
        self._unwraps = range_counts is not None and (range_counts > per_rev or mechanics.geared)
        self._range_loses_phase = (
            mechanics.absolute and (self._modulus * mechanics.joint_turns) % self._counts_per_turn != 0
        )

    def forget(self) -> None:
        """The node left service: nothing that it said before counts any more."""
        self.position_counts: int | None = None
        self.stamp_ns: int | None = None
        self.certain = True
        """Which SYNC the sample answers is known; else it may be younger than its stamp."""
        self.raw_deg: float | None = None
        """In [0, 360)."""
        self.turns: int | None = None
        """Whole turns of the joint that belong to `raw_deg`."""
        self.velocity_deg_s: float | None = None
        """Over the last interval; None as well while the position is not believed."""
        self.velocity_change_deg_s: float | None = None
        """Against the interval before."""
        self.interval_s = 0.0
        """Between the last two samples."""
        self._wraps = 0
        self.jumped = False
        self.referenced = self.mechanics.absolute and not self._range_lost
        self._anchor_counts, self._anchor_stamp_ns, self._jump_deg = 0, 0, 0.0
        self._settled: int | None = None
        """Consistent samples since a spike came back; None: it has not."""

    @property
    def resolution_deg(self) -> float:
        """The joint's angle of one count."""
        return abs(self._deg_per_count)

    def set_referenced(self) -> None:
        """The reference was passed, or a person says that the zero is known."""
        self.referenced, self._range_lost = True, False

    def clear_jump(self) -> None:
        """A person says that the position is right in spite of its jump."""
        self.jumped = False
        if self.mechanics.absolute:
            self.referenced = not self._range_lost

    def move_to(self, counts: int, stamp_ns: int) -> None:
        """The position of a new sample."""
        if self.position_counts is None or self.stamp_ns is None:
            self._set(counts, stamp_ns)
            return
        moved = self._difference(counts, self.position_counts)
        if moved != counts - self.position_counts and self._unwraps:
            self._wraps += (moved - (counts - self.position_counts)) // self._modulus
            if self._range_loses_phase:
                self.referenced, self._range_lost = False, True
        moved_deg, elapsed_ns = moved * self._deg_per_count, stamp_ns - self.stamp_ns
        if self.mechanics.motion is not None:
            self._watch(self.mechanics.motion, counts, abs(moved_deg), elapsed_ns)
        if self.jumped:
            self.velocity_deg_s = self.velocity_change_deg_s = None
        elif elapsed_ns > 0:
            before, self.interval_s = self.velocity_deg_s, elapsed_ns * 1e-9
            self.velocity_deg_s = moved_deg / self.interval_s
            self.velocity_change_deg_s = None if before is None else self.velocity_deg_s - before
        self._set(counts, stamp_ns)

    def _set(self, counts: int, stamp_ns: int) -> None:
        self.position_counts, self.stamp_ns = counts, stamp_ns
        along = self._step * (counts + self._wraps * self._modulus)
        self.turns, rest = divmod(along, self._counts_per_turn)
        self.raw_deg = rest * DEG_PER_TURN / self._counts_per_turn

    def _difference(self, counts: int, from_counts: int) -> int:
        """The shorter way round."""
        half = self._modulus // 2
        return (counts - from_counts + half) % self._modulus - half

    def _watch(self, motion: MotionLimits, counts: int, moved_deg: float, elapsed_ns: int) -> None:
        consistent = moved_deg <= _reach_deg(motion, elapsed_ns) and (not self._unwraps or counts < self._modulus)
        if not self.jumped:
            if not consistent:
                assert self.position_counts is not None  # noqa: S101 - there is a sample before a movement
                assert self.stamp_ns is not None  # noqa: S101
                self._anchor_counts, self._anchor_stamp_ns = self.position_counts, self.stamp_ns
                self._jump_deg = moved_deg
                self.jumped, self.referenced, self._settled = True, False, None
        elif not consistent:
            back_deg = abs(self._difference(counts, self._anchor_counts) * self._deg_per_count)
            since_ns = self.stamp_ns + elapsed_ns - self._anchor_stamp_ns if self.stamp_ns is not None else 0
            reach_deg = _reach_deg(motion, since_ns)
            # Only while what stayed where it jumped to cannot be as near as that: later it proves nothing.
            self._settled = 0 if back_deg <= reach_deg < self._jump_deg / 2 else None
        elif self._settled is not None:
            self._settled += 1
            if self._settled >= motion.settle_samples:
                self.clear_jump()


def _reach_deg(motion: MotionLimits, elapsed_ns: int) -> float:
    """How far the joint can have moved."""
    return motion.max_speed_deg_s * (max(0, elapsed_ns) * 1e-9 + motion.jitter_ms * 1e-3) + motion.margin_deg


@dataclass(frozen=True, slots=True, kw_only=True)
class Extrapolation:
    """The way from the sample to the moment of publication."""

    moved_deg: float
    uncertainty_arcsec: float
    """Standard uncertainty (k = 1) of that way."""


VELOCITY_TIME_JITTER_S = 50e-6
"""Standard uncertainty of the interval between two samples: a process sends SYNC, the kernel stamps frames."""
SHORTEST_INTERVAL_S = 10 * VELOCITY_TIME_JITTER_S
"""Frames that waited together and were read in one go lie microseconds apart, whatever time lay between them."""


class AngleSource(Protocol):
    """Where a joint's angle is read: one reading head, or several fused."""

    raw_deg: float | None
    turns: int | None
    stamp_ns: int | None
    velocity_deg_s: float | None
    velocity_change_deg_s: float | None
    interval_s: float

    @property
    def resolution_deg(self) -> float:
        """The joint's angle of one count."""
        ...


def extrapolate(track: AngleSource, age_s: float) -> Extrapolation | None:
    """The way moved in `age_s` at the last velocity; None where that is not known to a tenth.

    With interval T, velocity v and its change dv against the interval before, the velocity is that of the middle
    of the last interval: two quantised counts give it resolution / (sqrt(6) T), the interval's jitter
    v * jitter / T, and a joint that goes on accelerating as it did moves dv / T * age * (age + T) / 2 further.
    """
    velocity, change, interval_s = track.velocity_deg_s, track.velocity_change_deg_s, track.interval_s
    if velocity is None or change is None or interval_s < SHORTEST_INTERVAL_S:
        return None
    quantised = track.resolution_deg / math.sqrt(6.0) / interval_s * age_s
    jitter = velocity * VELOCITY_TIME_JITTER_S / interval_s * age_s
    acceleration = change / interval_s * age_s * (age_s + interval_s) / 2.0
    return Extrapolation(
        moved_deg=velocity * age_s,
        uncertainty_arcsec=3600.0
        * math.sqrt(quantised * quantised + jitter * jitter + acceleration * acceleration),
    )
