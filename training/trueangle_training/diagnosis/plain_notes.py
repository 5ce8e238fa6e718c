"""Notes of a report on the readings themselves: which were set aside, and what a few of them still say."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle_training.diagnosis.noise import NoiseModel
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import recalibration_span
from trueangle_training.diagnosis.scatter import loud_run

Floats = NDArray[np.float64]

MOVED_ARCSEC = 1e-6
SHOWN_SPANS = 12
LONG_SPAN = 3
"""Readings in a row that are no single wild ones."""


def disturbed_note(campaign: Campaign, problem: Problem, cleaned_arcsec: Floats) -> tuple[str, ...]:
    """Which readings were drawn in before the runs were judged; () where none was."""
    moved = np.abs(cleaned_arcsec - problem.error_arcsec)
    rows = moved > MOVED_ARCSEC
    if not rows.any():
        return ()
    reading = np.arange(len(problem)) if problem.reading is None else problem.reading
    together = spans(np.sort(campaign.row[reading[rows]]).tolist())
    lines = ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in together[:SHOWN_SPANS])
    readings = "1 reading was" if rows.sum() == 1 else f"{int(rows.sum())} readings were"
    more = " ..." if len(together) > SHOWN_SPANS else ""
    note = (
        f"{readings} taken for disturbances and drawn to their neighbours, by up to "
        f"{float(moved.max()):.3g} arcsec (lines {lines}{more}): the answer is about the others"
    )
    if any(last - first + 1 >= LONG_SPAN for first, last in together):
        note += "; several in a row can be counts lost for a while or to the end of the run, too: look at them"
    return (note,)


def loud_note(problem: Problem, noise: NoiseModel) -> tuple[str, ...]:
    """Which run scatters beyond all others; () where none does."""
    run = loud_run(problem, noise)
    if run is None:
        return ()
    note = (
        f"run {run} scatters far beyond all other runs, in no pattern of the library: look at its clamping, the "
        "air, the light of the autocollimator; without that run the others can be judged"
    )
    return (note,)


def spans(lines: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of ascending numbers that follow each other."""
    found: list[tuple[int, int]] = []
    for line in lines:
        if found and line == found[-1][1] + 1:
            found[-1] = (found[-1][0], line)
        else:
            found.append((line, line))
    return found


def one_way_note(problem: Problem) -> tuple[str, ...]:
    """That both directions were measured, but never under one zero: a constant difference is then lost."""
    direction = problem.conditions.direction
    if direction is None or float(np.ptp(direction)) == 0.0:
        return ()
    _, group = np.unique(problem.conditions.zero_group, return_inverse=True)
    sense = np.bincount(group, weights=direction) / np.bincount(group)
    if not np.all(np.abs(sense) == float(np.max(np.abs(direction)))):
        return ()
    note = (
        "each zero was approached from one direction only: a difference between the directions that is the same "
        "at all angles (hysteresis at order 0), or latency at one speed, cannot be seen; measure both directions "
        "under one zero"
    )
    return (note,)


def still_said(problem: Problem) -> str:
    """What can be said of a campaign that shows no effect: its size beside the simulator, fitted and not."""
    _, index = np.unique(problem.conditions.zero_group, return_inverse=True)
    groups = int(index.max(initial=-1)) + 1
    off = problem.error_arcsec - problem.nominal_arcsec
    off = off - (np.bincount(index, weights=off) / np.bincount(index))[index]
    span = recalibration_span(problem)
    freedom = len(problem) - span.rank
    shipped = "readings and shipped simulator differ by"
    said = f"what can be said all the same: {shipped} {_rms(off, len(problem) - groups):.3g} arcsec RMS"
    if freedom < 1:
        return f"{said}; its parameters can be moved to fit every reading, so nothing is left to judge"
    left = _rms(span.outside(problem.error_arcsec), freedom)
    return f"{said}, {left:.3g} once its parameters are fitted to them ({freedom} degrees of freedom)"


def _rms(values: Floats, freedom: int) -> float:
    return float(np.sqrt(float(values @ values) / max(freedom, 1)))
