"""One joint in one campaign, and the plant that draws it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.defect import AtSize, Defect
from trueangle_training.plant.listing import Encoder, Listing, draw_encoder, draw_listing
from trueangle_training.plant.mechanical import drive_defects, seat_defects, thermal_defects
from trueangle_training.plant.mechanical.chain import Floats, Share, Stand, error_arcsec, phasor, scatter_arcsec
from trueangle_training.plant.mechanical.joint_heat import Sensor, draw_joint_heat, draw_sensor
from trueangle_training.plant.mechanical.noise import Noise, draw_noise
from trueangle_training.plant.mechanical.seat_defects import HIGHEST_ORDER, screwed_down
from trueangle_training.plant.mechanical.unknown_defects import ON_ANY_PLAN, ON_RICH_PLAN
from trueangle_training.plant.schedule import PlanName, draw_schedule
from trueangle_training.plant.world import Measured, Plant, zeroed

LIBRARY: dict[str, Callable[[Stand, np.random.Generator], Defect]] = {
    "eccentricity": seat_defects.eccentricity,
    "grating_tilt": seat_defects.grating_tilt,
    "graduation_error": seat_defects.graduation_error,
    "thermal_eccentricity": thermal_defects.thermal_eccentricity,
    "thermal_tilt": thermal_defects.thermal_tilt,
    "thermal_nonlinearity": thermal_defects.thermal_nonlinearity,
    "thermal_lag": thermal_defects.thermal_lag,
    "temperature_sensor_error": thermal_defects.temperature_sensor_error,
    "self_heating": thermal_defects.self_heating,
    "hysteresis": drive_defects.hysteresis,
    "windup": drive_defects.windup,
    "bearing_wobble": drive_defects.bearing_wobble,
    "load_deflection": drive_defects.load_deflection,
    "index_drift": drive_defects.index_drift,
    "read_latency": drive_defects.read_latency,
    "run_to_run_eccentricity": seat_defects.run_to_run_eccentricity,
    "noise_growth": drive_defects.noise_growth,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Listed:
    """Sizes and directions of every effect that may be listed, in arcsec; drawn whether it is listed or not."""

    constant: dict[int, complex]
    thermal: dict[int, complex]
    """For 15 K."""
    drift_arcsec_per_k: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joint:
    """All that a case is made of but its defects."""

    stand: Stand
    encoder: Encoder
    sensor: Sensor
    noise: Noise
    listed: Listed
    listing: Listing

    @property
    def conditions(self) -> Conditions:
        """What the readings were taken under."""
        return self.stand.conditions

    @property
    def sensor_step_c(self) -> float:
        """Resolution of the temperature sensor."""
        return self.sensor.step_c

    def with_listing(self, listing: Listing) -> Self:
        """The same joint when other effects are listed, and so present."""
        return replace(self, listing=listing)

    def noise_of_one_reading(self) -> float:
        """Standard deviation about the zero groups' means, rounding to counts included, bursts left out."""
        usual, groups = self.noise.usual_arcsec, self.conditions.schedule.zero_group
        squares, free = self.encoder.count_arcsec**2 / 12.0 * usual.size, 0
        for group in np.unique(groups):
            own = usual[groups == group]
            squares += float(np.sum((own - own.mean()) ** 2))
            free += own.size - 1
        return float(np.sqrt(squares / free))

    def defect(self, name: str, rng: np.random.Generator) -> Defect:
        """One effect of the library, or a family of the unknown."""
        if name == "graduation_error":
            return seat_defects.graduation_error(self.stand, rng, avoid=self.listing.constant)
        return (LIBRARY[name] if name in LIBRARY else ON_RICH_PLAN[name])(self.stand, rng)

    def curve_arcsec(self, sized: Sequence[AtSize]) -> Floats:
        """Indicated minus reference without noise, shape [n]."""
        return error_arcsec(self.stand, [self._known(), *(each.part for each in sized)])

    def scatter_arcsec(self, sized: AtSize) -> Floats:
        """Standard deviation that a defect adds to each reading, shape [n]."""
        return scatter_arcsec(self.stand, [sized.part])

    def measured(self, sized: Sequence[AtSize], rng: np.random.Generator) -> Measured:
        """The encoder trembles a little and is rounded to counts; the reference has the rest of the noise."""
        parts: list[Share] = [each.part for each in sized]
        schedule = self.conditions.schedule
        scatter = scatter_arcsec(self.stand, parts) * rng.normal(size=len(schedule))
        trembling = float(rng.uniform(0.1, 0.9))
        wrong = self.curve_arcsec(sized) + trembling * self.noise.usual_arcsec + scatter
        count_deg = self.encoder.count_arcsec / 3600.0
        angle_deg = np.rint((schedule.angle_deg + wrong / 3600.0) / count_deg) * count_deg
        step = float(rng.choice([0.01, 0.02, 0.05]))
        said = -(1.0 - trembling) * self.noise.usual_arcsec - self.noise.rare_arcsec
        error = (angle_deg - schedule.angle_deg) * 3600.0 - np.rint(said / step) * step
        return Measured(
            angle_deg=angle_deg,
            error_arcsec=zeroed(error, schedule.zero_group),
            temperature_c=self._sensor_with(parts).readings_c(self.stand.heat),
        )

    def _sensor_with(self, parts: Sequence[Share]) -> Sensor:
        # Where a listed thermal order has no constant one beside it, a sensor's wrong zero would show as a
        # constant pattern that nothing listed takes up: that would be an effect, no ordinary sensor.
        absorbed = set(self.listing.thermal) <= set(self.listing.constant)
        gain = float(np.prod([part.gain for part in parts]))
        return replace(
            self.sensor,
            bias_c=(self.sensor.bias_c if absorbed else 0.0) + sum(part.bias_c for part in parts),
            gain=self.sensor.gain * gain,
        )

    def _known(self) -> Share:
        """Everything that is listed, and the datum's drift with temperature."""
        x = thermal_defects.expansion(self.stand)
        centre = np.zeros(x.size, dtype=np.complex128)
        oval = np.zeros(x.size, dtype=np.complex128)
        track = np.zeros(x.size)
        for order in self.listing.constant:
            size = self.listed.constant[order]
            if order == 1:
                centre += size
            elif order == 2:
                oval += size
            else:
                at = size / abs(size)
                track += abs(size) * screwed_down(self.stand, screws=order, at=at, uneven=1e-3)
        for order in self.listing.thermal:
            grown = self.listed.thermal[order] * x
            centre, oval = (centre + grown, oval) if order == 1 else (centre, oval + grown)
        drift = self.listed.drift_arcsec_per_k * 15.0 * self.stand.heat.warming
        return Share(centre_arcsec=centre, oval_arcsec=oval, track_arcsec=track, index_arcsec=drift)


def draw_listed(rng: np.random.Generator) -> Listed:
    """Usual amplitudes of a joint that was mounted with care."""
    sizes = {1: float(rng.uniform(15.0, 50.0)), 2: float(rng.uniform(2.0, 10.0))}
    sizes |= {order: float(rng.uniform(0.2, 7.0)) / order for order in range(3, HIGHEST_ORDER + 1)}
    warm = {1: float(rng.uniform(2.0, 8.0)), 2: float(rng.uniform(0.3, 2.0))}
    return Listed(
        constant={order: size * phasor(rng) for order, size in sizes.items()},
        thermal={order: size * phasor(rng) for order, size in warm.items()},
        drift_arcsec_per_k=float(rng.normal(0.0, 0.1)),
    )


def draw_world(plan: PlanName, rng: np.random.Generator) -> Joint:
    """A campaign after a plan, the joint's heat, an encoder, noise, and what is listed."""
    schedule = draw_schedule(plan, rng)
    heat, encoder = draw_joint_heat(schedule, rng), draw_encoder(rng)
    conditions = Conditions(
        schedule=schedule,
        grid_s=heat.grid_s,
        body_c=heat.grating_c,
        travel_deg=heat.travel_deg,
        lines_per_rev=encoder.lines_per_rev,
    )
    return Joint(
        stand=Stand(conditions=conditions, heat=heat),
        encoder=encoder,
        sensor=draw_sensor(rng),
        noise=draw_noise(schedule, rng),
        listed=draw_listed(rng),
        listing=draw_listing(rng),
    )


PLANT = Plant(
    letter="B",
    description="friction, compliance and heat stepped in time, series geometry, fractional noise",
    library=tuple(LIBRARY),
    unknown={"paper": tuple(ON_ANY_PLAN), "rich": tuple(ON_RICH_PLAN)},
    draw_world=draw_world,
)
