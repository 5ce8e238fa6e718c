"""One campaign in, findings out: the order in which the questions are asked.

The plan is judged before any error is looked at, the file before any physics, re-calibration before structure.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.document import structure
from trueangle.contract.joint import Joint
from trueangle_training.diagnosis import verdict as which
from trueangle_training.diagnosis.attribution import Attribution, attribute
from trueangle_training.diagnosis.closure import Closure, closure_of
from trueangle_training.diagnosis.constancy import drifting
from trueangle_training.diagnosis.curve_checks import other_joint_faults
from trueangle_training.diagnosis.curves import Curves
from trueangle_training.diagnosis.data_checks import DataChecks, data_checks
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.end_task import compensation_of, end_task
from trueangle_training.diagnosis.findings import (
    Cause,
    Estimate,
    Findings,
    Gap,
    Place,
    PlanSight,
    Unexplained,
    conclusion_of,
)
from trueangle_training.diagnosis.found_effect import found_effect
from trueangle_training.diagnosis.found_parts import found_parts
from trueangle_training.diagnosis.joint_update import FoundShape, JointUpdate, growth_settings, joint_update
from trueangle_training.diagnosis.location import where
from trueangle_training.diagnosis.next_measurement import next_measurement
from trueangle_training.diagnosis.overlooked import OVERLOOKED, more_than_noise, overlooked
from trueangle_training.diagnosis.plain_notes import disturbed_note, loud_note, one_way_note, still_said
from trueangle_training.diagnosis.plan_sight import plan_sight, subject_of
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.diagnosis.recalibration import recalibration_span
from trueangle_training.diagnosis.shares import Shares, shares_of
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature

Floats = NDArray[np.float64]

STAGES = ("data", "attribution", "shares", "places", "closure", "end task")
"""What `diagnose` reports progress over."""
SEED = 0
"""Of sign flips and bootstraps: the same file gives the same report."""
MEND_FIRST = "Mend the file, or measure again what is wrong in it; then diagnose again."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A campaign laid out and its plan judged; its errors have not been looked at."""

    campaign: Campaign
    joint: Joint
    library: Mapping[str, LibraryEffect]
    problem: Problem
    design: Design
    sight: PlanSight


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """The answer and what is needed to show and to use it."""

    findings: Findings
    sight: PlanSight
    library: Mapping[str, LibraryEffect]
    problem: Problem
    attribution: Attribution | None = None
    """None: the file is faulty or the plan blind."""
    causes: tuple[which.Cause, ...] = ()
    """As the attribution gave them, in the order of the findings."""
    curves: Curves | None = None


def prepare(campaign: Campaign, joint: Joint, *, library: Mapping[str, LibraryEffect] = EFFECTS) -> Prepared:
    """Judge the plan; ContractError where JOINT.yaml's effects contradict themselves or the campaign's columns."""
    # The scatter that the simulator has is not looked for again; effects of the mean are re-calibrated instead.
    modelled = {name for name in joint.effects if name in library and library[name].nature is Nature.VARIANCE}
    library = {name: effect for name, effect in library.items() if name not in modelled}
    problem = problem_of(campaign, joint, library=library)
    design = design_check(problem.without_errors())
    sight = plan_sight(
        design,
        subject_of(campaign, joint),
        library,
        next_measurement=next_measurement(problem, _without_modelled(design, joint)).text,
        notes=(*problem.notes, *_angle_only_note(problem), *one_way_note(problem)),
    )
    return Prepared(campaign=campaign, joint=joint, library=library, problem=problem, design=design, sight=sight)


def _without_modelled(design: Design, joint: Joint) -> Design:
    """What the simulator models is calibrated: nobody needs to measure in order to see it."""
    hidden = tuple(name for name in design.invisible if name not in joint.effects)
    return replace(
        design,
        invisible=hidden,
        not_testable=tuple(name for name in design.not_testable if name not in joint.effects),
    )


def _angle_only_note(problem: Problem) -> tuple[str, ...]:
    if problem.conditions.temperature_c is not None:
        return ()
    note = (
        "no temperatures in the campaign: everything here is of the angle only; what follows temperature shows as"
    )
    return (f"{note} a change from run to run",)


def diagnose(prepared: Prepared, *, progress: Callable[[int], None] = lambda done: None) -> Diagnosis:
    """All findings. `progress` is told how many of the `STAGES` are done."""
    progress(0)
    checks = data_checks(prepared.campaign, prepared.joint)
    if not checks.faults and prepared.sight.testable:
        checks = replace(checks, faults=other_joint_faults(prepared.problem))
    progress(1)
    if checks.faults or not prepared.sight.testable:
        return Diagnosis(
            findings=_without_physics(prepared, checks),
            sight=prepared.sight,
            library=prepared.library,
            problem=prepared.problem,
        )
    return _with_physics(prepared, checks, progress)


def _without_physics(prepared: Prepared, checks: DataChecks) -> Findings:
    """What can still be said of a file that is faulty or of a plan that shows nothing."""
    sight = prepared.sight
    findings = _blank(prepared, checks)
    conclusion = conclusion_of(
        data_faults=checks.faults, testable=bool(sight.testable), causes=(), unexplained=findings.unexplained
    )
    if checks.faults:
        return replace(findings, conclusion=conclusion, next_measurement=MEND_FIRST)
    shares = shares_of(prepared.problem)
    if shares is not None:
        findings = replace(findings, gap=_gap(shares, Closure()), notes=(*findings.notes, *shares.notes))
    notes = (*findings.notes, still_said(prepared.problem))
    return replace(findings, conclusion=conclusion, notes=notes)


def _blank(prepared: Prepared, checks: DataChecks) -> Findings:
    sight = prepared.sight
    return Findings(
        subject=sight.subject,
        conclusion=conclusion_of(
            data_faults=checks.faults, testable=bool(sight.testable), causes=(), unexplained=Unexplained()
        ),
        data_faults=checks.faults,
        invisible=sight.invisible,
        not_testable=sight.not_testable,
        next_measurement=sight.next_measurement,
        notes=(*sight.notes, *checks.notes),
    )


def _with_physics(prepared: Prepared, checks: DataChecks, progress: Callable[[int], None]) -> Diagnosis:
    problem = prepared.problem
    attribution = attribute(problem)
    answer = which.verdict_of(problem, attribution, prepared.design)
    progress(2)
    cleaned = replace(problem, error_arcsec=attribution.cleaned_arcsec)
    found = np.column_stack([np.empty((len(problem), 0)), *(m.curve_arcsec for m in attribution.members)])
    shares = shares_of(cleaned, found=found)
    floor_arcsec2 = _floor_arcsec2(attribution, shares)
    progress(3)
    rng = np.random.default_rng(SEED)
    places = where(
        cleaned,
        floor_arcsec2=floor_arcsec2,
        rng=rng,
        found=found_parts(problem, attribution, prepared.design.spans),
    )
    places = _with_scatter(places, answer)
    progress(4)
    named = tuple(cause.effect for cause in answer.named)
    closure = closure_of(cleaned, attribution, named=named, shares=shares, rng=rng)
    progress(5)
    task, task_notes = end_task(
        cleaned,
        compensation=compensation_of(problem, named),
        floor_arcsec2=floor_arcsec2,
        found_in=(lambda fold: closure.found_in_fold[fold]) if closure.found_in_fold else None,
    )
    progress(6)
    causes = tuple(_cause(problem, attribution, closure, cause) for cause in answer.causes)
    unexplained = Unexplained(
        significant=answer.unexplained.significant,
        nearest_effect=answer.unexplained.nearest_effect,
        nearest_share=min(answer.unexplained.nearest_share, 1.0),
    )
    if answer.kind is which.VerdictKind.NONE and more_than_noise(shares, places):
        unexplained = overlooked(prepared.design, cleaned)
        closure = replace(closure, closure=0.0, interval=(0.0, 0.0), notes=(*closure.notes, OVERLOOKED))
    blank = _blank(prepared, checks)
    disturbed = disturbed_note(prepared.campaign, problem, attribution.cleaned_arcsec)
    findings = replace(
        blank,
        conclusion=conclusion_of(data_faults=checks.faults, testable=True, causes=causes, unexplained=unexplained),
        causes=causes,
        unexplained=unexplained,
        where=places,
        drifting=drifting(cleaned),
        gap=_gap(shares, closure),
        waterfall=closure.waterfall,
        end_task=task,
        next_measurement=_next_measurement(prepared, attribution, answer),
        notes=(
            *blank.notes,
            *loud_note(problem, attribution.noise),
            *disturbed,
            *(() if shares is None else shares.notes),
            *closure.notes,
            *task_notes,
        ),
    )
    return Diagnosis(
        findings=findings,
        sight=prepared.sight,
        library=prepared.library,
        problem=problem,
        attribution=attribution,
        causes=answer.causes,
        curves=_curves(cleaned, attribution),
    )


def _next_measurement(prepared: Prepared, attribution: Attribution, answer: which.Verdict) -> str:
    """For the first class of several effects; else what the plan as such asks for."""
    for cause in answer.causes:
        if len(cause.effect_class) > 1:
            found = found_effect(prepared.problem, [attribution.members[place] for place in cause.members])
            return next_measurement(prepared.problem, prepared.design, cause.effect_class, found).text
    return prepared.sight.next_measurement


def _floor_arcsec2(attribution: Attribution, shares: Shares | None) -> float:
    """Variance of one reading: over repeats where there are any, else as the attribution's noise model has it."""
    if shares is not None:
        return shares.floor.variance_arcsec2
    known = attribution.noise.run_variance[np.isfinite(attribution.noise.run_variance)]
    return float(np.mean(known)) if known.size else 1.0


def _gap(shares: Shares | None, closure: Closure) -> Gap:
    if shares is None:
        return Gap()
    explained_arcsec2 = closure.explained_arcsec2
    return Gap(
        rmse_shipped_arcsec=float(np.sqrt(shares.shipped_arcsec2)),
        rmse_recalibrated_arcsec=float(np.sqrt(shares.recalibrated_arcsec2)),
        rmse_explained_arcsec=None if explained_arcsec2 is None else float(np.sqrt(max(explained_arcsec2, 0.0))),
        floor_arcsec=float(np.sqrt(shares.floor.variance_arcsec2)),
        parametric_share=shares.parametric_share,
        structural_share=shares.structural_share,
        floor_share=shares.floor_share,
        closure=closure.closure,
        closure_interval=closure.interval,
        ceiling=closure.ceiling,
        random_control=closure.random_control,
    )


def _with_scatter(places: tuple[Place, ...], answer: which.Verdict) -> tuple[Place, ...]:
    """Where nothing but scatter is named, its cell comes first; it has all of it if nothing else was found."""
    nameless = answer.unexplained.cells
    if nameless and all(cell.moment == "variance" for cell in nameless) and not answer.named:
        first = [Place(cell=cell, share=0.0, p_value=None, significant=True) for cell in nameless]
        return (*first, *(place for place in places if place.cell not in nameless))
    if not answer.named or any(cause.nature is not Nature.VARIANCE for cause in answer.named):
        return places
    cells = {cell for cause in answer.named for cell in EFFECTS[cause.effect].cells}
    there = [place for place in places if place.cell in cells]
    significant = [place for place in there if place.significant]
    chosen = (significant or there or [_place_of(answer.named[0].effect)])[0]
    others = (place for place in places if place.cell != chosen.cell)
    if len(answer.named) < len(answer.causes) or answer.unexplained.significant:
        # What was found besides has no name, and keeps its places behind.
        return (replace(chosen, share=0.0, significant=True), *others)
    first = replace(chosen, share=1.0, significant=True)
    return (first, *(replace(place, share=0.0, could_carry=0.0) for place in others))


def _place_of(effect: str) -> Place:
    return Place(cell=EFFECTS[effect].cells[0], share=1.0, p_value=None, significant=True, runs_needed=None)


def _shapes(problem: Problem, attribution: Attribution, cause: which.Cause) -> list[Hypothesis]:
    return [problem.hypotheses[attribution.members[place].hypothesis_index] for place in cause.members]


def _cause(problem: Problem, attribution: Attribution, closure: Closure, cause: which.Cause) -> Cause:
    shapes = _shapes(problem, attribution, cause)
    return Cause(
        effect=cause.effect,
        probability=cause.probability,
        members=cause.effect_class,
        class_probability=cause.class_probability,
        kind=cause.nature,
        parameters={
            name: Estimate(value=each.value, standard_uncertainty=each.standard_uncertainty)
            for name, each in cause.parameters.items()
        },
        closes=(closure.closes or {}).get(cause.effect),
        closes_interval=(closure.closes_interval or {}).get(cause.effect),
        label="; ".join(dict.fromkeys(shape.label for shape in shapes if shape.label)),
        cell=shapes[0].cell if shapes else None,
    )


def _curves(cleaned: Problem, attribution: Attribution) -> Curves:
    span = recalibration_span(cleaned)
    explained = attribution.explained(cleaned)
    return Curves(
        angle_deg=cleaned.conditions.angle_deg,
        run=cleaned.conditions.run,
        recalibrated_arcsec=span.outside(cleaned.error_arcsec),
        explained_arcsec=span.outside(cleaned.error_arcsec - explained),
        temperature_c=cleaned.conditions.temperature_c,
        direction=cleaned.conditions.direction,
    )


def update_of(diagnosis: Diagnosis) -> JointUpdate | None:
    """The joint with the named causes added and its parameters re-calibrated; None: nothing was fitted."""
    attribution, problem = diagnosis.attribution, diagnosis.problem
    if attribution is None:
        return None
    drift = problem.drift.shape[1]
    coefficients = attribution.modelled_coefficients[drift:] - _carried_for_others(problem)[drift:]
    names = np.array(problem.modelled_effects)
    modelled = {name: coefficients[names == name] for name in dict.fromkeys(problem.modelled_effects)}
    found: list[FoundShape] = []
    for cause in diagnosis.causes:
        if cause.class_probability < which.NAMED_FROM:
            continue
        for place in cause.members:
            member = attribution.members[place]
            shape = problem.hypotheses[member.hypothesis_index]
            mains = shape.main.shape[1]
            found.append(
                FoundShape(
                    hypothesis=shape, coefficients=member.coefficients[:mains], curve_arcsec=member.curve_arcsec
                )
            )
    return joint_update(
        problem.joint,
        problem.conditions,
        EFFECTS,
        modelled=modelled,
        found=found,
        scatter=_scatter_settings(diagnosis),
    )


def _carried_for_others(problem: Problem) -> Floats:
    """What drift and modelled columns carry of effects that keep their settings, which would count twice.

    A campaign at one temperature does not re-calibrate the drift with temperature, but its errors hold it.
    """
    kept = np.zeros(len(problem))
    for name, node in problem.joint.effects.items():
        if name not in problem.modelled_effects:
            settings = structure(EFFECTS[name].settings, node)
            kept = kept + settings.error_arcsec(problem.conditions, problem.joint, None)
    offsets = problem.offsets().shape[1]
    carried: Floats = np.linalg.lstsq(problem.nuisance(), kept, rcond=1e-8)[0].astype(np.float64)
    return carried[offsets:]


def _scatter_settings(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """Of the named causes that change the scatter and not the mean."""
    found: dict[str, dict[str, Any]] = {}
    for cause in diagnosis.causes:
        if cause.class_probability < which.NAMED_FROM or cause.nature is not Nature.VARIANCE:
            continue
        if cause.growth is not None:
            floor_arcsec = diagnosis.findings.gap.floor_arcsec or 0.0
            conditions = diagnosis.problem.conditions
            found[cause.effect] = growth_settings(cause.growth, conditions, scatter_arcsec=floor_arcsec)
        elif "counts_per_rev" in cause.parameters:
            found[cause.effect] = {"counts_per_rev": round(cause.parameters["counts_per_rev"].value)}
    return found
