"""Whether two names are one pattern over the turn, with a course in temperature or time that neither of them has.

Two effects of one order have a phase each, and any difference between the two is as likely as any other. The parts
of one pattern that grows, settles or steps have the same phase. With the difference d of the phases, half a turn
left out, and its standard deviation s

    B = p(d | one pattern) / p(d | two effects) = pi N(d; 0, s),

N wrapped to a period of pi, and two effects have the probability 1 / (1 + q B), with odds of q : 1 for one pattern
beforehand.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.attribution import Attribution, Member
from trueangle_training.diagnosis.containment import Spans
from trueangle_training.diagnosis.design_check import CARRIED
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]

ONE_PATTERN_ODDS = 0.5
"""Of one pattern with a course of its own against two effects of one order, before the phases are seen."""
MOST_OF_PATTERN = 0.8
"""Of what is lost without either name."""
PHASE_ERROR = 0.05
"""Radians by which the parts of one pattern differ because no shape is exact."""
_WRAPS = np.pi * np.arange(-2, 3)


def kept_of_names(problem: Problem, attribution: Attribution, spans: Spans) -> dict[str, float]:
    """By name, the factor on its probability that such a pattern leaves; names without doubt are left out.

    A name that could carry all of the pattern, or is by far the larger part of it, is the answer to it: only the
    other one is doubted, which then is what the first one's shape is off by.
    """
    kept: dict[str, float] = {}
    for one, other in combinations(attribution.members, 2):
        if not _of_one_order(problem, one, other):
            continue
        both = 1.0 / (1.0 + ONE_PATTERN_ODDS * in_phase(one, other))
        for member in (one, other):
            most = member.share >= MOST_OF_PATTERN * (one.share + other.share)
            if most or _carries(problem, spans, member, one.curve_arcsec + other.curve_arcsec):
                continue
            name = str(member.effect)
            kept[name] = min(kept.get(name, 1.0), both)
    return kept


def in_phase(one: Member, other: Member) -> float:
    """B of two members with a cosine and a sine each."""
    first, second = one.coefficients[:2], other.coefficients[:2]
    difference = float(np.arctan2(second[1], second[0]) - np.arctan2(first[1], first[0]))
    difference = (difference + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    variance = PHASE_ERROR**2 + _phase_variance(one) + _phase_variance(other)
    density = np.exp(-0.5 * (difference + _WRAPS) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
    return float(np.pi * np.sum(density))


def _phase_variance(member: Member) -> float:
    a = member.coefficients[:2]
    across = np.array([-a[1], a[0]]) / float(a @ a)
    return float(across @ member.covariance[:2, :2] @ across)


def _of_one_order(problem: Problem, one: Member, other: Member) -> bool:
    """Both named, of two names, each a cosine and a sine of the same order that comes again in each run."""
    if one.effect is None or other.effect is None or one.effect == other.effect:
        return False
    shapes = [problem.hypotheses[member.hypothesis_index] for member in (one, other)]
    if any(each.nature is not Nature.MEAN or each.main.shape[1] != 2 for each in shapes):
        return False
    return shapes[0].cell.order == shapes[1].cell.order and shapes[0].cell.order.isdecimal()


def _carries(problem: Problem, spans: Spans, member: Member, curve: Floats) -> bool:
    columns = problem.hypotheses[member.hypothesis_index].main
    return spans.carried_by(columns, curve) >= CARRIED
