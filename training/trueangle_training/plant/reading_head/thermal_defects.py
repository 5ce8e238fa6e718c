"""What temperature does to the joint, and what motion's heat does."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.reading_head.contribution import Contribution, LineShift, Setting
from trueangle_training.plant.reading_head.geometry import ARCSEC_PER_RAD
from trueangle_training.plant.reading_head.grating_defects import phase, ruled_wave
from trueangle_training.plant.schedule import FACES

Floats = NDArray[np.float64]

BASE_C = 20.0
SPAN_K = 15.0


def warming(setting: Setting) -> Floats:
    """Temperature from 20 degC in units of 15 K, shape [n]."""
    return (setting.climate.temperature_c - BASE_C) / SPAN_K


def bimetal(x: Floats, *, bend: float) -> Floats:
    """Deflection of two materials whose expansion itself grows, less its linear part: near x^2 for |x| <= 1."""
    return 2.0 * (np.expm1(bend * x) - bend * x) / bend**2


def thermal_eccentricity(setting: Setting, rng: np.random.Generator) -> Defect:
    """Differential expansion moves the grating's centre."""
    toward, x = np.exp(1j * phase(rng)), warming(setting)
    return Defect(
        name="thermal_eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(centre_mm=setting.mm(size) * toward * x),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={},
    )


def thermal_tilt(setting: Setting, rng: np.random.Generator) -> Defect:
    """The grating tilts or grows oval with temperature."""
    axis, x = np.exp(1j * phase(rng)), warming(setting)
    return Defect(
        name="thermal_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(ovality=2.0 * size / ARCSEC_PER_RAD * axis * x),
        cells=(CellTruth(order="2", temperature="linear"),),
        parameters={},
    )


def thermal_graduation(setting: Setting, rng: np.random.Generator) -> Defect:
    """Lines carried along by a disc that expands unevenly: one or two orders >= 3."""
    orders = rng.choice(np.arange(3, (FACES - 1) // 2 + 1), size=int(rng.integers(1, 3)), replace=False)
    phases, x = [phase(rng) for _ in orders], warming(setting)
    skew = float(rng.uniform(0.02, 0.12))

    def shift_of(size: float) -> LineShift:
        return lambda place: (
            size
            * x
            * sum(
                ruled_wave(place, order=int(k), phase_rad=p, skew=skew)
                for k, p in zip(orders, phases, strict=True)
            )
        )

    return Defect(
        name="thermal_graduation",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(line_shifts=(shift_of(size),)),
        cells=tuple(CellTruth(order=str(k), temperature="linear") for k in orders),
        parameters={f"order_{i + 1}": float(k) for i, k in enumerate(orders)},
    )


def thermal_nonlinearity(setting: Setting, rng: np.random.Generator) -> Defect:
    """Expansion that itself grows with temperature, at order 1 or 2."""
    order = int(rng.integers(1, 3))
    toward = np.exp(1j * phase(rng))
    curve = bimetal(warming(setting), bend=float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.1, 0.45)))

    def contribute(size: float) -> Contribution:
        if order == 1:
            return Contribution(centre_mm=setting.mm(size) * toward * curve)
        return Contribution(ovality=2.0 * size / ARCSEC_PER_RAD * toward * curve)

    return Defect(
        name="thermal_nonlinearity",
        in_library=True,
        kind="mean",
        contribute=contribute,
        cells=(CellTruth(order=str(order), temperature="quadratic"),),
        parameters={"order": float(order)},
    )


def thermal_lag(setting: Setting, rng: np.random.Generator) -> Defect:
    """The grating is late behind its sensor: its centre, and a little its place, follow two nodes in a row."""
    constant = float(np.exp(rng.uniform(np.log(400.0), np.log(5000.0))))
    climate = setting.climate
    late = climate.lagged_c(constant)
    late = 0.9 * late + 0.1 * climate.lagged_c(2.5 * constant)
    behind = (late - climate.temperature_c) / 1.0
    toward = np.exp(1j * phase(rng))
    along = float(rng.normal(0.0, 0.15))
    return Defect(
        name="thermal_lag",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(
            centre_mm=setting.mm(size) * toward * behind, head_arcsec=size * along * behind
        ),
        cells=(CellTruth(order="1", temperature="lagged"), CellTruth(order="0", temperature="lagged")),
        parameters={"time_constant_s": constant},
    )


def self_heating(setting: Setting, rng: np.random.Generator) -> Defect:
    """Friction warms the shaft away from the sensor; the grating's centre and the head move."""
    constant = float(np.exp(rng.uniform(np.log(400.0), np.log(3500.0))))
    heat = setting.climate.motion_heat(constant, loss=float(rng.uniform(0.0, 0.1)))
    heat = heat / max(float(heat.max()), 1e-9)
    toward = np.exp(1j * phase(rng))
    once = float(rng.uniform(0.2, 0.6))
    return Defect(
        name="self_heating",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(
            head_arcsec=size * heat, centre_mm=setting.mm(size) * once * toward * heat
        ),
        cells=(
            CellTruth(order="0", time="within_run"),
            CellTruth(order="0", speed="linear"),
            *(CellTruth(order=order, time="within_run", speed="linear") for order in ("0", "1")),
        ),
        parameters={"time_constant_s": constant},
    )


def temperature_sensor_error(setting: Setting, rng: np.random.Generator) -> Defect:
    """Bias and gain of the sensor: absorbed wherever the thermal response that is modelled is linear."""
    return Defect(
        name="temperature_sensor_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={"bias_c": float(rng.normal(0.0, 1.0)), "gain": 1.0 + float(rng.normal(0.0, 0.04))},
    )
