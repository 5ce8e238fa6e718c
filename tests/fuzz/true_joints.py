"""The joints of `true_angles`: shafts that know where they are, nodes and what is wrong with them, a model."""

import math
import random
import struct
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueangle.core.correction import ModelAnswer
from trueangle.core.health import NodeCondition
from trueangle.core.position import Mechanics
from trueangle.core.serving import ServingPolicy

MS = 1_000_000
PERIOD_NS = 5 * MS
PER_REV = 3_600_000
"""One count is 0.36 arcsec."""
ARCSEC = 1 / 3600
FASTEST_DEG_S, STEP_DEG_S = 200.0, 8.0
"""Of the shafts, and by how much their speed changes within one period."""
ECCENTRICITY_ARCSEC, MODEL_UNCERTAINTY_ARCSEC = 30.0, 2.0


def correction_arcsec(raw_deg: float, temperature_c: float) -> float:
    return 20.0 * math.sin(math.radians(raw_deg)) + 3.0 * (temperature_c - 20.0)


@dataclass
class Model:
    """The formula, unless it is spoilt."""

    spoilt: tuple[float, float | None] | None = None

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        right = correction_arcsec(float(angle_deg[0]), float(temperature_c[0])), MODEL_UNCERTAINTY_ARCSEC
        correction, uncertainty = self.spoilt or right
        told = None if uncertainty is None else np.array([uncertainty])
        return ModelAnswer(correction_arcsec=np.array([correction]), uncertainty_arcsec=told)


class Shaft:
    """Where a joint is, by period: constant speed within each."""

    def __init__(self, rng: random.Random, start_ns: int) -> None:
        self._rng, self._start_ns = rng, start_ns
        self._deg, self._speed_deg_s = deque([rng.uniform(-400, 400)], maxlen=1000), 0.0
        self._first = 0

    def turn(self) -> None:
        """One more period."""
        rng = self._rng
        if rng.random() < 0.02:
            self._speed_deg_s = 0.0 if abs(self._speed_deg_s) <= STEP_DEG_S else self._speed_deg_s
        self._speed_deg_s += rng.uniform(-STEP_DEG_S, STEP_DEG_S) if rng.random() < 0.7 else 0.0
        self._speed_deg_s = max(-FASTEST_DEG_S, min(FASTEST_DEG_S, self._speed_deg_s))
        if len(self._deg) == self._deg.maxlen:
            self._first += 1
        self._deg.append(self._deg[-1] + self._speed_deg_s * PERIOD_NS * 1e-9)

    def at(self, time_ns: int) -> float:
        """Turns included."""
        period, rest_ns = divmod(time_ns - self._start_ns, PERIOD_NS)
        place = max(period - self._first, 0)
        if place >= len(self._deg) - 1:
            return self._deg[-1]
        return self._deg[place] + (self._deg[place + 1] - self._deg[place]) * rest_ns / PERIOD_NS

    def between(self, from_ns: int, to_ns: int) -> list[float]:
        """Its extremes are here."""
        first, last = (from_ns - self._start_ns) // PERIOD_NS + 1, (to_ns - self._start_ns) // PERIOD_NS
        inside = [self._start_ns + n * PERIOD_NS for n in range(first, last + 1)]
        return [self.at(time_ns) for time_ns in (from_ns, *inside, to_ns)]


@dataclass
class Head:
    """One encoder node and what is wrong with it."""

    node_id: int
    number: int
    mounting_deg: float
    condition: NodeCondition = NodeCondition.RUNNING
    sequence: int = 0
    moved_deg: float = 0.0
    """Its own zero: not 0 means that its angle is wrong for good."""
    frozen: bytes | None = None
    last: bytes = b""
    arrived_ns: int = 0
    last_frame_ns: int = 0
    good_frames: int = 0
    since_ns: int = 0
    """Identified: its first frames are in time, or nothing tells that they are late."""


@dataclass
class Joint:
    """One joint, as it is and as it is configured."""

    slot: int
    shaft: Shaft
    heads: list[Head]
    policy: ServingPolicy
    mechanics: Mechanics
    by_timer: bool
    with_sequence: bool
    model: Model = field(default_factory=Model)
    zero_deg: float | None = 0.0
    temperature_c: float = 20.0
    glitch_c: float | None = None
    warm_values: int = 0
    """Since it was cold, or its node out, or its temperature wrong."""

    def counts(self, head: Head, time_ns: int) -> int:
        at_deg = self.shaft.at(time_ns) + head.mounting_deg + head.moved_deg
        if len(self.heads) > 1:
            at_deg += ECCENTRICITY_ARCSEC * ARCSEC * math.sin(math.radians(at_deg))
        gear = self.mechanics.motor_turns / self.mechanics.joint_turns
        turned = round(self.mechanics.direction * at_deg / 360 * PER_REV * gear)
        return turned % (self.mechanics.range_counts or PER_REV)

    def read(self, head: Head, time_ns: int) -> bytes:
        head.sequence = (head.sequence + 1) & 0xFF
        data = struct.pack("<I", self.counts(head, time_ns))
        return data + bytes((head.sequence,)) if self.with_sequence else data
