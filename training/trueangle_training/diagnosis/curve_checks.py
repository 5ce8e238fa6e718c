"""Do the errors of a file belong together, and to the joint that JOINT.yaml describes?

A smooth curve, harmonics of the angle and their drift with temperature, is what every run of one joint shares.
Runs that show it enlarged by the ratio of two units, a ramp as of another line count, single readings far beyond
any noise, and a curve that has nothing in common with the shipped simulator are faults of the file.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_TURN, wrap_deg
from trueangle_training.diagnosis.findings import DataFault
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import less_group_mean, orthonormal, recalibration_columns

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

UNIT_RATIOS = {3600.0: "degrees", 60.0: "arcminutes", 1000.0: "thousandths of it", 206.264806: "milliradians"}
RATIO_ROOM = 0.25
"""Of a run's size from the ratio of two units: no effect enlarges a run tenfold, so it need not be exact."""
SAME_CURVE = 0.8
"""Correlation of a run's curve with that of the others."""
HARMONICS_OF_A_RUN = 5
FEWEST_READINGS_OF_A_RUN = 13
OUTLIER_OVER_NOISE = 50.0
"""Bursts of 30 standard deviations happen on sound benches."""
SMALLEST_OUTLIER_ARCSEC = 20.0
NEIGHBOURS_APART = 0.2
NORMAL_OVER_MAD = 1.4826
RAMP_SHARE = 0.8
SMALLEST_RAMP_ARCSEC = 25.0
"""Over a turn: creep and windup of sound joints stay below."""
NEARLY_A_LINE = 0.8
LARGEST_QUANTUM_ARCSEC = 1000.0
"""Of encoders with few lines: no effect of a joint grows that far over a turn."""
SHORTEST_RAMP_TURN = 0.25
UNRELATED = 0.15
"""Regression of the measured curve on the shipped one; 1 where the simulator is right."""
NOMINAL_OVER_REST = 3.0


def curve_faults(
    campaign: Campaign, joint: Joint, *, faults_before: bool
) -> tuple[tuple[DataFault, ...], tuple[str, ...]]:
    """Faults and notes; a file that is broken otherwise is not judged by its curve."""
    if faults_before:
        return (), ()
    mixed = _mixed_units(campaign)
    if mixed is not None:
        return (mixed,), ()
    outliers = _outliers(campaign)
    kept = ~outliers.rows
    ramp = ramp_fault(campaign, joint, kept)
    faults: list[DataFault] = [] if ramp is None else [ramp]
    if outliers.rows.any():
        shown = ", ".join(
            f"{line} ({value:+.4g} arcsec)"
            for line, value in list(
                zip(campaign.row[outliers.rows], outliers.off_arcsec[outliers.rows], strict=True)
            )[:10]
        )
        faults.append(
            DataFault(
                kind="outliers",
                rows=tuple(int(line) for line in campaign.row[outliers.rows]),
                text=f"{int(outliers.rows.sum())} single readings lie over {outliers.limit_arcsec:.3g} arcsec off "
                f"their neighbours: lines {shown}; are they typing errors or slipped faces?",
            )
        )
    return tuple(faults), ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Outliers:
    rows: Mask
    off_arcsec: Floats
    limit_arcsec: float


def _mixed_units(campaign: Campaign) -> DataFault | None:
    """Runs whose curve is that of the others, enlarged or shrunk by the ratio of two units."""
    runs, size, shape = _run_curves(campaign)
    if runs.size < 3:
        return None
    unit = shape / np.maximum(np.linalg.norm(shape, axis=1, keepdims=True), 1e-12)
    middle = np.median(unit, axis=0)
    alike = unit @ middle / max(float(np.linalg.norm(middle)), 1e-12)
    ratio = size / float(np.median(size))
    wrong, name = np.zeros(runs.size, dtype=bool), ""
    for factor, unit_name in UNIT_RATIOS.items():
        for each in (factor, 1.0 / factor):
            here = (np.abs(np.log(ratio / each)) < RATIO_ROOM) & (alike > SAME_CURVE)
            if here.any():
                wrong, name = wrong | here, unit_name if each < 1.0 else "another unit"
    # Where half of the runs are of each unit the median lies in between or on either: both halves are then named.
    if not wrong.any():
        low, high = float(size.min()), float(size.max())
        apart = [
            name for factor, name in UNIT_RATIOS.items() if abs(np.log(high / max(low, 1e-12) / factor)) < 0.1
        ]
        if apart and float(np.min(alike)) > SAME_CURVE:
            wrong, name = size < np.sqrt(low * high), apart[0]
    if not wrong.any():
        return None
    rows = np.isin(campaign.run, runs[wrong])
    return DataFault(
        kind="unit_mix",
        rows=tuple(int(line) for line in campaign.row[rows]),
        text=f"the errors of {int(wrong.sum())} runs have the shape of the others and another size (times "
        f"{float(np.median(ratio[wrong])):.3g}): they are in {name} instead of arcseconds",
    )


def _run_curves(campaign: Campaign) -> tuple[Integers, Floats, Floats]:
    """Runs of enough readings, the RMS of each about its mean, and its first harmonics [runs, 2 orders]."""
    chosen: list[int] = []
    size: list[float] = []
    shape: list[NDArray[np.floating]] = []
    for run in np.unique(campaign.run).tolist():
        rows = campaign.run == run
        if rows.sum() < FEWEST_READINGS_OF_A_RUN or np.ptp(campaign.angle_deg[rows]) < 180.0:
            continue
        design = np.column_stack(
            [np.ones(int(rows.sum())), _harmonics(campaign.angle_deg[rows], HARMONICS_OF_A_RUN)]
        )
        error = campaign.error_arcsec[rows]
        coefficients = np.linalg.lstsq(design, error, rcond=1e-6)[0]
        chosen.append(run)
        size.append(float(np.std(error)))
        shape.append(coefficients[1:])
    return (
        np.array(chosen, dtype=np.int64),
        np.array(size),
        np.array(shape, dtype=np.float64).reshape(len(chosen), 2 * HARMONICS_OF_A_RUN),
    )


def _harmonics(angle_deg: Floats, highest: int) -> Floats:
    theta = np.radians(np.mod(angle_deg, 360.0))
    return np.column_stack([f(k * theta) for k in range(1, highest + 1) for f in (np.cos, np.sin)])


def _outliers(campaign: Campaign) -> _Outliers:
    """Single readings far off both neighbours, which agree with each other, and off the same place in other runs.

    A lost count or a step stays after it happened; a defect of the grating comes again at its place.
    """
    off, apart = _off_neighbours(campaign)
    usual = NORMAL_OVER_MAD * float(np.median(np.abs(off)))
    limit = max(OUTLIER_OVER_NOISE * usual, SMALLEST_OUTLIER_ARCSEC)
    rows = (np.abs(off) > limit) & (apart < NEIGHBOURS_APART * np.abs(off))
    if rows.any():
        place = np.rint(wrap_deg(campaign.angle_deg) / 1.0).astype(np.int64) % 360
        there, flagged = np.bincount(place, minlength=360), np.bincount(place, weights=rows, minlength=360)
        rows &= flagged[place] <= np.maximum(1.0, there[place] / 3.0)
    return _Outliers(rows=rows, off_arcsec=off, limit_arcsec=limit)


def _off_neighbours(campaign: Campaign) -> tuple[Floats, Floats]:
    """Each reading less the mean of its two neighbours in its run, and how far these are apart.

    The joint's own curve bends between faces: what all runs have in common at a place is taken out first.
    """
    left = _less_common_curve(campaign)
    off, apart = np.zeros(left.size), np.full(left.size, np.inf)
    for run in np.unique(campaign.run):
        rows = np.flatnonzero(campaign.run == run)
        if rows.size < 3:
            continue
        values = left[rows]
        before = np.concatenate([[values[2]], values[:-1]])
        after = np.concatenate([values[1:], [values[-3]]])
        off[rows] = values - (before + after) / 2.0
        apart[rows] = np.abs(before - after)
    return off, apart


def _less_common_curve(campaign: Campaign) -> Floats:
    """Errors less the median over the runs at each degree of the turn, each counted from the median of its run."""
    run = np.unique(campaign.run, return_inverse=True)[1]
    left = campaign.error_arcsec - _medians(campaign.error_arcsec, run)[run]
    # Where steps are long and places seldom, neighbours differ by the joint's own first harmonics.
    waves = _harmonics(campaign.angle_deg, HARMONICS_OF_A_RUN)
    left = left - waves @ np.linalg.lstsq(waves, left, rcond=1e-6)[0]
    place = np.unique(np.rint(wrap_deg(campaign.angle_deg)) % 360, return_inverse=True)[1]
    count = np.bincount(place)
    common = np.where(count >= 3, _medians(left, place), 0.0)
    return left - common[place]


def _medians(values: Floats, group: Integers) -> Floats:
    """Median of each group 0, 1, ..."""
    order = np.lexsort((values, group))
    count = np.bincount(group)
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    ordered = values[order]
    return (ordered[start + (count - 1) // 2] + ordered[start + count // 2]) / 2.0


def ramp_fault(campaign: Campaign, joint: Joint, kept: Mask) -> DataFault | None:
    """A growth of the error in proportion to the angle, the mark of a wrong number of lines or counts."""
    angle = campaign.angle_deg[kept]
    _, group = np.unique(campaign.zero_group[kept], return_inverse=True)
    group = group.astype(np.int64)
    turn = angle / 360.0
    if np.ptp(turn) < SHORTEST_RAMP_TURN:
        return None
    table = less_group_mean(np.column_stack([campaign.error_arcsec[kept], turn, _harmonics(angle, 2)]), group)
    basis = orthonormal(table[:, 2:])
    outside = table[:, :2] - basis @ (basis.T @ table[:, :2])
    error, ramp = outside.T
    slope = float(ramp @ error / max(float(ramp @ ramp), 1e-12))
    share = slope**2 * float(ramp @ ramp) / max(float(error @ error), 1e-12)
    quantum = ARCSEC_PER_TURN / joint.encoder.lines_per_rev
    if share < RAMP_SHARE or abs(slope) < max(
        SMALLEST_RAMP_ARCSEC, NEARLY_A_LINE * min(quantum, LARGEST_QUANTUM_ARCSEC)
    ):
        return None
    lines = slope / quantum
    return DataFault(
        kind="wrong_line_count",
        rows=(),
        text=f"the error grows by {slope:.4g} arcsec over a turn in all runs, as of {lines:+.3g} lines "
        f"beside the {joint.encoder.lines_per_rev} of JOINT.yaml: wrong line count or counts_per_rev",
    )


def other_joint_faults(problem: Problem) -> tuple[DataFault, ...]:
    """`other_joint` where the measured curve has nothing in common with the simulator as shipped.

    Only where JOINT.yaml gives nominal parameters, the shipped curve is large beside what re-calibration leaves,
    and every modelled effect taken by itself has moved: one re-mounted part moves one effect, not all.
    """
    _, index = np.unique(problem.conditions.zero_group, return_inverse=True)
    index = index.astype(np.int64)
    columns = less_group_mean(recalibration_columns(problem), index)
    both = less_group_mean(np.column_stack([problem.error_arcsec, problem.nominal_arcsec]), index)
    basis = orthonormal(columns)
    error, nominal = (basis @ (basis.T @ both)).T
    rest = both[:, 0] - error
    own = float(nominal @ nominal)
    if own < NOMINAL_OVER_REST**2 * float(rest @ rest) or own == 0.0:
        return ()
    if _gain(error, nominal) > UNRELATED:
        return ()
    gains: list[float] = []
    for effect in dict.fromkeys(problem.modelled_effects):
        chosen = np.array([False] * problem.drift.shape[1] + [name == effect for name in problem.modelled_effects])
        span = orthonormal(columns[:, chosen])
        part = span @ (span.T @ nominal)
        if float(part @ part) > float(rest @ rest) / 4.0:
            gains.append(_gain(span @ (span.T @ error), part))
    if len(gains) < 2 or max(gains) > 0.6:
        return ()
    text = (
        f"the measured curve has nothing in common with the shipped simulator (regression "
        f"{_gain(error, nominal):.2f} instead of 1, every modelled effect has moved): a file from "
        "another joint, or JOINT.yaml of another one"
    )
    return (DataFault(kind="other_joint", rows=(), text=text),)


def _gain(error: Floats, nominal: Floats) -> float:
    return float(error @ nominal) / max(float(nominal @ nominal), 1e-12)
