"""Which selection is the answer: of all patterns, of the names alone, or of all that are not drawn in each run."""

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.design_check import CARRIED
from trueangle_training.diagnosis.evidence import Accepted, Evidence, fit, joint_log_evidence, scores
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.random_draws import are_no_draws
from trueangle_training.diagnosis.selection import NEAR_NATS, Families, Selection, select
from trueangle_training.effects.effect import Nature

NAMED_IN_SPITE_OF_GENERIC = 0.20
"""Share of generic patterns up to which names stand as they are."""
LEFT_TO_GENERIC = 0.10
"""Share that a choice among the library alone may leave to the best generic pattern and still be the answer."""
MOST_NAMES_WITHOUT_GENERIC = 2
NARROW = 4
"""Columns of a pattern: an order that drifts over the campaign has four."""


class Way(Enum):
    """Among which patterns the members were chosen."""

    BY_EVIDENCE = "all"
    BY_NAMED_SHARE = "the library's with a curve of their own"
    WITHOUT_DRAWS = "all that are not drawn in each run"


def chosen(problem: Problem, evidence: Evidence, families: Families) -> tuple[Selection, Way]:
    """The selection, and what was set aside for it.

    A wide pattern beats an effect with several events or a slightly bent shape, be it generic or drawn anew in
    each run; where two names with a curve of their own explain nearly all, the names are the answer.
    run_to_run_eccentricity is no such name: it can imitate any order 1.
    """
    everything = np.ones(evidence.hypothesis.size, dtype=bool)
    selection = select(evidence, families, everything)
    drawn = any(evidence.drawn[each.block] for each in selection.accepted)
    if _generic_share(families, selection) <= NAMED_IN_SPITE_OF_GENERIC and not drawn:
        return selection, Way.BY_EVIDENCE
    wide = families.generic[families.of_block] | evidence.drawn
    named = select(evidence, families, ~wide)
    effects = {problem.hypotheses[evidence.hypothesis[each.block]].effect for each in named.accepted}
    few = 0 < len(effects) <= MOST_NAMES_WITHOUT_GENERIC
    undrawn = select(evidence, families, ~evidence.drawn) if drawn else selection
    nearly_all = few and left_to(evidence, families, named, wide) < LEFT_TO_GENERIC
    several = len(effects) > 1 and _is_one_pattern(problem, evidence, families, undrawn, named)
    if nearly_all and not several and not _plainly_better(evidence, families, undrawn, named):
        return named, Way.BY_NAMED_SHARE
    if any(_is_orderly(problem, evidence, selection, each) for each in selection.accepted):
        return undrawn, Way.WITHOUT_DRAWS
    return selection, Way.BY_EVIDENCE


def _plainly_better(evidence: Evidence, families: Families, selection: Selection, named: Selection) -> bool:
    """Whether a narrow generic pattern explains the errors better than the names do, and not in other words.

    A wide one wins by its width; a narrow one only by being nearer to the truth.
    """
    if _judged(evidence, families, selection) <= _judged(evidence, families, named) + NEAR_NATS:
        return False
    found = fit(evidence, selection.accepted)
    name = named.accepted[0].block
    mains = evidence.column_range(name)[: evidence.mains[name]]
    of_name = evidence.product(name)[: evidence.mains[name]]
    for each in selection.accepted:
        narrow = evidence.mains[each.block] <= NARROW and not evidence.drawn[each.block]
        if not families.generic[families.of_block[each.block]] or not narrow:
            continue
        own = evidence.column_range(each.block)
        coefficients = found.coefficients[np.isin(found.columns, own)]
        energy = float(coefficients @ evidence.product(each.block)[:, own] @ coefficients)
        shared = of_name[:, own] @ coefficients
        carried = float(shared @ np.linalg.lstsq(of_name[:, mains], shared, rcond=1e-9)[0])
        if len(named.accepted) > 1 or carried < CARRIED * energy:
            return True
    return False


def _is_one_pattern(
    problem: Problem, evidence: Evidence, families: Families, selection: Selection, named: Selection
) -> bool:
    """Whether several names stand for what is one generic pattern with a curve of its own, and no less likely.

    Sums of patterns that are constant over the faces are such: nobody can tell which two a pattern is the sum of.
    """
    if len(selection.accepted) != 1:
        return False
    pattern = problem.hypotheses[evidence.hypothesis[selection.accepted[0].block]]
    if pattern.effect is not None or pattern.nature is not Nature.MEAN:
        return False
    return _judged(evidence, families, selection) >= _judged(evidence, families, named) - NEAR_NATS


def _judged(evidence: Evidence, families: Families, selection: Selection) -> float:
    """Log evidence of a whole selection, penalties taken off."""
    penalty = sum(float(families.penalty[families.of_block[each.block]]) for each in selection.accepted)
    return joint_log_evidence(evidence, selection.accepted) - penalty


def _is_orderly(problem: Problem, evidence: Evidence, selection: Selection, member: Accepted) -> bool:
    """Whether an effect drawn in each run follows the runs' conditions, and so is not drawn."""
    hypothesis = int(evidence.hypothesis[member.block])
    if not evidence.drawn[member.block] or problem.hypotheses[hypothesis].effect is None:
        return False
    found = fit(evidence, selection.accepted)
    own = evidence.column_range(member.block)
    coefficients = found.coefficients[np.isin(found.columns, own)] * evidence.scale[own]
    return are_no_draws(problem.conditions, problem.curve(hypothesis, coefficients))


def _generic_share(families: Families, selection: Selection) -> float:
    return sum(
        share
        for each, share in zip(selection.accepted, selection.share, strict=True)
        if families.generic[families.of_block[each.block]]
    )


def left_to(evidence: Evidence, families: Families, selection: Selection, rivals: NDArray[np.bool_]) -> float:
    """Share of all explained energy that the best of the rivals ([blocks]) takes beside the selection."""
    found = scores(evidence, selection.accepted)
    log_evidence = np.where(rivals, found.log_evidence, -np.inf)
    if not np.isfinite(log_evidence).any():
        return 0.0
    block = int(np.argmax(log_evidence - families.penalty[families.of_block]))
    with_it = [*selection.accepted, Accepted(block=block, tau=float(found.tau[block]))]
    whole = float(evidence.error @ evidence.error)
    before, after = float(fit(evidence, selection.accepted).energy_left), float(fit(evidence, with_it).energy_left)
    return max(0.0, (before - after) / max(whole - after, 1e-12))
