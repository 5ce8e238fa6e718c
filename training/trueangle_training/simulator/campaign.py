"""A calibration campaign as an operator would measure it, with polygon and autocollimator or a reference encoder.

Each run is zeroed at its first reading (Eq. 11 of Jia et al. 2020): with indicated angle theta_j, autocollimator
reading delta_j and the nominal angle phi_j of stop j from the first one,

    error_j = (theta_j - delta_j) - (theta_1 - delta_1) - phi_j

so the noise of the first reading enters all of the run. Runs that share a zero are counted from the first reading
of them all: the drift of the datum with temperature then stays in the errors.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, campaign_to_csv
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import EFFECT_NAMES, Joint, Plan, ReferenceKind
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.effects.conditions import Conditions, Timeline
from trueangle_training.simulator.joint import SimulatedJoint
from trueangle_training.simulator.schedule import SECONDS_PER_HOUR, Leg, legs

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Draws:
    """All that is drawn for the joint itself; shapes [readings]."""

    temperature_c: Floats
    """Of the place of the sensor, the chamber's jitter included."""
    noise_arcsec: Floats
    autocollimator_arcsec: Floats
    """0 against a reference encoder, whose scatter counts as the joint's repeatability."""


def simulate_campaign(simulated: SimulatedJoint, plan: Plan, seed: int) -> Campaign:
    """The campaign of `plan` on the joint; the same seed gives the same readings.

    `angle_deg` is the encoder-indicated angle, quantised to counts, as a counter shows it that passed its zero
    just before the run: a first stop may be a few arcsec below 0 and is not wrapped to 360. `row` and `sha256` are
    those of the campaign written without comments.
    """
    joint = simulated.joint
    ways = legs(plan)
    _check_polygon(joint, plan, ways)
    draws = _draws(joint, plan, ways, np.random.default_rng(seed))
    conditions = _conditions(joint, plan, ways, draws)
    counts = simulated.indicated_counts(conditions, draws.noise_arcsec, lambda name: _effect_rng(seed, name))
    angle_deg = counts.astype(np.float64) * (DEG_PER_TURN / joint.encoder.counts_per_rev)
    error_arcsec = (angle_deg - conditions.angle_deg) * ARCSEC_PER_DEG - draws.autocollimator_arcsec
    error_arcsec += simulated.reference_arcsec(conditions, lambda name: _effect_rng(seed, name))
    if joint.reference.polygon_arcsec > 0.0 and conditions.face is not None:
        error_arcsec -= _face_deviations_arcsec(joint, seed)[conditions.face]
    campaign = Campaign(
        angle_deg=angle_deg,
        error_arcsec=_zeroed(error_arcsec, conditions.zero_group),
        run=conditions.run,
        zero_group=conditions.zero_group,
        row=np.arange(2, counts.size + 2, dtype=np.int64),
        source="simulation",
        sha256="",
        temperature_c=simulated.shown_temperatures_c(draws.temperature_c),
        time_s=conditions.time_s,
        direction=_each([leg.direction for leg in ways], ways),
        velocity_deg_s=conditions.velocity_deg_s,
        load_nm=conditions.load_nm,
        face=conditions.face,
        polygon_offset=conditions.polygon_offset,
    )
    digest = hashlib.sha256(campaign_to_csv(campaign).encode()).hexdigest()
    return replace(campaign, sha256=digest)


def _effect_rng(seed: int, name: str) -> np.random.Generator:
    # A trailing 0 would be the campaign's own stream: numpy pads seeds with zeros.
    return np.random.default_rng([seed, 2 + EFFECT_NAMES.index(name)])


def _face_deviations_arcsec(joint: Joint, seed: int) -> Floats:
    """How far each face stands from where it is taken to stand; index 0, a reference encoder, stays 0."""
    faces = joint.reference.faces or 0
    deviations = np.random.default_rng([seed, 1]).normal(0.0, joint.reference.polygon_arcsec, size=faces)
    return np.concatenate([[0.0], deviations])


def _check_polygon(joint: Joint, plan: Plan, ways: Sequence[Leg]) -> None:
    reference = joint.reference
    if not any(leg.polygon for leg in ways):
        return
    if reference.kind is not ReferenceKind.POLYGON:
        found = reference.kind.value
        raise ContractError([Fault(where="reference.kind", expected="polygon to simulate", found=found)])
    if reference.faces != plan.faces:
        expected = f"the joint's polygon with {reference.faces} faces"
        raise ContractError([Fault(where="the plan's faces", expected=expected, found=str(plan.faces))])


def _draws(joint: Joint, plan: Plan, ways: Sequence[Leg], rng: np.random.Generator) -> _Draws:
    """Run by run, in the order in which they are measured."""
    temperature_c: list[Floats] = []
    noise_arcsec: list[Floats] = []
    autocollimator_arcsec: list[Floats] = []
    began_s, offset_c = 0.0, 0.0
    for before, leg in zip((None, *ways), ways, strict=False):
        if before is None or before.run != leg.run:
            jitter_c = plan.temperature_jitter_c
            began_s, offset_c = float(leg.time_s[0]), rng.uniform(-jitter_c, jitter_c)
        since_h = (leg.time_s - began_s) / SECONDS_PER_HOUR
        temperature_c.append((leg.set_point_c + offset_c) + leg.ramp_c_per_h * since_h)
        size = leg.true_deg.size
        noise_arcsec.append(rng.normal(0.0, joint.noise.repeatability_arcsec, size=size))
        scatter_arcsec = joint.reference.autocollimator_arcsec if leg.polygon else 0.0
        autocollimator_arcsec.append(rng.normal(0.0, scatter_arcsec, size=size))
    return _Draws(
        temperature_c=np.concatenate(temperature_c),
        noise_arcsec=np.concatenate(noise_arcsec),
        autocollimator_arcsec=np.concatenate(autocollimator_arcsec),
    )


def _each(values: Sequence[int], ways: Sequence[Leg]) -> Integers:
    """One value of each leg, for each of its readings."""
    return np.repeat(np.array(values, dtype=np.int64), [leg.true_deg.size for leg in ways])


def _conditions(joint: Joint, plan: Plan, ways: Sequence[Leg], draws: _Draws) -> Conditions:
    lengths = [leg.true_deg.size for leg in ways]
    loaded = any(leg.load_nm != 0.0 for leg in ways)
    return Conditions(
        angle_deg=np.concatenate([leg.true_deg for leg in ways]),
        run=_each([leg.run for leg in ways], ways),
        zero_group=_each([leg.zero_group for leg in ways], ways),
        lines_per_rev=joint.encoder.lines_per_rev,
        counts_per_rev=joint.encoder.counts_per_rev,
        base_temperature_c=joint.base_temperature_c,
        temperature_c=draws.temperature_c,
        time_s=np.concatenate([leg.time_s for leg in ways]),
        direction=_each([leg.direction for leg in ways], ways).astype(np.float64),
        velocity_deg_s=np.repeat([leg.velocity_deg_s for leg in ways], lengths),
        load_nm=np.repeat([leg.load_nm for leg in ways], lengths) if loaded else None,
        face=np.concatenate([leg.face for leg in ways]),
        polygon_offset=_each([leg.polygon_offset for leg in ways], ways),
        faces=joint.reference.faces,
        joint=joint,
        timeline=_timeline(joint, plan, ways, draws.temperature_c),
    )


def _timeline(joint: Joint, plan: Plan, ways: Sequence[Leg], temperature_c: Floats) -> Timeline:
    """From equilibrium at the base temperature on; ContractError where a soak ends before the chamber is there."""
    time_s: list[Floats] = [np.zeros(1)]
    knot_c: list[Floats] = [np.array([joint.base_temperature_c])]
    faults: list[Fault] = []
    first = 0
    for leg in ways:
        own_c = temperature_c[first : first + leg.time_s.size]
        first += leg.time_s.size
        if leg.soaked_since_s is not None:
            before_c, after_c = knot_c[-1][-1], own_c[0]
            soak_s = float(leg.time_s[0]) - leg.soaked_since_s
            rate = plan.chamber_c_per_h
            change_s = 0.0 if rate is None else abs(after_c - before_c) / rate * SECONDS_PER_HOUR
            # A step within the jitter is no change of the set point.
            if change_s > soak_s and abs(after_c - before_c) > 2 * plan.temperature_jitter_c:
                needed = f"at least {change_s / SECONDS_PER_HOUR:.2g} h to {leg.set_point_c:g} degC"
                found = f"{soak_s / SECONDS_PER_HOUR:.2g} h"
                faults.append(Fault(where="soak_h beside chamber_c_per_h", expected=needed, found=found))
            change_s = min(change_s, soak_s)
            time_s.append(leg.soaked_since_s + np.array([0.0, change_s]))
            knot_c.append(np.array([before_c, after_c]))
        time_s.append(leg.time_s)
        knot_c.append(own_c)
    if faults:
        raise ContractError(faults)
    return Timeline(
        time_s=np.concatenate(time_s),
        temperature_c=np.concatenate(knot_c),
    )


def _zeroed(from_stop_arcsec: Floats, zero_group: Integers) -> Floats:
    """Each zero group counted from its first reading."""
    _, first, place = np.unique(zero_group, return_index=True, return_inverse=True)
    return from_stop_arcsec - from_stop_arcsec[first][place]
