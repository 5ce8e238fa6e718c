"""The only place that knows how the diagnosis is called; its answers come back in the form of report.json."""

import json
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.joint import Joint
from trueangle_training.diagnosis.attribution import Attribution, attribute
from trueangle_training.diagnosis.data_checks import data_checks
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.diagnose import diagnose, prepare
from trueangle_training.diagnosis.findings_json import report_plain
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.diagnosis.verdict import Cause, Verdict, verdict_of
from trueangle_training.documents import load_joint
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.effect import LibraryEffect
from trueangle_training.plant.cases import Case
from trueangle_training.plant.defect import CellTruth

Floats = NDArray[np.float64]
Json = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What the diagnosis said of one case."""

    report: Json
    """As report.json; keys that the way of asking does not give are missing."""
    visible: dict[str, float]
    """Visible fraction of each effect as the design check predicts it."""
    true_closure: float | None
    """Part of the true structure's visible energy that the explanation takes away; None: not known."""
    seconds: float
    """Processor time of the diagnosis alone."""


Ask = Callable[[Case], Answer]


def ask_attribution(case: Case) -> Answer:
    """Data checks, design check, attribution and verdict, in this process: no closure, no map, no end task."""
    campaign, joint = _loaded(case)
    started = time.process_time()
    faults = data_checks(campaign, joint).faults
    problem = problem_of(campaign, joint, library=library_for(case))
    design = design_check(problem.without_errors())
    if faults:
        kinds = [{"kind": fault.kind, "rows": [], "text": fault.text} for fault in faults]
        report: Json = {"verdict": "data_fault", "data_faults": kinds, "causes": [], "where": []}
        return Answer(
            report=report,
            visible=dict(design.visible),
            true_closure=None,
            seconds=time.process_time() - started,
        )
    attribution = attribute(problem)
    verdict = verdict_of(problem, attribution, design)
    seconds = time.process_time() - started
    return Answer(
        report=_report(problem, attribution, verdict, design),
        visible=dict(design.visible),
        true_closure=_true_closure(problem, attribution, case),
        seconds=seconds,
    )


def ask_report(case: Case) -> Answer:
    """All that report.json holds, in this process."""
    campaign, joint = _loaded(case)
    started = time.process_time()
    prepared = prepare(campaign, joint, library=library_for(case))
    diagnosis = diagnose(prepared)
    report = report_plain(diagnosis.findings)
    seconds = time.process_time() - started
    attribution, closure = diagnosis.attribution, None
    if attribution is not None:
        report["evidence"] = _evidence(diagnosis.problem, attribution)
        closure = _true_closure(diagnosis.problem, attribution, case)
    return Answer(report=report, visible=dict(prepared.design.visible), true_closure=closure, seconds=seconds)


def ask_command(case: Case) -> Answer:
    """`trueangle diagnose` and the files that it writes, without HTML; nothing is withheld from it."""
    # The command brings the plots with it, which the other ways never need.
    from trueangle_training.cli import main

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        _loaded(case, place)
        started = time.process_time()
        command = ["diagnose", str(place / "measured.csv"), "--joint", str(place / "joint.yaml")]
        code = main([*command, "--out", str(place / "out"), "--no-html"])
        seconds = time.process_time() - started
        if code != 0:
            raise RuntimeError(f"trueangle diagnose: expected exit code 0, got {code}")
        report = json.loads((place / "out" / "report.json").read_text("utf-8"))
        design = json.loads((place / "out" / "design.json").read_text("utf-8"))
    visible = {each["effect"]: each["visible_fraction"] or 0.0 for each in design["effects"]}
    return Answer(report=report, visible=visible, true_closure=None, seconds=seconds)


WAYS: dict[str, Ask] = {"attribution": ask_attribution, "report": ask_report, "command": ask_command}


def library_for(case: Case) -> Mapping[str, LibraryEffect]:
    """All effects; of a withheld one, all but this."""
    if case.truth.stratum != "withheld":
        return EFFECTS
    gone = {effect.name for effect in case.truth.effects}
    return {name: effect for name, effect in EFFECTS.items() if name not in gone}


def _loaded(case: Case, folder: Path | None = None) -> tuple[Campaign, Joint]:
    data = case.measured_csv.encode()
    with tempfile.TemporaryDirectory() as own:
        place = Path(own) if folder is None else folder
        (place / "measured.csv").write_bytes(data)
        (place / "joint.yaml").write_text(case.joint_yaml, "utf-8")
        return read_campaign(data, source="measured.csv"), load_joint(place / "joint.yaml")


def _report(problem: Problem, attribution: Attribution, verdict: Verdict, design: Design) -> Json:
    places = sorted(attribution.members, key=lambda member: -member.share)
    where = [
        {"cell": asdict(problem.hypotheses[member.hypothesis_index].cell), "share": member.share}
        for member in places
    ]
    return {
        "verdict": verdict.kind.value,
        "unexplained": {
            "significant": verdict.unexplained.significant,
            "nearest_effect": verdict.unexplained.nearest_effect,
            "nearest_share": verdict.unexplained.nearest_share,
        },
        "data_faults": [],
        "causes": [_cause(cause) for cause in verdict.causes],
        "where": [*where, *(_scatter(cause) for cause in verdict.causes if cause.growth is not None)],
        "invisible": list(design.invisible),
        "not_testable": list(design.not_testable),
        "evidence": _evidence(problem, attribution),
        "outliers": int(attribution.outlier_rows.size),
    }


def _evidence(problem: Problem, attribution: Attribution) -> list[Json]:
    return [
        {
            "effect": member.effect,
            "label": problem.hypotheses[member.hypothesis_index].label,
            "log_evidence": round(member.log_evidence, 2),
            "share": round(member.share, 3),
        }
        for member in attribution.members
    ]


def _cause(cause: Cause) -> Json:
    return {
        "effect": cause.effect,
        "probability": cause.probability,
        "class": list(cause.effect_class),
        "class_probability": cause.class_probability,
        "kind": cause.nature.value,
        "closes": None,
    }


def _scatter(cause: Cause) -> Json:
    """The cell of a noise that grows."""
    condition = "" if cause.growth is None else cause.growth.condition
    axis = next(name for name in ("temperature", "speed", "load") if condition.startswith(name))
    return {"cell": asdict(CellTruth(order="0", moment="variance", **{axis: "linear"})), "share": cause.share}


def _true_closure(problem: Problem, attribution: Attribution, case: Case) -> float | None:
    """1 - |(f - found) outside the re-calibratable span|^2 / |f outside it|^2, f the true structure."""
    truth = case.truth.structure_arcsec
    if truth.size != len(problem) or not truth.any():
        return None
    nuisance = problem.nuisance()
    basis, values, _ = np.linalg.svd(nuisance / np.linalg.norm(nuisance, axis=0).clip(1e-300), full_matrices=False)
    basis = basis[:, values > 1e-9 * values[0]]
    left = truth - attribution.explained(problem)
    seen, rest = (each - basis @ (basis.T @ each) for each in (truth, left))
    return 1.0 - float(rest @ rest) / float(seen @ seen)
