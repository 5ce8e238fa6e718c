"""`trueangle diagnose`: where a joint departs from its simulator, which effect causes it, how far that shrinks."""

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

from trueangle.contract.calibration import read_campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle_training.command import Surroundings
from trueangle_training.dataset import without_rows
from trueangle_training.documents import load_joint
from trueangle_training.files import check_writable, read_whole, write_whole
from trueangle_training.progress import Progress, progress_bar
from trueangle_training.train_options import excluded_rows

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.diagnosis.diagnose import Diagnosis

PROCESSES = 2
REPORT_JSON, DESIGN_JSON, REPORT_HTML, PLOTS = "report.json", "design.json", "report.html", "plots"
EXIT_BAD_INPUT = 2
EXTENDED = "extended by what was found"
"""In what `joint_update` says of an effect that the joint had and that has got more parts."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "diagnose",
        allow_abbrev=False,
        help="find which effect the simulator of a joint lacks",
        description="Hold a measured campaign against the simulator of the joint: where the gap lies, which "
        "effect of the library causes it, how far it shrinks once that effect is added, what the plan cannot see "
        "and what to measure next. Writes report.json, design.json, report.html and the plots.",
    )
    parser.add_argument(
        "measured", type=Path, nargs="+", metavar="MEASURED.csv", help="several: a batch, one folder each"
    )
    parser.add_argument(
        "--joint", type=Path, required=True, metavar="JOINT.yaml", help="what the simulator models"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="made if it is not there")
    parser.add_argument("--no-html", action="store_true", help="neither page nor plots")
    parser.add_argument(
        "--update",
        type=Path,
        metavar="JOINT.yaml",
        help="write the joint with what was found added and its parameters re-calibrated",
    )
    parser.add_argument(
        "--exclude-rows",
        type=excluded_rows,
        default=frozenset(),
        metavar="N,N-M",
        help="lines of the campaign file to leave out",
    )
    parser.set_defaults(run=run)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One campaign of a batch; travels to another process."""

    measured: Path
    joint: Path
    folder: Path
    html: bool
    update: Path | None
    excluded: frozenset[int]
    today: date


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a case."""

    measured: Path
    lines: tuple[str, ...]
    """For the user."""
    faults: tuple[Fault, ...] = ()
    """Empty: a report was made."""


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Diagnose, write and sum up; 0, or 2 where a file of a batch could not be read."""
    cases = _cases(arguments, surroundings.today)
    if len(cases) == 1:
        with progress_bar(surroundings.err, f"diagnosing {cases[0].measured}") as progress:
            lines = diagnose_case(cases[0], progress)
        surroundings.out.writelines(f"{line}\n" for line in lines)
        return 0
    return _run_batch(cases, surroundings)


def _cases(arguments: argparse.Namespace, today: date) -> list[Case]:
    """All that can be judged before the first diagnosis; every fault at once."""
    faults: list[Fault] = []
    several = len(arguments.measured) > 1
    for option, given in (("--update", arguments.update is not None), ("--exclude-rows", arguments.exclude_rows)):
        if several and given:
            faults.append(
                Fault(where=option, expected="one campaign", found=f"{len(arguments.measured)} campaigns")
            )
    try:
        load_joint(arguments.joint)
    except ContractError as error:
        faults += error.faults
    if arguments.update is not None:
        try:
            check_writable(arguments.update)
        except ContractError as error:
            faults += error.faults
        own = [arguments.out / name for name in (REPORT_JSON, DESIGN_JSON, REPORT_HTML)]
        for taken, whose in ((arguments.measured, "the campaign"), (own, "the report's own files")):
            if any(_same(arguments.update, each) for each in taken):
                found = str(arguments.update)
                faults.append(Fault(where="--update", expected=f"another file than {whose}", found=found))
    if faults:
        raise ContractError(faults)
    folders = _folders(arguments.out, arguments.measured) if several else [arguments.out]
    for folder in folders:
        _make(folder)
    return [
        Case(
            measured=measured,
            joint=arguments.joint,
            folder=folder,
            html=not arguments.no_html,
            update=arguments.update,
            excluded=arguments.exclude_rows,
            today=today,
        )
        for measured, folder in zip(arguments.measured, folders, strict=True)
    ]


def _same(one: Path, other: Path) -> bool:
    """Whether both are one file, or will be once they are written."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return one.resolve() == other.resolve()


def _folders(out: Path, measured: Sequence[Path]) -> list[Path]:
    """One folder for each campaign, by its name; equal names are numbered."""
    names: list[str] = []
    for path in measured:
        name, number = path.stem, 2
        while name in names:
            name, number = f"{path.stem}-{number}", number + 1
        names.append(name)
    return [out / name for name in names]


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise ContractError(
            [Fault(where=str(folder), expected="a folder that can be made", found=found)]
        ) from error
    check_writable(folder / REPORT_JSON)


def _run_batch(cases: Sequence[Case], surroundings: Surroundings) -> int:
    outcomes: list[Outcome] = []
    context = get_context("spawn")
    title = f"diagnosing {len(cases)} campaigns"
    workers = min(PROCESSES, len(cases))
    with (
        progress_bar(surroundings.err, title) as progress,
        ProcessPoolExecutor(max_workers=workers, mp_context=context) as pool,
    ):
        for outcome in pool.map(_outcome, cases):
            outcomes.append(outcome)
            progress(len(outcomes), len(cases))
    for outcome in outcomes:
        surroundings.out.writelines(f"{outcome.measured}: {line}\n" for line in outcome.lines)
    faults = [fault for outcome in outcomes for fault in outcome.faults]
    surroundings.err.writelines(f"trueangle: {fault}\n" for fault in faults)
    return EXIT_BAD_INPUT if faults else 0


def _outcome(case: Case) -> Outcome:
    """A case whose file is broken must not end the batch."""
    try:
        lines = diagnose_case(case, lambda done, total: None)
    except ContractError as error:
        return Outcome(measured=case.measured, lines=(), faults=error.faults)
    return Outcome(measured=case.measured, lines=(lines[0], lines[-1]))


def diagnose_case(case: Case, progress: Progress) -> list[str]:
    """Read, diagnose and write one campaign; the lines that sum it up. ContractError: it cannot be read."""
    joint = load_joint(case.joint)
    campaign = read_campaign(read_whole(case.measured), source=str(case.measured))
    if case.excluded:
        campaign = without_rows(campaign, case.excluded)
    from trueangle_training.diagnosis.diagnose import STAGES, diagnose, prepare
    from trueangle_training.diagnosis.findings_json import design_json, report_json
    from trueangle_training.diagnosis.wording import summary_lines

    steps = len(STAGES) + case.html

    def stage(number: int) -> None:
        progress(number, steps)

    prepared = prepare(campaign, joint)
    # An answer of an earlier file must not stand beside this one's design while, or after, this one fails.
    _remove_old(case.folder)
    write_whole(case.folder / DESIGN_JSON, design_json(prepared.sight))
    diagnosis = diagnose(prepared, progress=stage)
    write_whole(case.folder / REPORT_JSON, report_json(diagnosis.findings))
    if case.html:
        _write_page(case, diagnosis)
    stage(steps)
    lines = summary_lines(diagnosis.findings)
    if case.update is not None:
        lines += _write_update(case, diagnosis)
    written = [REPORT_JSON, DESIGN_JSON, *([REPORT_HTML] if case.html else [])]
    return [*lines, f"{'written':<17}{case.folder}: {', '.join(written)}"]


def _remove_old(folder: Path) -> None:
    old = [folder / REPORT_JSON, folder / REPORT_HTML, *(folder / PLOTS).glob("*.svg")]
    for path in old:
        path.unlink(missing_ok=True)


def _write_page(case: Case, diagnosis: "Diagnosis") -> None:
    from trueangle_training.diagnosis.report_page import PageInputs, pictures, report_page

    inputs = PageInputs(
        findings=diagnosis.findings,
        sight=diagnosis.sight,
        curves=diagnosis.curves,
        library=diagnosis.library,
        made_on=case.today,
    )
    drawn = pictures(inputs)
    if drawn:
        _make(case.folder / PLOTS)
    for picture in drawn:
        write_whole(case.folder / PLOTS / f"{picture.name}.svg", picture.svg)
    write_whole(case.folder / REPORT_HTML, report_page(inputs, drawn).encode())


def _write_update(case: Case, diagnosis: "Diagnosis") -> list[str]:
    from trueangle_training.diagnosis.diagnose import update_of
    from trueangle_training.documents import joint_text_with_effects

    assert case.update is not None  # noqa: S101 - the caller has looked
    update = update_of(diagnosis)
    if update is None:
        return [f"{'joint':<17}{case.update} was not written: nothing was fitted"]
    heading = f"Effects by trueangle diagnose on {case.today.isoformat()} from {_shown(case.measured.name)}"
    heading += (
        f" (SHA-256 {diagnosis.findings.subject.campaign_sha256[:12]}), report in {_shown(str(case.folder))}."
    )
    text = joint_text_with_effects(
        read_whole(case.joint).decode("utf-8-sig"),
        source=str(case.joint),
        effects=update.effects,
        comments=update.comments,
        heading=heading,
    )
    write_whole(case.update, text.encode())
    changed = _changed(update.comments)
    notes = [*update.notes, *_stand_ins(diagnosis)]
    return [f"{'joint':<17}{case.update}: {changed}", *(f"{'note':<17}{note}" for note in notes)]


def _stand_ins(diagnosis: "Diagnosis") -> list[str]:
    """Effects that are written although the plan cannot tell them from others."""
    classes = [cause for cause in diagnosis.findings.causes if cause.named and len(cause.members) > 1]
    return [
        f"{cause.effect} is written for one of {', '.join(cause.members)}: on this plan their curves are one, "
        "elsewhere they are not"
        for cause in classes
    ]


def _changed(comments: Mapping[str, str]) -> str:
    """What was done to the joint, from what is written beside its effects."""
    added = [name for name, comment in comments.items() if comment.startswith("found")]
    extended = [name for name, comment in comments.items() if EXTENDED in comment]
    parts = [f"{', '.join(names)} {what}" for names, what in ((added, "added"), (extended, "extended")) if names]
    return f"with {' and '.join(parts)}" if parts else "re-calibrated, nothing added"


def _shown(name: str) -> str:
    """A file's name in a comment of YAML, which takes printable characters only."""
    return "".join(character if character.isprintable() else "?" for character in name)
