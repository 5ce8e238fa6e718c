"""The diagnosis as one page that needs nothing beside itself."""

import base64
import datetime
from collections.abc import Mapping
from dataclasses import dataclass

from trueangle_training.diagnosis import report_plots, wording
from trueangle_training.diagnosis.curves import Curves
from trueangle_training.diagnosis.findings import Cause, Conclusion, Findings, PlanSight
from trueangle_training.effects.effect import LibraryEffect
from trueangle_training.html_page import Markup, page

SHOWN_ROWS = 40
SHOWN_PARAMETERS = 8
"""Of a cause; more of them (a draw for each run, a figure for each face) are folded away."""
SMALLEST_BAR = 0.015
"""Of the bar's width: a smaller share would not be seen at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure: in the page and as a file beside it."""

    name: str
    svg: bytes
    title: str
    caption: str
    words: str
    """For those who cannot see it."""

    @property
    def address(self) -> Markup:
        """A data address, the only value that is not escaped: letters of base 64."""
        return Markup("data:image/svg+xml;base64,") + base64.b64encode(self.svg).decode()


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """One part of a split bar."""

    name: str
    text: str
    width_percent: float
    kind: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """A cause with what the library knows of it."""

    cause: Cause
    physics: str
    formula: str
    proof: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PageInputs:
    """All that the page shows."""

    findings: Findings
    sight: PlanSight
    curves: Curves | None
    """None: nothing was fitted, the file being faulty or the plan blind."""
    library: Mapping[str, LibraryEffect]
    made_on: datetime.date


def pictures(inputs: PageInputs) -> tuple[Picture, ...]:
    """The figures in the order of the page."""
    findings, curves = inputs.findings, inputs.curves
    drawn: list[Picture] = []
    svg = report_plots.heat_map(findings.where) if findings.where else None
    if svg is not None:
        places = wording.significant_places(findings)
        significant = "; ".join(
            f"{wording.cell_words(each.cell)}: {wording.percent(each.share)}" for each in places
        )
        other = wording.elsewhere_words(findings)
        drawn.append(
            Picture(
                name="where",
                svg=svg,
                title="Where the structure lies",
                caption="Share of the structural part in percent, by order (times a turn) and by what it follows. "
                "Framed: significant (family-wise 5 %, by whole runs) and not explained by another cell. "
                "Hatched: too few runs to test."
                + (f" What has the largest share may lie there, {other}." if other else ""),
                words=f"Significant cells: {significant or 'none'}.",
            )
        )
    if curves is None:
        return tuple(drawn)
    odd = any(cause.cell is not None and cause.cell.direction == "odd" for cause in findings.causes)
    drawn.append(
        Picture(
            name="residuals",
            svg=report_plots.before_and_after(curves, by_direction=odd),
            title="Before and after",
            caption="Measured minus simulator, its parameters re-calibrated; below, with all that was found taken "
            "off, named or not. All readings, fitted, so a little better than on the held-out runs of the text.",
            words="Residuals over the angle before and after what was found is taken off.",
        )
    )
    drawn.append(
        Picture(
            name="runs",
            svg=report_plots.by_run(curves, floor_arcsec=findings.gap.floor_arcsec),
            title="Run by run",
            caption="The same by runs: one that stands out afterwards was measured differently from the others.",
            words="RMS of each run before and after what was found is taken off.",
        )
    )
    if findings.waterfall:
        steps = "; ".join(f"with {each.effect}: {wording.percent(each.closure)}" for each in findings.waterfall)
        drawn.append(
            Picture(
                name="waterfall",
                svg=report_plots.waterfall(findings.waterfall, ceiling=findings.gap.ceiling),
                title="What each cause closes",
                caption="Of the gap between the re-calibrated simulator and the noise floor, on held-out runs, "
                "one cause added after the other; bars: 95 % over runs.",
                words=f"Closed part of the structural gap, {steps}.",
            )
        )
    return tuple(drawn)


def report_page(inputs: PageInputs, drawn: tuple[Picture, ...]) -> str:
    """The page as HTML; the same inputs give the same text."""
    findings = inputs.findings
    text = page(
        "diagnosis.html.j2",
        {
            "findings": findings,
            "sight": inputs.sight,
            "made_on": inputs.made_on,
            "sentence": wording.verdict_sentence(findings),
            "named": any(cause.named for cause in findings.causes),
            "headline": HEADLINES[findings.conclusion],
            "faulty": findings.conclusion in (Conclusion.DATA_FAULT, Conclusion.INSUFFICIENT),
            "pictures": {each.name: each for each in drawn},
            "split": split_bar(findings),
            "causes": tuple(_explained(cause, inputs.library) for cause in findings.causes),
            "hidden": wording.by_reason(
                {name: _why_hidden(inputs.sight, name) for name in wording.hidden_effects(findings)}
            ),
            "not_testable": wording.by_reason(findings.not_testable),
            "places": wording.significant_places(findings),
            "shown_rows": SHOWN_ROWS,
            "shown_parameters": SHOWN_PARAMETERS,
            "words": wording,
        },
    )
    # A number and its sign stay on one line.
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _why_hidden(sight: PlanSight, effect: str) -> str:
    reasons = {seen.effect: seen.reason for seen in sight.effects}
    return reasons.get(effect) or "re-calibration takes it up completely"


HEADLINES: Mapping[Conclusion, str] = {
    Conclusion.NONE: "Nothing is missing",
    Conclusion.NAMED: "Cause found",
    Conclusion.UNKNOWN: "Something unexplained",
    Conclusion.DATA_FAULT: "The file is faulty",
    Conclusion.INSUFFICIENT: "Too little was measured",
}


def split_bar(findings: Findings) -> tuple[Bar, ...]:
    """Parametric, structural and noise, as wide as their shares; () where they are not known."""
    gap = findings.gap
    shares = (
        ("parameters", gap.parametric_share, "parametric"),
        ("structure", gap.structural_share, "structural"),
        ("noise", gap.floor_share, "floor"),
    )
    known = [(name, share, kind) for name, share, kind in shares if share is not None]
    if len(known) < len(shares):
        return ()
    widths = [max(share, SMALLEST_BAR) if share > 0.0 else 0.0 for _, share, _ in known]
    return tuple(
        Bar(name=name, text=wording.percent(share), width_percent=round(100.0 * width / sum(widths), 2), kind=kind)
        for (name, share, kind), width in zip(known, widths, strict=True)
    )


def _explained(cause: Cause, library: Mapping[str, LibraryEffect]) -> Explained:
    entry = library.get(cause.effect)
    if entry is None:
        return Explained(cause=cause, physics="", formula="", proof="")
    return Explained(cause=cause, physics=entry.physics, formula=entry.formula, proof=entry.proof)
