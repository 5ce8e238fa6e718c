"""Families in no library: what polygon, autocollimator, glue and laboratory do that nobody wrote down."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.metrological.chain import Bench, Part
from trueangle_training.plant.metrological.grating_lines import Ruling, screw_error
from trueangle_training.plant.metrological.joint_known import any_phase
from trueangle_training.plant.metrological.stops import friction_at_readings
from trueangle_training.plant.schedule import FACES

Floats = NDArray[np.float64]
Family = Callable[[Bench, np.random.Generator], Defect]


def changing(values: Floats, *along: Floats) -> Floats:
    """What of a course neither stays the same nor goes straight along others, RMS 1, shape [n].

    What stays is an effect of its own, and so is what grows in proportion to a condition.
    """
    straight = np.column_stack([np.ones_like(values), *along])
    left = values - straight @ np.linalg.lstsq(straight, values, rcond=None)[0]
    return left / max(float(np.sqrt(np.mean(left**2))), 1e-12)


def _changing_on_polygon(bench: Bench, values: Floats, *along: Floats) -> Floats:
    """The same of the readings on the polygon alone, RMS 1 there; 0 elsewhere."""
    rows, out = bench.reference.on_polygon, np.zeros_like(values)
    out[rows] = changing(values[rows], *(each[rows] for each in along))
    return out


def _age(bench: Bench) -> Floats:
    """0 to 1 over the campaign, shape [n]."""
    time_s = bench.schedule.time_s
    return (time_s - float(time_s.min())) / max(float(np.ptp(time_s)), 1.0)


def _over_faces(bench: Bench, faces: Floats) -> Floats:
    """A value of each face [faces] at the readings; 0 where there is no polygon."""
    return np.where(bench.reference.on_polygon, faces[bench.reference.face], 0.0)


def _face_wave(order: int, phase_rad: float) -> Floats:
    return np.sqrt(2.0) * np.cos(2.0 * np.pi * order * np.arange(FACES) / FACES + phase_rad)


def _of_reference(name: str, kind: str, pattern: Floats, cells: tuple[CellTruth, ...]) -> Defect:
    return Defect(
        name=name,
        in_library=False,
        kind=kind,
        contribute=lambda size: Part(reference_arcsec=size * pattern),
        cells=cells,
        parameters={},
    )


def _of_disc(
    bench: Bench, name: str, kind: str, order: int, course: Floats, at_rad: float, cells: tuple[CellTruth, ...]
) -> Defect:
    """An order of the grating with a course of its own; order 2 is a strain of the whole disc."""

    def contribute(size: float) -> Part:
        if order == 2:
            return Part(strain_arcsec=size * np.sqrt(2.0) * np.exp(1j * at_rad) * course)
        return Part(rulings=(Ruling(lines_arcsec=size * lines, course=course),))

    lines = np.sqrt(2.0) * screw_error(bench.encoder.lines_per_rev, order=order, phase_rad=at_rad, stick=0.0)
    return Defect(
        name=name,
        in_library=False,
        kind=kind,
        contribute=contribute,
        cells=cells,
        parameters={"order": float(order)},
    )


def _also_by_temperature(course: Floats, relative: Floats) -> list[str]:
    """Words of the lattice's temperature axis in which this campaign lets most of a course be said as well."""
    shapes = {
        "linear": [relative[:, None]],
        "quadratic": [np.column_stack([relative**2, relative**3])],
        "step": [(relative > split).astype(np.float64)[:, None] for split in np.linspace(-0.9, 0.9, 13)],
    }

    def carried(shape: Floats) -> float:
        columns = np.column_stack([np.ones_like(course), shape])
        left = course - columns @ np.linalg.lstsq(columns, course, rcond=None)[0]
        return 1.0 - float(left @ left) / float(course @ course)

    return [word for word, tried in shapes.items() if max(carried(shape) for shape in tried) >= 0.5]


def cross_hair_turns(bench: Bench, rng: np.random.Generator) -> Defect:
    """The autocollimator turns about its axis over the days: more and more of the faces' tilt is read as angle.

    Lapping has left that tilt with a low order, and each face with some of its own.
    """
    order = int(rng.integers(3, 6))
    tilt = _face_wave(order, any_phase(rng)) + 0.15 * rng.normal(size=FACES)
    roll = _changing_on_polygon(bench, _age(bench) ** float(rng.uniform(0.5, 2.0)))
    cells = (CellTruth(order=str(order), time="between_runs", frame="polygon"),)
    return _of_reference("cross_hair_turns", "mean", _over_faces(bench, tilt) * roll, cells)


def chuck_grips(bench: Bench, rng: np.random.Generator) -> Defect:
    """A three-jaw chuck bends the polygon, but only beyond the play of its jaws about some temperature."""
    relative = 2.0 * bench.from_cold_to_hot - 1.0
    play = float(rng.uniform(0.3, 0.6))
    grip = np.sign(relative) * np.maximum(np.abs(relative) - play, 0.0)
    if rng.random() < 0.5:
        grip = np.maximum(relative - float(rng.uniform(0.0, 0.4)), 0.0)
    pattern = _over_faces(bench, _face_wave(3, any_phase(rng))) * _changing_on_polygon(bench, grip, relative)
    cells = (
        CellTruth(order="3", temperature="quadratic", frame="polygon"),
        CellTruth(order="3", temperature="step", frame="polygon"),
    )
    return _of_reference("chuck_grips", "mean", pattern, cells)


def loose_lug(bench: Bench, rng: np.random.Generator) -> Defect:
    """One of the disc's lugs sits in one of two places and changes over at random between runs."""
    runs, which = np.unique(bench.schedule.run, return_inverse=True)
    order = int(rng.integers(2, 8))
    change = float(rng.uniform(0.2, 0.45))
    seats = np.where(np.cumsum(rng.random(runs.size) < change) % 2 == 0, 1.0, -1.0)
    if abs(float(seats.sum())) > 0.6 * runs.size:
        seats[runs.size // 3 : 2 * runs.size // 3] *= -1.0
    cells = (CellTruth(order=str(order), time="between_runs"),)
    return _of_disc(bench, "loose_lug", "random", order, changing(seats[which]), any_phase(rng), cells)


def glue_creep(bench: Bench, rng: np.random.Generator) -> Defect:
    """Fresh glue under the disc gives way by the logarithm of time, all through the campaign."""
    order, onset = int(rng.integers(3, 8)), float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
    course = changing(np.log1p(_age(bench) / onset))
    cells = (CellTruth(order=str(order), time="between_runs"),)
    return _of_disc(bench, "glue_creep", "mean", order, course, any_phase(rng), cells)


def daily_swing(bench: Bench, rng: np.random.Generator) -> Defect:
    """Sun on the wall of the hall: an order of the disc swings with the hours, whatever the soak."""
    order, period_s = int(rng.integers(3, 8)), 3600.0 * float(rng.uniform(5.0, 12.0))
    swing = np.sin(2.0 * np.pi * bench.schedule.time_s / period_s + any_phase(rng))
    cells = (CellTruth(order=str(order), time="between_runs"),)
    return _of_disc(bench, "daily_swing", "mean", order, changing(swing), any_phase(rng), cells)


def lamp_thermostat(bench: Bench, rng: np.random.Generator) -> Defect:
    """The autocollimator's lamp house is heated on and off: its zero climbs slowly and falls back, in each run."""
    period_s = float(np.exp(rng.uniform(np.log(90.0), np.log(400.0))))
    runs, which = np.unique(bench.schedule.run, return_inverse=True)
    begun = rng.random(runs.size)[which]
    cycle = (bench.schedule.seconds_into_run() / period_s + begun) % 1.0
    rise = float(rng.uniform(0.6, 0.9))
    saw = np.sqrt(12.0) * (np.where(cycle < rise, cycle / rise, (1.0 - cycle) / (1.0 - rise)) - 0.5)
    pattern = np.where(bench.reference.on_polygon, saw, 0.0)
    return _of_reference("lamp_thermostat", "random", pattern, (CellTruth(order="0", time="within_run"),))


def smeared_face(bench: Bench, rng: np.random.Generator) -> Defect:
    """Somebody has touched a face: from some run on it reads otherwise."""
    runs = np.unique(bench.schedule.run)
    since = int(rng.choice(runs[runs.size // 4 : -(runs.size // 4)]))
    touched = np.zeros(FACES)
    touched[int(rng.integers(FACES))] = np.sqrt(FACES)
    later = _changing_on_polygon(bench, (bench.schedule.run >= since).astype(np.float64))
    said = ["constant", *_also_by_temperature(later, 2.0 * bench.from_cold_to_hot - 1.0)]
    cells = tuple(
        CellTruth(order="localized", time=time, temperature=temperature, frame=frame)
        for frame in ("polygon", "encoder")
        for time, temperature in (("between_runs", "constant"), *(("constant", each) for each in said))
    )
    return _of_reference("smeared_face", "event", _over_faces(bench, touched) * later, cells)


def jaw_under_load(bench: Bench, rng: np.random.Generator) -> Defect:
    """The load goes through the polygon's seat: an order of its faces bends in proportion."""
    order, load = int(rng.integers(3, 8)), bench.schedule.load_nm
    pattern = _over_faces(bench, _face_wave(order, any_phase(rng))) * _changing_on_polygon(bench, load)
    cells = (CellTruth(order=str(order), load="linear", frame="polygon"),)
    return _of_reference("jaw_under_load", "mean", pattern, cells)


def seat_by_direction(bench: Bench, rng: np.random.Generator) -> Defect:
    """The polygon creeps within its seat at each reversal: an order of its faces with the sense of approach."""
    order = int(rng.integers(4, 10))
    state = friction_at_readings(
        bench.schedule, thresholds_deg=rng.uniform(0.1, 0.8, size=2), weights=np.array([0.5, 0.5])
    )
    pattern = _over_faces(bench, _face_wave(order, any_phase(rng))) * state
    cells = (CellTruth(order=str(order), direction="odd", frame="polygon"),)
    return _of_reference("seat_by_direction", "mean", pattern, cells)


def disc_flutters(bench: Bench, rng: np.random.Generator) -> Defect:
    """A thin disc bends in motion, with the square of the speed: an order from 3."""
    order, speed = int(rng.integers(3, 9)), bench.schedule.velocity_deg_s
    fast = (speed / max(float(np.abs(speed).max()), 1e-9)) ** 2
    cells = (CellTruth(order=str(order), speed="linear"),)
    return _of_disc(bench, "disc_flutters", "mean", order, fast, any_phase(rng), cells)


ON_ANY_PLAN: dict[str, Family] = {
    each.__name__: each
    for each in (
        cross_hair_turns,
        chuck_grips,
        loose_lug,
        glue_creep,
        daily_swing,
        lamp_thermostat,
        smeared_face,
    )
}
ON_RICH_PLAN: dict[str, Family] = ON_ANY_PLAN | {
    each.__name__: each for each in (jaw_under_load, seat_by_direction, disc_flutters)
}
