"""Does the clock of a campaign file run as a clock must?"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import NEW_RUN_GAP_S, Campaign
from trueangle_training.diagnosis.findings import DataFault

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

RARELY = 0.2
"""Part of the steps of a run. More of them backwards: the rows are sorted by something else than time."""
LEAP_OVER_USUAL = 20.0
"""A leap forwards inside a run is this much longer than any other gap inside runs."""
CLEARLY_SLOWER = 3.0
FEWEST_RUNS = 3
FEWEST_RUNS_IN_ORDER = 5
"""One fall of the clock among fewer runs may be their order in the file."""


def clock_faults(campaign: Campaign) -> Iterator[DataFault]:
    """`clock_not_increasing` and `clock_offset`, with the rows from which the clock is wrong."""
    time_s = campaign.time_s
    if time_s is None or not np.isfinite(time_s).all():
        return
    backwards, leaps, leap_s = _inside_runs(campaign, time_s)
    if backwards.any():
        yield _fault(
            campaign,
            "clock_not_increasing",
            backwards,
            f"at {int(backwards.sum())} rows inside runs time_s falls back from one row to the next",
        )
    elif leaps.any():
        yield _fault(
            campaign,
            "clock_offset",
            leaps,
            f"inside a run time_s leaps by {leap_s:.6g} s from one row to the next: the clock was set, or rows of "
            "two runs carry one number",
        )
    elif (overlapping := _overlapping_runs(campaign, time_s)).any():
        runs = np.unique(campaign.run[overlapping])
        yield _fault(
            campaign,
            "clock_offset",
            overlapping,
            f"{runs.size} runs were taken, by their time_s, while another run was going on: the clock of some "
            "runs is off",
        )
    elif (late := _set_back(campaign, time_s)).any():
        yield _fault(
            campaign,
            "clock_offset",
            late,
            "time_s falls back between two runs and nowhere else: the clock was set back, or two campaigns with "
            "clocks of their own are in one file",
        )
    elif (wrong := _against_motion(campaign, time_s)).any():
        yield _fault(
            campaign,
            "clock_offset",
            wrong,
            "readings at a constant speed lie farther apart, or nearer together, in time_s than their angles and "
            "velocity_deg_s allow",
        )


def _fault(campaign: Campaign, kind: str, rows: Mask, text: str) -> DataFault:
    return DataFault(kind=kind, rows=tuple(int(line) for line in campaign.row[rows]), text=text)


def _inside_runs(campaign: Campaign, time_s: Floats) -> tuple[Mask, Mask, float]:
    """Rows before which time falls back; rows from a leap forwards to the end of the run; the longest leap."""
    backwards, leaps = np.zeros(time_s.size, dtype=bool), np.zeros(time_s.size, dtype=bool)
    longest: list[tuple[float, float, Integers]] = []
    for run in np.unique(campaign.run):
        rows = np.flatnonzero(campaign.run == run)
        step = np.diff(time_s[rows])
        if step.size < 2:
            continue
        back = step < 0.0
        if back.any() and np.mean(back) <= RARELY:
            backwards[rows[1:][back]] = True
        ordered = np.sort(step)
        at = int(np.argmax(step))
        longest.append((float(ordered[-1]), float(ordered[-2]), rows[at + 1 :]))
    if len(longest) >= FEWEST_RUNS:
        others = max(second for _, second, _ in longest)
        firsts = sorted(first for first, _, _ in longest)
        usual = max(others, firsts[len(firsts) // 2])
        for first, _, rows in longest:
            if first > NEW_RUN_GAP_S and first > LEAP_OVER_USUAL * max(usual, 1e-9):
                leaps[rows] = True
    return backwards, leaps, max((first for first, _, _ in longest), default=0.0)


def _overlapping_runs(campaign: Campaign, time_s: Floats) -> Mask:
    """Readings of runs that begin while another one is going on."""
    runs, index = np.unique(campaign.run, return_inverse=True)
    begin, end = np.full(runs.size, np.inf), np.full(runs.size, -np.inf)
    np.minimum.at(begin, index, time_s)
    np.maximum.at(end, index, time_s)
    first_row = np.full(runs.size, time_s.size)
    np.minimum.at(first_row, index, np.arange(time_s.size))
    wrong = np.zeros(runs.size, dtype=bool)
    by_begin = np.argsort(begin, kind="stable")
    for one, other in pairwise(by_begin.tolist()):
        if begin[other] < end[one] - 1e-6:
            # The one that the file holds later is the one out of step.
            wrong[other if first_row[other] > first_row[one] else one] = True
    return wrong[index]


def _set_back(campaign: Campaign, time_s: Floats) -> Mask:
    """Rows from the one fall of the clock on; none where it falls more often: files sorted by temperature."""
    falls = np.flatnonzero(np.diff(time_s) < 0.0)
    late = np.zeros(time_s.size, dtype=bool)
    if falls.size == 1 and np.unique(campaign.run).size >= FEWEST_RUNS_IN_ORDER:
        late[falls[0] + 1 :] = True
    return late


def _against_motion(campaign: Campaign, time_s: Floats) -> Mask:
    """Readings of runs in motion of which one step in time does not fit the way and the speed, while most do."""
    wrong = np.zeros(time_s.size, dtype=bool)
    velocity = campaign.velocity_deg_s
    if velocity is None:
        return wrong
    for run in np.unique(campaign.run):
        rows = np.flatnonzero(campaign.run == run)
        speed = np.abs(velocity[rows])
        if rows.size < 8 or not (speed > 0.0).all() or np.ptp(speed) > 0.05 * speed.max():
            continue
        expected = np.abs(np.diff(campaign.angle_deg[rows])) / speed[1:]
        step = np.diff(time_s[rows])
        fits = np.abs(step - expected) <= 0.2 * expected + 0.02 * float(np.median(step))
        odd = (step > NEW_RUN_GAP_S + CLEARLY_SLOWER * expected) & ~fits
        if np.mean(fits) >= 1.0 - RARELY and odd.any():
            wrong[rows[int(np.argmax(odd)) + 1 :]] = True
    return wrong
