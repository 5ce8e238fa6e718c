"""What heat does along the joint."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.mechanical.chain import Share, Stand, phasor

Floats = NDArray[np.float64]

EXPANSION_GROWTH_PER_K = 1.2e-4
"""Relative growth of a metal's expansion, about half of that of steel, as two metals work against each other."""


def expansion(stand: Stand) -> Floats:
    """Differential expansion at the readings, 1 for 15 K above 20 degC, shape [n]."""
    x = stand.heat.warming
    return x * (1.0 + 0.5 * EXPANSION_GROWTH_PER_K * 15.0 * x)


def thermal_eccentricity(stand: Stand, rng: np.random.Generator) -> Defect:
    """Hub and disc expand unequally about a seat that is not in the middle."""
    toward = expansion(stand) * phasor(rng)
    return Defect(
        name="thermal_eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(centre_arcsec=size * toward),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={},
    )


def thermal_tilt(stand: Stand, rng: np.random.Generator) -> Defect:
    """Two screws hold the ring while it grows: it becomes oval."""
    toward = expansion(stand) * phasor(rng)
    return Defect(
        name="thermal_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(oval_arcsec=size * toward),
        cells=(CellTruth(order="2", temperature="linear"),),
        parameters={},
    )


def thermal_nonlinearity(stand: Stand, rng: np.random.Generator) -> Defect:
    """A seat that grows softer as it warms gives way by the square of the warming, a little less when hot."""
    x, order = expansion(stand), int(rng.integers(1, 3))
    softer = float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.05, 0.2))
    toward = x**2 / (1.0 + softer * x) * phasor(rng)
    return Defect(
        name="thermal_nonlinearity",
        in_library=True,
        kind="mean",
        contribute=lambda size: (
            Share(centre_arcsec=size * toward) if order == 1 else Share(oval_arcsec=size * toward)
        ),
        cells=(CellTruth(order=str(order), temperature="quadratic"),),
        parameters={"order": float(order)},
    )


def thermal_lag(stand: Stand, rng: np.random.Generator) -> Defect:
    """The disc hangs on its rim by bad glue and comes late; its centre moves, and the index a little."""
    diffusion_s = float(np.exp(rng.uniform(np.log(500.0), np.log(5000.0))))
    behind = stand.heat.behind_k(diffusion_s)
    toward, along = phasor(rng), float(rng.normal(0.0, 0.12))
    return Defect(
        name="thermal_lag",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(centre_arcsec=size * behind * toward, index_arcsec=size * along * behind),
        cells=(CellTruth(order="1", temperature="lagged"), CellTruth(order="0", temperature="lagged")),
        parameters={"diffusion_s": diffusion_s},
    )


def self_heating(stand: Stand, rng: np.random.Generator) -> Defect:
    """The bearing's heat runs along the shaft: the index moves, and the grating's centre."""
    diffusion_s = float(np.exp(rng.uniform(np.log(400.0), np.log(3000.0))))
    heat = stand.heat.motion_heat(
        diffusion_s, film_share=float(rng.uniform(0.0, 1.0)), place=float(rng.uniform(0.78, 1.0))
    )
    toward = float(rng.uniform(0.2, 0.6)) * phasor(rng)
    return Defect(
        name="self_heating",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(index_arcsec=size * heat, centre_arcsec=size * heat * toward),
        cells=(
            CellTruth(order="0", time="within_run"),
            CellTruth(order="0", speed="linear"),
            *(CellTruth(order=order, time="within_run", speed="linear") for order in ("0", "1")),
        ),
        parameters={"diffusion_s": diffusion_s},
    )


def temperature_sensor_error(stand: Stand, rng: np.random.Generator) -> Defect:
    """A sensor that has aged: zero and slope are off, whatever size is asked for."""
    bias_c, gain = float(rng.normal(0.0, 1.0)), 1.0 + float(rng.normal(0.0, 0.04))
    return Defect(
        name="temperature_sensor_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(bias_c=bias_c, gain=gain),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={"bias_c": bias_c, "gain": gain},
    )
