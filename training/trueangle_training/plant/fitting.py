"""Defects of the size that is wished for, in a world that lets them be what they are called."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.bench import error_arcsec, indicate
from trueangle_training.plant.contribution import Contribution, Defect, Setting, together
from trueangle_training.plant.grating_defects import graduation_error
from trueangle_training.plant.joint_base import base_contribution, draw_listing, without
from trueangle_training.plant.library_defects import LIBRARY_DEFECTS
from trueangle_training.plant.schedule import PlanName
from trueangle_training.plant.simulator_reach import (
    CONTAINED,
    VISIBLE_FRACTION,
    Span,
    containments,
    recalibrated_span,
)
from trueangle_training.plant.unknown_defects import ON_RICH_PLAN
from trueangle_training.plant.world import World, base_curve, noise_of_one_reading

Floats = NDArray[np.float64]
Stratum = Literal["noise", "parametric", "single", "pair", "confounded", "unknown", "withheld", "broken"]

ATTEMPTS = 12
"""Draws of an effect until the plan shows it, or until a pair is as separable as it is wished."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a case shall be; everything else is drawn from its seed."""

    seed: int
    plan: PlanName
    stratum: Stratum
    enr: float = 1.0
    """Of the first effect."""
    names: tuple[str, ...] = ()
    """Effects of the library, or families of the unknown, one or two; of a broken case its data fault."""
    ratio: float = 1.0
    """Second effect's size to the first one's."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sized:
    """A defect at its size, in a world that fits it."""

    defect: Defect
    part: Contribution
    curve: Floats
    enr: float
    visible_fraction: float


def fitting(world: World, wish: Wish, rng: np.random.Generator) -> tuple[World, tuple[Sized, ...]]:
    """Draw the defects until they are what the wish asks for, or as near as the attempts came."""
    names = [name for name in wish.names if name in LIBRARY_DEFECTS or name in ON_RICH_PLAN]
    if not names:
        return world, ()
    found: tuple[World, tuple[Sized, ...]] | None = None
    for _ in range(ATTEMPTS):
        tried = replace(world, listing=draw_listing(rng))
        for name in names:
            tried = replace(tried, listing=without(tried.listing, name))
        span = recalibrated_span(tried.setting, tried.listing)
        enrs = [wish.enr, wish.enr * wish.ratio]
        sized = tuple(_sized(tried, name, enr, span, rng) for name, enr in zip(names, enrs, strict=False))
        found = (tried, sized)
        if _suits(wish, tried, sized, span):
            return found
    if found is None or wish.stratum in ("pair", "confounded", "unknown"):
        raise CaseNotFoundError(f"{wish} cannot be drawn on this plan")
    return found


class CaseNotFoundError(Exception):
    """The plan does not let the wished case be what it should be."""


def _suits(wish: Wish, world: World, sized: tuple[Sized, ...], span: Span) -> bool:
    if any(each.visible_fraction < VISIBLE_FRACTION for each in sized):
        return False
    if wish.stratum in ("single", "withheld", "broken") or all(each.defect.kind == "variance" for each in sized):
        return True
    base = base_curve(world)
    if wish.stratum == "unknown":
        return max(containments(sized[0].curve, world.setting, span, base_arcsec=base).values()) < 0.75
    carried = [containments(each.curve, world.setting, span, base_arcsec=base) for each in sized]
    summed = sum((each.curve for each in sized), np.zeros_like(sized[0].curve))
    both = containments(summed, world.setting, span, base_arcsec=base)
    crossed = max(carried[0][sized[1].defect.name], carried[1][sized[0].defect.name])
    # What can imitate every order 1 is no sign of confusion: the report names it only on better evidence.
    single = max(share for name, share in both.items() if name != "run_to_run_eccentricity")
    if wish.stratum == "confounded":
        return single >= CONTAINED or crossed >= CONTAINED
    alone = 1.0 / (1.0 + wish.ratio**2)
    return single < 0.5 * (1.0 + alone) and crossed < 0.5


def _sized(world: World, name: str, enr: float, span: Span, rng: np.random.Generator) -> Sized:
    """Scale a defect until what is visible of it has the wished size."""
    setting = world.setting
    if name == "graduation_error":
        defect = graduation_error(setting, rng, avoid=world.listing.constant)
    elif name in LIBRARY_DEFECTS:
        defect = LIBRARY_DEFECTS[name](setting, rng)
    else:
        defect = ON_RICH_PLAN[name](setting, rng)
    base = base_contribution(setting, world.base, world.listing)
    noise = noise_of_one_reading(world)
    if defect.kind == "variance":
        return _sized_scatter(setting, defect, enr * noise, noise)
    plain = base_curve(world)
    size, curve, visible = enr * noise, np.zeros_like(plain), 0.0
    for _ in range(4):
        curve = error_arcsec(indicate(setting, together([base, defect.contribute(size)]))) - plain
        visible = _rms(span.outside(curve))
        if visible < np.sqrt(VISIBLE_FRACTION) * _rms(curve) or visible <= 0.0:
            break
        if abs(visible - enr * noise) < 0.002 * enr * noise:
            break
        size *= enr * noise / visible
    fraction = (visible / _rms(curve)) ** 2 if curve.any() else 0.0
    return Sized(
        defect=defect,
        part=defect.contribute(size),
        curve=curve,
        enr=visible / noise,
        visible_fraction=fraction,
    )


def _sized_scatter(setting: Setting, defect: Defect, size: float, noise: float) -> Sized:
    part = defect.contribute(size)
    scatter = np.broadcast_to(np.asarray(part.scatter_arcsec, dtype=np.float64), setting.schedule.angle_deg.shape)
    if part.coarse > 1:
        step = setting.count_arcsec
        coarse = np.sqrt((part.coarse**2 - 1.0) / 12.0) * step
        scatter = np.full(setting.schedule.angle_deg.shape, coarse)
    return Sized(
        defect=defect, part=part, curve=np.array(scatter), enr=_rms(scatter) / noise, visible_fraction=1.0
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
