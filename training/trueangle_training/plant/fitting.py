"""Defects of the size that is wished for, in a world that lets them be what they are called."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.data_faults import DATA_FAULTS
from trueangle_training.plant.defect import AtSize, Defect
from trueangle_training.plant.listing import Listing, draw_listing, without
from trueangle_training.plant.plants import PLANTS
from trueangle_training.plant.simulator_reach import (
    CONTAINED,
    VISIBLE_FRACTION,
    Span,
    containments,
    recalibrated_span,
)
from trueangle_training.plant.wish import Wish
from trueangle_training.plant.world import World

Floats = NDArray[np.float64]

ATTEMPTS = 12
"""Draws of an effect until the plan shows it, or until a pair is as separable as it is wished."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sized:
    """A defect at its size, in a world that fits it."""

    placed: AtSize
    curve: Floats
    enr: float
    visible_fraction: float

    @property
    def defect(self) -> Defect:
        """What it is."""
        return self.placed.defect


def fitting(world: World, wish: Wish, rng: np.random.Generator) -> tuple[World, tuple[Sized, ...]]:
    """Draw the defects until they are what the wish asks for, or as near as the attempts came."""
    plant = PLANTS[wish.plant]
    names = [name for name in wish.names if name not in DATA_FAULTS]
    missing = [name for name in names if name not in plant.library and name not in plant.unknown["rich"]]
    if missing:
        raise CaseNotFoundError(f"plant {plant.letter} cannot make {', '.join(missing)}")
    if not names:
        return world.with_listing(_shortened(world.listing, wish.unlisted)) if wish.unlisted else world, ()
    found: tuple[World, tuple[Sized, ...]] | None = None
    for _ in range(ATTEMPTS):
        tried = world.with_listing(_shortened(draw_listing(rng), (*names, *wish.unlisted)))
        span = recalibrated_span(tried.conditions, tried.listing)
        enrs = [wish.enr, wish.enr * wish.ratio]
        sized = tuple(_sized(tried, name, enr, span, rng) for name, enr in zip(names, enrs, strict=False))
        found = (tried, sized)
        if _suits(wish, tried, sized, span):
            return found
    if found is None or wish.stratum in ("pair", "confounded", "unknown"):
        raise CaseNotFoundError(f"{wish} cannot be drawn on this plan")
    return found


def _shortened(listing: Listing, names: Sequence[str]) -> Listing:
    for name in names:
        listing = without(listing, name)
    return listing


class CaseNotFoundError(Exception):
    """The plan does not let the wished case be what it should be."""


def _suits(wish: Wish, world: World, sized: tuple[Sized, ...], span: Span) -> bool:
    if any(each.visible_fraction < VISIBLE_FRACTION for each in sized):
        return False
    if wish.stratum in ("single", "withheld", "broken") or all(each.defect.kind == "variance" for each in sized):
        return True
    base, conditions = world.curve_arcsec(()), world.conditions
    if wish.stratum == "unknown":
        return max(containments(sized[0].curve, conditions, span, base_arcsec=base).values()) < 0.75
    carried = [containments(each.curve, conditions, span, base_arcsec=base) for each in sized]
    summed = sum((each.curve for each in sized), np.zeros_like(sized[0].curve))
    both = containments(summed, conditions, span, base_arcsec=base)
    crossed = max(carried[0][sized[1].defect.name], carried[1][sized[0].defect.name])
    # What can imitate every order 1 is no sign of confusion: the report names it only on better evidence.
    single = max(share for name, share in both.items() if name != "run_to_run_eccentricity")
    if wish.stratum == "confounded":
        return single >= CONTAINED or crossed >= CONTAINED
    alone = 1.0 / (1.0 + wish.ratio**2)
    return single < 0.5 * (1.0 + alone) and crossed < 0.5


def _sized(world: World, name: str, enr: float, span: Span, rng: np.random.Generator) -> Sized:
    """Scale a defect until what is visible of it has the wished size."""
    defect = world.defect(name, rng)
    noise = world.noise_of_one_reading()
    if defect.kind == "variance":
        placed = AtSize(defect=defect, size=enr * noise)
        scatter = world.scatter_arcsec(placed)
        return Sized(placed=placed, curve=scatter, enr=_rms(scatter) / noise, visible_fraction=1.0)
    plain = world.curve_arcsec(())
    size, curve, visible = enr * noise, np.zeros_like(plain), 0.0
    for _ in range(4):
        curve = world.curve_arcsec((AtSize(defect=defect, size=size),)) - plain
        visible = _rms(span.outside(curve))
        if visible < np.sqrt(VISIBLE_FRACTION) * _rms(curve) or visible <= 0.0:
            break
        if abs(visible - enr * noise) < 0.002 * enr * noise:
            break
        size *= enr * noise / visible
    fraction = (visible / _rms(curve)) ** 2 if curve.any() else 0.0
    return Sized(
        placed=AtSize(defect=defect, size=size), curve=curve, enr=visible / noise, visible_fraction=fraction
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
