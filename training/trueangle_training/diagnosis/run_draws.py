"""Effects that are drawn anew in each run: what of them can be told within a held-out run.

Nobody can predict the draw of a new run. So the run is cut into blocks; the draw (amplitude, phase, place) is
fitted on every other block and scored on the ones between, both ways. How large draws are comes from
the training runs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.effect import Hypothesis

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

BLOCKS_OF_RUN = 8
NEGLIGIBLE = 1e-9
LIKELY_EVENT = 0.2
"""Prior probability that a run has an event, where the training runs do not say otherwise."""


def predicted_draws(
    problem: Problem,
    left_arcsec: Floats,
    effect: str,
    rows: Mask,
    *,
    draw_arcsec2: float,
    noise_arcsec2: float,
) -> Floats:
    """[readings]: the effect's curve in the held-out runs of `rows`, each half from the other one; 0 elsewhere.

    `left_arcsec`: [readings], errors less all that was predicted otherwise, before offsets; `draw_arcsec2`: mean
    square of the effect over the readings of a run that has it.
    """
    curve = np.zeros(left_arcsec.size)
    shapes = [each for each in problem.hypotheses if each.effect == effect]
    run = problem.conditions.run
    for each in np.unique(run[rows]):
        here = np.flatnonzero(rows & (run == each))
        columns = _of_run(shapes, here)
        if not columns:
            continue
        block = np.arange(here.size) * min(BLOCKS_OF_RUN, here.size) // here.size
        for half in (0, 1):
            fitted = block % 2 == half
            if fitted.sum() < 3 or (~fitted).sum() < 2:
                continue
            predicted = _averaged(columns, left_arcsec[here], fitted, draw_arcsec2, noise_arcsec2)
            curve[here[~fitted]] = predicted[~fitted]
    return curve


def _of_run(shapes: Sequence[Hypothesis], here: Integers) -> list[Floats]:
    """Main columns that are not 0 on these readings, of each shape that has some."""
    found: list[Floats] = []
    for shape in shapes:
        columns = shape.main[here]
        kept = columns[:, np.ptp(columns, axis=0) > NEGLIGIBLE]
        if kept.shape[1]:
            found.append(kept)
    return found


def _averaged(
    shapes: Sequence[Floats], left: Floats, fitted: Mask, draw_arcsec2: float, noise_arcsec2: float
) -> Floats:
    """[readings of the run]: posterior mean over all shapes and over there being none."""
    log_evidence, curves = [np.log1p(-LIKELY_EVENT)], [np.zeros(left.size)]
    prior_each = np.log(LIKELY_EVENT / len(shapes))
    values = left[fitted] - left[fitted].mean()
    for columns in shapes:
        centred = columns - columns[fitted].mean(axis=0)
        size = float(np.mean(np.sum((columns - columns.mean(axis=0)) ** 2, axis=1)))
        if size <= NEGLIGIBLE:
            continue
        prior = draw_arcsec2 / size
        inside = centred[fitted]
        gram = inside.T @ inside / noise_arcsec2
        score = inside.T @ values / noise_arcsec2
        precision = gram + np.eye(gram.shape[0]) / prior
        mean = np.linalg.solve(precision, score)
        log_evidence.append(
            prior_each + 0.5 * float(score @ mean) - 0.5 * float(np.linalg.slogdet(prior * precision)[1])
        )
        curves.append(centred @ mean)
    weight = np.exp(np.array(log_evidence) - max(log_evidence))
    return np.asarray((weight / weight.sum()) @ np.array(curves, dtype=np.float64))
