"""Mechanisms of joints that are in no library."""

from collections.abc import Callable

import numpy as np

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.mechanical.chain import Floats, Share, Stand, phasor
from trueangle_training.plant.mechanical.drive_defects import draw_lugre
from trueangle_training.plant.mechanical.friction import lugre_torque
from trueangle_training.plant.mechanical.seat_defects import screwed_down

Family = Callable[[Stand, np.random.Generator], Defect]


def _unknown(
    name: str, contribute: Callable[[float], Share], cells: tuple[CellTruth, ...], kind: str = "mean"
) -> Defect:
    return Defect(name=name, in_library=False, kind=kind, contribute=contribute, cells=cells, parameters={})


def _feet(stand: Stand, rng: np.random.Generator, *, least: int, most: int) -> tuple[int, Floats]:
    """How many feet carry a ring, and the wave that they leave on its track."""
    feet = int(rng.integers(least, most + 1))
    return feet, screwed_down(stand, screws=feet, at=phasor(rng), uneven=0.02)


def preload_loss(stand: Stand, rng: np.random.Generator) -> Defect:
    """Above a temperature the bearing's preload is gone and its ring follows its feet: Hertz, power 2/3."""
    feet, wave = _feet(stand, rng, least=3, most=7)
    from_x = float(rng.uniform(0.25, 0.6))
    course = np.maximum(stand.conditions.relative_temperature - from_x, 0.0) ** (2.0 / 3.0)
    cells = (
        CellTruth(order=str(feet), temperature="quadratic"),
        CellTruth(order=str(feet), temperature="step"),
    )
    return _unknown("preload_loss", lambda size: Share(track_arcsec=2.0 * size * course * wave), cells)


def clamp_trips(stand: Stand, rng: np.random.Generator) -> Defect:
    """A clamped ring jumps over when it gets warm, and back only when it is some kelvin colder."""
    feet, wave = _feet(stand, rng, least=3, most=7)
    body = stand.conditions.body_c
    seen = stand.conditions.temperature_c
    middle = 0.5 * (float(seen.min()) + float(seen.max()))
    up_c = middle + float(rng.uniform(-0.3, 0.5)) * 0.5 * float(np.ptp(seen))
    over = tripped(body, up=up_c, down=up_c - float(rng.uniform(0.5, 4.0)))
    # Between two steps of the grid it has not yet jumped.
    course = (
        over[np.searchsorted(stand.conditions.grid_s, stand.conditions.schedule.time_s, side="right") - 1] - 0.5
    )
    cells = (
        CellTruth(order=str(feet), temperature="step"),
        CellTruth(order=str(feet), temperature="quadratic"),
    )
    return _unknown("clamp_trips", lambda size: Share(track_arcsec=2.0 * size * course * wave), cells)


def tripped(course: Floats, *, up: float, down: float) -> Floats:
    """0 or 1: 1 from rising above `up` on until falling below `down`, shape [g]."""
    decided = (course > up) | (course < down)
    last = np.maximum.accumulate(np.where(decided, np.arange(course.size), 0))
    return (course[last] > up).astype(np.float64)


def seat_settling(stand: Stand, rng: np.random.Generator) -> Defect:
    """A press fit gives way by the logarithm of the time since the campaign began."""
    feet, wave = _feet(stand, rng, least=2, most=6)
    age = np.log1p(stand.conditions.schedule.time_s / float(np.exp(rng.uniform(np.log(1800.0), np.log(20_000.0)))))
    course = 3.0 * (age / float(age.max()) - 0.5)
    cells = (CellTruth(order=str(feet), time="between_runs"),)
    return _unknown("seat_settling", lambda size: Share(track_arcsec=size * course * wave), cells)


def daily_bending(stand: Stand, rng: np.random.Generator) -> Defect:
    """The sun comes round the hall: the stand's feet press the ring once a day, whatever the chamber does."""
    feet, wave = _feet(stand, rng, least=2, most=6)
    hours = stand.conditions.schedule.time_s / 3600.0
    course = np.sin(2.0 * np.pi * (hours / 24.0 + float(rng.random())))
    cells = (CellTruth(order=str(feet), time="between_runs"),)
    return _unknown("daily_bending", lambda size: Share(track_arcsec=1.5 * size * course * wave), cells)


def unseated_run(stand: Stand, rng: np.random.Generator) -> Defect:
    """In one run a chip lay under the hub: it tilts and takes the ring out of round."""
    schedule = stand.conditions.schedule
    there = schedule.run == int(rng.choice(np.unique(schedule.run)))
    tilt, (feet, wave) = np.where(there, phasor(rng), 0.0), _feet(stand, rng, least=3, most=5)
    bent = float(rng.uniform(0.5, 1.0)) * np.where(there, wave, 0.0)
    cells = (CellTruth(order="2", time="between_runs"), CellTruth(order=str(feet), time="between_runs"))
    return _unknown(
        "unseated_run", lambda size: Share(oval_arcsec=size * tilt, track_arcsec=size * bent), cells, kind="event"
    )


def growing_backlash(stand: Stand, rng: np.random.Generator) -> Defect:
    """A toothed coupling's play opens as it warms; the drive takes off the mean of it, and no more."""
    torque = lugre_torque(stand.conditions.schedule, draw_lugre(rng))
    play = np.maximum(stand.conditions.relative_temperature - float(rng.uniform(-1.0, 0.0)), 0.0)
    cells = (
        CellTruth(order="0", direction="odd", temperature="linear"),
        CellTruth(order="0", direction="odd", temperature="quadratic"),
    )
    left = torque * (play - float(play.mean()))
    return _unknown("growing_backlash", lambda size: Share(twist_arcsec=2.0 * size * left), cells)


def rubbing_coupling(stand: Stand, rng: np.random.Generator) -> Defect:
    """A misaligned coupling drags in its grease twice a turn, the more the faster."""
    velocity = stand.conditions.schedule.velocity_deg_s
    wave = (phasor(rng) * np.exp(2j * stand.angle_rad)).real
    twist = wave * velocity / max(float(np.abs(velocity).max()), 1e-9)
    cells = (CellTruth(order="2", speed="linear"), CellTruth(order="2", direction="odd", speed="linear"))
    return _unknown("rubbing_coupling", lambda size: Share(twist_arcsec=size * twist), cells)


def rubbing_ring(stand: Stand, rng: np.random.Generator) -> Defect:
    """The ring's high spots rub on a seal and are dragged along, this way or that: friction of an order from 3."""
    feet, wave = _feet(stand, rng, least=3, most=7)
    dragged = lugre_torque(stand.conditions.schedule, draw_lugre(rng)) * wave
    cells = (CellTruth(order=str(feet), direction="odd"),)
    return _unknown("rubbing_ring", lambda size: Share(twist_arcsec=1.5 * size * dragged), cells)


def loaded_ring(stand: Stand, rng: np.random.Generator) -> Defect:
    """The load goes through the feet of the ring, which was set up round at middle load."""
    feet, wave = _feet(stand, rng, least=3, most=7)
    load = stand.conditions.schedule.load_nm
    more = (load - 0.5 * float(load.min() + load.max())) / float(load.max())
    cells = (CellTruth(order=str(feet), load="linear"),)
    return _unknown("loaded_ring", lambda size: Share(track_arcsec=3.0 * size * more * wave), cells)


ON_ANY_PLAN: dict[str, Family] = {
    each.__name__: each for each in (preload_loss, clamp_trips, seat_settling, daily_bending, unseated_run)
}
ON_RICH_PLAN: dict[str, Family] = ON_ANY_PLAN | {
    each.__name__: each for each in (growing_backlash, rubbing_coupling, rubbing_ring, loaded_ring)
}
