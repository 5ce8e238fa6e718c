"""A campaign laid out for the diagnosis: what is computed once and sliced for each fold."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.diagnosis.condensing import condense
from trueangle_training.diagnosis.generic import generic_hypotheses
from trueangle_training.effects import EFFECTS, joint_settings
from trueangle_training.effects.conditions import Conditions, Integers, conditions_of
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature
from trueangle_training.effects.patterns import distinct_places

Floats = NDArray[np.float64]

FEWEST_READINGS_OF_EVENT = 3.5
"""k (n - k) / n for k of n readings: 5 of 23. A burst at the end of a run may wear two or three."""
STEADY_C = 0.5
"""Temperatures that differ by less are one temperature: a sensor's resolution and a chamber's jitter."""

LARGEST_OWN_NOISE = 6.0
"""Median deviations, four standard deviations of normal noise."""

ANGLES_OF_A_PLACE = 1.1
"""At most, on average: with more of them the indicated angle scatters about its place."""
READINGS_OF_AN_ANGLE = 2.0
"""At least, on average: with fewer nothing tells whether the joint comes back to the same angle."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Errors, what the simulator can say about them, and the shapes that may explain the rest."""

    conditions: Conditions
    error_arcsec: Floats
    """[readings], indicated minus reference, as measured."""
    joint: Joint
    nominal_arcsec: Floats
    """[readings], the simulator as shipped; 0 where JOINT.yaml leaves all parameters out."""
    modelled: Floats
    """[readings, columns]: the span in which re-calibration may move the effects that JOINT.yaml lists."""
    modelled_effects: tuple[str, ...]
    """The effect of each column of `modelled`."""
    drift: Floats
    """[readings, 0 or 1]: the datum's drift with temperature, which no zeroed campaign can lay to an effect."""
    hypotheses: tuple[Hypothesis, ...]
    """Of library and generic patterns alike, on all readings."""
    library: Mapping[str, LibraryEffect] = field(default_factory=dict[str, LibraryEffect])
    """The effects that may be named."""
    reading: Integers | None = None
    """[readings]: index of the row's first reading in the campaign; None: the campaign's own rows."""
    averaged: Integers | None = None
    """[readings]: readings of the campaign that are averaged in a row; None: one each."""
    notes: tuple[str, ...] = ()
    """What was averaged, filled in or left out, in plain words."""

    def __len__(self) -> int:
        return len(self.conditions)

    def offsets(self) -> Floats:
        """[readings, groups]: one free offset for each zero group."""
        groups = np.unique(self.conditions.zero_group)
        return (self.conditions.zero_group[:, None] == groups[None, :]).astype(np.float64)

    def nuisance(self) -> Floats:
        """[readings, columns]: all that is re-calibrated before a gap is structural."""
        return np.column_stack([self.offsets(), self.drift, self.modelled])

    def curve(self, hypothesis_index: int, coefficients: Floats) -> Floats:
        """[readings] of one hypothesis with main and wiggle coefficients."""
        shape = self.hypotheses[hypothesis_index]
        mains = shape.main.shape[1]
        return shape.main @ coefficients[:mains] + shape.wiggle @ coefficients[mains:]

    def rows(self, kept: NDArray[np.bool_] | Integers) -> "Problem":
        """The readings of a mask or of indices; shapes keep the values that they have in the whole campaign."""
        return replace(
            self,
            conditions=self.conditions.rows(kept),
            error_arcsec=self.error_arcsec[kept],
            nominal_arcsec=self.nominal_arcsec[kept],
            modelled=self.modelled[kept],
            drift=self.drift[kept],
            hypotheses=tuple(
                replace(each, main=each.main[kept], wiggle=each.wiggle[kept]) for each in self.hypotheses
            ),
            reading=None if self.reading is None else self.reading[kept],
            averaged=None if self.averaged is None else self.averaged[kept],
        )

    def without_errors(self) -> "Problem":
        """The plan alone, for the design check: every error is 0."""
        return replace(self, error_arcsec=np.zeros_like(self.error_arcsec))


def problem_of(campaign: Campaign, joint: Joint, *, library: Mapping[str, LibraryEffect] = EFFECTS) -> Problem:
    """Lay a campaign out; ContractError where the settings of JOINT.yaml's effects do not fit.

    Campaigns beyond 12,000 readings are condensed; missing temperatures and times are filled in between their
    neighbours; both are noted.
    """
    condensed = condense(campaign)
    rows = condensed.campaign
    conditions, notes = _complete(conditions_of(rows, joint))
    shown = conditions
    temperature = conditions.temperature_c
    if temperature is not None and float(np.ptp(temperature)) <= STEADY_C:
        # A chamber's jitter about one temperature shows no drift but noise divided by a tenth of a kelvin.
        shown = replace(conditions, temperature_c=None)
    crude, _, drift = recalibration_span(shown, joint)
    shown = _without_own_noise(shown, rows.error_arcsec, drift, crude)
    modelled, names, drift = recalibration_span(shown, joint)
    from_library = [
        replace(each, family=each.family or name, nature=effect.nature)
        for name, effect in library.items()
        for each in effect.hypotheses(shown)
        if effect.nature is not Nature.EVENT or _enough_readings(each.main, conditions.zero_group)
    ]
    return Problem(
        conditions=conditions,
        error_arcsec=rows.error_arcsec,
        joint=joint,
        nominal_arcsec=_nominal_arcsec(conditions, joint),
        modelled=modelled,
        modelled_effects=names,
        drift=drift,
        hypotheses=(*from_library, *generic_hypotheses(shown, library)),
        library=library,
        reading=condensed.reading,
        averaged=condensed.averaged,
        notes=(*campaign.notes, *condensed.notes, *notes),
    )


def _without_own_noise(
    conditions: Conditions, error_arcsec: Floats, drift: Floats, modelled: Floats
) -> Conditions:
    """The conditions with each reading's own scatter taken off its angle.

    The indicated angle holds the noise of the reading, and a column of many thousand periods a turn follows it:
    with 16,384 lines 0.6 arcsec are 0.05 rad of the phase. Such a column would explain the noise by itself. So it
    would where the noise is taken off an angle that does not hold it: set points of the encoder stay as they are.
    """
    if _at_set_points(conditions):
        return conditions
    _, group = np.unique(conditions.zero_group, return_inverse=True)
    count = np.bincount(group)
    table = np.column_stack([error_arcsec, drift, modelled])
    table = table - np.stack([np.bincount(group, weights=each) / count for each in table.T], axis=1)[group]
    scatter = table[:, 0]
    if table.shape[1] > 1:
        scatter = scatter - table[:, 1:] @ np.linalg.lstsq(table[:, 1:], scatter, rcond=1e-8)[0]
    # A wild reading says nothing of its angle.
    limit = LARGEST_OWN_NOISE * float(np.median(np.abs(scatter)))
    return replace(conditions, angle_deg=conditions.angle_deg - np.clip(scatter, -limit, limit) / ARCSEC_PER_DEG)


def _at_set_points(conditions: Conditions) -> bool:
    """Whether the indicated angle comes back to the same count again and again: the scatter is the reference's."""
    counts = np.rint(conditions.angle_deg * conditions.counts_per_rev / DEG_PER_TURN).astype(np.int64)
    angles = np.unique(counts % conditions.counts_per_rev).size
    places = distinct_places(conditions.angle_deg).size
    return angles <= ANGLES_OF_A_PLACE * places and counts.size >= READINGS_OF_AN_ANGLE * angles


def _enough_readings(main: Floats, zero_group: Integers) -> bool:
    """Whether an event moves enough readings against enough others to be told from wild readings."""
    moved = np.flatnonzero(main.any(axis=1))
    if moved.size == 0:
        return False
    together = main[zero_group == zero_group[moved[0]]]
    spread = np.sum((together - together.mean(axis=0)) ** 2, axis=0)
    return bool(np.max(spread) >= FEWEST_READINGS_OF_EVENT * float(np.max(main**2)))


def recalibration_span(conditions: Conditions, joint: Joint) -> tuple[Floats, tuple[str, ...], Floats]:
    """Columns of the modelled effects, the effect of each, and the drift of the datum; [readings, columns]."""
    columns: list[Floats] = []
    names: list[str] = []
    for name, settings in joint_settings(joint).items():
        span = settings.columns(conditions, joint)
        columns.append(span)
        names += [name] * span.shape[1]
    temperature = conditions.temperature_c
    drift = np.empty((len(conditions), 0))
    if temperature is not None and _largest_span(temperature, conditions.zero_group) > STEADY_C:
        drift = ((temperature - conditions.base_temperature_c) / 20.0)[:, None]
    return np.column_stack([np.empty((len(conditions), 0)), *columns]), tuple(names), drift


def _largest_span(values: Floats, group: Integers) -> float:
    """Of the values within one group: from group to group the free offsets take up any drift.

    A drift fitted to the jitter of one chamber temperature would be noise divided by a tenth of a kelvin.
    """
    _, index = np.unique(group, return_inverse=True)
    low = np.full(int(index.max()) + 1, np.inf)
    high = -low
    np.minimum.at(low, index, values)
    np.maximum.at(high, index, values)
    return float(np.max(high - low))


def _nominal_arcsec(conditions: Conditions, joint: Joint) -> Floats:
    """The simulator as shipped, random parts at their mean."""
    total = np.zeros(len(conditions))
    for settings in joint_settings(joint).values():
        total += settings.error_arcsec(conditions, joint, None)
    return total


def _complete(conditions: Conditions) -> tuple[Conditions, list[str]]:
    """Missing cells filled in between neighbours of the same run; a column that is mostly empty is dropped."""
    notes: list[str] = []
    changed: dict[str, Floats | None] = {}
    for name in ("temperature_c", "time_s", "velocity_deg_s", "load_nm"):
        values: Floats | None = getattr(conditions, name)
        if values is None:
            continue
        missing = ~np.isfinite(values)
        if not missing.any():
            continue
        if float(np.mean(missing)) > 0.5:
            changed[name] = None
            notes.append(f"column {name} is empty in {int(missing.sum())} rows of {missing.size} and was left out")
            continue
        changed[name] = _filled(values, missing, conditions.run)
        notes.append(f"column {name}: {int(missing.sum())} empty cells were filled in between their neighbours")
    return replace(conditions, **changed) if changed else conditions, notes


def _filled(values: Floats, missing: NDArray[np.bool_], run: Integers) -> Floats:
    filled = values.copy()
    place = np.arange(values.size)
    filled[missing] = np.interp(place[missing], place[~missing], values[~missing])
    for each in np.unique(run[missing]):
        here = run == each
        known = here & ~missing
        if known.any():
            gap = here & missing
            filled[gap] = np.interp(place[gap], place[known], values[known])
    return filled
