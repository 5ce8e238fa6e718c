"""Which cases a check consists of: strata, effects, effect-to-noise ratios, all from one seed."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from trueangle_training.plant.data_faults import DATA_FAULTS
from trueangle_training.plant.plants import PLANTS
from trueangle_training.plant.schedule import PlanName
from trueangle_training.plant.wish import Stratum, Wish

PlanChoice = Literal["paper", "rich", "both"]

ENRS = (0.2, 0.5, 1.0, 2.0, 5.0)
ENR_ROUND = (0.2, 0.5, 1.0, 1.0, 2.0, 2.0, 5.0, 5.0)
"""How often each ratio comes: of 80 cases of an effect 60 are at 1 or more, where the worst effect is judged."""
UNKNOWN_ENRS = (0.5, 1.0, 2.0, 5.0)
WITHHELD_ENRS = (1.0, 2.0, 5.0)
PAIR_RATIOS = (0.7, 0.3)
SPARES = 4
"""Other pairs for one that the plan does not let be what it should be."""
RICH_SHARE = 0.3
"""Of the cases, where both plans are asked for: a rich one takes five times as long."""
NEVER_NAMED = "temperature_sensor_error"
"""Taken up by re-calibration wherever the modelled thermal response is linear: part of the parametric share."""
VARIANCE = ("quantisation", "noise_growth")
"""Effects of the scatter: no partner of a pair."""
HIDDEN_ON_PAPER = ("read_latency", "load_deflection", "self_heating", "hysteresis", NEVER_NAMED)
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
    parametric: int = 200
    single: int = 2000
    pair: int = 300
    confounded: int = 200
    unknown: int = 400
    broken: int = 100

    @property
    def total(self) -> int:
        """Cases in all."""
        return sum(self.by_name().values())

    def by_name(self) -> dict[str, int]:
        """Stratum to cases."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def scaled(self, total: int) -> "Sizes":
        """So many cases in all, the strata in the same proportion, rounded by largest remainders."""
        names, counts = list(self.by_name()), np.array(list(self.by_name().values()), dtype=np.float64)
        wanted = counts * total / counts.sum()
        whole = np.floor(wanted).astype(np.int64)
        for place in np.argsort(whole - wanted, kind="stable")[: total - int(whole.sum())]:
            whole[place] += 1
        return Sizes(**{name: int(count) for name, count in zip(names, whole, strict=True)})

    def split(self, share: float) -> tuple["Sizes", "Sizes"]:
        """All but a share, and the share; pairs that a poor plan confounds stay with the first."""
        rich = {name: round(count * share) for name, count in self.by_name().items()} | {"confounded": 0}
        rest = {name: count - rich[name] for name, count in self.by_name().items()}
        return Sizes(**rest), Sizes(**rich)


FULL = Sizes()


def wishes(sizes: Sizes, *, plan: PlanChoice, plants: Sequence[str], seed: int) -> list[Wish]:
    """All cases, in an order in which every prefix holds all strata; the same arguments, the same wishes."""
    if plan == "both":
        paper, rich = sizes.split(RICH_SHARE)
        parts: list[tuple[PlanName, Sizes]] = [("paper", paper), ("rich", rich)]
    elif plan == "rich":
        # It tells apart what the other plan confounds: all pairs are separable ones.
        parts = [(plan, replace(sizes, pair=sizes.pair + sizes.confounded, confounded=0))]
    else:
        parts = [(plan, sizes)]
    # Sets that differ in anything share no case: one that was seen must not come back under another number.
    root = f"{seed}/{plan}/{''.join(plants)}/{sizes.total}"
    found: list[Wish] = []
    for name, part in parts:
        draw = _Draw(plan=name, plants=tuple(plants), root=root, both=plan == "both")
        lacking = [wish for make in (_single, _pairs) for wish in make(draw, part)]
        others = [wish for make in (_healthy, _unknown, _broken) for wish in make(draw, part)]
        found += [*lacking, *_listing_no_more(draw, others, lacking)]
    order = np.random.default_rng([seed, 1]).permutation(len(found))
    return [found[i] for i in order]


def _listing_no_more(draw: "_Draw", others: Sequence[Wish], lacking: Sequence[Wish]) -> Iterator[Wish]:
    """The others with JOINT.yaml as short as where an effect of the library is what the simulator lacks."""
    rng = draw.rng("unlisted")
    for wish in others:
        same = [each.names for each in lacking if each.plant == wish.plant and NEVER_NAMED not in each.names]
        yield replace(wish, unlisted=same[int(rng.integers(len(same)))]) if same else wish


def withheld_wishes(effect: str, cases: int, *, plan: PlanChoice, plants: Sequence[str], seed: int) -> list[Wish]:
    """Cases of one effect, a third as many of other effects and of nothing beside it; empty: never to be seen.

    The others are asked with the same curtailed library, so that which effect it lacks tells nothing of a case.
    """
    if effect in HIDDEN_ON_PAPER and plan == "paper":
        return []
    hidden = effect in HIDDEN_ON_PAPER
    shown: PlanName = "rich" if hidden or plan == "rich" else "paper"
    root = f"{seed}/{plan}/{''.join(plants)}/{cases} without {effect}"
    draw = _Draw(plan=shown, plants=tuple(plants), root=root, both=False)
    makers = draw.makers_of(effect)
    others = [name for name in draw.separable_names() if name != effect]
    decoys = cases // 4
    found: list[Wish] = []
    for i in range(cases - decoys if makers else 0):
        key = f"withheld/{i}"
        enr = WITHHELD_ENRS[i % len(WITHHELD_ENRS)]
        plant = makers[i % len(makers)]
        found.append(draw.wish(key, plant=plant, stratum="withheld", names=(effect,), enr=enr))
    for i in range(decoys if makers else 0):
        key, plant = f"beside/{i}", draw.plants[i % len(draw.plants)]
        if i % 2:
            name = _one_of(others, draw.rng(key), [each for each in others if plant in draw.makers_of(each)])
            beside = draw.wish(key, plant=plant, stratum="single", names=(name,), enr=2.0)
        else:
            beside = draw.wish(key, plant=plant, stratum="noise")
        found.append(replace(beside, unlisted=(effect,)))
    return found


def _one_of(names: Sequence[str], rng: np.random.Generator, possible: Sequence[str]) -> str:
    return str(rng.choice(list(possible or names)))


def effects_of(plants: Sequence[str]) -> tuple[str, ...]:
    """Library effects that at least one of the plants makes, without the one that is never named."""
    found = dict.fromkeys(name for letter in plants for name in PLANTS[letter].library)
    return tuple(name for name in found if name != NEVER_NAMED)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Draw:
    """What the makers of wishes have in common."""

    plan: PlanName
    plants: tuple[str, ...]
    root: str
    """What the set is made from, as text: every seed hangs on it."""
    both: bool
    """The other plan is asked as well."""

    def wish(
        self,
        key: str,
        *,
        plant: str,
        stratum: Stratum,
        names: tuple[str, ...] = (),
        enr: float = 1.0,
        ratio: float = 1.0,
    ) -> Wish:
        """With a seed of its own, which says nothing of the others."""
        digest = hashlib.sha256(f"{self.root}/{self.plan}/{plant}/{key}".encode()).digest()
        number = int.from_bytes(digest[:6], "big")
        return Wish(seed=number, plan=self.plan, stratum=stratum, enr=enr, names=names, ratio=ratio, plant=plant)

    def rng(self, key: str) -> np.random.Generator:
        """For choices among cases."""
        digest = hashlib.sha256(f"{self.root}/{self.plan}/{key}".encode()).digest()
        return np.random.default_rng(int.from_bytes(digest[:8], "big"))

    def makers_of(self, *names: str) -> list[str]:
        """Plants that make all of these."""
        return [letter for letter in self.plants if set(names) <= set(PLANTS[letter].library)]

    def visible_names(self) -> list[str]:
        """Effects of the library that this plan may show."""
        gone = HIDDEN_ON_PAPER if self.plan == "paper" else (NEVER_NAMED,)
        return [name for name in self.all_names() if name not in gone]

    def separable_names(self) -> list[str]:
        """Those of the mean, of the runs and of events."""
        return [name for name in self.visible_names() if name not in VARIANCE]

    def all_names(self) -> list[str]:
        """Effects of the library that any of the plants makes."""
        return list(dict.fromkeys(name for letter in self.plants for name in PLANTS[letter].library))


def _healthy(draw: _Draw, sizes: Sizes) -> Iterator[Wish]:
    for i in range(sizes.noise):
        yield draw.wish(f"noise/{i}", plant=draw.plants[i % len(draw.plants)], stratum="noise")
    for i in range(sizes.parametric):
        yield draw.wish(f"parametric/{i}", plant=draw.plants[i % len(draw.plants)], stratum="parametric")


def _single(draw: _Draw, sizes: Sizes) -> Iterator[Wish]:
    """Every effect at every ratio; what the paper's plan hides comes there less often, on the rich one more."""
    seen = draw.visible_names()
    hidden = [name for name in draw.all_names() if name in HIDDEN_ON_PAPER]
    if draw.plan == "paper":
        often: Mapping[str, int] = dict.fromkeys(seen, 4) | dict.fromkeys(hidden, 1)
    else:
        often = {name: 6 if draw.both and name in HIDDEN_ON_PAPER else 1 for name in seen}
    rounds = [(name, enr) for name, times in often.items() for enr in ENR_ROUND for _ in range(times)]
    # Plants take turns, each effect beginning with another one: small sets hold all of them, too.
    rng, turns = draw.rng("single"), {name: number for number, name in enumerate(often)}
    order: list[int] = []
    while len(order) < sizes.single:
        order += [int(place) for place in rng.permutation(len(rounds))]
    for i in range(sizes.single):
        name, enr = rounds[order[i]]
        makers = draw.makers_of(name)
        plant = makers[turns[name] % len(makers)]
        turns[name] += 1
        yield draw.wish(f"single/{i}", plant=plant, stratum="single", names=(name,), enr=enr)


def pair_names(stratum: Stratum, plan: PlanName, plant: str) -> list[str]:
    """What the two effects of a case are chosen from."""
    if stratum == "confounded":
        return [name for name in CONSTANT_OVER_FACES if name in PLANTS[plant].library]
    hidden = HIDDEN_ON_PAPER if plan == "paper" else (NEVER_NAMED,)
    return [name for name in PLANTS[plant].library if name not in (*hidden, *VARIANCE)]


def spares_of(wish: Wish) -> tuple[Wish, ...]:
    """Wishes in its place where no draw fulfils it: other pairs, as many are always separable, or never."""
    if wish.stratum not in ("pair", "confounded"):
        return ()
    rng = np.random.default_rng([wish.seed, 4])
    names = pair_names(wish.stratum, wish.plan, wish.plant)
    return tuple(replace(wish, names=_two(names, rng)) for _ in range(SPARES))


def _pairs(draw: _Draw, sizes: Sizes) -> Iterator[Wish]:
    rng = draw.rng("pair")
    for i in range(sizes.pair):
        plant = draw.plants[i % len(draw.plants)]
        names = pair_names("pair", draw.plan, plant)
        chosen, enr = _two(names, rng), float(rng.choice([1.0, 2.0, 5.0]))
        ratio = PAIR_RATIOS[i // len(draw.plants) % 2]
        yield draw.wish(f"pair/{i}", plant=plant, stratum="pair", names=chosen, enr=enr, ratio=ratio)
    for i in range(sizes.confounded if draw.plan == "paper" else 0):
        plant = draw.plants[i % len(draw.plants)]
        names = pair_names("confounded", draw.plan, plant)
        chosen, enr = _two(names, rng), float(rng.choice([1.0, 2.0]))
        ratio = PAIR_RATIOS[i // len(draw.plants) % 2]
        yield draw.wish(f"confounded/{i}", plant=plant, stratum="confounded", names=chosen, enr=enr, ratio=ratio)


def _two(names: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    return tuple(str(name) for name in rng.choice(list(names), size=2, replace=False))


def _unknown(draw: _Draw, sizes: Sizes) -> Iterator[Wish]:
    families = [(letter, name) for letter in draw.plants for name in PLANTS[letter].unknown[draw.plan]]
    families = [families[int(place)] for place in draw.rng("unknown").permutation(len(families))]
    for i in range(sizes.unknown):
        plant, name = families[i % len(families)]
        enr = UNKNOWN_ENRS[(i + i // len(families)) % len(UNKNOWN_ENRS)]
        yield draw.wish(f"unknown/{i}", plant=plant, stratum="unknown", names=(name,), enr=enr)


def _broken(draw: _Draw, sizes: Sizes) -> Iterator[Wish]:
    """Half of them on a joint that lacks something besides."""
    rng = draw.rng("broken")
    for i in range(sizes.broken):
        plant = draw.plants[i // len(DATA_FAULTS) % len(draw.plants)]
        constant = [name for name in CONSTANT_OVER_FACES if plant in draw.makers_of(name)]
        beside = (str(rng.choice(constant)),) if rng.random() < 0.5 else ()
        names = (DATA_FAULTS[i % len(DATA_FAULTS)], *beside)
        yield draw.wish(f"broken/{i}", plant=plant, stratum="broken", names=names, enr=2.0)
