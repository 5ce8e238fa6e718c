"""Two names for one pattern, and further names that the library's own error may have made."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.training import gap_campaigns

from trueangle_training.diagnosis.attribution import attribute
from trueangle_training.diagnosis.curve_error import CURVE_ERROR, within_curve_error
from trueangle_training.diagnosis.design_check import design_check
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.verdict import Verdict, VerdictKind, verdict_of

Floats = NDArray[np.float64]
RISING_C = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
"""The temperature is a clock: what settles looks like a line in temperature with a constant part."""


def _problem(seed: int, pattern: gap_campaigns.Pattern | None) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(seed, pattern, temperatures_c=RISING_C), shapes=True)


def _verdict(problem: Problem) -> Verdict:
    return verdict_of(problem, attribute(problem), design_check(problem.without_errors()))


def test_a_pattern_that_settles_is_not_named_as_a_constant_and_a_thermal_one() -> None:
    def settling(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
        return 1.2 * (np.log1p(run / 2.0) - 0.8) * np.cos(6 * theta + 0.4)

    verdict = _verdict(_problem(61, settling))
    assert verdict.named == ()
    assert verdict.kind is VerdictKind.UNKNOWN


def test_two_effects_of_one_order_with_a_phase_each_are_named() -> None:
    def two(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
        return 0.8 * np.cos(6 * theta + 0.4) + 0.06 * (t - 20) * np.cos(6 * theta + 1.7)

    named = {cause.effect for cause in _verdict(_problem(62, two)).named}
    assert named >= {"graduation_error", "thermal_graduation"}


@pytest.mark.parametrize(("order", "share", "within"), [("0", 0.5, True), ("0", 2.0, False), ("7", 0.5, False)])
def test_a_further_name_must_exceed_what_the_whole_curve_of_the_first_is_known_to(
    order: str, share: float, within: bool
) -> None:
    problem = _problem(63, None)
    spans = design_check(problem.without_errors()).spans
    drift = [i for i, each in enumerate(problem.hypotheses) if each.effect == "index_drift"]
    visible = float(np.median(spans.visible[drift][spans.visible[drift] >= 0.01]))
    leading = problem.hypotheses[drift[0]].main[:, 0]
    seen = spans.projected(leading)
    steps = spans.projected(np.where(np.arange(len(problem)) > 200, np.arange(len(problem)) % 2 - 0.5, 0.0))
    further = steps * np.linalg.norm(seen) / np.linalg.norm(steps) * CURVE_ERROR * np.sqrt(share / visible)
    assert within_curve_error(problem, spans, leading, ["index_drift"], further, order) is within
