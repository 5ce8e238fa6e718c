"""The diagnosis on campaigns that have the shape of real encoders.

    python -m tests.benchmarks.real_shape [--tables DIR] [--cases 8] [--nulls 40] [--seed 1] [--out FILE.json]

The measured curve of one calibration table of an AS5047D is read at the stops of an angle-only campaign; the noise
is ours (nothing is concluded from theirs). Asked of `prepare` and `diagnose`, as the command does:

- nothing planted, with a joint that models every order the stops can tell (the table as it is); with a joint that
  models what a maker would list (the table's own series of those orders); and so again where the shipped simulator
  holds the other calibration of the same unit: the gap is one of parameters. The right answer is `none`;
- the table as it is and a maker's joint: what the orders beyond leave is real, and a curve of the angle;
- an effect of the library planted at an effect-to-noise ratio of 0.5, 1 and 2 (RMS outside the re-calibratable
  span over the noise; lost counts are whole, the ratio as near as they come): it must be named;
- the difference of two calibrations of one unit, rescaled so, growing over the campaign or coming between two
  runs: in no library, so `unknown` in a cell between runs, or an effect that carries 95 % of it under this plan;
- the two calibrations themselves as two runs of one joint.

The tables are not part of this repository (CC BY-SA 4.0): they are looked for in shared/data/as5047d beside it.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.benchmarks import real_shape_campaigns as shapes
from tests.benchmarks.real_shape_campaigns import Layout, Shape, Table

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.joint import Joint
from trueangle_training.blind_check.intervals import exact_binomial
from trueangle_training.diagnosis.design_check import CARRIED
from trueangle_training.diagnosis.diagnose import Prepared, diagnose, prepare
from trueangle_training.diagnosis.findings import Conclusion, Findings
from trueangle_training.progress import progress_bar

Floats = NDArray[np.float64]

TABLES = Path(__file__).resolve().parents[3] / "shared" / "data" / "as5047d"
UNIT = ("table05", "table06")
"""Two calibrations, very likely of one unit."""
RATIOS = (0.5, 1.0, 2.0)
NULLS = ("null, every order", "null, maker's orders", "null, other calibration shipped")
BEYOND = "the maker's orders and the whole curve"
DRIFTS = ("drift_growing", "drift_stepping")
CONFIDENT = 0.9
COUNT_PLACES = 40
"""Tried for a step of whole counts that is as large as asked."""
OUTCOMES = ("right", "none", "unknown", "wrong", "fault")


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """One campaign to be made."""

    stratum: str
    """Of `NULLS`, `BEYOND`, or what is planted."""
    ratio: float
    """Effect to noise; 0: nothing is planted."""
    table: str
    every_order: bool
    """The joint models every order that the stops can tell."""
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """What was said of one campaign."""

    wish: Wish
    ratio: float
    """As it came out; of `BEYOND`, of what the maker's orders leave."""
    outcome: str
    """Of `OUTCOMES`."""
    verdict: str
    causes: tuple[tuple[str, float, float], ...]
    """Effect, probability, class probability."""
    unexplained: bool
    cells: tuple[str, ...]
    """The first places, in short."""
    parametric_share: float | None
    closure: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planted:
    """A campaign with its truth."""

    campaign: Campaign
    joint: Joint
    curve_arcsec: Floats
    """[readings]: what is planted; 0 where nothing is."""
    sigma_arcsec: float


def wishes(names: Sequence[str], *, cases: int, nulls: int, seed: int) -> list[Wish]:
    """All campaigns; tables and joints take turns."""
    wanted = [
        Wish(stratum=stratum, ratio=0.0, table=table, every_order=stratum == NULLS[0], seed=0)
        for stratum in NULLS
        for table in _in_turn(UNIT if stratum == NULLS[2] else names, nulls)
    ]
    wanted += [Wish(stratum=BEYOND, ratio=0.0, table=t, every_order=False, seed=0) for t in _in_turn(names, cases)]
    for stratum in (*shapes.EFFECTS, *DRIFTS):
        for ratio in RATIOS:
            for i, table in enumerate(_in_turn(names, cases)):
                # Both joints meet every table, where the effect is not a curve of the angle.
                every_order = stratum not in shapes.CONSTANT and (i + i // len(names)) % 2 == 0
                wanted.append(Wish(stratum=stratum, ratio=ratio, table=table, every_order=every_order, seed=0))
    return [replace(wish, seed=seed * 1_000_000 + i) for i, wish in enumerate(wanted)]


def _in_turn(names: Sequence[str], count: int) -> list[str]:
    return [names[i % len(names)] for i in range(count)]


def plant(wish: Wish, tables: Mapping[str, Table]) -> Planted:
    """Make one campaign."""
    rng = np.random.default_rng(wish.seed)
    table = tables[wish.table]
    where = shapes.layout(both_ways=wish.stratum in shapes.BOTH_WAYS)
    modelled = table.curve_arcsec if wish.every_order else table.smooth_arcsec
    sigma = shapes.NOISE_SHARE * float(np.std(table.error_arcsec))
    base = modelled(where.angle_deg) + shapes.noise(where, sigma, rng)
    other = tables[UNIT[1 - UNIT.index(wish.table)]].harmonics() if wish.stratum == NULLS[2] else None
    joint = shapes.joint(shapes.EVERY_ORDER if wish.every_order else shapes.MAKER_ORDER, other)
    curve = np.zeros_like(base)
    if wish.ratio > 0:
        drifts = shapes.drift_shapes(tables[UNIT[0]], tables[UNIT[1]])
        shape = {**shapes.EFFECTS, **drifts}[wish.stratum]
        nuisance = prepare(shapes.campaign(where, base), joint, library={}).problem.nuisance()
        curve = scaled(shape, where, nuisance, wish.ratio * sigma, rng)
    elif wish.stratum == BEYOND:
        curve = table.curve_arcsec(where.angle_deg) - table.smooth_arcsec(where.angle_deg)
    return Planted(
        campaign=shapes.campaign(where, base + curve), joint=joint, curve_arcsec=curve, sigma_arcsec=sigma
    )


def scaled(shape: Shape, where: Layout, nuisance: Floats, size_arcsec: float, rng: np.random.Generator) -> Floats:
    """The shape with an RMS outside the re-calibratable span; counts are lost whole, at a place that suits."""
    if shape is not shapes.EFFECTS["count_loss"]:
        curve = shape(where, rng)
        return curve * rng.choice([-1.0, 1.0]) * (size_arcsec / outside(curve, nuisance))
    steps = [shape(where, rng) for _ in range(COUNT_PLACES)]
    sizes = np.array([outside(step, nuisance) for step in steps])
    counts = np.maximum(np.rint(size_arcsec / sizes), 1.0)
    nearest = int(np.argmin(np.abs(np.log(counts * sizes / size_arcsec))))
    return counts[nearest] * steps[nearest] * rng.choice([-1.0, 1.0])


def outside(curve_arcsec: Floats, nuisance: Floats) -> float:
    """RMS of what re-calibration leaves, arcsec."""
    taken = nuisance @ np.linalg.lstsq(nuisance, curve_arcsec, rcond=1e-9)[0]
    return float(np.sqrt(np.mean((curve_arcsec - taken) ** 2)))


def ask(wish: Wish, tables: Mapping[str, Table]) -> Mark:
    """Make one campaign, diagnose it and compare."""
    planted = plant(wish, tables)
    prepared = prepare(planted.campaign, planted.joint)
    findings = diagnose(prepared).findings
    ratio = 0.0
    if planted.curve_arcsec.any():
        ratio = outside(planted.curve_arcsec, prepared.problem.nuisance()) / planted.sigma_arcsec
    return Mark(
        wish=wish,
        ratio=ratio,
        outcome=outcome_of(wish, findings, accepted_names(wish, prepared, planted.curve_arcsec)),
        verdict=findings.conclusion.value,
        causes=tuple((c.effect, c.probability, c.class_probability) for c in findings.causes),
        unexplained=findings.unexplained.significant,
        cells=tuple(_short(asdict(place.cell)) for place in findings.where[:2]),
        parametric_share=findings.gap.parametric_share,
        closure=findings.gap.closure,
    )


def accepted_names(wish: Wish, prepared: Prepared, curve_arcsec: Floats) -> frozenset[str]:
    """The effect itself; of what is in no library, those that can carry it under this plan."""
    if wish.stratum in shapes.EFFECTS:
        return frozenset([wish.stratum])
    if wish.stratum == BEYOND:
        # Any curve of the angle: the library's own ways to say one.
        return frozenset(shapes.CONSTANT)
    if not curve_arcsec.any():
        return frozenset()
    carried = prepared.design.spans.carried(curve_arcsec)
    names = [each.effect for each in prepared.problem.hypotheses]
    pairs = zip(names, carried.tolist(), strict=True)
    return frozenset(name for name, share in pairs if name is not None and share >= CARRIED)


def outcome_of(wish: Wish, findings: Findings, accepted: frozenset[str]) -> str:
    """One of `OUTCOMES`; a confident name that is not there outweighs all else."""
    if findings.conclusion is Conclusion.DATA_FAULT:
        return "fault"
    for cause in findings.causes:
        sure_of_name = cause.probability >= CONFIDENT and cause.effect not in accepted
        sure_of_class = cause.class_probability >= CONFIDENT and not accepted & set(cause.members)
        if sure_of_name or sure_of_class:
            return "wrong"
    if findings.conclusion is Conclusion.NONE:
        return "right" if wish.stratum in NULLS else "none"
    if any(cause.named for cause in findings.causes):
        return "right"
    if wish.stratum == BEYOND:
        return "right"
    if wish.stratum in DRIFTS:
        return "right" if any(place.cell.time == "between_runs" for place in findings.where[:2]) else "unknown"
    return "unknown"


def _short(cell: Mapping[str, str]) -> str:
    """The order and whatever is not constant."""
    usual = ("constant", "even", "encoder", "mean")
    return " ".join([cell["order"], *(f"{k} {v}" for k, v in cell.items() if k != "order" and v not in usual)])


def untouched(tables: Mapping[str, Table]) -> Findings:
    """The two calibrations of one unit as two runs, against a joint as the defaults have it but for its orders."""
    rows = ["angle_deg,error_arcsec,run"]
    for run, name in enumerate(UNIT):
        table = tables[name]
        pairs = zip(table.angle_deg.tolist(), table.error_arcsec.tolist(), strict=True)
        rows += [f"{angle},{error},{run}" for angle, error in pairs]
    read = read_campaign("\n".join(rows).encode(), source="two calibrations")
    return diagnose(prepare(read, shapes.joint(shapes.MAKER_ORDER))).findings


def print_table(marks: Sequence[Mark]) -> None:
    """Of each stratum and ratio the counts, and the share of the right ones with its exact 95 % interval."""
    width = max(len(mark.wish.stratum) for mark in marks)
    print(f"{'planted':{width}}  ratio  cases" + "".join(f"{name:>8}" for name in OUTCOMES) + "  right, 95 %")
    groups = {
        f"{stratum:{width}}  {ratio:5.1f}": [
            m for m in marks if (m.wish.stratum, m.wish.ratio) == (stratum, ratio)
        ]
        for stratum, ratio in dict.fromkeys((mark.wish.stratum, mark.wish.ratio) for mark in marks)
    }
    for name, members in (("all nulls", NULLS), ("all library effects", shapes.EFFECTS), ("all drifts", DRIFTS)):
        groups[f"{name:{width}}       "] = [mark for mark in marks if mark.wish.stratum in members]
    for name, group in groups.items():
        if group:
            counts = [sum(mark.outcome == outcome for mark in group) for outcome in OUTCOMES]
            low, high = exact_binomial(counts[0], len(group))
            print(f"{name}  {len(group):5d}" + "".join(f"{n:8d}" for n in counts) + f"  {low:.3f} to {high:.3f}")


def failure(mark: Mark) -> str:
    """What was said instead, with all that is needed to make the case again."""
    wish = mark.wish
    causes = ", ".join(f"{name} {own:.2f}/{whole:.2f}" for name, own, whole in mark.causes)
    return (
        f"{mark.outcome}: {wish.stratum}, ratio {mark.ratio:.2f}, {wish.table}, "
        f"{'every order' if wish.every_order else 'maker'}, seed {wish.seed}: {mark.verdict}; "
        f"[{causes}]{' and unexplained' if mark.unexplained else ''}; at {'; '.join(mark.cells)}"
    )


def print_untouched(findings: Findings) -> None:
    """What is said of the two calibrations themselves."""
    print(f"\n{' and '.join(UNIT)} as two runs of one joint: {findings.conclusion.value}")
    for cause in findings.causes:
        print(f"  {cause.effect} {cause.probability:.2f}, class {', '.join(cause.members)}: {cause.label}")
    left = findings.unexplained
    if left.significant:
        print(f"  unexplained, nearest {left.nearest_effect} with {left.nearest_share:.2f}")
    for place in findings.where[:4]:
        print(f"  at {_short(asdict(place.cell))}: share {place.share:.2f}, p {place.p_value}")
    print(f"  {findings.gap}")
    for text in (*findings.notes, findings.next_measurement):
        print(f"  {text}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Make, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=Path, default=TABLES, metavar="DIR")
    parser.add_argument("--cases", type=int, default=8, help="of each effect and ratio")
    parser.add_argument("--nulls", type=int, default=40, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="*", metavar="STRATUM", help="what is planted; all if left out")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="marks of every case")
    options = parser.parse_args(arguments)
    tables = shapes.read_tables(options.tables)
    if not set(UNIT) <= set(tables):
        expected = " and ".join(f"{name}.csv" for name in UNIT)
        found = ", ".join(tables) or "none"
        print(
            f"{options.tables}: expected {expected}, found {found}; give their folder as --tables", file=sys.stderr
        )
        return 2
    wanted = [
        wish
        for wish in wishes([*tables], cases=options.cases, nulls=options.nulls, seed=options.seed)
        if not options.only or wish.stratum in options.only
    ]
    marks: list[Mark] = []
    title = f"{len(wanted)} campaigns of real shape"
    with Pool(options.processes) as pool, progress_bar(sys.stderr, title) as progress:
        for mark in pool.imap(partial(ask, tables=tables), wanted):
            marks.append(mark)
            if mark.outcome != "right":
                print(failure(mark), flush=True)
            progress(len(marks), len(wanted))
    if options.out is not None:
        options.out.write_text(json.dumps([asdict(mark) for mark in marks], indent=1) + "\n", "utf-8")
    print_table(marks)
    print_untouched(untouched(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main())
