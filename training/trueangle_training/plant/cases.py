"""One case of the check: a campaign file, the joint's file, and the truth."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.data_faults import DATA_FAULTS, Columns, damaged
from trueangle_training.plant.fitting import Sized, fitting
from trueangle_training.plant.joint_file import NAMES, THERMAL_NAMES, Nominal, fitted_nominals, joint_yaml
from trueangle_training.plant.listing import Encoder
from trueangle_training.plant.plants import PLANTS
from trueangle_training.plant.simulator_reach import (
    CONTAINED,
    OTHER_CELLS,
    VISIBLE_FRACTION,
    Span,
    cell_shares,
    containments,
    recalibrated_span,
)
from trueangle_training.plant.truth import EffectTruth, Truth
from trueangle_training.plant.wish import Wish
from trueangle_training.plant.world import Measured, World

Floats = NDArray[np.float64]

LEFT_OUT = 0.3
"""How often JOINT.yaml holds no nominal parameters."""
NOISE_LEFT_OUT = 0.45
"""A parametric gap needs them always: with half as many of those, sound joints together lack them as often."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What the diagnosis is given, and what it is judged by."""

    measured_csv: str
    joint_yaml: str
    truth: Truth


def draw_case(wish: Wish) -> Case:
    """The case of a wish: the same wish, the same bytes."""
    seeds = np.random.SeedSequence(_entropy(wish, 0x7A)).spawn(4)
    world_rng, defect_rng, measure_rng, writing_rng = (np.random.default_rng(seed) for seed in seeds)
    world = PLANTS[wish.plant].draw_world(wish.plan, world_rng)
    world, sized = fitting(world, wish, defect_rng)
    measured = world.measured([each.placed for each in sized], measure_rng)
    return _written(wish, world, sized, measured, writing_rng)


def _entropy(wish: Wish, purpose: int) -> list[int]:
    """Plant A's alone is that of the days when it was alone."""
    return [wish.seed, purpose] + [ord(letter) for letter in wish.plant if wish.plant != "A"]


def _written(
    wish: Wish, world: World, sized: tuple[Sized, ...], measured: Measured, rng: np.random.Generator
) -> Case:
    schedule = world.conditions.schedule
    columns = Columns(
        angle_deg=measured.angle_deg,
        error_arcsec=measured.error_arcsec,
        temperature_c=measured.temperature_c,
        run=schedule.run,
        zero_group=schedule.zero_group,
        time_s=schedule.time_s,
        direction=schedule.direction,
        velocity_deg_s=schedule.velocity_deg_s,
        load_nm=schedule.load_nm,
        face=schedule.face,
        polygon_offset=schedule.polygon_offset,
    )
    size = len(schedule)
    kept = rng.random(size) >= rng.uniform(0.0, 0.01)
    empty = rng.random(size) < 0.003
    encoder, fault = world.encoder, None
    if wish.stratum == "broken":
        fault = next(name for name in wish.names if name in DATA_FAULTS)
        columns, scale = damaged(columns, fault, rng)
        encoder = Encoder(
            lines_per_rev=round(encoder.lines_per_rev / scale),
            counts_per_rev=round(encoder.counts_per_rev / scale),
        )
    rows = np.flatnonzero(kept & ~empty)
    return Case(
        measured_csv=columns.to_csv(rows=np.flatnonzero(kept), empty=empty),
        joint_yaml=_joint_text(wish, world, encoder, rng),
        truth=_truth(wish, world, sized, rows, fault),
    )


def _joint_text(wish: Wish, world: World, encoder: Encoder, rng: np.random.Generator) -> str:
    """Nominal parameters right, off by a few to some tens of per cent, or left out."""
    left_out = rng.random() < (NOISE_LEFT_OUT if wish.stratum == "noise" else LEFT_OUT)
    off = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
    if wish.stratum == "noise" or (wish.stratum != "parametric" and rng.random() < 0.5):
        off = 0.0
    listing = world.listing
    nominals = fitted_nominals(
        world.conditions, world.curve_arcsec(()), constant=listing.constant, thermal=listing.thermal
    )
    nominals = tuple(_moved(each, off, rng) for each in nominals)
    noise = world.noise_of_one_reading()
    return joint_yaml(
        lines_per_rev=encoder.lines_per_rev,
        counts_per_rev=encoder.counts_per_rev,
        repeatability_arcsec=noise * float(np.exp(rng.normal(0.0, 0.1))),
        sensor_step_c=world.sensor_step_c,
        constant=listing.constant,
        thermal=listing.thermal,
        nominals=None if left_out and wish.stratum != "parametric" else nominals,
    )


def _moved(nominal: Nominal, off: float, rng: np.random.Generator) -> Nominal:
    size = float(np.hypot(nominal.cosine, nominal.sine))
    cosine, sine = rng.normal(size=2) * off * size
    return replace(nominal, cosine=nominal.cosine + float(cosine), sine=nominal.sine + float(sine))


def _truth(
    wish: Wish, world: World, sized: tuple[Sized, ...], rows: NDArray[np.int64], fault: str | None
) -> Truth:
    span = recalibrated_span(world.conditions, world.listing)
    effects = tuple(_effect_truth(world, each, span, rows) for each in sized)
    visible = [each for each in effects if each.visible]
    expected = "none" if not visible else "named" if all(each.accepted_names for each in visible) else "unknown"
    structure = [each.curve for each in sized if each.defect.kind != "variance"]
    constant, thermal = world.listing.constant, world.listing.thermal
    listed = [NAMES.get(k, "graduation_error") for k in constant] + [THERMAL_NAMES[k] for k in thermal]
    return Truth(
        case_id=f"{np.random.SeedSequence(_entropy(wish, 0x1D)).generate_state(1, np.uint64)[0]:016x}",
        seed=wish.seed,
        plant=wish.plant,
        plan=wish.plan,
        stratum=wish.stratum,
        asked_enr=wish.enr if sized else 0.0,
        noise_arcsec=world.noise_of_one_reading(),
        effects=effects,
        listed=tuple(dict.fromkeys(listed)),
        data_fault=fault,
        expected="data_fault" if fault else expected,
        carried_together=_carriers(world, structure, span),
        structure_arcsec=sum(structure, np.zeros(len(world.conditions.schedule)))[rows],
    )


def _carriers(world: World, curves: list[Floats], span: Span) -> tuple[str, ...]:
    """Effects of the library that could carry the sum of two curves."""
    if len(curves) < 2:
        return ()
    summed = sum(curves, np.zeros_like(curves[0]))
    carried = containments(summed, world.conditions, span, base_arcsec=world.curve_arcsec(()))
    return tuple(name for name, share in carried.items() if share >= CONTAINED)


def _effect_truth(world: World, sized: Sized, span: Span, rows: NDArray[np.int64]) -> EffectTruth:
    defect, visible = sized.defect, sized.visible_fraction >= VISIBLE_FRACTION
    carried: dict[str, float] = {}
    cells = list(defect.cells)
    if visible and defect.kind != "variance":
        carried = {
            k: v
            for k, v in containments(
                sized.curve, world.conditions, span, base_arcsec=world.curve_arcsec(())
            ).items()
            if v >= 0.5
        }
        shares = cell_shares(sized.curve, world.conditions, span)
        own = max((shares.get(cell, 0.0) for cell in defect.cells), default=0.0)
        cells += [cell for cell, share in shares.items() if share >= max(0.5, 0.9 * own)]
        cells += [
            cell for name, share in carried.items() if share >= CONTAINED for cell in OTHER_CELLS.get(name, ())
        ]
    accepted = [defect.name] if defect.in_library else []
    accepted += [name for name, share in carried.items() if share >= CONTAINED and name not in accepted]
    known: dict[str, Any] = dict(defect.parameters)
    return EffectTruth(
        name=defect.name,
        in_library=defect.in_library,
        kind=defect.kind,
        enr=sized.enr,
        visible_fraction=sized.visible_fraction,
        visible=visible,
        contained_in=carried,
        accepted_names=tuple(accepted),
        cells=tuple(dict.fromkeys(cells)),
        parameters=known,
        curve_arcsec=sized.curve[rows],
    )
