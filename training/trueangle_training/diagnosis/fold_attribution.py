"""What would have been found without some runs: selection and fit again, on the noise that is known already.

The noise of all runs, found by the full attribution, is kept: it is no choice among effects, and finding it anew
costs more than all the rest.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.attribution import Attribution
from trueangle_training.diagnosis.evidence import evidence_of, fit, stacked_columns
from trueangle_training.diagnosis.noise import NoiseModel
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.selection import families_of, select
from trueangle_training.diagnosis.spectra import run_transform
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

RIVAL_FAMILIES = 10
RIVAL_FAMILIES_OF_MANY = 4
MANY_READINGS = 2_000
DRAWN = (Nature.RANDOM, Nature.EVENT)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundShape:
    """A shape of the library with its coefficients."""

    effect: str
    hypothesis_index: int
    """In the problem's hypotheses."""
    coefficients: Floats
    """Main then wiggle."""
    drawn: bool
    """Drawn anew in each run."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Competition:
    """What competes inside every fold, made ready once."""

    problem: Problem
    """With the families that did best on all readings, and all members' own; others are no rivals."""
    attribution: Attribution
    transformed: NDArray[np.floating]
    """[all columns, readings]: in the cosine transform of each run, where a run left out is a row left out."""


def competition(problem: Problem, attribution: Attribution) -> Competition:
    """`problem.error_arcsec` is cleaned."""
    count = RIVAL_FAMILIES if len(problem) < MANY_READINGS else RIVAL_FAMILIES_OF_MANY
    indices = {member.hypothesis_index for member in attribution.members}
    for rivals in (attribution.candidates, *attribution.rivals):
        indices |= {candidate.hypothesis_index for candidate in rivals[:count]}
    keys = {_family(problem, index) for index in indices}
    shapes = tuple(each for i, each in enumerate(problem.hypotheses) if _family(problem, i) in keys)
    pruned = replace(problem, hypotheses=shapes)
    return Competition(
        problem=pruned,
        attribution=attribution,
        transformed=attribution.noise.transform.of_stacked(stacked_columns(pruned)),
    )


def _family(problem: Problem, index: int) -> tuple[str | None, str]:
    shape = problem.hypotheses[index]
    return shape.effect, shape.family


def found_without(rivals: Competition, out: Mask) -> tuple[FoundShape, ...]:
    """Library shapes that the readings outside `out` ([readings]) select.

    Where the full attribution set generic patterns aside, so does this one.
    """
    inside = ~out
    problem, attribution = rivals.problem, rivals.attribution
    # Of the shapes only the numbers of columns are asked below: they need not be cut to the rows.
    part = replace(replace(problem, hypotheses=()).rows(inside), hypotheses=problem.hypotheses)
    noise = noise_of_rows(attribution.noise, part.conditions.run, part.conditions.time_s, inside)
    run = problem.conditions.run
    if np.isin(run[out], run[inside]).any():
        cut = problem.rows(inside)
        transformed = noise.transform.of_stacked(stacked_columns(cut))
    else:
        transformed = np.compress(inside, rivals.transformed, axis=1)
    evidence = evidence_of(part, noise, part.error_arcsec, transformed)
    if evidence.hypothesis.size == 0:
        return ()
    families = families_of(evidence, part.hypotheses)
    allowed = np.ones(evidence.hypothesis.size, dtype=bool)
    if attribution.by_named_share:
        allowed = ~families.generic[families.of_block]
    accepted = select(evidence, families, allowed).accepted
    fitted = fit(evidence, accepted)
    shapes: list[FoundShape] = []
    at = 0
    for each in accepted:
        width = int(evidence.width[each.block])
        index = int(evidence.hypothesis[each.block])
        coefficients = fitted.coefficients[at : at + width] * evidence.scale[evidence.column_range(each.block)]
        at += width
        effect = problem.hypotheses[index].effect
        if effect is not None:
            drawn = problem.hypotheses[index].nature in DRAWN
            shapes.append(
                FoundShape(effect=effect, hypothesis_index=index, coefficients=coefficients, drawn=drawn)
            )
    return tuple(shapes)


def noise_of_rows(noise: NoiseModel, run: Integers, time_s: Floats | None, inside: Mask) -> NoiseModel:
    """The noise model of the readings inside, whose runs and times are given; whole runs are left out."""
    kept = inside[noise.offset_rows]
    offset_rows = (np.cumsum(inside) - 1)[noise.offset_rows[kept]].astype(np.int64)
    offset_root = noise.offset_root
    if offset_rows.size:
        # The covariance of the means that are left is a part of that of all.
        covariance = np.linalg.inv(offset_root.T @ offset_root)[np.ix_(kept, kept)]
        offset_root = np.linalg.inv(np.linalg.cholesky(covariance))
    return replace(
        noise,
        transform=run_transform(run, time_s),
        variance=noise.variance[inside],
        offset_rows=offset_rows,
        offset_root=offset_root if offset_rows.size else np.zeros((0, 0)),
    )
