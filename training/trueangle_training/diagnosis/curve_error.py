"""How large a further name must be beside one of which the plan shows a small part only.

The library knows the whole curve of an effect to a tenth, in the orders in which the effect lives. Where
re-calibration takes up all of it but a hundredth, such an error is as large as what is left to be seen. The found
part may be that of any effect that could carry it, so the least visible one of the class counts.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.containment import LEAST_VISIBLE, Spans
from trueangle_training.diagnosis.problem import Problem

Floats = NDArray[np.float64]

CURVE_ERROR = 0.1
"""RMS of what a shape of the library is off by (time constants, courses of heat) over that of the whole curve."""


def within_curve_error(
    problem: Problem, spans: Spans, leading: Floats, leading_class: Sequence[str], further: Floats, order: str
) -> bool:
    """Whether a further curve [readings] of an order may be what the leading one's shape is off by."""
    seen, beside = spans.projected(leading), spans.projected(further)
    energy, least = float(seen @ seen), float(beside @ beside)
    return any(
        least < CURVE_ERROR**2 * energy / visible
        for name in leading_class
        if (visible := _visible(problem, spans, name, order)) is not None
    )


def _visible(problem: Problem, spans: Spans, name: str, order: str) -> float | None:
    """Median over an effect's visible shapes of an order of what re-calibration leaves; None: there is none."""
    own = [each.effect == name and each.cell.order == order for each in problem.hypotheses]
    shares = spans.visible[np.array(own, dtype=bool) & (spans.visible >= LEAST_VISIBLE)]
    return float(np.median(shares)) if shares.size else None
