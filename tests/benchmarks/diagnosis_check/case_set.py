"""Which cases a check consists of: strata, effects, effect-to-noise ratios, all from one seed."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trueangle_training.plant.data_faults import DATA_FAULTS
from trueangle_training.plant.reading_head.library_defects import LIBRARY_DEFECTS
from trueangle_training.plant.reading_head.unknown_defects import ON_ANY_PLAN, ON_RICH_PLAN
from trueangle_training.plant.schedule import PlanName
from trueangle_training.plant.wish import Wish

ENRS = (0.2, 0.5, 1.0, 2.0, 5.0)
PAIR_RATIOS = (0.7, 0.3)
HIDDEN_ON_PAPER = ("read_latency", "load_deflection", "self_heating", "hysteresis", "temperature_sensor_error")
"""Standing still at one load, one direction, one zero a run: little or nothing of these is ever seen."""
CONSTANT_OVER_FACES = (
    "reference_artefact",
    "graduation_error",
    "localized_defect",
    "bearing_wobble",
    "windup",
    "index_drift",
    "subdivision_error",
    "grating_tilt",
)
"""On the paper's plan all of these are one pattern over the faces, the same in each run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Cases of each stratum, 0 or more."""

    noise: int = 400
    parametric: int = 100
    single: int = 230
    pair: int = 60
    confounded: int = 30
    unknown: int = 100
    withheld: int = 46
    broken: int = 40

    def scaled(self, factor: float) -> "Sizes":
        """All strata by one factor, none that is asked for left empty."""
        return Sizes(
            **{
                name: max(1, round(getattr(self, name) * factor)) if getattr(self, name) else 0
                for name in (
                    "noise",
                    "parametric",
                    "single",
                    "pair",
                    "confounded",
                    "unknown",
                    "withheld",
                    "broken",
                )
            }
        )


SHORT = Sizes(noise=8, parametric=3, single=12, pair=2, confounded=1, unknown=4, withheld=2, broken=5)
"""For the continuous integration."""


def wishes(sizes: Sizes, *, plan: PlanName, seed: int) -> list[Wish]:
    """The cases of one plan, in an order in which every prefix holds all strata."""
    found = [
        wish
        for number, make in enumerate((_healthy, _single, _pairs, _unknown, _broken, _withheld))
        for wish in make(sizes, plan, seed * 1_000_003 + number * 100_003)
    ]
    order = np.random.default_rng([seed, 1]).permutation(len(found))
    return [found[i] for i in order]


def _healthy(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    for i in range(sizes.noise):
        yield Wish(seed=seed + i, plan=plan, stratum="noise")
    for i in range(sizes.parametric):
        yield Wish(seed=seed + sizes.noise + i, plan=plan, stratum="parametric")


def _single(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    """Every effect at every ratio in turn; effects that the paper's plan hides come a third as often there."""
    names = [name for name in LIBRARY_DEFECTS if name != "temperature_sensor_error"]
    if plan == "paper":
        seen = [name for name in LIBRARY_DEFECTS if name not in HIDDEN_ON_PAPER]
        names = [*seen, *seen, *seen, *HIDDEN_ON_PAPER]
    rng = np.random.default_rng([seed, 2])
    rounds = [(name, enr) for enr in ENRS for name in names]
    order = list(rng.permutation(len(rounds)))
    while len(order) < sizes.single:
        order += list(rng.permutation(len(rounds)))
    for i in range(sizes.single):
        name, enr = rounds[order[i]]
        yield Wish(seed=seed + i, plan=plan, stratum="single", names=(name,), enr=enr)


def _pairs(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    rng = np.random.default_rng([seed, 3])
    hidden = (
        (*HIDDEN_ON_PAPER, "quantisation", "noise_growth") if plan == "paper" else ("quantisation", "noise_growth")
    )
    names = [name for name in LIBRARY_DEFECTS if name not in (*hidden, "temperature_sensor_error")]
    for i in range(sizes.pair):
        chosen = tuple(str(name) for name in rng.choice(names, size=2, replace=False))
        enr, ratio = float(rng.choice([1.0, 2.0, 5.0])), PAIR_RATIOS[i % 2]
        yield Wish(seed=seed + i, plan=plan, stratum="pair", names=chosen, enr=enr, ratio=ratio)
    for i in range(sizes.confounded if plan == "paper" else 0):
        chosen = tuple(str(name) for name in rng.choice(CONSTANT_OVER_FACES, size=2, replace=False))
        enr, ratio = float(rng.choice([1.0, 2.0])), PAIR_RATIOS[i % 2]
        yield Wish(seed=seed + 50_000 + i, plan=plan, stratum="confounded", names=chosen, enr=enr, ratio=ratio)


def _unknown(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    families = list(ON_ANY_PLAN if plan == "paper" else ON_RICH_PLAN)
    for i in range(sizes.unknown):
        enr = (0.5, 1.0, 2.0, 5.0)[(i // len(families)) % 4]
        name = families[i % len(families)]
        yield Wish(seed=seed + i, plan=plan, stratum="unknown", names=(name,), enr=enr)


def _broken(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    """Half of them on a joint that lacks something besides."""
    rng = np.random.default_rng([seed, 4])
    for i in range(sizes.broken):
        fault = DATA_FAULTS[i % len(DATA_FAULTS)]
        beside = (str(rng.choice(CONSTANT_OVER_FACES)),) if rng.random() < 0.5 else ()
        yield Wish(seed=seed + i, plan=plan, stratum="broken", names=(fault, *beside), enr=2.0)


def _withheld(sizes: Sizes, plan: PlanName, seed: int) -> Iterator[Wish]:
    """Effects of the mean and of the runs that both simulator and library lack."""
    hidden = (
        (*HIDDEN_ON_PAPER, "quantisation", "noise_growth") if plan == "paper" else ("quantisation", "noise_growth")
    )
    names = [name for name in LIBRARY_DEFECTS if name not in (*hidden, "temperature_sensor_error")]
    for i in range(sizes.withheld):
        enr = (1.0, 2.0, 5.0)[(i // len(names)) % 3]
        yield Wish(seed=seed + i, plan=plan, stratum="withheld", names=(names[i % len(names)],), enr=enr)
