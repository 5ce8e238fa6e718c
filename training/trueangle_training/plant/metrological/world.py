"""One joint in this laboratory in one campaign."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.defect import AtSize, Defect
from trueangle_training.plant.listing import Encoder, Listing, draw_encoder, draw_listing
from trueangle_training.plant.metrological import encoder_causes, joint_causes, reference_causes
from trueangle_training.plant.metrological.chain import Bench, Part, signs
from trueangle_training.plant.metrological.habits import with_habits
from trueangle_training.plant.metrological.joint_known import Known, draw_bench, draw_known, known_parts
from trueangle_training.plant.metrological.scatter import Scatter, draw_scatter
from trueangle_training.plant.metrological.soak import Probe, draw_probe, draw_soak
from trueangle_training.plant.metrological.surprises import ON_ANY_PLAN, ON_RICH_PLAN
from trueangle_training.plant.schedule import PlanName, draw_schedule
from trueangle_training.plant.world import Measured, Plant, zeroed

Floats = NDArray[np.float64]
Maker = Callable[[Bench, np.random.Generator], Defect]

LIBRARY: dict[str, Maker] = {
    "eccentricity": encoder_causes.eccentricity,
    "grating_tilt": encoder_causes.grating_tilt,
    "graduation_error": encoder_causes.graduation_error,
    "localized_defect": encoder_causes.localized_defect,
    "subdivision_error": encoder_causes.subdivision_error,
    "quantisation": encoder_causes.quantisation,
    "count_loss": encoder_causes.count_loss,
    "thermal_eccentricity": joint_causes.thermal_eccentricity,
    "thermal_tilt": joint_causes.thermal_tilt,
    "thermal_graduation": joint_causes.thermal_graduation,
    "thermal_nonlinearity": joint_causes.thermal_nonlinearity,
    "thermal_lag": joint_causes.thermal_lag,
    "temperature_sensor_error": joint_causes.temperature_sensor_error,
    "self_heating": joint_causes.self_heating,
    "hysteresis": joint_causes.hysteresis,
    "windup": joint_causes.windup,
    "bearing_wobble": joint_causes.bearing_wobble,
    "load_deflection": joint_causes.load_deflection,
    "index_drift": joint_causes.index_drift,
    "read_latency": encoder_causes.read_latency,
    "reference_artefact": reference_causes.reference_artefact,
    "run_to_run_eccentricity": joint_causes.run_to_run_eccentricity,
    "noise_growth": joint_causes.noise_growth,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Laboratory:
    """All that a case is made of but its defects."""

    bench: Bench
    probe: Probe
    scatter: Scatter
    known: Known
    listing: Listing

    @property
    def conditions(self) -> Conditions:
        """What the readings were taken under."""
        soak = self.bench.soak
        return Conditions(
            schedule=self.bench.schedule,
            grid_s=soak.grid_s,
            body_c=soak.body_c,
            travel_deg=soak.travel_deg,
            lines_per_rev=self.encoder.lines_per_rev,
        )

    @property
    def encoder(self) -> Encoder:
        """Its label."""
        return self.bench.encoder

    @property
    def sensor_step_c(self) -> float:
        """Resolution of the temperature sensor."""
        return self.probe.step_c

    def with_listing(self, listing: Listing) -> Self:
        """The same joint when other effects are listed, and so present."""
        return replace(self, listing=listing)

    def noise_of_one_reading(self) -> float:
        """Standard deviation about the zero groups' means, rounding to counts included, gross errors left out."""
        usual = self.scatter.usual_arcsec
        groups, which = np.unique(self.bench.schedule.zero_group, return_inverse=True)
        left = usual - (np.bincount(which, usual) / np.bincount(which))[which]
        variance = float(left @ left) / (left.size - groups.size)
        return float(np.sqrt(variance + self.encoder.count_arcsec**2 / 12.0))

    def defect(self, name: str, rng: np.random.Generator) -> Defect:
        """One effect of the library, or a family of the unknown."""
        if name == "graduation_error":
            return encoder_causes.graduation_error(self.bench, rng, avoid=self.listing.constant)
        return (LIBRARY[name] if name in LIBRARY else ON_RICH_PLAN[name])(self.bench, rng)

    def curve_arcsec(self, sized: Sequence[AtSize]) -> Floats:
        """Indicated minus reference without noise and rounding, shape [n]."""
        return signs(self.bench, self._parts(sized)).error_arcsec

    def scatter_arcsec(self, sized: AtSize) -> Floats:
        """Standard deviation that a defect adds to each reading, shape [n]."""
        part: Part = sized.part
        shape = self.bench.schedule.angle_deg.shape
        if part.bits_lost > 1:
            return np.full(shape, np.sqrt((part.bits_lost**2 - 1.0) / 12.0) * self.encoder.count_arcsec)
        return np.array(np.broadcast_to(np.asarray(part.scatter_arcsec, dtype=np.float64), shape))

    def measured(self, sized: Sequence[AtSize], rng: np.random.Generator) -> Measured:
        """The campaign's columns, with noise and rounding: counts cut off, the reference's digits rounded."""
        schedule, parts = self.bench.schedule, self._parts(sized)
        both = signs(self.bench, parts)
        coarse = max(part.bits_lost for part in parts)
        lattice_arcsec = self.encoder.count_arcsec * coarse
        true_arcsec = schedule.angle_deg * 3600.0
        counted = np.floor((true_arcsec + both.encoder_arcsec) / lattice_arcsec) * lattice_arcsec
        more = np.sqrt(sum((np.square(np.asarray(part.scatter_arcsec)) for part in parts), np.float64(0.0)))
        noise = self.scatter.usual_arcsec + self.scatter.gross_arcsec + more * rng.normal(size=len(schedule))
        step_arcsec = float(rng.choice([0.01, 0.02, 0.05]))
        beside = self.bench.reference.beside_arcsec
        read = np.round((beside + both.reference_arcsec - noise) / step_arcsec) * step_arcsec - beside
        return Measured(
            angle_deg=counted / 3600.0,
            error_arcsec=zeroed(counted - true_arcsec - read, schedule.zero_group),
            temperature_c=self._probe(sized).readings_c(self.bench.soak, schedule.seconds_into_run()),
        )

    def _probe(self, sized: Sequence[AtSize]) -> Probe:
        probe = self.probe
        if not set(self.listing.thermal) <= set(self.listing.constant):
            # Nothing listed would take up the constant pattern that its bias makes: an effect, no ordinary probe.
            probe = replace(probe, bias_c=0.0)
        for each in sized:
            if each.defect.name == "temperature_sensor_error":
                wrong = each.defect.parameters
                probe = replace(probe, bias_c=probe.bias_c + wrong["bias_c"], gain=probe.gain * wrong["gain"])
        return probe

    def _parts(self, sized: Sequence[AtSize]) -> list[Part]:
        return [*known_parts(self.bench, self.known, self.listing), *(each.part for each in sized)]


def draw_world(plan: PlanName, rng: np.random.Generator) -> Laboratory:
    """A campaign after a plan, what stands in the laboratory, its noise, and what is listed."""
    schedule = with_habits(draw_schedule(plan, rng), rng)
    soak, encoder = draw_soak(schedule, rng), draw_encoder(rng)
    return Laboratory(
        bench=draw_bench(schedule, soak, encoder, rng),
        probe=draw_probe(rng),
        scatter=draw_scatter(schedule, rng),
        known=draw_known(rng),
        listing=draw_listing(rng),
    )


PLANT = Plant(
    letter="C",
    description="line-by-line grating, certified polygon and autocollimator, short soak, ringing and turbulence",
    library=tuple(LIBRARY),
    unknown={"paper": tuple(ON_ANY_PLAN), "rich": tuple(ON_RICH_PLAN)},
    draw_world=draw_world,
)
