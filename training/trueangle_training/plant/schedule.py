"""What the operator does, when: the polyline of the shaft's angle in time, with the readings taken along it."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
PlanName = Literal["paper", "rich"]

FACES = 23
PITCH_DEG = 360.0 / FACES


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule:
    """Readings of a campaign and the motion between them; arrays of readings have shape [n], of the path [p]."""

    angle_deg: Floats
    """True shaft angle at the reference, not wrapped within a run."""
    time_s: Floats
    run: Integers
    zero_group: Integers
    direction: Integers
    velocity_deg_s: Floats
    load_nm: Floats
    face: Integers
    polygon_offset: Integers
    path_time_s: Floats
    path_angle_deg: Floats
    """All motion, returns included; between two points the shaft turns one way."""
    reading_at: Integers
    """[n], the path point of each reading."""
    chamber_time_s: Floats
    chamber_c: Floats
    """Set point of the chamber from each of these times on; the last one of two neighbours ramps linearly."""

    def __len__(self) -> int:
        return int(self.angle_deg.size)

    def seconds_into_run(self) -> Floats:
        """Time since the first reading of the same run, shape [n]."""
        first = {int(run): float(self.time_s[self.run == run].min()) for run in np.unique(self.run)}
        return self.time_s - np.array([first[int(run)] for run in self.run])


@dataclass(slots=True, kw_only=True)
class Operator:
    """Writes down what is done, one step after the other."""

    rng: np.random.Generator
    mount_deg: float
    """Angle of the shaft at which face 1 faces the autocollimator, polygon not re-mounted."""
    scatter_deg: float
    """Standard deviation of how closely a face is turned to the autocollimator."""
    now_s: float = 0.0
    angle_deg: float = 0.0
    chamber_c: float = 20.0
    path: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    chamber: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    rows: list[tuple[float, ...]] = field(default_factory=list[tuple[float, ...]])

    def wait(self, seconds: float) -> None:
        """Stand still."""
        self.now_s += seconds
        self.path.append((self.now_s, self.angle_deg))

    def set_chamber(self, celsius: float, *, over_s: float = 1.0) -> None:
        """A new set point, reached linearly over a time; the operator goes on at once."""
        self.chamber.append((self.now_s, self.chamber_c))
        self.chamber.append((self.now_s + over_s, celsius))
        self.chamber_c = celsius

    def move(self, angle_deg: float, *, speed_deg_s: float) -> None:
        """Turn to an angle at a speed."""
        self.now_s += abs(angle_deg - self.angle_deg) / speed_deg_s
        self.angle_deg = angle_deg
        self.path.append((self.now_s, angle_deg))

    def read(
        self, *, run: int, zero: int, direction: int, face: int, load_nm: float, offset: int, velocity: float
    ) -> None:
        """Take a reading here and now."""
        self.path.append((self.now_s, self.angle_deg))
        place = len(self.path) - 1
        self.rows.append(
            (place, self.now_s, self.angle_deg, run, zero, direction, face, load_nm, offset, velocity)
        )

    def polygon_pass(
        self, *, run: int, direction: int, load_nm: float, offset: int, dwell_s: float, speed_deg_s: float
    ) -> None:
        """Every face once in a direction, after an overrun so that the approach is always from the same side."""
        positions = range(FACES) if direction > 0 else range(FACES - 1, -1, -1)
        before = -1.0 if direction > 0 else float(FACES)
        overrun = float(self.rng.uniform(0.2, 0.8))
        self.move(self.mount_deg + (before + overrun * direction) * PITCH_DEG, speed_deg_s=speed_deg_s)
        for position in positions:
            scatter = float(self.rng.normal(0.0, self.scatter_deg))
            self.move(self.mount_deg + position * PITCH_DEG + scatter, speed_deg_s=speed_deg_s)
            self.wait(dwell_s * float(self.rng.uniform(0.8, 1.2)))
            face = (position + offset) % FACES + 1
            self.read(
                run=run, zero=run, direction=direction, face=face, load_nm=load_nm, offset=offset, velocity=0.0
            )

    def sweep(
        self,
        *,
        run: int,
        zero: int,
        direction: int,
        load_nm: float,
        turns: float,
        readings: int,
        speed_deg_s: float,
    ) -> None:
        """Readings against the reference encoder while the shaft turns."""
        step = direction * 360.0 * turns / readings
        self.move(self.angle_deg + 20.0 * direction, speed_deg_s=speed_deg_s)
        for _ in range(readings):
            self.move(self.angle_deg + step, speed_deg_s=speed_deg_s)
            velocity = direction * speed_deg_s
            self.read(
                run=run, zero=zero, direction=direction, face=0, load_nm=load_nm, offset=0, velocity=velocity
            )

    def schedule(self) -> Schedule:
        """What was written down."""
        rows = np.array(self.rows, dtype=np.float64)
        path = np.array(self.path, dtype=np.float64)
        chamber = np.array(self.chamber, dtype=np.float64)
        whole = rows.astype(np.int64)
        return Schedule(
            angle_deg=rows[:, 2],
            time_s=rows[:, 1],
            run=whole[:, 3],
            zero_group=whole[:, 4],
            direction=whole[:, 5],
            velocity_deg_s=rows[:, 9],
            load_nm=rows[:, 7],
            face=whole[:, 6],
            polygon_offset=whole[:, 8],
            path_time_s=path[:, 0],
            path_angle_deg=path[:, 1],
            reading_at=whole[:, 0],
            chamber_time_s=chamber[:, 0],
            chamber_c=chamber[:, 1],
        )


def draw_schedule(plan: PlanName, rng: np.random.Generator) -> Schedule:
    """A campaign after one of the two plans; how it is carried out differs from draw to draw."""
    scatter_deg = float(np.exp(rng.uniform(np.log(2.0), np.log(60.0)))) / 3600.0
    operator = Operator(rng=rng, mount_deg=float(rng.uniform(0, 360)), scatter_deg=scatter_deg)
    operator.angle_deg = operator.mount_deg
    operator.path.append((0.0, operator.angle_deg))
    operator.set_chamber(20.0)
    if plan == "paper":
        _paper(operator, rng)
    else:
        _rich(operator, rng)
    return operator.schedule()


def _temperatures(rng: np.random.Generator, count: int) -> Floats:
    values = np.linspace(10.0, 40.0, count)
    way = rng.integers(3)
    return values if way == 0 else values[::-1] if way == 1 else rng.permutation(values)


def _paper(operator: Operator, rng: np.random.Generator) -> None:
    """7 temperatures x 3 repeats x 23 faces, one direction, one load, standing still: 483 readings, 21 runs."""
    soak_s = 3600.0 * float(np.exp(rng.uniform(np.log(0.8), np.log(4.0))))
    dwell_s = float(rng.uniform(8.0, 20.0))
    load_nm = round(float(rng.uniform(0.5, 3.0)), 2)
    run = 0
    for celsius in _temperatures(rng, 7):
        operator.set_chamber(float(celsius))
        operator.wait(soak_s)
        for _ in range(3):
            run += 1
            operator.polygon_pass(
                run=run, direction=1, load_nm=load_nm, offset=0, dwell_s=dwell_s, speed_deg_s=10.0
            )
            operator.wait(float(rng.uniform(60.0, 600.0)))


def _rich(operator: Operator, rng: np.random.Generator) -> None:
    """About 6,000 readings: both directions, two loads a run, re-mounted polygon, sweeps at two speeds, a ramp."""
    soak_s = 3600.0 * float(np.exp(rng.uniform(np.log(0.8), np.log(4.0))))
    dwell_s = float(rng.uniform(6.0, 12.0))
    light_nm = round(float(rng.uniform(0.5, 2.0)), 2)
    loads = (light_nm, round(light_nm * float(rng.uniform(2.0, 4.0)), 2))
    slow, fast = round(float(rng.uniform(1.5, 4.0)), 1), round(float(rng.uniform(10.0, 25.0)), 1)
    offsets = (0, int(rng.integers(5, 10)), int(rng.integers(13, 19)))
    run = 0
    for number, celsius in enumerate(_temperatures(rng, 7)):
        operator.set_chamber(float(celsius))
        operator.wait(soak_s)
        for offset in offsets:
            run += 1
            for load_nm in rng.permutation(loads):
                for direction in (1, -1):
                    operator.polygon_pass(
                        run=run,
                        direction=direction,
                        load_nm=float(load_nm),
                        offset=offset,
                        dwell_s=dwell_s,
                        speed_deg_s=fast,
                    )
            operator.wait(float(rng.uniform(60.0, 600.0)))
        if number % 2 == 0:
            run = _sweeps(operator, rng, run=run, speeds=(slow, fast), loads=loads)
    _ramps(operator, rng, run=run, load_nm=light_nm)


SWEEP_ZERO = 1000
"""All readings against the reference encoder share its zero."""


def _sweeps(
    operator: Operator,
    rng: np.random.Generator,
    *,
    run: int,
    speeds: tuple[float, float],
    loads: tuple[float, ...],
) -> int:
    for speed in speeds:
        for repeat in range(2):
            run += 1
            for direction in (1, -1):
                operator.sweep(
                    run=run,
                    zero=SWEEP_ZERO,
                    direction=direction,
                    load_nm=loads[repeat],
                    turns=2.0,
                    readings=112,
                    speed_deg_s=speed,
                )
            operator.wait(float(rng.uniform(60.0, 300.0)))
    return run


def _ramps(operator: Operator, rng: np.random.Generator, *, run: int, load_nm: float) -> None:
    """Up and down again while the shaft steps on slowly, standing still at each reading."""
    operator.set_chamber(15.0)
    operator.wait(3600.0 * 2)
    for target in (35.0, 15.0):
        run += 1
        operator.set_chamber(target, over_s=5400.0)
        for number in range(240):
            direction = 1 if number < 120 else -1
            operator.move(operator.angle_deg + direction * 27.0, speed_deg_s=10.0)
            operator.wait(20.0)
            operator.read(
                run=run, zero=SWEEP_ZERO, direction=direction, face=0, load_nm=load_nm, offset=0, velocity=0.0
            )
        operator.wait(600.0)
