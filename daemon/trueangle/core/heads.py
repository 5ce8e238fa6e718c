"""Several reading heads on one joint, fused into one angle that does not jump when one is lost.

A head mounted at m reads `angle + m + e(angle)`. Equally spaced heads read the same error curve at equal
distances, so their mean cancels every harmonic of it that is no multiple of their number: eccentricity with two.

Rules of this file: heads are averaged only over one and the same sample, that of one SYNC, whose time all its
samples have exactly; one whose sample is another SYNC's is missing. While all are there, each head's difference
from the mean is kept, by sector of the turn. When one is lost the others go on from where the mean stood: the
angle is continuous, and drifts from the full mean as the joint turns, by what the missing heads no longer
cancel. How much that is, is known where all heads have been seen, and unknown elsewhere. When it comes back the
difference fades with `FADE_S`; until then the head counts as lost.
"""

import math
from collections.abc import Sequence

from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN, angle_difference_deg, wrap_deg
from trueangle.core.position import PositionTrack

SECTORS = 36
FADE_S = 1.0
FADED_ARCSEC = 0.01


class _Sectors:
    """Least and greatest difference of one head from the mean, by sector of the turn."""

    __slots__ = ("_greatest", "_least")

    def __init__(self) -> None:
        self._least = [math.inf] * SECTORS
        self._greatest = [-math.inf] * SECTORS

    def add(self, sector: int, difference_deg: float) -> None:
        if difference_deg < self._least[sector]:
            self._least[sector] = difference_deg
        if difference_deg > self._greatest[sector]:
            self._greatest[sector] = difference_deg

    def furthest_deg(self, sector: int, from_deg: float) -> float | None:
        """The largest distance of this sector's differences from one; None where the head was never seen there."""
        if self._least[sector] > self._greatest[sector]:
            return None
        # The neighbours too, as far as they are known: the fused angle may lie on the other side of a border.
        around = (sector - 1, sector, (sector + 1) % SECTORS)
        least, greatest = min(self._least[s] for s in around), max(self._greatest[s] for s in around)
        return max(abs(least - from_deg), abs(greatest - from_deg))


class HeadFusion:
    """One joint's angle from two to four heads; the attributes are those of a `PositionTrack`."""

    __slots__ = (
        "_differences",
        "_fused_once",
        "_mounting",
        "_present",
        "_remainder_deg",
        "_sectors",
        "_tracks",
        "disagreement_arcsec",
        "interval_s",
        "lost",
        "raw_deg",
        "resolution_deg",
        "stamp_ns",
        "turns",
        "uncertainty_arcsec",
        "velocity_change_deg_s",
        "velocity_deg_s",
    )

    def __init__(self, tracks: Sequence[PositionTrack], mounting_deg: Sequence[float]) -> None:
        self._tracks, self._mounting = tuple(tracks), tuple(mounting_deg)
        self._sectors = [_Sectors() for _ in tracks]
        self.resolution_deg = max(track.resolution_deg for track in tracks)
        self.forget()

    def forget(self) -> None:
        """No head is left: nothing connects the next angle with the last. What the heads cancel stays known."""
        self._differences = [0.0] * len(self._tracks)
        """Of each head from the fused angle, as last seen while it was there."""
        self._present: tuple[int, ...] = ()
        self._fused_once = False
        """All heads were there at once since then."""
        self._remainder_deg = 0.0
        """What is left of a difference that fades."""
        self.lost = False
        self.raw_deg: float | None = None
        self.turns: int | None = None
        self.stamp_ns: int | None = None
        self.velocity_deg_s: float | None = None
        self.velocity_change_deg_s: float | None = None
        self.interval_s = 0.0
        self.uncertainty_arcsec: float | None = 0.0
        """What the missing heads add; None: not known."""
        self.disagreement_arcsec = 0.0
        """The largest difference between a head and where it belongs."""

    def fuse(self, usable: Sequence[bool]) -> None:
        """The angle of the newest sample, from the usable heads that took part in it."""
        tracks = self._tracks
        stamps_ns = [t.stamp_ns for t, ok in zip(tracks, usable, strict=True) if ok and t.stamp_ns is not None]
        if not stamps_ns:
            self.forget()
            return
        stamp_ns = max(stamps_ns)
        present = tuple(
            i
            for i, (track, ok) in enumerate(zip(tracks, usable, strict=True))
            if ok and track.stamp_ns == stamp_ns
        )
        if len(present) > 1:
            certain = [i for i in present if tracks[i].certain]
            present = tuple(certain or present[:1])
        elapsed_s = 0.0 if self.stamp_ns is None else max(0, stamp_ns - self.stamp_ns) * 1e-9
        self.stamp_ns = stamp_ns
        self._average(present, elapsed_s)
        velocities = [v for i in present if (v := tracks[i].velocity_deg_s) is not None]
        self.velocity_deg_s = sum(velocities) / len(velocities) if velocities else None
        leader = tracks[min(present)]
        self.velocity_change_deg_s, self.interval_s = leader.velocity_change_deg_s, leader.interval_s

    def _average(self, present: tuple[int, ...], elapsed_s: float) -> None:
        first = self._angle_deg(present[0])
        # Relative to one head, so that nothing wraps; each is the angle as the first head would read it.
        relative = {i: angle_difference_deg(self._angle_deg(i), first) for i in present}
        complete = len(present) == len(self._tracks)
        common = [i for i in present if i in self._present]
        if not common:
            self._forget_connection(complete=complete)
            common = list(present)
        base = sum(relative[i] - self._differences[i] for i in common) / len(common)
        if complete:
            mean = sum(relative.values()) / len(present)
            if present != self._present or self._remainder_deg:
                self._remainder_deg = (base - mean) * math.exp(-elapsed_s / FADE_S) if self._fused_once else 0.0
            fused = mean + self._remainder_deg
            self._fused_once = True
        else:
            fused = base
        self._place(present[0], fused)
        self._note(relative, fused, complete=complete)
        self._weigh(present, complete=complete)
        self._present = present

    def _forget_connection(self, *, complete: bool) -> None:
        """No head of the last angle is in this one."""
        self._differences = [0.0] * len(self._tracks)
        self._remainder_deg = 0.0
        self._fused_once = complete

    def _angle_deg(self, head: int) -> float:
        raw_deg = self._tracks[head].raw_deg
        assert raw_deg is not None  # noqa: S101 - a head with a stamp has an angle
        return raw_deg - self._mounting[head]

    def _note(self, relative: dict[int, float], fused: float, *, complete: bool) -> None:
        """Keep where each head stands: a missing one keeps its last place."""
        mean, sector = sum(relative.values()) / len(relative), self._sector
        furthest_deg = 0.0
        for i, angle_deg in relative.items():
            self._differences[i] = angle_deg - fused
            furthest_deg = max(furthest_deg, abs(angle_deg - mean))
            if complete:
                self._sectors[i].add(sector, angle_deg - mean)
        self.disagreement_arcsec = furthest_deg * ARCSEC_PER_DEG

    @property
    def _sector(self) -> int:
        assert self.raw_deg is not None  # noqa: S101 - asked for a fused angle
        return int(self.raw_deg * SECTORS / DEG_PER_TURN) % SECTORS

    def _place(self, head: int, fused: float) -> None:
        """The fused angle in one turn, and the turns that belong to it."""
        angle_deg, turns = self._angle_deg(head) + fused, self._tracks[head].turns
        self.raw_deg = wrap_deg(angle_deg)
        self.turns = None if turns is None else turns + round((angle_deg - self.raw_deg) / DEG_PER_TURN)

    def _weigh(self, present: tuple[int, ...], *, complete: bool) -> None:
        """What the missing heads cost: they cancel nothing any more, and the mean stands where it stood."""
        self.lost = not complete or abs(self._remainder_deg) * ARCSEC_PER_DEG > FADED_ARCSEC
        if complete:
            if not self.lost:
                self._remainder_deg = 0.0
            self.uncertainty_arcsec = abs(self._remainder_deg) * ARCSEC_PER_DEG
            return
        self.uncertainty_arcsec = None
        if not self._fused_once:
            return
        total_deg, sector = abs(self._remainder_deg) * len(self._tracks), self._sector
        missing = set(range(len(self._tracks))) - set(present)
        for i in missing:
            furthest_deg = self._sectors[i].furthest_deg(sector, self._differences[i])
            if furthest_deg is None:
                return
            total_deg += furthest_deg
        # The differences of all heads add up to nothing: what one missing head had, the n others share. Heads that
        # were lost one after the other left different angles, and only the sum is sure.
        share = len(present) if len(missing) == 1 else 1
        self.uncertainty_arcsec = total_deg / share * ARCSEC_PER_DEG
