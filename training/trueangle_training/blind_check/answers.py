"""The only place that knows how the diagnosis is called: two texts in, an answer of plain values out."""

import datetime
import json
import tempfile
import time
from collections.abc import Collection, Mapping
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
from trueangle_training.diagnosis.diagnose import Diagnosis, diagnose, prepare
from trueangle_training.diagnosis.findings_json import report_json, report_plain
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.diagnosis.verdict import Cause, Verdict, verdict_of
from trueangle_training.documents import load_joint
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.effect import LibraryEffect

Floats = NDArray[np.float64]
Json = dict[str, Any]

CURVE_DECIMALS = 4
"""Of the explanation in arcsec: a tenth of a milliarcsecond."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """All that the diagnosis is told of a case."""

    measured_csv: str
    joint_yaml: str
    without: tuple[str, ...] = ()
    """Effects that the library shall lack."""
    quick: bool = False
    """No map, no closure, no end task."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What the diagnosis said of one case."""

    report: Json
    """As report.json, with the evidence beside it; the quick way leaves keys out."""
    visible: dict[str, float]
    """Visible fraction of each effect as the design check predicts it."""
    explained_arcsec: Floats | None
    """[readings with an error], all that was found; None: nothing was fitted."""
    seconds: float
    """Processor time of the diagnosis alone."""

    def to_plain(self) -> Json:
        """JSON data."""
        curve = self.explained_arcsec
        return {
            "report": self.report,
            "visible": self.visible,
            "explained_arcsec": None if curve is None else np.round(curve, CURVE_DECIMALS).tolist(),
            "seconds": self.seconds,
        }


def answer_of_plain(plain: Json) -> Answer:
    """The answer that `to_plain` wrote."""
    curve = plain["explained_arcsec"]
    return Answer(
        report=plain["report"],
        visible=plain["visible"],
        explained_arcsec=None if curve is None else np.array(curve, dtype=np.float64),
        seconds=plain["seconds"],
    )


def answer_of(question: Question) -> Answer:
    """Ask; the same question gives the same answer but for the time."""
    campaign, joint = loaded(question.measured_csv, question.joint_yaml)
    library = library_without(question.without)
    started = time.process_time()
    if question.quick:
        return _quick(campaign, joint, library, started)
    diagnosis, visible = _whole(campaign, joint, library)
    report = report_plain(diagnosis.findings)
    seconds = time.process_time() - started
    attribution = diagnosis.attribution
    if attribution is not None:
        report["evidence"] = _evidence(diagnosis.problem, attribution)
    return Answer(
        report=report,
        visible=visible,
        explained_arcsec=None if attribution is None else attribution.explained(diagnosis.problem),
        seconds=seconds,
    )


def pages_of(question: Question, *, today: datetime.date) -> dict[str, str]:
    """The files that `trueangle diagnose` writes of a case, the plots inside the page only: name to text."""
    # Only the chosen few have a page: the others need no plots.
    from trueangle_training.diagnosis.report_page import PageInputs, pictures, report_page

    campaign, joint = loaded(question.measured_csv, question.joint_yaml)
    diagnosis, _ = _whole(campaign, joint, library_without(question.without))
    inputs = PageInputs(
        findings=diagnosis.findings,
        sight=diagnosis.sight,
        curves=diagnosis.curves,
        library=diagnosis.library,
        made_on=today,
    )
    return {
        "report.html": report_page(inputs, pictures(inputs)),
        "report.json": report_json(diagnosis.findings).decode(),
    }


def library_without(names: Collection[str]) -> Mapping[str, LibraryEffect]:
    """All effects but these."""
    return {name: effect for name, effect in EFFECTS.items() if name not in names} if names else EFFECTS


def loaded(measured_csv: str, joint_yaml: str) -> tuple[Campaign, Joint]:
    """Both files, read as the commands read them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "joint.yaml"
        path.write_text(joint_yaml, "utf-8")
        return read_campaign(measured_csv.encode(), source="measured.csv"), load_joint(path)


def _whole(
    campaign: Campaign, joint: Joint, library: Mapping[str, LibraryEffect]
) -> tuple[Diagnosis, dict[str, float]]:
    prepared = prepare(campaign, joint, library=library)
    return diagnose(prepared), dict(prepared.design.visible)


def _quick(campaign: Campaign, joint: Joint, library: Mapping[str, LibraryEffect], started: float) -> Answer:
    faults = data_checks(campaign, joint).faults
    problem = problem_of(campaign, joint, library=library)
    design = design_check(problem.without_errors())
    visible = dict(design.visible)
    if faults:
        kinds = [{"kind": fault.kind, "rows": [], "text": fault.text} for fault in faults]
        report: Json = {"verdict": "data_fault", "data_faults": kinds, "causes": [], "where": []}
        seconds = time.process_time() - started
        return Answer(report=report, visible=visible, explained_arcsec=None, seconds=seconds)
    attribution = attribute(problem)
    verdict = verdict_of(problem, attribution, design)
    seconds = time.process_time() - started
    return Answer(
        report=_report(problem, attribution, verdict, design),
        visible=visible,
        explained_arcsec=attribution.explained(problem),
        seconds=seconds,
    )


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
    return {"cell": asdict(Cell(order="0", moment="variance")) | {axis: "linear"}, "share": cause.share}


def as_line(plain: Json) -> str:
    """One line of text for a pipe."""
    return json.dumps(plain, separators=(",", ":"), allow_nan=False) + "\n"
