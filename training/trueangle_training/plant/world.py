"""One joint in one campaign, before anything is wrong with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.bench import error_arcsec, indicate
from trueangle_training.plant.contribution import Setting
from trueangle_training.plant.heat import Sensor, draw_climate, draw_sensor
from trueangle_training.plant.joint_base import (
    BaseSizes,
    Encoder,
    base_contribution,
    draw_base,
    draw_encoder,
    draw_listing,
    draw_setting,
)
from trueangle_training.plant.noise import Noise, draw_noise
from trueangle_training.plant.schedule import PlanName, draw_schedule
from trueangle_training.plant.simulator_reach import Listing

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """All that a case is made of but its defects."""

    setting: Setting
    encoder: Encoder
    sensor: Sensor
    noise: Noise
    base: BaseSizes
    listing: Listing


def draw_world(plan: PlanName, rng: np.random.Generator) -> World:
    """A campaign after a plan, an encoder, noise, sizes of what may be listed, and what is listed."""
    schedule = draw_schedule(plan, rng)
    climate = draw_climate(schedule, rng)
    encoder = draw_encoder(rng)
    return World(
        setting=draw_setting(schedule, climate, encoder, rng),
        encoder=encoder,
        sensor=draw_sensor(rng),
        noise=draw_noise(schedule, rng),
        base=draw_base(rng),
        listing=draw_listing(rng),
    )


def noise_of_one_reading(world: World) -> float:
    """Standard deviation about the zero groups' means, rounding to counts included, outliers left out."""
    usual = world.noise.usual_arcsec
    groups, which = np.unique(world.setting.schedule.zero_group, return_inverse=True)
    left = usual - (np.bincount(which, usual) / np.bincount(which))[which]
    variance = float(left @ left) / (left.size - groups.size)
    return float(np.sqrt(variance + world.setting.count_arcsec**2 / 12.0))


def base_curve(world: World) -> Floats:
    """Indicated minus reference of the joint as its maker knows it, without noise, shape [n]."""
    return error_arcsec(indicate(world.setting, base_contribution(world.setting, world.base, world.listing)))
