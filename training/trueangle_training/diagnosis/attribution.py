"""Which effects explain what re-calibration leaves: cleaning, noise, evidence and selection, twice over.

The second pass estimates cleaning and noise anew with the found part as mean, so that an effect that was taken for
noise at first, or noise for an effect, is seen for what it is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.choice import Way, chosen, left_to
from trueangle_training.diagnosis.cleaning import Cleaned, Dictionary, clean, wide_dictionary
from trueangle_training.diagnosis.evidence import (
    Accepted,
    Evidence,
    evidence_of,
    fit,
    scores,
    stacked_columns,
)
from trueangle_training.diagnosis.noise import NoiseModel, estimate_noise, run_kinds
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.selection import (
    Families,
    Selection,
    families_of,
    family_evidence,
)
from trueangle_training.diagnosis.spectra import RunTransform, run_transform

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Member:
    """One shape that is part of the explanation."""

    effect: str | None
    """None: a generic pattern."""
    hypothesis_index: int
    """In `Problem.hypotheses`."""
    coefficients: Floats
    """Main then wiggle, in the hypothesis's own units."""
    covariance: Floats
    log_evidence: float
    """Given the other members, penalty taken off."""
    share: float
    """What is lost of the explained energy when it is removed, 0 to 1."""
    curve_arcsec: Floats
    """[readings], as the shape has it: what an offset could take up is still in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A family and how well it would do instead of the first member (or at all, where there is none)."""

    effect: str | None
    family: str
    log_evidence: float
    hypothesis_index: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attribution:
    """What explains the errors, and all that the verdict is based on."""

    members: tuple[Member, ...]
    """Ordered by share."""
    modelled_coefficients: Floats
    """Of drift and modelled columns, re-calibrated together with the members."""
    noise: NoiseModel
    cleaned_arcsec: Floats
    """[readings]: errors with wild readings brought back to their neighbours."""
    outlier_rows: Integers
    """Readings that were replaced."""
    candidates: tuple[Candidate, ...]
    """All families given all members but the first, best first."""
    rivals: tuple[tuple[Candidate, ...], ...]
    """Of each member, all families given the other members, best first."""
    by_named_share: bool
    """The library alone explains so much that generic patterns were set aside."""
    draws_set_aside: bool
    """Patterns drawn in each run were set aside: what they could carry follows the conditions of the runs."""
    left_to_generic: float
    """Share that the best generic pattern would take beside the members."""
    residual_energy: float
    """Mean square of the whitened residual; 1 where noise is all that is left."""
    explained_energy: float
    """Whitened energy of the explained part: twice the nats a perfect shape would win."""

    def predict(self, problem: Problem) -> Floats:
        """[readings] of `problem` (same hypotheses, any rows): modelled effects and members, without offsets."""
        return self.modelled(problem) + self.explained(problem)

    def modelled(self, problem: Problem) -> Floats:
        """[readings]: the re-calibrated part alone."""
        return np.column_stack([problem.drift, problem.modelled]) @ self.modelled_coefficients

    def explained(self, problem: Problem) -> Floats:
        """[readings]: the members alone."""
        total = np.zeros(len(problem))
        for member in self.members:
            total += problem.curve(member.hypothesis_index, member.coefficients)
        return total


def attribute(problem: Problem) -> Attribution:
    """Explain the errors of a problem."""
    state = _State.of(problem)
    evidence, families, noise, cleaned = state.weighed(problem, None)
    selection, way = chosen(problem, evidence, families)
    if selection.accepted:
        mean = np.sum(_curves(problem, evidence, selection), axis=0)
        evidence, families, noise, cleaned = state.weighed(problem, mean)
        selection, way = chosen(problem, evidence, families)
    return _attribution(problem, evidence, families, selection, noise, cleaned, way)


def weighed_evidence(problem: Problem) -> tuple[Evidence, Families, NoiseModel]:
    """All hypotheses weighed once, before anything is accepted."""
    evidence, families, noise, _ = _State.of(problem).weighed(problem, None)
    return evidence, families, noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    """What both passes share."""

    dictionary: Dictionary
    kinds: Integers
    scale_group: Integers
    transform: RunTransform
    transformed: NDArray[np.floating]
    """[all columns, rows] of all hypotheses, in the run-wise cosine transform."""

    @staticmethod
    def of(problem: Problem) -> "_State":
        transform = run_transform(problem.conditions.run, problem.conditions.time_s)
        kinds = run_kinds(problem.conditions, transform)
        return _State(
            dictionary=wide_dictionary(problem),
            kinds=kinds,
            scale_group=kinds[transform.run_index],
            transform=transform,
            transformed=transform.of_stacked(stacked_columns(problem)),
        )

    def weighed(
        self, problem: Problem, mean_arcsec: Floats | None
    ) -> tuple[Evidence, Families, NoiseModel, Cleaned]:
        """Clean and estimate the noise about a mean, then weigh all hypotheses on the cleaned errors."""
        cleaned = clean(problem, self.dictionary, scale_group=self.scale_group, mean_arcsec=mean_arcsec)
        about = cleaned.error_arcsec if mean_arcsec is None else cleaned.error_arcsec - mean_arcsec
        noise = estimate_noise(
            about,
            self.dictionary.whole,
            self.transform,
            self.kinds,
            problem.conditions,
            # What a first pass has found is taken off: what is left at the slowest cosines of the runs is noise.
            shared=None if mean_arcsec is None else self.dictionary.shared,
        )
        evidence = evidence_of(problem, noise, cleaned.error_arcsec, self.transformed)
        return evidence, families_of(evidence, problem.hypotheses), noise, cleaned


def _curves(problem: Problem, evidence: Evidence, selection: Selection) -> list[Floats]:
    """[readings] of each accepted block."""
    found = fit(evidence, selection.accepted)
    curves: list[Floats] = []
    at = 0
    for each in selection.accepted:
        width = int(evidence.width[each.block])
        coefficients = found.coefficients[at : at + width] * evidence.scale[evidence.column_range(each.block)]
        curves.append(problem.curve(int(evidence.hypothesis[each.block]), coefficients))
        at += width
    return curves


def _attribution(
    problem: Problem,
    evidence: Evidence,
    families: Families,
    selection: Selection,
    noise: NoiseModel,
    cleaned: Cleaned,
    way: Way,
) -> Attribution:
    found = fit(evidence, selection.accepted)
    members: list[Member] = []
    at = 0
    for each, log_evidence, share in zip(selection.accepted, selection.log_evidence, selection.share, strict=True):
        width = int(evidence.width[each.block])
        scale = evidence.scale[evidence.column_range(each.block)]
        here = slice(at, at + width)
        index = int(evidence.hypothesis[each.block])
        coefficients = found.coefficients[here] * scale
        members.append(
            Member(
                effect=problem.hypotheses[index].effect,
                hypothesis_index=index,
                coefficients=coefficients,
                covariance=found.covariance[here, here] * np.outer(scale, scale),
                log_evidence=log_evidence,
                share=min(max(share, 0.0), 1.0),
                curve_arcsec=problem.curve(index, coefficients),
            )
        )
        at += width
    rivals = tuple(
        _candidates(problem, evidence, families, [a for a in selection.accepted if a is not each])
        for each in selection.accepted
    )
    whole = float(evidence.error @ evidence.error)
    left = float(found.energy_left)
    freedom = max(1, len(problem) - evidence.nuisance.shape[0])
    explained = sum((m.curve_arcsec for m in members), np.zeros(len(problem)))
    return Attribution(
        members=tuple(members),
        modelled_coefficients=_recalibrated(problem, noise, cleaned.error_arcsec - explained),
        noise=noise,
        cleaned_arcsec=cleaned.error_arcsec,
        outlier_rows=np.flatnonzero(cleaned.replaced),
        candidates=rivals[0] if rivals else _candidates(problem, evidence, families, []),
        rivals=rivals,
        by_named_share=way is Way.BY_NAMED_SHARE,
        draws_set_aside=way is not Way.BY_EVIDENCE,
        left_to_generic=(
            left_to(evidence, families, selection, families.generic[families.of_block])
            if selection.accepted
            else 0.0
        ),
        residual_energy=left / freedom,
        explained_energy=whole - left,
    )


def _candidates(
    problem: Problem, evidence: Evidence, families: Families, accepted: list[Accepted]
) -> tuple[Candidate, ...]:
    log_evidence = scores(evidence, accepted).log_evidence
    by_family = family_evidence(log_evidence, families)
    found: list[Candidate] = []
    for family in np.argsort(-by_family):
        blocks = np.flatnonzero(families.of_block == family)
        index = int(evidence.hypothesis[blocks[np.argmax(log_evidence[blocks])]])
        found.append(
            Candidate(
                effect=problem.hypotheses[index].effect,
                family=families.names[family],
                log_evidence=float(by_family[family]),
                hypothesis_index=index,
            )
        )
    return tuple(found)


def _recalibrated(problem: Problem, noise: NoiseModel, error_arcsec: Floats) -> Floats:
    """Coefficients of drift and modelled columns by generalised least squares, offsets free."""
    offsets = problem.offsets().shape[1]
    design = noise.whiten(problem.nuisance())
    # Offsets and modelled columns may share a direction: the shortest of all equal solutions is taken.
    solution = np.linalg.lstsq(design, noise.whiten(error_arcsec), rcond=1e-8)[0]
    return np.asarray(solution[offsets:], dtype=np.float64)
