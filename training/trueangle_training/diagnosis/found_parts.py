"""What the attribution found, as the map of cells takes it: the shape, its cell, and where it may lie as well."""

from dataclasses import replace

import numpy as np

from trueangle_training.diagnosis.attribution import Attribution, Member
from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.choice import NARROW
from trueangle_training.diagnosis.containment import Spans
from trueangle_training.diagnosis.design_check import CARRIED
from trueangle_training.diagnosis.generic import ODD_RUN_FAMILY
from trueangle_training.diagnosis.location import CellFit, Elsewhere, FoundPart, order_shares
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.selection import NEAR_NATS
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.effect import Hypothesis, Nature

SIMPLE_COLUMNS = 2
"""Cosine and sine of one order: what one cell says in full."""
LINE_ORDERS = ("N", "2N", "4N")


def found_parts(problem: Problem, attribution: Attribution, spans: Spans) -> tuple[FoundPart, ...]:
    """Of each member, in their order."""
    return tuple(
        FoundPart(
            cell=problem.hypotheses[member.hypothesis_index].cell,
            fit=_cell_fit(problem.hypotheses[member.hypothesis_index]),
            curve_arcsec=member.curve_arcsec,
            elsewhere=_elsewhere(problem, attribution, spans, place),
        )
        for place, member in enumerate(attribution.members)
    )


def _elsewhere(problem: Problem, attribution: Attribution, spans: Spans, place: int) -> Elsewhere | None:
    """The likeliest other cell that the plan or the noise does not rule out; None: there is none.

    A pattern with a curve of its own that could carry what was found is the same under this plan; any pattern that
    is nearly as likely may be the true one.
    """
    member = attribution.members[place]
    rivals = attribution.rivals[place]
    own = next((rival.log_evidence for rival in rivals if _same(problem, rival.hypothesis_index, member)), None)
    least = (member.log_evidence if own is None else own) - NEAR_NATS
    for rival in rivals:
        shape = problem.hypotheses[rival.hypothesis_index]
        if rival.log_evidence <= 0.0 or shape.cell == problem.hypotheses[member.hypothesis_index].cell:
            continue
        carried = min(1.0, spans.carried_by(shape.main, member.curve_arcsec))
        if rival.log_evidence >= least or (shape.nature is not Nature.RANDOM and carried >= CARRIED):
            return Elsewhere(cell=_cell_of(problem, shape, member), carried=carried)
    found = problem.hypotheses[member.hypothesis_index]
    if found.effect is None and found.cell.temperature != "constant" and _each_temperature_once(problem):
        # Whatever goes with temperature goes with the campaign then.
        return Elsewhere(cell=replace(found.cell, temperature="constant", time="between_runs"), carried=1.0)
    return None


def _cell_of(problem: Problem, shape: Hypothesis, member: Member) -> Cell:
    """Where a shape would have what was found: any pattern over the faces at the order that has most of it."""
    if _cell_fit(shape) is not CellFit.ANY_ORDER:
        return shape.cell
    part = FoundPart(cell=shape.cell, fit=CellFit.ANY_ORDER, curve_arcsec=member.curve_arcsec)
    unit = np.unique(problem.conditions.run, return_inverse=True)[1].astype(np.int64)
    shares = order_shares(part, problem.conditions.angle_deg, unit)
    return max(shares, key=lambda cell: shares[cell])


def _each_temperature_once(problem: Problem) -> bool:
    """Whether no temperature was come back to."""
    axes = axes_of(problem.conditions)
    if axes.temperature_level is None:
        return False
    level = axes.temperature_level[np.argsort(axes.run_index, kind="stable")]
    return int(np.count_nonzero(np.diff(level))) == np.unique(level).size - 1


def _same(problem: Problem, hypothesis_index: int, member: Member) -> bool:
    shape, own = problem.hypotheses[hypothesis_index], problem.hypotheses[member.hypothesis_index]
    return (shape.effect, shape.family) == (own.effect, own.family)


def _cell_fit(shape: Hypothesis) -> CellFit:
    if shape.main.shape[1] <= SIMPLE_COLUMNS:
        return CellFit.WHOLE
    if shape.cell.order in LINE_ORDERS or (shape.effect is None and shape.main.shape[1] <= NARROW):
        # Sums of line orders, and one order that drifts along a parabola: one place, which no cell alone carries.
        return CellFit.WHOLE
    if shape.family == ODD_RUN_FAMILY or shape.cell.frame == "polygon":
        return CellFit.ANY_ORDER
    # Own draws of one order in each run have many columns and yet one place.
    return CellFit.WHOLE if shape.nature is Nature.RANDOM else CellFit.HINT
