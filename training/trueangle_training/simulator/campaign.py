"""A calibration campaign with polygon and autocollimator, as an operator would measure it.

One run for each temperature, repeat and direction, in this order. In a run the shaft is stopped where the
autocollimator sees the next face, once round, starting at the first stop at or after the encoder's zero. With the
polygon turned on the shaft by s face pitches, face p is seen at the true angle (p - 1 + s) 360 / faces: the whole
part of s only renames the faces, its fraction moves the stops.

Each run is zeroed at its first reading (Eq. 11 of Jia et al. 2020): with indicated angle theta_j, autocollimator
reading delta_j and the nominal angle phi_j of stop j from the first one,

    error_j = (theta_j - delta_j) - (theta_1 - delta_1) - phi_j

so the noise of the first reading enters all of the run. A plan with one zero counts all runs from the campaign's
first reading: the drift of the datum with temperature then stays in the errors.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, campaign_to_csv
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint, Plan, PlanZero, ReferenceKind
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.simulator.joint import SimulatedJoint

SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSetup:
    """One run of a plan: what distinguishes it from the others."""

    run: int
    temperature_c: float
    """Set point."""
    offset_faces: float
    """Turn of the polygon on the shaft, 0 <= offset < faces."""
    direction: int
    started_s: float

    @property
    def whole_faces(self) -> int:
        """By how many whole faces the polygon is turned: it only renames the faces."""
        return math.floor(self.offset_faces)

    def stops(self, faces: int) -> NDArray[np.int64]:
        """Place of each reading in the turn, counted in faces from the first one, shape [faces]."""
        # Downwards the first stop is the same one, then the last: both directions share their zero.
        return self.direction * np.arange(faces) % faces

    def stop_deg(self, faces: int) -> NDArray[np.float64]:
        """True angle of each reading, shape [faces]."""
        broken = self.offset_faces - self.whole_faces
        return (self.stops(faces).astype(np.float64) + broken) * (DEG_PER_TURN / faces)

    def stop_faces(self, faces: int) -> NDArray[np.int64]:
        """Polygon face 1..n of each reading, shape [faces]."""
        return (self.stops(faces) - self.whole_faces) % faces + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Readings:
    """The readings of one run, shape [faces], in the order in which they were taken."""

    angle_deg: NDArray[np.float64]
    from_stop_arcsec: NDArray[np.float64]
    """Error, not yet zeroed."""
    face: NDArray[np.int64]
    temperature_c: float
    """Shown by the sensor."""


def simulate_campaign(simulated: SimulatedJoint, plan: Plan, seed: int) -> Campaign:
    """The campaign of `plan` on the joint; the same seed gives the same readings.

    `angle_deg` is the encoder-indicated angle, quantised to counts, as a counter shows it that passed its zero
    just before the run: a first stop may be a few arcsec below 0 and is not wrapped to 360. `row` and `sha256` are
    those of the campaign written without comments.
    """
    _check_polygon(simulated.joint, plan)
    rng = np.random.default_rng(seed)
    setups = tuple(run_setups(plan))
    runs = tuple(_measure_run(simulated, plan, setup, rng) for setup in setups)
    zeroed = [(each, (runs[0] if plan.zero is PlanZero.ONE else each).from_stop_arcsec[0]) for each in runs]
    n = plan.faces
    elapsed_s = np.arange(n, dtype=np.float64) * plan.seconds_per_reading

    def each_run(values: list[int]) -> NDArray[np.int64]:
        return np.repeat(np.array(values, dtype=np.int64), n)

    run = each_run([setup.run for setup in setups])
    campaign = Campaign(
        angle_deg=np.concatenate([readings.angle_deg for readings in runs]),
        error_arcsec=np.concatenate([readings.from_stop_arcsec - zero_arcsec for readings, zero_arcsec in zeroed]),
        run=run,
        zero_group=np.ones_like(run) if plan.zero is PlanZero.ONE else run.copy(),
        row=np.arange(2, run.size + 2, dtype=np.int64),
        source="simulation",
        sha256="",
        temperature_c=np.repeat(np.array([readings.temperature_c for readings in runs]), n),
        time_s=np.concatenate([setup.started_s + elapsed_s for setup in setups]),
        direction=each_run([setup.direction for setup in setups]),
        velocity_deg_s=np.zeros(run.size),
        face=np.concatenate([readings.face for readings in runs]),
        polygon_offset=each_run([setup.whole_faces for setup in setups]),
    )
    digest = hashlib.sha256(campaign_to_csv(campaign).encode()).hexdigest()
    return replace(campaign, sha256=digest)


def _check_polygon(joint: Joint, plan: Plan) -> None:
    reference = joint.reference
    if reference.kind is not ReferenceKind.POLYGON:
        found = reference.kind.value
        raise ContractError([Fault(where="reference.kind", expected="polygon to simulate", found=found)])
    if reference.faces != plan.faces:
        expected = f"the joint's polygon with {reference.faces} faces"
        raise ContractError([Fault(where="the plan's faces", expected=expected, found=str(plan.faces))])


def run_setups(plan: Plan) -> Iterator[RunSetup]:
    """The runs of a plan in the order in which they are measured."""
    run = 0
    clock_s = 0.0
    for temperature_c in plan.temperatures_c:
        clock_s += plan.soak_h * SECONDS_PER_HOUR
        for repeat in range(plan.repeats):
            for direction in plan.directions:
                run += 1
                yield RunSetup(
                    run=run,
                    temperature_c=temperature_c,
                    offset_faces=repeat * plan.shift_faces % plan.faces,
                    direction=direction,
                    started_s=clock_s,
                )
                clock_s += plan.faces * plan.seconds_per_reading


def _measure_run(simulated: SimulatedJoint, plan: Plan, setup: RunSetup, rng: np.random.Generator) -> _Readings:
    reference = simulated.joint.reference
    jitter_c = plan.temperature_jitter_c
    temperature_c = setup.temperature_c + rng.uniform(-jitter_c, jitter_c)
    true_deg = setup.stop_deg(plan.faces)
    counts = simulated.indicated_counts(true_deg, temperature_c, rng)
    autocollimator_arcsec = rng.normal(0.0, reference.autocollimator_arcsec, size=plan.faces)
    angle_deg = counts.astype(np.float64) * (DEG_PER_TURN / simulated.joint.encoder.counts_per_rev)
    from_stop_arcsec = (angle_deg - true_deg) * ARCSEC_PER_DEG - autocollimator_arcsec
    return _Readings(
        angle_deg=angle_deg,
        from_stop_arcsec=from_stop_arcsec,
        face=setup.stop_faces(plan.faces),
        temperature_c=simulated.shown_temperature_c(temperature_c),
    )
