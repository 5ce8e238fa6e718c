"""One joint in one campaign, before anything is wrong with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.defect import AtSize, Defect
from trueangle_training.plant.listing import Encoder, Listing, draw_encoder, draw_listing
from trueangle_training.plant.reading_head.bench import error_arcsec, indicate, measure
from trueangle_training.plant.reading_head.contribution import Contribution, Setting, together
from trueangle_training.plant.reading_head.grating_defects import graduation_error
from trueangle_training.plant.reading_head.heat import Sensor, draw_climate, draw_sensor
from trueangle_training.plant.reading_head.joint_base import (
    BaseSizes,
    base_contribution,
    draw_base,
    draw_setting,
)
from trueangle_training.plant.reading_head.library_defects import LIBRARY_DEFECTS
from trueangle_training.plant.reading_head.noise import Noise, draw_noise
from trueangle_training.plant.reading_head.unknown_defects import ON_ANY_PLAN, ON_RICH_PLAN
from trueangle_training.plant.schedule import PlanName, draw_schedule
from trueangle_training.plant.world import Measured, Plant

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingHead:
    """All that a case is made of but its defects."""

    setting: Setting
    encoder: Encoder
    sensor: Sensor
    noise: Noise
    base: BaseSizes
    listing: Listing

    @property
    def conditions(self) -> Conditions:
        """What the readings were taken under."""
        climate = self.setting.climate
        return Conditions(
            schedule=self.setting.schedule,
            grid_s=climate.grid_s,
            body_c=climate.body_c,
            travel_deg=climate.travel_deg,
            lines_per_rev=self.setting.lines_per_rev,
        )

    @property
    def sensor_step_c(self) -> float:
        """Resolution of the temperature sensor."""
        return self.sensor.step_c

    def with_listing(self, listing: Listing) -> Self:
        """The same joint when other effects are listed, and so present."""
        return replace(self, listing=listing)

    def noise_of_one_reading(self) -> float:
        """Standard deviation about the zero groups' means, rounding to counts included, outliers left out."""
        usual = self.noise.usual_arcsec
        groups, which = np.unique(self.setting.schedule.zero_group, return_inverse=True)
        left = usual - (np.bincount(which, usual) / np.bincount(which))[which]
        variance = float(left @ left) / (left.size - groups.size)
        return float(np.sqrt(variance + self.setting.count_arcsec**2 / 12.0))

    def defect(self, name: str, rng: np.random.Generator) -> Defect:
        """One effect of the library, or a family of the unknown."""
        if name == "graduation_error":
            return graduation_error(self.setting, rng, avoid=self.listing.constant)
        return (LIBRARY_DEFECTS[name] if name in LIBRARY_DEFECTS else ON_RICH_PLAN[name])(self.setting, rng)

    def curve_arcsec(self, sized: Sequence[AtSize]) -> Floats:
        """Indicated minus reference without noise, shape [n]."""
        return error_arcsec(indicate(self.setting, self._all(sized)))

    def scatter_arcsec(self, sized: AtSize) -> Floats:
        """Standard deviation that a defect adds to each reading, shape [n]."""
        part: Contribution = sized.part
        shape = self.setting.schedule.angle_deg.shape
        if part.coarse > 1:
            return np.full(shape, np.sqrt((part.coarse**2 - 1.0) / 12.0) * self.setting.count_arcsec)
        return np.array(np.broadcast_to(np.asarray(part.scatter_arcsec, dtype=np.float64), shape))

    def measured(self, sized: Sequence[AtSize], rng: np.random.Generator) -> Measured:
        """The campaign's columns, with noise and rounding."""
        sensor = self.sensor
        if not set(self.listing.thermal) <= set(self.listing.constant):
            # Its bias would show as a constant pattern that nothing listed takes up: an effect in itself.
            sensor = replace(sensor, bias_c=0.0)
        for each in sized:
            if each.defect.name == "temperature_sensor_error":
                parameters = each.defect.parameters
                sensor = replace(
                    sensor, bias_c=sensor.bias_c + parameters["bias_c"], gain=sensor.gain * parameters["gain"]
                )
        return measure(
            self.setting,
            self._all(sized),
            sensor=sensor,
            noise_arcsec=self.noise.total_arcsec,
            extra_noise=rng.normal(size=len(self.setting.schedule)),
            reference_step_arcsec=float(rng.choice([0.01, 0.02, 0.05])),
        )

    def _all(self, sized: Sequence[AtSize]) -> Contribution:
        base = base_contribution(self.setting, self.base, self.listing)
        return together([base, *(each.part for each in sized)])


def draw_world(plan: PlanName, rng: np.random.Generator) -> ReadingHead:
    """A campaign after a plan, an encoder, noise, sizes of what may be listed, and what is listed."""
    schedule = draw_schedule(plan, rng)
    climate = draw_climate(schedule, rng)
    encoder = draw_encoder(rng)
    return ReadingHead(
        setting=draw_setting(schedule, climate, encoder, rng),
        encoder=encoder,
        sensor=draw_sensor(rng),
        noise=draw_noise(schedule, rng),
        base=draw_base(rng),
        listing=draw_listing(rng),
    )


PLANT = Plant(
    letter="A",
    description="exact geometry of reading head and grating, sine and cosine signals, Ornstein-Uhlenbeck noise",
    library=tuple(LIBRARY_DEFECTS),
    unknown={"paper": tuple(ON_ANY_PLAN), "rich": tuple(ON_RICH_PLAN)},
    draw_world=draw_world,
)
