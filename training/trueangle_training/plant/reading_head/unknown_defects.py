"""Patterns that are in no library: each family a way in which real joints surprise their makers."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.history import friction_at_readings
from trueangle_training.plant.reading_head.contribution import Contribution, Setting
from trueangle_training.plant.reading_head.grating_defects import phase

Floats = NDArray[np.float64]
Family = Callable[[Setting, np.random.Generator], Defect]


def wave(setting: Setting, order: int, at: float) -> Floats:
    """cos(order x angle + at) at the readings, shape [n]; 1 at order 0."""
    return np.cos(order * np.deg2rad(setting.schedule.angle_deg) + at) if order else np.ones(len(setting.schedule))


def bare(values: Floats, *regressors: Floats) -> Floats:
    """What of a course is left after its mean and its straight lines over the regressors, RMS 1, shape [n]."""
    columns = np.column_stack([np.ones_like(values), *regressors])
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return left / max(float(np.sqrt(np.mean(left**2))), 1e-12)


def _along_grating(name: str, pattern: Floats, cells: tuple[CellTruth, ...], kind: str = "mean") -> Defect:
    return Defect(
        name=name,
        in_library=False,
        kind=kind,
        contribute=lambda size: Contribution(head_arcsec=size * pattern),
        cells=cells,
        parameters={},
    )


def _thermal_cells(order: int) -> tuple[CellTruth, ...]:
    return (CellTruth(order=str(order), temperature="quadratic"), CellTruth(order=str(order), temperature="step"))


def kink_in_temperature(setting: Setting, rng: np.random.Generator) -> Defect:
    """A part lifts off at one temperature: a kink, at an order from 3."""
    x, order = setting.relative_temperature, int(rng.integers(3, 9))
    kink = bare(np.abs(x - float(rng.uniform(-0.3, 0.3))), x)
    return _along_grating("kink_in_temperature", kink * wave(setting, order, phase(rng)), _thermal_cells(order))


def step_in_temperature(setting: Setting, rng: np.random.Generator) -> Defect:
    """A glue joint slips over at one temperature and back again."""
    x, order = setting.relative_temperature, int(rng.integers(2, 7))
    step = bare((x > float(rng.uniform(-0.5, 0.5))).astype(np.float64), x)
    return _along_grating("step_in_temperature", step * wave(setting, order, phase(rng)), _thermal_cells(order))


def wandering_phase(setting: Setting, rng: np.random.Generator) -> Defect:
    """A high order whose phase goes round with temperature."""
    x, order = setting.relative_temperature, int(rng.integers(3, 9))
    turn = float(rng.choice([-1.0, 1.0])) * float(rng.uniform(1.3, 2.2)) * np.pi / 2 * 1.5
    at = phase(rng)
    pattern = np.cos(order * np.deg2rad(setting.schedule.angle_deg) + at + turn * x)
    cells = (CellTruth(order=str(order), temperature="linear"), *_thermal_cells(order))
    return _along_grating("wandering_phase", pattern, cells)


def saturating_temperature(setting: Setting, rng: np.random.Generator) -> Defect:
    """A bend that comes to a stop within a few degrees, both ways."""
    x, order = setting.relative_temperature, int(rng.integers(3, 9))
    course = bare(np.tanh((x - float(rng.uniform(-0.4, 0.4))) / 0.12), x)
    pattern = course * wave(setting, order, phase(rng))
    return _along_grating("saturating_temperature", pattern, _thermal_cells(order))


def campaign_drift(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order that changes over the days of the campaign, whatever the temperature."""
    time_s, order = setting.schedule.time_s, int(rng.integers(2, 8))
    age = time_s / float(time_s.max())
    course = bare(age ** float(rng.uniform(0.5, 1.5)))
    pattern = course * wave(setting, order, phase(rng))
    return _along_grating("campaign_drift", pattern, (CellTruth(order=str(order), time="between_runs"),))


def slipped_once(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order that is another one after some run."""
    runs, order = np.unique(setting.schedule.run), int(rng.integers(2, 7))
    at_run = int(rng.choice(runs[runs.size // 4 : -(runs.size // 4)]))
    course = bare((setting.schedule.run >= at_run).astype(np.float64))
    pattern = course * wave(setting, order, phase(rng))
    return _along_grating(
        "slipped_once", pattern, (CellTruth(order=str(order), time="between_runs"),), kind="event"
    )


def odd_run(setting: Setting, rng: np.random.Generator) -> Defect:
    """One run that was clamped badly: two low orders in this run alone."""
    run = int(rng.choice(np.unique(setting.schedule.run)))
    orders = rng.choice(np.arange(2, 7), size=2, replace=False)
    shape = sum((wave(setting, int(k), phase(rng)) for k in orders), np.zeros(len(setting.schedule)))
    pattern = np.where(setting.schedule.run == run, shape, 0.0)
    cells = tuple(CellTruth(order=str(int(k)), time="between_runs") for k in orders)
    return _along_grating("odd_run", pattern, cells, kind="event")


def order_random_by_run(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order from 2 with another amplitude and phase in each run."""
    runs, which = np.unique(setting.schedule.run, return_inverse=True)
    order = int(rng.integers(2, 6))
    drawn = (rng.normal(size=runs.size) + 1j * rng.normal(size=runs.size))[which]
    pattern = (drawn * np.exp(1j * order * np.deg2rad(setting.schedule.angle_deg))).real
    cells = (CellTruth(order=str(order), time="between_runs"),)
    return _along_grating("order_random_by_run", pattern, cells, kind="random")


def oscillation_in_time(setting: Setting, rng: np.random.Generator) -> Defect:
    """The room's air conditioning, or a wandering pier: a period in time, a phase that slips from run to run."""
    period_s = float(np.exp(rng.uniform(np.log(90.0), np.log(600.0))))
    runs, which = np.unique(setting.schedule.run, return_inverse=True)
    slipped = rng.uniform(0, 2 * np.pi, size=runs.size)[which]
    pattern = np.sin(2 * np.pi * setting.schedule.time_s / period_s + slipped)
    return _along_grating(
        "oscillation_in_time", pattern, (CellTruth(order="0", time="within_run"),), kind="random"
    )


def growing_in_run(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order that grows from the beginning of each run on."""
    since = setting.schedule.seconds_into_run()
    longest = max(float(since.max()), 1.0)
    order = int(rng.integers(2, 7))
    course = bare(np.sqrt(since / longest))
    cells = (CellTruth(order=str(order), time="within_run"),)
    return _along_grating("growing_in_run", course * wave(setting, order, phase(rng)), cells)


def order_by_direction(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order from 4 whose sign follows the direction of approach."""
    order = int(rng.integers(4, 10))
    state = friction_at_readings(setting.schedule, length_deg=float(rng.uniform(0.3, 0.9)))
    cells = (CellTruth(order=str(order), direction="odd"),)
    return _along_grating("order_by_direction", state * wave(setting, order, phase(rng)), cells)


def order_by_speed(setting: Setting, rng: np.random.Generator) -> Defect:
    """An order that shows in motion only."""
    speed = np.abs(setting.schedule.velocity_deg_s)
    order = int(rng.integers(3, 9))
    pattern = speed / max(float(speed.max()), 1e-9) * wave(setting, order, phase(rng))
    return _along_grating("order_by_speed", pattern, (CellTruth(order=str(order), speed="linear"),))


def direction_by_temperature(setting: Setting, rng: np.random.Generator) -> Defect:
    """Friction that changes its sense between cold and hot: grease and seal against one another."""
    state = friction_at_readings(setting.schedule, length_deg=float(rng.uniform(0.3, 0.9)))
    pattern = state * setting.relative_temperature
    cells = (CellTruth(order="0", direction="odd", temperature="linear"),)
    return _along_grating("direction_by_temperature", pattern, cells)


def order_by_load(setting: Setting, rng: np.random.Generator) -> Defect:
    """The load presses the grating out of shape: an order from 3."""
    load = setting.schedule.load_nm
    order = int(rng.integers(3, 8))
    pattern = bare(load + 1e-9 * setting.schedule.time_s) * wave(setting, order, phase(rng))
    return _along_grating("order_by_load", pattern, (CellTruth(order=str(order), load="linear"),))


def load_by_temperature(setting: Setting, rng: np.random.Generator) -> Defect:
    """A coupling that is soft when hot and over-tight when cold, so that the load's effect changes its sign."""
    pattern = setting.schedule.load_nm / float(setting.schedule.load_nm.max()) * setting.relative_temperature
    cells = (CellTruth(order="0", load="linear", temperature="linear"),)
    return _along_grating("load_by_temperature", pattern, cells)


def moving_speck(setting: Setting, rng: np.random.Generator) -> Defect:
    """A speck whose shadow grows and turns its sign with temperature."""
    seen = float(setting.schedule.angle_deg[rng.integers(len(setting.schedule))])
    away = np.abs((setting.schedule.angle_deg - seen + 180.0) % 360.0 - 180.0)
    pattern = np.clip(1.3 - away / float(rng.uniform(4.0, 8.0)), 0.0, 1.0) * setting.relative_temperature
    return _along_grating("moving_speck", pattern, (CellTruth(order="localized", temperature="linear"),))


ON_ANY_PLAN: dict[str, Family] = {
    each.__name__: each
    for each in (
        kink_in_temperature,
        step_in_temperature,
        wandering_phase,
        saturating_temperature,
        campaign_drift,
        slipped_once,
        odd_run,
        order_random_by_run,
        oscillation_in_time,
        moving_speck,
    )
}
ON_RICH_PLAN: dict[str, Family] = ON_ANY_PLAN | {
    each.__name__: each
    for each in (
        growing_in_run,
        order_by_direction,
        order_by_speed,
        direction_by_temperature,
        order_by_load,
        load_by_temperature,
    )
}
