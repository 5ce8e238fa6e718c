"""What a plan can see and what it can tell apart, before any error is looked at."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.containment import LEAST_VISIBLE, Spans, spans_of
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]

CARRIED = 0.95
"""Share of a pattern from which another effect is as good an explanation."""
SHAPES_COMPARED = 8
"""Of each effect, spread over its grid of shapes."""
FEWEST_RUNS_FOR_SCATTER = 8
"""Runs from which a scatter that grows can be told from chance (permutations of fewer are too few)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """What the plan can see."""

    visible: Mapping[str, float]
    """Share of each effect's energy that re-calibration leaves, of its most visible shape, 0 to 1."""
    carries: Mapping[str, Mapping[str, float]]
    """Of each visible effect, how much of its pattern another effect can carry, 0 to 1."""
    invisible: tuple[str, ...]
    """Effects of which the plan shows less than 1 %."""
    not_testable: tuple[str, ...]
    """Effects that need a column or a change of conditions that the campaign does not have."""
    reasons: Mapping[str, str]
    """Of each effect that is invisible or not testable, why."""
    spans: Spans

    @property
    def testable(self) -> tuple[str, ...]:
        """Effects that this plan can find."""
        return tuple(name for name in self.visible if name not in self.invisible)

    def confusable(self, effect: str) -> tuple[str, ...]:
        """Other effects that could carry this one under the plan, the likeliest first."""
        others = self.carries.get(effect, {})
        return tuple(
            name
            for name in sorted(others, key=lambda name: -others[name])
            if others[name] >= CARRIED and name != effect
        )


def design_check(problem: Problem) -> Design:
    """Judge the plan; the errors of `problem` are not looked at."""
    spans = spans_of(problem)
    shapes = {name: _shapes_of(problem, name) for name in problem.library}
    visible: dict[str, float] = {}
    not_testable: list[str] = []
    reasons: dict[str, str] = {}
    for name, effect in problem.library.items():
        if effect.nature is Nature.VARIANCE:
            reason = _scatter_reason(problem, name)
            if reason is None:
                visible[name] = 1.0
            else:
                not_testable.append(name)
                reasons[name] = reason
        elif shapes[name].size == 0:
            not_testable.append(name)
            reasons[name] = _missing(problem, name)
        else:
            visible[name] = float(spans.visible[shapes[name]].max())
    invisible = tuple(name for name, share in visible.items() if share < LEAST_VISIBLE)
    for name in invisible:
        reasons[name] = "re-calibration and zeroing take up all of it under this plan"
    return Design(
        visible=visible,
        carries=_carries(problem, spans, shapes),
        invisible=invisible,
        not_testable=tuple(not_testable),
        reasons=reasons,
        spans=spans,
    )


def _shapes_of(problem: Problem, effect: str) -> NDArray[np.int64]:
    return np.array([i for i, each in enumerate(problem.hypotheses) if each.effect == effect], dtype=np.int64)


def _carries(
    problem: Problem, spans: Spans, shapes: Mapping[str, NDArray[np.int64]]
) -> dict[str, dict[str, float]]:
    names = [name for name, own in shapes.items() if own.size and float(spans.visible[own].max()) >= LEAST_VISIBLE]
    place = {name: i for i, name in enumerate(names)}
    owner = np.array([place.get(each.effect or "", -1) for each in problem.hypotheses], dtype=np.int64)
    found: dict[str, dict[str, float]] = {}
    for name in names:
        seen = shapes[name][spans.visible[shapes[name]] >= LEAST_VISIBLE]
        chosen = seen[np.unique(np.linspace(0, seen.size - 1, SHAPES_COMPARED).astype(np.int64))]
        # A pattern drawn anew in each run is judged by its average, not by the draw that repeats in all runs.
        random = problem.library[name].nature is not Nature.MEAN
        best = np.zeros(len(names))
        carried = spans.carried_at_best(chosen, average=random)
        np.maximum.at(best, owner[owner >= 0], carried[owner >= 0])
        found[name] = {other: float(min(best[place[other]], 1.0)) for other in names if other != name}
    return found


def _scatter_reason(problem: Problem, name: str) -> str | None:
    """Why an effect of the scatter cannot be tested; None: it can."""
    if name != "noise_growth":
        return None
    axes = axes_of(problem.conditions)
    if axes.runs < FEWEST_RUNS_FOR_SCATTER:
        runs = "1 run" if axes.runs == 1 else f"{axes.runs} runs"
        return f"{runs}; {FEWEST_RUNS_FOR_SCATTER} are needed to judge the scatter"
    if axes.temperature is None and axes.speed is None and axes.load is None:
        return "temperature, speed and load are constant or not recorded"
    return None


def _missing(problem: Problem, name: str) -> str:
    """The columns that the campaign lacks, or the change of conditions, as far as the effect's cells tell."""
    conditions, axes = problem.conditions, axes_of(problem.conditions)
    cells = problem.library[name].cells
    lacking = [column for column in problem.library[name].needs if getattr(conditions, column) is None]
    if lacking:
        return "the campaign lacks " + " and ".join(lacking)
    if any(cell.temperature != "constant" for cell in cells) and axes.temperature is None:
        lacking.append("temperature_c" if conditions.temperature_c is None else "a second temperature")
    if any(cell.direction == "odd" for cell in cells) and axes.direction is None:
        lacking.append("direction" if conditions.direction is None else "readings in both directions")
    if any(cell.speed != "constant" for cell in cells) and axes.velocity is None:
        lacking.append("velocity_deg_s" if conditions.velocity_deg_s is None else "a second speed")
    if any(cell.load != "constant" for cell in cells) and axes.load is None:
        lacking.append("load_nm" if conditions.load_nm is None else "a second load")
    if any(cell.time == "within_run" for cell in cells) and conditions.time_s is None:
        lacking.append("time_s")
    if any(cell.frame == "polygon" for cell in cells) and conditions.face is None:
        lacking.append("face")
    return (
        "the campaign lacks " + " and ".join(lacking) if lacking else "the campaign has no readings that show it"
    )
