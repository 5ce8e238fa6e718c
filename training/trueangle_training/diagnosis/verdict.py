"""What is said of an attribution: named causes with probability and class, and what stays unexplained."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.diagnosis.attribution import Attribution, Candidate, Member
from trueangle_training.diagnosis.confidence import Grounds, class_probability
from trueangle_training.diagnosis.curve_error import within_curve_error
from trueangle_training.diagnosis.design_check import CARRIED, Design
from trueangle_training.diagnosis.one_pattern import kept_of_names
from trueangle_training.diagnosis.parameters import Estimate, estimates
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.scatter import Growth, coarser_ratio, loud_run, noise_growth
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]

NAMED_FROM = 0.9
"""Class probability from which a cause is named."""
ONE_OF_A_CLASS = 0.89
"""Highest probability of one name among several that the plan cannot tell apart."""
ONE_OF_A_SUM = 0.5
"""Highest probability of a name whose pattern is wide enough to be the sum of others: of 35 such names 11 were
right where pairs and withheld effects are frequent."""
EVIDENCE_COUNTS = 0.8
"""Weight of the evidence against equal chances for all members of a class; 0.8 has the least log loss on 273
classes of two and more that held the true effect."""
IMITATES_WITHIN = 3.0
"""A pattern drawn in each run can imitate any order 1: it is of the class only where it is as likely, in nats."""
GROWTH_BESIDE_OTHERS_P = 0.0005
"""What a found curve leaves over looks like noise that goes with its condition."""
ABOVE_ROUNDING = 1.5
BESIDE_ROUNDING = 0.5
"""Highest probability of a cause whose curve is no larger than that of a resolution found too coarse."""
BESIDE_CURVE_ERROR = 0.5
"""Highest probability of a cause no larger than what the leading one's shape may be off by."""
LOUD_CELL = Cell(order="0", time="between_runs", moment="variance")
"""Of a run that scatters beyond all others, in no pattern that the library or a generic one has."""
GROWTH_CELLS = {
    "temperature_c": Cell(order="0", temperature="linear", moment="variance"),
    "speed_deg_s": Cell(order="0", speed="linear", moment="variance"),
    "load_nm": Cell(order="0", load="linear", moment="variance"),
}
"""Of noise that grows, by its condition, where the library has no name for it."""
LATTICE_CELL = Cell(order="0", moment="variance")
"""Of a resolution coarser than stated, the same."""
WIDE = 10
"""Columns of a pattern."""
WEAK_GENERIC = 20.0
"""Log evidence of a lone generic pattern up to which growing noise explains it as well."""


class VerdictKind(Enum):
    """What the diagnosis says in a word."""

    NONE = "none"
    NAMED = "named"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One effect that is found."""

    effect: str
    """The likeliest of its class."""
    probability: float
    """That it is this effect."""
    effect_class: tuple[str, ...]
    """The effects that could carry at least 95 % of what was found, the named one first."""
    class_probability: float
    """That it is one of the class."""
    nature: Nature
    parameters: Mapping[str, Estimate]
    share: float
    """Of all that is explained, 0 to 1."""
    members: tuple[int, ...]
    """In `Attribution.members`; none for effects of the scatter."""
    grounds: Grounds | None
    """None for effects of the scatter: their probability comes from a test of its own."""
    growth: Growth | None = None
    """Of noise that grows: with what."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unexplained:
    """Structure that no effect of the library explains."""

    significant: bool
    nearest_effect: str | None
    """The effect that could carry most of it; None where there is nothing, or no effect carries any."""
    nearest_share: float
    """How much of it that effect could carry, 0 to 1."""
    cells: tuple[Cell, ...]
    """Where it lives, the largest first."""
    share: float
    """Of all structure that was found, 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The answer to `which`."""

    kind: VerdictKind
    causes: tuple[Cause, ...]
    """The most probable first; some may be too improbable to be named."""
    unexplained: Unexplained

    @property
    def named(self) -> tuple[Cause, ...]:
        """The causes that are stated."""
        return tuple(cause for cause in self.causes if cause.class_probability >= NAMED_FROM)


def verdict_of(problem: Problem, attribution: Attribution, design: Design) -> Verdict:
    """Judge an attribution."""
    kept = kept_of_names(problem, attribution, design.spans)
    causes = [
        _less_probable(_cause(problem, attribution, design, name), kept.get(name, 1.0))
        for name in _effects(attribution)
    ]
    causes = [_beside_leading(problem, attribution, design, causes[0], cause) for cause in causes]
    generic = [member for member in attribution.members if member.effect is None]
    # What the simulator models of the scatter is not looked for again.
    growth = None if "noise_growth" in problem.joint.effects else _growth(problem, attribution)
    ratio = None if "quantisation" in problem.joint.effects else coarser_ratio(problem.conditions)
    nameless: list[Cell] = []
    if growth is not None:
        if len(attribution.members) == 1 and generic and generic[0].log_evidence < WEAK_GENERIC:
            generic = []
        if "noise_growth" in problem.library:
            causes.append(_growth_cause(growth))
        else:
            nameless.append(GROWTH_CELLS[growth.condition])
    if ratio is not None:
        lattice = _lattice_cause(problem, ratio)
        rounded = lattice.parameters["step_arcsec"].value / np.sqrt(12.0)
        causes = [_doubted(problem, attribution, design, cause, rounded) for cause in causes]
        if "quantisation" in problem.library:
            causes.append(lattice)
        else:
            nameless.append(LATTICE_CELL)
    causes.sort(key=lambda cause: -cause.class_probability)
    unexplained = _unexplained(problem, attribution, design, generic)
    if growth is None and not unexplained.significant and loud_run(problem, attribution.noise) is not None:
        nameless.append(LOUD_CELL)
    if nameless:
        unexplained = replace(unexplained, significant=True, cells=(*unexplained.cells, *nameless))
    if any(cause.class_probability >= NAMED_FROM for cause in causes):
        kind = VerdictKind.NAMED
    elif causes or unexplained.significant:
        kind = VerdictKind.UNKNOWN
    else:
        kind = VerdictKind.NONE
    return Verdict(kind=kind, causes=tuple(causes), unexplained=unexplained)


def _effects(attribution: Attribution) -> tuple[str, ...]:
    """Named once each, in the order of the members."""
    return tuple(dict.fromkeys(m.effect for m in attribution.members if m.effect is not None))


def _cause(problem: Problem, attribution: Attribution, design: Design, name: str) -> Cause:
    places = [i for i, member in enumerate(attribution.members) if member.effect == name]
    members = [attribution.members[i] for i in places]
    leading = places[0]
    rivals = attribution.rivals[leading]
    curve = sum((m.curve_arcsec for m in members), np.zeros(len(problem)))
    carried = design.spans.carried(curve)
    own = next((c.log_evidence for c in rivals if c.effect == name), members[0].log_evidence)
    effect_class = _class(problem, design, name, carried, rivals, own)
    grounds = Grounds(
        margin=own - _best_outside(problem, design, _standing(problem, attribution, rivals), effect_class, curve),
        left=attribution.left_to_generic,
        by_named_share=attribution.by_named_share,
    )
    whole = class_probability(grounds)
    probability = whole * _within_class(name, effect_class, rivals)
    if _may_be_a_sum(problem, design, members):
        probability = min(probability, ONE_OF_A_SUM)
    return Cause(
        effect=name,
        probability=probability,
        effect_class=effect_class,
        class_probability=whole,
        nature=problem.library[name].nature,
        parameters=estimates(problem, members),
        share=min(1.0, sum(member.share for member in members)),
        members=tuple(places),
        grounds=grounds,
    )


def _less_probable(cause: Cause, factor: float) -> Cause:
    return replace(
        cause, probability=factor * cause.probability, class_probability=factor * cause.class_probability
    )


def _class(
    problem: Problem, design: Design, name: str, carried: Floats, rivals: Sequence[Candidate], own: float
) -> tuple[str, ...]:
    """The effects that could carry the found part and that the design check had listed for it."""
    listed = set(design.confusable(name))
    found: list[str] = []
    for other, effect in problem.library.items():
        if other == name or other not in listed:
            continue
        shares = [carried[i] for i, each in enumerate(problem.hypotheses) if each.effect == other]
        if not shares or max(shares) < CARRIED:
            continue
        if effect.nature is Nature.RANDOM:
            likely = next((c.log_evidence for c in rivals if c.effect == other), -np.inf)
            if likely < own - IMITATES_WITHIN:
                continue
        found.append(other)
    return (name, *found)


def _standing(problem: Problem, attribution: Attribution, rivals: Sequence[Candidate]) -> list[Candidate]:
    """The rivals that were not set aside when the members were chosen."""
    return [
        rival
        for rival in rivals
        if not (attribution.by_named_share and rival.effect is None)
        and not (
            attribution.draws_set_aside and problem.hypotheses[rival.hypothesis_index].nature is Nature.RANDOM
        )
    ]


def _best_outside(
    problem: Problem,
    design: Design,
    rivals: Sequence[Candidate],
    effect_class: Sequence[str],
    curve: Floats,
) -> float:
    """Log evidence of the best rival that is another answer.

    Nothing at all, with a log evidence of 0, is one. A generic pattern that carries as much of the found part as
    the class does is the same answer in other words.
    """
    for rival in rivals:
        if rival.effect in effect_class:
            continue
        if rival.effect is None and np.isfinite(rival.log_evidence):
            columns = problem.hypotheses[rival.hypothesis_index].main
            if design.spans.carried_by(columns, curve) >= CARRIED:
                continue
        return max(rival.log_evidence, 0.0)
    return 0.0


def _within_class(name: str, effect_class: Sequence[str], rivals: Sequence[Candidate]) -> float:
    """Probability of the name, given that its class is right."""
    if len(effect_class) == 1:
        return 1.0
    evidence = {c.effect: c.log_evidence for c in rivals if c.effect in effect_class}
    values = np.array([evidence.get(each, -np.inf) for each in effect_class])
    share = np.exp(values - values.max())
    # The evidence prefers the simpler pattern; the plan cannot tell whether nature did.
    by_evidence, by_number = float(share[0] / share.sum()), 1.0 / len(effect_class)
    return min(EVIDENCE_COUNTS * by_evidence + (1.0 - EVIDENCE_COUNTS) * by_number, ONE_OF_A_CLASS)


def _may_be_a_sum(problem: Problem, design: Design, members: Sequence[Member]) -> bool:
    """A pattern wide enough for other effects to be contained in it may be two of them at once; no draws are."""
    name = members[0].effect
    if name is not None and problem.library[name].nature is Nature.RANDOM:
        return False
    widest = max(problem.hypotheses[member.hypothesis_index].main.shape[1] for member in members)
    contained = [other for other, carriers in design.carries.items() if carriers.get(name or "", 0.0) >= CARRIED]
    return widest >= WIDE and len(contained) > 1


def _growth(problem: Problem, attribution: Attribution) -> Growth | None:
    tested = noise_growth(problem, attribution.noise, attribution.explained(problem))
    if not tested or not tested[0].significant:
        return None
    best = tested[0]
    if attribution.members and best.p_value > GROWTH_BESIDE_OTHERS_P:
        return None
    if any(member.effect is None and member.log_evidence >= WEAK_GENERIC for member in attribution.members):
        # What no effect explains is not known well enough to tell noise from what it leaves over.
        return None
    return best


def _growth_cause(best: Growth) -> Cause:
    # Two or three conditions were tried; a ratio near 1.15 is at the edge of what exchanging runs can tell.
    probability = float(np.clip(1.0 - 40.0 * best.p_value, 0.5, 0.97))
    return Cause(
        effect="noise_growth",
        probability=probability,
        effect_class=("noise_growth",),
        class_probability=probability,
        nature=Nature.VARIANCE,
        parameters={f"growth_over_{best.condition}": Estimate(value=best.ratio, standard_uncertainty=0.0)},
        share=0.0,
        members=(),
        grounds=None,
        growth=best,
    )


def _lattice_cause(problem: Problem, ratio: int) -> Cause:
    """A resolution that is coarser than stated: arithmetic, not statistics."""
    step_arcsec = ratio * DEG_PER_TURN * ARCSEC_PER_DEG / problem.conditions.counts_per_rev
    return Cause(
        effect="quantisation",
        probability=0.98,
        effect_class=("quantisation",),
        class_probability=0.98,
        nature=Nature.VARIANCE,
        parameters={
            "counts_per_rev": Estimate(
                value=float(problem.conditions.counts_per_rev // ratio), standard_uncertainty=0.0
            ),
            "step_arcsec": Estimate(value=step_arcsec, standard_uncertainty=0.0),
        },
        share=0.0,
        members=(),
        grounds=None,
    )


def _doubted(
    problem: Problem, attribution: Attribution, design: Design, cause: Cause, rounded_arcsec: float
) -> Cause:
    """A curve no larger than the rounding error may be the rounding error: at the same stops it comes again."""
    curves = [attribution.members[place].curve_arcsec for place in cause.members]
    seen = design.spans.projected(sum(curves, np.zeros(len(problem))))
    if not curves or float(np.sqrt(np.mean(seen**2))) > ABOVE_ROUNDING * rounded_arcsec:
        return cause
    return replace(
        cause,
        probability=min(cause.probability, BESIDE_ROUNDING),
        class_probability=min(cause.class_probability, BESIDE_ROUNDING),
    )


def _beside_leading(
    problem: Problem, attribution: Attribution, design: Design, leading: Cause, cause: Cause
) -> Cause:
    """A further cause, doubted where the leading one's shape may be off by as much."""
    if cause is leading or problem.library[leading.effect].nature is not Nature.MEAN:
        return cause
    curves = [
        sum((attribution.members[place].curve_arcsec for place in each.members), np.zeros(len(problem)))
        for each in (leading, cause)
    ]
    order = problem.hypotheses[attribution.members[cause.members[0]].hypothesis_index].cell.order
    if not within_curve_error(problem, design.spans, curves[0], leading.effect_class, curves[1], order):
        return cause
    return replace(
        cause,
        probability=min(cause.probability, BESIDE_CURVE_ERROR),
        class_probability=min(cause.class_probability, BESIDE_CURVE_ERROR),
    )


def _unexplained(
    problem: Problem, attribution: Attribution, design: Design, generic: Sequence[Member]
) -> Unexplained:
    if not generic:
        return Unexplained(significant=False, nearest_effect=None, nearest_share=0.0, cells=(), share=0.0)
    curve = sum((member.curve_arcsec for member in generic), np.zeros(len(problem)))
    carried = design.spans.carried(curve)
    nearest: str | None = None
    nearest_share = 0.0
    for i, each in enumerate(problem.hypotheses):
        if each.effect is None or each.nature is not Nature.MEAN:
            continue
        if carried[i] > nearest_share:
            nearest, nearest_share = each.effect, float(carried[i])
    cells = tuple(dict.fromkeys(problem.hypotheses[member.hypothesis_index].cell for member in generic))
    return Unexplained(
        significant=True,
        nearest_effect=nearest,
        nearest_share=nearest_share,
        cells=cells,
        share=min(1.0, sum(member.share for member in generic)),
    )
