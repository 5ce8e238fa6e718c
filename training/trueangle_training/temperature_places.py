"""Which places of the turn were read at each temperature.

A temperature at which half of the turn is missing trains without complaint: the model carries the change over from
other temperatures and claims this one as measured. Such temperatures are named, and what is read at a few places
only does not extend the range in which a model may be used.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import Fault
from trueangle.contract.metadata import Interval
from trueangle.contract.units import DEG_PER_TURN, wrap_deg
from trueangle_training.evaluation.held_out import temperature_groups
from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.base_series import SAME_TEMPERATURE_C, base_angle_faults

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_PLACE_DEG = 0.5
"""Readings this close together are of one stop: the paper sets its first face to 0.2 deg."""
FEWEST_ANGLES = 5
"""Two harmonics, of eccentricity and of tilt, are in every joint: 2 x 2 + 1 angles determine them."""
LARGEST_GAP_DEG = 30.0
GAP_OVER_MEDIAN = 3.0
"""Wider gaps than both between places are part of the turn that was not measured."""
FARTHER_THAN_USUAL = 1.5
"""Times the distance to the nearest reading that is usual at the campaign's temperatures: a place is missing."""
RANGES_SHOWN = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TemperaturePlaces:
    """What was read at one temperature."""

    temperature_c: float
    """Mean of its readings."""
    lowest_c: float
    highest_c: float
    rows: Integers
    """File lines of its readings, rising."""
    places: int
    """Distinct places of the turn."""
    missing_deg: tuple[tuple[float, float], ...]
    """First and last of each row of neighbouring places that other temperatures have and this one has not."""
    missing: int
    """How many places these are."""
    whole: bool
    """Whether it covers what the campaign covers, without a wide gap: only then a model may be used up to it."""


def places_by_temperature(readings: TrainingReadings, row: Integers) -> tuple[TemperaturePlaces, ...]:
    """One entry a temperature, rising; `row` [readings]: file lines."""
    group = temperature_groups(readings)
    places_deg = _places_deg(readings.angle_deg)
    limit_deg = widest_gap_deg(places_deg) / 2.0
    temperatures = range(int(group.max()) + 1)
    distance_deg = np.stack(
        [_distance_deg(places_deg, readings.angle_deg[group == each]) for each in temperatures]
    )
    usual_deg = FARTHER_THAN_USUAL * float(np.median(distance_deg.max(axis=1)))
    far = distance_deg > min(max(usual_deg, SAME_PLACE_DEG), limit_deg)
    found: list[TemperaturePlaces] = []
    for each in temperatures:
        here = group == each
        places = _places_deg(readings.angle_deg[here]).size
        found.append(
            TemperaturePlaces(
                temperature_c=float(readings.temperature_c[here].mean()),
                lowest_c=float(readings.temperature_c[here].min()),
                highest_c=float(readings.temperature_c[here].max()),
                rows=np.sort(row[here]),
                places=places,
                missing_deg=_stretches(places_deg, far[each]),
                missing=int(np.count_nonzero(far[each])),
                whole=bool(distance_deg[each].max() <= limit_deg) and places >= FEWEST_ANGLES,
            )
        )
    return tuple(found)


def widest_gap_deg(places_deg: Floats) -> float:
    """The widest gap between neighbouring places that is none: of rising places, shape [places]."""
    gaps_deg = np.diff(places_deg, append=places_deg[0] + DEG_PER_TURN)
    gaps_deg = gaps_deg[gaps_deg > SAME_PLACE_DEG]
    return max(LARGEST_GAP_DEG, GAP_OVER_MEDIAN * float(np.median(gaps_deg)) if gaps_deg.size else 0.0)


def places_sentence(found: TemperaturePlaces) -> str:
    """What is missing, and what becomes of it; without file and lines."""
    stretches = ", ".join(
        f"{first:.1f} deg" if first == last else f"{first:.1f} to {last:.1f} deg"
        for first, last in found.missing_deg[:RANGES_SHOWN]
    )
    more = ", ..." if len(found.missing_deg) > RANGES_SHOWN else ""
    many = f"{found.missing} place{'s' if found.missing > 1 else ''}"
    missing = (
        f"{many} of other temperatures not read ({stretches}{more})"
        if found.missing
        else f"{found.places} places only"
    )
    if found.whole:
        return f"{missing}: the correction there is carried over from other temperatures"
    return f"{missing}: too little of the turn for the valid temperature range to count this temperature"


def place_warnings(places: tuple[TemperaturePlaces, ...], *, source: str) -> tuple[str, ...]:
    """One sentence for each temperature at which places of the turn are missing."""
    return tuple(
        f"{source} {lines_text(each.rows)}, column angle_deg: at {each.temperature_c:.1f} degC "
        f"{places_sentence(each)}"
        for each in places
        if each.missing or not each.whole
    )


def valid_temperature(places: tuple[TemperaturePlaces, ...]) -> Interval | None:
    """From the coldest to the hottest temperature at which the turn was read; None: at none."""
    whole = [each for each in places if each.whole]
    if not whole:
        return None
    return Interval(minimum=min(each.lowest_c for each in whole), maximum=max(each.highest_c for each in whole))


def whole_temperature_faults(places: tuple[TemperaturePlaces, ...], *, source: str) -> list[Fault]:
    """Less than two temperatures at which the turn was read: there is no range in which to use a model."""
    whole = [each for each in places if each.whole]
    if whole and whole[-1].temperature_c - whole[0].temperature_c >= SAME_TEMPERATURE_C:
        return []
    partly = "; ".join(
        f"{each.temperature_c:.1f} degC ({lines_text(each.rows)}): {places_sentence(each)}"
        for each in [each for each in places if not each.whole][:RANGES_SHOWN]
    )
    return [
        Fault(
            where=f"{source}, columns angle_deg and temperature_c",
            expected="two temperatures or more at which the turn was read as far as at all together",
            found=", ".join(f"{each.temperature_c:.1f} degC" for each in whole) or "none",
            advice=f"measure what is missing: {partly}",
        )
    ]


def base_place_faults(campaign: Campaign, base_temperature_c: float | None, order: int | None) -> list[Fault]:
    """Places missing at the base temperature, by line, for methods that take a series there.

    None where the whole campaign has no better places: the method says so itself.
    """
    if base_temperature_c is None or campaign.temperature_c is None:
        return []
    at_base = np.zeros(len(campaign), dtype=np.bool_)
    for run in np.unique(campaign.run):
        here = (campaign.run == run) & ~np.isnan(campaign.temperature_c)
        if here.any():
            mean_c = float(campaign.temperature_c[here].mean())
            at_base[here] = abs(mean_c - base_temperature_c) <= SAME_TEMPERATURE_C
    angle_deg = wrap_deg(campaign.angle_deg)
    if not at_base.any() or base_angle_faults(angle_deg, order, base_temperature_c):
        return []
    where = f"{campaign.source} {lines_text(np.sort(campaign.row[at_base]))}, column angle_deg"
    faults = base_angle_faults(angle_deg[at_base], order, base_temperature_c)
    return [replace(fault, where=where) for fault in faults]


def lines_text(rows: Integers) -> str:
    """`lines 3 to 25, 40 to 62`."""
    breaks = np.flatnonzero(np.diff(rows) > 1)
    starts, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [rows.size - 1]])
    ranges = [f"{rows[a]}" if a == b else f"{rows[a]} to {rows[b]}" for a, b in zip(starts, ends, strict=True)]
    more = f", ... {rows.size} in all" if len(ranges) > RANGES_SHOWN else ""
    return f"line{'s' if rows.size > 1 else ''} {', '.join(ranges[:RANGES_SHOWN])}{more}"


def _places_deg(angle_deg: Floats) -> Floats:
    """One angle for each place, rising, the first after the widest gap may be the smallest or not."""
    ordered = np.unique(wrap_deg(angle_deg))
    gaps = np.diff(ordered, append=ordered[0] + DEG_PER_TURN)
    start = (int(np.argmax(gaps)) + 1) % ordered.size
    # A face at the seam, some readings just below a full turn and some just above 0, is one place.
    unrolled = np.sort(np.mod(ordered - ordered[start], DEG_PER_TURN))
    places, first = [], -np.inf
    for angle in unrolled.tolist():
        if angle - first > SAME_PLACE_DEG:
            first = angle
            places.append(first)
    return np.sort(wrap_deg(np.array(places) + ordered[start]))


def _distance_deg(places_deg: Floats, angle_deg: Floats) -> Floats:
    """From each place to the nearest reading, shape [places]."""
    ordered = np.unique(wrap_deg(angle_deg))
    around = np.concatenate([ordered[-1:] - DEG_PER_TURN, ordered, ordered[:1] + DEG_PER_TURN])
    after = np.clip(np.searchsorted(around, places_deg), 1, around.size - 1)
    return np.minimum(np.abs(around[after] - places_deg), np.abs(places_deg - around[after - 1]))


def _stretches(places_deg: Floats, chosen: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """First and last of each unbroken row of chosen places."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    return tuple(
        (float(places_deg[start]), float(places_deg[end - 1])) for start, end in edges.reshape(-1, 2).tolist()
    )
