"""Findings in plain words, for the terminal and for the page."""

from collections.abc import Sequence

from trueangle.contract.joint import EFFECT_NAMES
from trueangle_training.diagnosis.findings import (
    Cause,
    Conclusion,
    EndTask,
    Estimate,
    Findings,
    Place,
    Unexplained,
)
from trueangle_training.effects.cells import Cell

LITTLE = 0.05
"""Of the shipped simulator's mean square: below it a share is not worth a clause."""
NEAR = 0.1
"""Share of what is unexplained below which an effect that could carry it is no neighbour."""
SHOWN_PLACES = 3
TIMES = " \N{MULTIPLICATION SIGN} "
SMALLEST_PLACE = 0.01
"""Share below which a significant place is left to the map."""


def effect_words(name: str) -> str:
    """The effect's name as prose."""
    return name.replace("_", " ")


def listed(names: Sequence[str], *, last: str = "and") -> str:
    """Names as prose: "a, b and c"."""
    words = [effect_words(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def prose(text: str) -> str:
    """A text in which the names of effects stand, for people."""
    for name in EFFECT_NAMES:
        text = text.replace(name, effect_words(name))
    return text


def order_words(order: str) -> str:
    """The order of a cell for people: how often a turn, or per line of the grating."""
    turns = {"0": "all angles alike", "1": "once a turn", "2": "twice a turn"}
    lines = {"N": "once a line", "2N": "twice a line", "4N": "four times a line"}
    special = {"non-integer": "not closed over one turn", "localized": "one spot of the turn"}
    return {**turns, **lines, **special}.get(order) or f"{order} times a turn"


def condition_words(cell: Cell) -> str:
    """What a cell's error follows, without its order; "always the same" where it follows nothing."""
    words: list[str] = []
    if cell.temperature != "constant":
        temperature = {"linear": "temperature", "quadratic": "temperature squared"}
        words.append(temperature.get(cell.temperature, f"temperature, {cell.temperature}"))
    if cell.direction == "odd":
        words.append("direction")
    if cell.time != "constant":
        words.append("time within the run" if cell.time == "within_run" else "another in each run")
    if cell.speed != "constant":
        words.append("speed")
    if cell.load != "constant":
        words.append("load")
    if cell.frame == "polygon":
        words.append("polygon face")
    if cell.moment == "variance":
        words.append("scatter")
    return TIMES.join(words) or "always the same"


def cell_words(cell: Cell) -> str:
    """A cell in one phrase."""
    return f"{order_words(cell.order)}, {condition_words(cell)}"


def verdict_sentence(findings: Findings) -> str:
    """The answer in one sentence."""
    match findings.conclusion:
        case Conclusion.DATA_FAULT:
            kinds = list(dict.fromkeys(fault.kind for fault in findings.data_faults))
            return f"The file is faulty ({listed(kinds)}): mend it before physics is asked."
        case Conclusion.INSUFFICIENT:
            return "This campaign cannot show any effect, whatever the joint does: more must be measured."
        case Conclusion.NONE:
            return _none_sentence(findings)
        case Conclusion.NAMED:
            return _named_sentence(findings)
        case Conclusion.UNKNOWN:
            return _unknown_sentence(findings)


def _none_sentence(findings: Findings) -> str:
    parametric = findings.gap.parametric_share
    if parametric is not None and parametric > LITTLE:
        return (
            f"No effect is missing from the simulator: re-calibrating its parameters closes {percent(parametric)} "
            "of the gap, the rest is noise."
        )
    return "No effect is missing from the simulator: what is left between it and the joint is noise."


def _named_sentence(findings: Findings) -> str:
    named = [cause for cause in findings.causes if cause.named]
    causes = " and ".join(_cause_words(cause) for cause in named)
    verb = "is" if len(named) == 1 else "are"
    sentence = f"The simulator lacks {causes}"
    if findings.gap.closure is not None:
        added = "adding it closes" if len(named) == 1 else "adding them closes"
        sentence += f"; {added} {percent(findings.gap.closure)} of the structural gap"
    if all(cause.kind.value == "variance" for cause in named):
        sentence = f"The scatter is not what the simulator says: {causes} {verb} missing"
    if findings.unexplained.significant:
        sentence += ". Something else is there that no effect of the library explains"
    return f"{sentence}."


def _cause_words(cause: Cause) -> str:
    if len(cause.members) > 1:
        return f"one of {listed(cause.members, last='or')} (this plan cannot tell them apart)"
    return f"{effect_words(cause.effect)} (probability {percent(cause.class_probability)})"


def _unknown_sentence(findings: Findings) -> str:
    places = [place for place in findings.where if place.significant][:1]
    where = f" ({cell_words(places[0].cell)})" if places else ""
    sentence = f"The joint does something{where} that the simulator lacks and no effect explains with certainty"
    if findings.causes:
        best = findings.causes[0]
        return f"{sentence}; likeliest is {listed(best.members, last='or')} ({percent(best.class_probability)})."
    return f"{sentence}{nearest_words(findings.unexplained)}."


def nearest_words(unexplained: Unexplained) -> str:
    """The effect that comes nearest to what no effect explains, as a clause; "" where there is none."""
    if unexplained.nearest_effect is None:
        return ""
    if unexplained.nearest_share < NEAR:
        return "; none comes near it"
    share = percent(unexplained.nearest_share)
    return f"; the nearest, {effect_words(unexplained.nearest_effect)}, could carry {share} of it"


def percent(share: float) -> str:
    """A share for people; the extremes are never rounded to certainty."""
    value = 100.0 * share
    if 99.0 < value < 100.0:
        return "more than 99 %"
    if 0.0 < value < 1.0:
        return "less than 1 %"
    return f"{round(value)} %".replace("-", "\N{MINUS SIGN}")


def arcsec(value: float | None) -> str:
    """Three digits of an error."""
    return "not known" if value is None else f"{value:.3g} arcsec"


def hidden_effects(findings: Findings) -> tuple[str, ...]:
    """Effects that the plan hides; those that the simulator models are not looked for but calibrated."""
    return tuple(name for name in findings.invisible if name not in findings.subject.modelled_effects)


def significant_places(findings: Findings) -> tuple[Place, ...]:
    """The places of the map that stand out."""
    return tuple(place for place in findings.where if place.significant)


def summary_lines(findings: Findings) -> list[str]:
    """The answer for a terminal: name and text, a line each."""
    rows = [("verdict", f"{findings.conclusion.value}: {verdict_sentence(findings)}")]
    rows += [("data fault", f"{fault.kind}: {fault.text}") for fault in findings.data_faults]
    rows += _gap_rows(findings)
    rows += [("cause", _cause_row(cause)) for cause in findings.causes]
    if findings.unexplained.significant and findings.conclusion is Conclusion.NAMED:
        rows.append(("unexplained", "structure beside the named causes"))
    rows += [
        ("where", f"{percent(place.share)} of the structure: {cell_words(place.cell)}")
        for place in significant_places(findings)[:SHOWN_PLACES]
        if place.share >= SMALLEST_PLACE
    ]
    rows += _end_task_rows(findings)
    hidden = hidden_effects(findings)
    if hidden:
        rows.append(("not visible", f"{listed(hidden)}: re-calibration takes it up completely under this plan"))
    if findings.not_testable:
        rows.append(("not testable", listed(list(findings.not_testable))))
    if findings.next_measurement:
        rows.append(("measure next", prose(findings.next_measurement)))
    return [f"{name:<17}{text}" for name, text in rows]


def _gap_rows(findings: Findings) -> list[tuple[str, str]]:
    gap = findings.gap
    if gap.rmse_shipped_arcsec is None:
        return []
    steps = [
        f"{arcsec(gap.rmse_shipped_arcsec)} RMS as shipped",
        f"{arcsec(gap.rmse_recalibrated_arcsec)} re-calibrated",
    ]
    if gap.rmse_explained_arcsec is not None and any(cause.named for cause in findings.causes):
        steps.append(f"{arcsec(gap.rmse_explained_arcsec)} with the causes")
    rows = [("gap", f"{', '.join(steps)}; floor {arcsec(gap.floor_arcsec)}")]
    if gap.parametric_share is not None and gap.structural_share is not None and gap.floor_share is not None:
        split = (
            f"{percent(gap.parametric_share)} parameters, {percent(gap.structural_share)} structure, "
            f"{percent(gap.floor_share)} noise"
        )
        rows.append(("split", f"{split} (of the mean square as shipped)"))
    if gap.closure is not None and any(cause.named for cause in findings.causes):
        interval = "" if gap.closure_interval is None else f" ({interval_words(gap.closure_interval)})"
        ceiling = "" if gap.ceiling is None else f"; the most any fit closes: {percent(gap.ceiling)}"
        rows.append(("closure", f"{percent(gap.closure)} of the structural gap{interval}{ceiling}"))
    return rows


def interval_words(interval: tuple[float, float]) -> str:
    """A 95 % interval of a share."""
    return f"95 %: {percent(interval[0])} to {percent(interval[1])}"


def _cause_row(cause: Cause) -> str:
    label = f" ({cause.label})" if cause.label else ""
    others = [name for name in cause.members if name != cause.effect]
    beside = f"; under this plan not to be told from {listed(others, last='or')}" if others else ""
    closes = "" if cause.closes is None else f", closes {percent(cause.closes)}"
    return f"{effect_words(cause.effect)}{label}, probability {percent(cause.probability)}{closes}{beside}"


def _end_task_rows(findings: Findings) -> list[tuple[str, str]]:
    task = findings.end_task
    rows: list[tuple[str, str]] = []
    if not task.compensable:
        rows.append(("compensation", f"not by a model of angle and temperature: {missing_words(task)}"))
    figures = (
        (task.none_arcsec, "without"),
        (task.simulator_arcsec, "with a model of the simulator as shipped"),
        (task.explained_arcsec, "with the causes added"),
        (task.oracle_arcsec, "trained on the measurement"),
    )
    known = [f"{arcsec(value)} {words}" for value, words in figures if value is not None]
    if known:
        rows.append(("end task", ", ".join(known)))
    return rows


def missing_words(task: EndTask) -> str:
    """Why a model of angle and temperature cannot take off what was found."""
    missing = task.missing_input or "an input"
    if missing == "reference":
        return "it is the reference's own error: measure it, do not compensate it"
    if missing.startswith("nothing: "):
        return missing.removeprefix("nothing: ")
    return f"it would need the {missing.removeprefix('a ')}"


UNITS: tuple[tuple[str, str], ...] = (
    ("_arcsec_per_deg_s", "arcsec/(deg/s)"),
    ("_arcsec_per_nm", "arcsec/Nm"),
    ("_arcsec_per_k2", "arcsec/K²"),
    ("_arcsec_per_k", "arcsec/K"),
    ("_arcsec", "arcsec"),
    ("_deg_s", "deg/s"),
    ("_deg", "deg"),
    ("_c", "°C"),
    ("_k", "K"),
    ("_s", "s"),
    ("_ms", "ms"),
    ("_us", "µs"),
    ("_counts", "counts"),
    ("_nm", "Nm"),
)
"""Endings of parameter names and the units that they stand for, longest first."""


def parameter_words(name: str) -> str:
    """A parameter's name as prose, its unit left to the value."""
    ending = next((ending for ending, _ in UNITS if name.endswith(ending) and name != ending[1:]), "")
    return effect_words(name.removesuffix(ending)).capitalize()


def parameter_value(name: str, estimate: Estimate) -> str:
    """Value, uncertainty and unit."""
    unit = next((f" {unit}" for ending, unit in UNITS if name.endswith(ending)), "")
    value = f"{estimate.value:.4g}"
    if estimate.standard_uncertainty is not None:
        value = f"{value} ± {estimate.standard_uncertainty:.2g}"
    return f"{value}{unit}".replace("-", "\N{MINUS SIGN}")
