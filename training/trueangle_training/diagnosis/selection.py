"""Which blocks explain the errors: greedy, with every choice made again once the others are known.

Generic patterns compete with the library from the first step. A further member must carry a share of what is
explained, because at many readings a shape that is 3 % off is worth hundreds of nats and would attract names.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.evidence import Accepted, Evidence, fit, scores
from trueangle_training.effects.effect import Hypothesis, Nature

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

LEAST_EVIDENCE = 4.5
"""Log evidence of a family, its penalty taken off, from which it is accepted as the first."""
LEAST_EVIDENCE_FURTHER = 5.5
"""The same beside others, whose shapes are a little off."""
LEAST_TO_STAY = 4.5
LEAST_SIZE = 0.08
"""Visible RMS over the noise of one reading: among thousands of readings evidence alone would find the hundredths
of an arcsecond by which linear models of a joint are off."""
LEAST_SIZE_DRAWN = 0.13
"""The same of a pattern drawn in each run, which slow noise resembles."""
LEAST_SHARE_LIBRARY = 0.05
LEAST_SHARE_GENERIC = 0.15
LEAST_SHARE_TO_STAY = 0.03
SPREAD = 3.0
"""How much of what a bent shape leaves over may be in some runs, over their part of the readings."""
MOST_MEMBERS = 6
REOPTIMISATIONS = 2
GENERIC_PENALTY = 3.0
DRAWN_PENALTY = 3.0
"""Beside the generic one: a draw in each run has dozens of columns that fit whatever a run does."""
RANDOM_EFFECT_PENALTY = 3.0
EVENT_PENALTY = 3.0
NEAR_NATS = 3.0
NEAR_SHARE = 0.05
"""Of the evidence: within either of the two, a drawn effect is preferred to a drawn generic pattern."""
LEAST_OVER_COLOUR = 4.0
"""Nats by which a pattern drawn in each run must do better than noise of another colour to be a candidate."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Families:
    """Which blocks share one prior probability."""

    of_block: Integers
    """[blocks]"""
    names: tuple[str, ...]
    generic: Mask
    """[families]"""
    penalty: Floats
    """[families], nats, the logarithm of the number of blocks included."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Selection:
    """The blocks that were accepted, in the order of what they explain."""

    accepted: tuple[Accepted, ...]
    log_evidence: tuple[float, ...]
    """Of each, given the others, penalty taken off."""
    share: tuple[float, ...]
    """Of each: what is lost of the explained energy when it is removed."""


def families_of(evidence: Evidence, hypotheses: Sequence[Hypothesis]) -> Families:
    """The families of all visible blocks."""
    keys = [_key(hypotheses[i]) for i in evidence.hypothesis]
    names = sorted(set(keys))
    place = {key: i for i, key in enumerate(names)}
    of_block = np.array([place[key] for key in keys], dtype=np.int64)
    size = np.bincount(of_block, minlength=len(names))
    penalty = np.log(np.maximum(size, 1))
    for block, family in enumerate(of_block):
        penalty[family] = np.log(size[family]) + _penalty(hypotheses[evidence.hypothesis[block]])
    return Families(
        of_block=of_block,
        names=tuple(name for _, name in names),
        generic=np.array([generic for generic, _ in names], dtype=bool),
        penalty=penalty,
    )


def _key(hypothesis: Hypothesis) -> tuple[bool, str]:
    return hypothesis.effect is None, hypothesis.effect or hypothesis.family


def _penalty(hypothesis: Hypothesis) -> float:
    drawn = hypothesis.nature is not Nature.MEAN
    if hypothesis.effect is None:
        return GENERIC_PENALTY + (DRAWN_PENALTY if drawn else 0.0)
    of_nature = {Nature.RANDOM: RANDOM_EFFECT_PENALTY, Nature.EVENT: EVENT_PENALTY}.get(hypothesis.nature, 0.0)
    return of_nature + hypothesis.doubt_nats


def family_evidence(log_evidence: Floats, families: Families) -> Floats:
    """[families]: log of the mean over the family's blocks, less its penalty."""
    top = np.full(len(families.names), -np.inf)
    np.maximum.at(top, families.of_block, log_evidence)
    safe = np.where(np.isfinite(top), top, 0.0)
    total = np.zeros(len(families.names))
    np.add.at(total, families.of_block, np.exp(log_evidence - safe[families.of_block]))
    return np.where(np.isfinite(top), safe + np.log(np.maximum(total, 1e-300)) - families.penalty, -np.inf)


def select(evidence: Evidence, families: Families, allowed: Mask) -> Selection:
    """Choose among the allowed blocks ([blocks])."""
    accepted: list[Accepted] = []
    if not allowed.any():
        return Selection(accepted=(), log_evidence=(), share=())
    while len(accepted) < MOST_MEMBERS:
        found = _best(evidence, families, allowed, accepted)
        if found is None or found[1] < (LEAST_EVIDENCE_FURTHER if accepted else LEAST_EVIDENCE):
            break
        if not _large_enough(evidence, accepted, found[0]):
            allowed = allowed & (families.of_block != families.of_block[found[0].block])
            continue
        if accepted and not _carries_enough(evidence, families, accepted, found[0]):
            break
        accepted = _reoptimised(evidence, families, allowed, [*accepted, found[0]])
    return _pruned(evidence, families, accepted)


def _best(
    evidence: Evidence, families: Families, allowed: Mask, accepted: Sequence[Accepted]
) -> tuple[Accepted, float] | None:
    """The likeliest block of the likeliest family beside the accepted ones, and the family's evidence."""
    found = scores(evidence, accepted)
    allowed = allowed & (found.over_colour >= LEAST_OVER_COLOUR)
    log_evidence = np.where(allowed, found.log_evidence, -np.inf)
    by_family = family_evidence(log_evidence, families)
    family = int(np.argmax(by_family))
    if not np.isfinite(by_family[family]):
        return None
    family = _preferred(evidence, families, by_family, family)
    block = int(np.argmax(np.where(families.of_block == family, log_evidence, -np.inf)))
    return Accepted(block=block, tau=float(found.tau[block])), float(by_family[family])


def _preferred(evidence: Evidence, families: Families, by_family: Floats, best: int) -> int:
    """Instead of a generic pattern drawn in each run an effect of the library that is drawn too, where it is near.

    Over one turn a run the two have the same columns but for their spacing, and that decides nothing.
    """
    drawn = np.zeros(len(families.names), dtype=bool)
    drawn[families.of_block[evidence.drawn]] = True
    if not (families.generic[best] and drawn[best]):
        return best
    near = by_family[best] - max(NEAR_NATS, NEAR_SHARE * float(by_family[best]))
    rivals = np.flatnonzero(drawn & ~families.generic & (by_family >= near))
    return int(rivals[np.argmax(by_family[rivals])]) if rivals.size else best


def _large_enough(evidence: Evidence, accepted: Sequence[Accepted], candidate: Accepted) -> bool:
    """Whether a candidate is large beside what neither the noise's colour nor the joint's model is known to."""
    if evidence.reach[candidate.block] < 1.0:
        return True
    own = evidence.column_range(candidate.block)
    coefficients = fit(evidence, [*accepted, candidate]).coefficients[-own.size :]
    energy = float(coefficients @ evidence.product(candidate.block)[:, own] @ coefficients)
    least = LEAST_SIZE_DRAWN if evidence.drawn[candidate.block] else LEAST_SIZE
    return energy >= least**2 * evidence.error.size


def _carries_enough(
    evidence: Evidence, families: Families, accepted: Sequence[Accepted], candidate: Accepted
) -> bool:
    whole = float(evidence.error @ evidence.error)
    before = float(fit(evidence, accepted).energy_left)
    after = float(fit(evidence, [*accepted, candidate]).energy_left)
    generic = families.generic[families.of_block[candidate.block]]
    least = LEAST_SHARE_GENERIC if generic else LEAST_SHARE_LIBRARY * _part(evidence, candidate)
    return before - after >= least * (whole - after)


def _part(evidence: Evidence, member: Accepted) -> float:
    """Part of the usual share that is asked of a member.

    What a bent shape leaves over spreads over all runs; an event is in a few, and so is what it must be told from.
    """
    return min(1.0, SPREAD * float(evidence.reach[member.block]))


def _reoptimised(
    evidence: Evidence, families: Families, allowed: Mask, accepted: list[Accepted]
) -> list[Accepted]:
    """Each member chosen again given the others: this swaps wrong first picks."""
    if len(accepted) == 1:
        return accepted
    for _ in range(REOPTIMISATIONS):
        before = [each.block for each in accepted]
        for place in range(len(accepted)):
            others = accepted[:place] + accepted[place + 1 :]
            found = _best(evidence, families, allowed, others)
            if found is not None and found[1] > 0:
                accepted[place] = found[0]
        if [each.block for each in accepted] == before:
            break
    return accepted


def _pruned(evidence: Evidence, families: Families, accepted: list[Accepted]) -> Selection:
    while True:
        judged = [_worth(evidence, families, accepted, place) for place in range(len(accepted))]
        weak = [
            place
            for place, (log_evidence, share) in enumerate(judged)
            if log_evidence < LEAST_TO_STAY
            or (share < LEAST_SHARE_TO_STAY * _part(evidence, accepted[place]) and len(accepted) > 1)
        ]
        if not weak:
            break
        accepted.pop(min(weak, key=lambda place: judged[place][0]))
    order = sorted(range(len(accepted)), key=lambda place: -judged[place][1])
    return Selection(
        accepted=tuple(accepted[place] for place in order),
        log_evidence=tuple(judged[place][0] for place in order),
        share=tuple(judged[place][1] for place in order),
    )


def _worth(
    evidence: Evidence, families: Families, accepted: Sequence[Accepted], place: int
) -> tuple[float, float]:
    """Log evidence of one member's family given the others, and its share of what is explained."""
    others = [*accepted[:place], *accepted[place + 1 :]]
    log_evidence = family_evidence(scores(evidence, others).log_evidence, families)
    whole = float(evidence.error @ evidence.error)
    without = float(fit(evidence, others).energy_left)
    left = float(fit(evidence, accepted).energy_left)
    share = (without - left) / max(whole - left, 1e-12)
    return float(log_evidence[families.of_block[accepted[place].block]]), share
