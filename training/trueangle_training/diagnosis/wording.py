"""Findings in plain words, for the terminal and for the page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from trueangle.contract.joint import EFFECT_NAMES
from trueangle_training.diagnosis.findings import (
    NAMED_FROM,
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
SMALLEST_P = 0.0001
LARGE_PLACE = 0.1
"""Share from which a place is told although the signs of whole runs alone do not make it significant."""
UNTESTED = " (too few runs to test this place by itself)"
BY_EVIDENCE_ONLY = " (by the evidence; the signs of whole runs alone do not show it)"
TIMES = " \N{MULTIPLICATION SIGN} "
SMALLEST_PLACE = 0.01
"""Share below which a significant place is left to the map."""
AS_MUCH = 0.95
"""Of the largest share: another cell that could carry so much is told, as a class holds what carries so much."""


def effect_words(name: str) -> str:
    """The effect's name as prose."""
    return name.replace("_", " ")


def listed(names: Sequence[str], *, last: str = "and") -> str:
    """Names as prose: "a, b and c"."""
    words = [effect_words(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def counted(number: int, name: str) -> str:
    """A number with its noun."""
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


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
            return (
                f"With {counted(findings.subject.readings, 'reading')} in {counted(findings.subject.runs, 'run')} "
                "this campaign cannot show any effect, whatever the joint does: more must be measured."
            )
        case Conclusion.NONE:
            return _none_sentence(findings)
        case Conclusion.NAMED:
            return _named_sentence(findings)
        case Conclusion.UNKNOWN:
            return _unknown_sentence(findings)


def _none_sentence(findings: Findings) -> str:
    parametric = findings.gap.parametric_share
    blind = hidden_effects(findings) or findings.not_testable
    subject = "No effect that this plan can show is missing" if blind else "No effect is missing"
    if parametric is not None and parametric > LITTLE:
        return (
            f"{subject} from the simulator: re-calibrating its parameters closes {percent(parametric)} "
            "of the gap, the rest is noise."
        )
    return f"{subject} from the simulator: what is left between it and the joint is noise."


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
    if may_be_a_sum(cause):
        sure = percent(cause.class_probability)
        return f"{effect_words(cause.effect)}, or effects whose sum looks like it (probability {sure})"
    return f"{effect_words(cause.effect)} (probability {percent(cause.class_probability)})"


def may_be_a_sum(cause: Cause) -> bool:
    """Whether the pattern is named with more confidence than the effect: several others could add up to it."""
    return len(cause.members) == 1 and cause.probability < NAMED_FROM <= cause.class_probability


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
    """A share for people, never rounded to certainty or up to the probability from which a cause is named."""
    value = 100.0 * share
    if 99.0 < value < 100.0:
        return "more than 99 %"
    if 0.0 < value < 1.0:
        return "less than 1 %"
    if share < NAMED_FROM and round(value) >= 100.0 * NAMED_FROM:
        # The threshold of a name is not reached by rounding.
        return f"{math.floor(10.0 * value) / 10.0:.1f} %"
    return f"{round(value)} %".replace("-", "\N{MINUS SIGN}")


def chance_share(share: float) -> str:
    """The closure by chance effects: where they make held-out runs worse, by how much says nothing."""
    return percent(share) if share >= 0.0 else "nothing of it"


def p_words(p_value: float | None) -> str:
    """A p-value; far out its size is that of the model's tails and says nothing."""
    if p_value is None:
        return "not tested"
    return f"p < {SMALLEST_P:g}" if p_value < SMALLEST_P else f"p = {p_value:.2g}"


def arcsec(value: float | None) -> str:
    """Three digits of an error."""
    return "not known" if value is None else f"{value:.3g} arcsec"


def by_reason(reasons: Mapping[str, str]) -> list[tuple[tuple[str, ...], str]]:
    """Effects of one reason together, and the reason."""
    grouped: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        grouped.setdefault(reason, []).append(name)
    return [(tuple(names), reason) for reason, names in grouped.items()]


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
    rows += _place_rows(findings)
    rows += _end_task_rows(findings)
    hidden = hidden_effects(findings)
    if hidden:
        rows.append(("not visible", f"{listed(hidden)}: re-calibration takes it up completely under this plan"))
    if findings.not_testable:
        rows += [
            ("not testable", listed(names) + (f": {reason}" if reason else ""))
            for names, reason in by_reason(findings.not_testable)
        ]
    if findings.next_measurement:
        name = "what to do" if findings.conclusion is Conclusion.DATA_FAULT else "measure next"
        rows.append((name, prose(findings.next_measurement)))
    rows += [("note", prose(note)) for note in findings.notes]
    return [f"{name:<17}{text}" for name, text in rows]


def _place_rows(findings: Findings) -> list[tuple[str, str]]:
    places = significant_places(findings)
    if findings.conclusion is Conclusion.NONE:
        return [("where", chance_words(places))] if places else []
    large = [
        place for place in findings.where if place.share >= (SMALLEST_PLACE if place.significant else LARGE_PLACE)
    ]
    rows = [
        (
            "where",
            f"{percent(place.share)} of the structure: {cell_words(place.cell)}"
            + ("" if place.significant else UNTESTED if place.p_value is None else BY_EVIDENCE_ONLY),
        )
        for place in large[:SHOWN_PLACES]
    ]
    other = elsewhere_words(findings)
    return [*rows, ("", other)] if other else rows


def elsewhere_words(findings: Findings) -> str:
    """Where what was found may lie as well, as a clause; "" where plan and noise leave no choice."""
    largest = max((place.share for place in findings.where), default=0.0)
    other = [
        cell_words(place.cell)
        for place in findings.where
        if place.share < place.could_carry and place.could_carry >= AS_MUCH * largest > 0.0
    ]
    return f"or, which this plan does not rule out: {other[0]}" if other else ""


def chance_words(places: Sequence[Place]) -> str:
    """What places that stand out mean where nothing was found."""
    return (
        f"{cell_words(places[0].cell)}: stands out in the map, as cells do now and then; the evidence as a whole "
        "does not bear it out"
    )


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
    if may_be_a_sum(cause):
        beside = f"; {percent(cause.class_probability)} with effects whose sum looks like it"
    closes = "" if cause.closes is None else f", closes {percent(cause.closes)}"
    return f"{effect_words(cause.effect)}{label}, probability {percent(cause.probability)}{closes}{beside}"


def _end_task_rows(findings: Findings) -> list[tuple[str, str]]:
    task = findings.end_task
    rows: list[tuple[str, str]] = []
    if not task.compensable:
        rows.append(
            (
                "compensation",
                f"not by a model of angle and temperature: {missing_words(task)}{doubt_words(findings)}",
            )
        )
    elif task.not_compensable:
        rows.append(("compensation", f"in part by a model of angle and temperature: {in_part_words(task)}"))
    figures = (
        (task.none_arcsec, "without"),
        (task.simulator_arcsec, "with a model of the simulator as shipped"),
        (
            task.explained_arcsec,
            "with the causes added" + (" that it can take off" if task.not_compensable else ""),
        ),
        (task.oracle_arcsec, "trained on the measurement"),
    )
    known = [f"{arcsec(value)} {words}" for value, words in figures if value is not None]
    if known:
        rows.append(("end task", ", ".join(known)))
    return rows


def missing_words(task: EndTask) -> str:
    """Why a model of angle and temperature cannot take off what was found."""
    said: list[str] = []
    inputs: list[str] = []
    for missing in (task.missing_input or "another input").split(", "):
        if missing == "reference":
            said.append("it is the reference's own error: measure it, do not compensate it")
        elif ": " in missing:
            # Not an input that could be had: why there is none.
            said.append(missing.partition(": ")[2])
        else:
            inputs.append(missing if missing.startswith(("a ", "an ", "the ")) else f"the {missing}")
    if inputs:
        said.append(f"it would need {' and '.join(inputs)}")
    return "; ".join(said)


def in_part_words(task: EndTask) -> str:
    """Which causes stay in the angle, and why."""
    return "; ".join(
        f"{effect_words(name)} stays in the angle, {missing_words(replace(task, missing_input=missing))}"
        for name, missing in task.not_compensable.items()
    )


def doubt_words(findings: Findings) -> str:
    """That the answer about compensation stands and falls with one member of a class; "" where it does not."""
    doubtful = [cause for cause in findings.causes if cause.named and cause.probability < NAMED_FROM]
    return f" (if it is {listed([cause.effect for cause in doubtful])} indeed)" if doubtful else ""


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
    """A parameter's name as prose, its unit left to the value; those of a second event are numbered."""
    name, number = _of_event(name)
    ending = next((ending for ending, _ in UNITS if name.endswith(ending) and name != ending[1:]), "")
    words = effect_words(name.removesuffix(ending)).capitalize()
    return f"{words} ({number})" if number else words


def _of_event(name: str) -> tuple[str, str]:
    """A parameter's name and the number of its event, "" for the first."""
    before, _, last = name.rpartition("_")
    return (before, last) if before and last.isdigit() else (name, "")


def parameter_value(name: str, estimate: Estimate) -> str:
    """Value, uncertainty and unit."""
    plain, _ = _of_event(name)
    unit = next((f" {unit}" for ending, unit in UNITS if plain.endswith(ending)), "")
    value = f"{estimate.value:.4g}"
    if estimate.standard_uncertainty is not None:
        value = f"{value} ± {estimate.standard_uncertainty:.2g}"
    return f"{value}{unit}".replace("-", "\N{MINUS SIGN}")
