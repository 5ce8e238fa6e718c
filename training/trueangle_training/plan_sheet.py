"""The sheet to work from: run by run and stop by stop what to set and where to write, as CSV or to be printed.

The CSV, filled in, is what `trueangle errors` reads: its columns are those of raw readings, plus what to set.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass

from trueangle.contract.joint import Plan, PlanZero
from trueangle_training.html_page import page
from trueangle_training.plan_design import SAME_OFFSET_FACES, PlanTime
from trueangle_training.simulator.schedule import RunSetup, run_setups

HEADER = (
    "run",
    "set_temperature_c",
    "direction",
    "polygon_turn_faces",
    "polygon_offset",
    "face",
    "set_angle_deg",
    "angle_deg",
    "autocollimator_arcsec",
    "temperature_c",
    "time_s",
)
INSTRUCTIONS = (
    "Write down the encoder's angle (deg), the autocollimator's reading (arcsec) and the joint's temperature.",
    "Autocollimator: positive where the shaft stands further on, as the encoder counts up.",
    "Face numbers rise with the encoder's angle; stop near the given one, where the autocollimator sees the face.",
    "Leave a cell empty where a reading was missed: never write a guess. A run needs its first line.",
)
ONE_ZERO_INSTRUCTIONS = (
    "One zero: over all runs leave polygon, clamp, autocollimator and preset as they are, the encoder on.",
    "The autocollimator and its foundation must not move with the chamber's temperature: watch a fixed mirror.",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSheet:
    """One run of the sheet."""

    setup: RunSetup
    set_angle_deg: tuple[float, ...]
    face: tuple[int, ...]
    new_temperature: bool
    """Wait for the soak before it."""
    remount: bool
    """The polygon is turned on the shaft before it."""


def run_sheets(plan: Plan) -> tuple[RunSheet, ...]:
    """The runs in the order in which they are measured."""
    sheets: list[RunSheet] = []
    before: RunSetup | None = None
    for setup in run_setups(plan):
        turned = 0.0 if before is None else before.offset_faces
        sheets.append(
            RunSheet(
                setup=setup,
                set_angle_deg=tuple(setup.stop_deg(plan.faces).tolist()),
                face=tuple(setup.stop_faces(plan.faces).tolist()),
                new_temperature=before is None or before.temperature_c != setup.temperature_c,
                remount=abs(setup.offset_faces - turned) > SAME_OFFSET_FACES,
            )
        )
        before = setup
    return tuple(sheets)


def instructions(plan: Plan) -> tuple[str, ...]:
    """What to mind, one sentence or two a line."""
    return (*INSTRUCTIONS, *(ONE_ZERO_INSTRUCTIONS if plan.zero is PlanZero.ONE else ()))


def sheet_csv(plan: Plan, title: str) -> str:
    """The sheet as CSV with empty cells to fill in."""
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in (title, *instructions(plan)))
    out.write(",".join(HEADER) + "\n")
    out.writelines(f"{line}\n" for line in _csv_lines(plan))
    return out.getvalue()


def _csv_lines(plan: Plan) -> Iterator[str]:
    for sheet in run_sheets(plan):
        setup = sheet.setup
        start = (
            f"{setup.run},{setup.temperature_c:g},{setup.direction},{setup.offset_faces:.4f},{setup.whole_faces}"
        )
        for face, angle_deg in zip(sheet.face, sheet.set_angle_deg, strict=True):
            yield f"{start},{face},{angle_deg:.3f},,,,"


def sheet_html(plan: Plan, title: str, time: PlanTime) -> str:
    """The sheet as a page to be printed, one table a run."""
    return page(
        "plan_sheet.html.j2",
        {
            "title": title,
            "plan": plan,
            "one_zero": plan.zero is PlanZero.ONE,
            "time": time,
            "instructions": instructions(plan),
            "runs": run_sheets(plan),
        },
    )
