"""Is the file sound? Faults of the data are named before any physics is looked for.

Every check rests on a contradiction inside the file, or between file and JOINT.yaml, that no effect of a joint can
cause: angles that run against the stated direction, clocks that run backwards, faces where no face is. A strong
hysteresis, a lost count or a burst of noise is physics and passes.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint, ReferenceKind
from trueangle.contract.units import ARCSEC_PER_DEG, ARCSEC_PER_TURN, DEG_PER_TURN, angle_difference_deg, wrap_deg
from trueangle_training.dataset import LARGEST_ERROR_ARCSEC, SHORTEST_COPY, SURELY_REVERSED, TEMPERATURE_LIMITS_C
from trueangle_training.diagnosis.clock_checks import RARELY, clock_faults
from trueangle_training.diagnosis.curve_checks import curve_faults, ramp_fault
from trueangle_training.diagnosis.findings import DataFault

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

FEWEST_STEPS = 3
"""Steps from one reading to the next from which a run shows in which sense it was driven."""
CLEARLY = 0.9
"""Part of the steps, or length of a mean unit vector, from which a statement is clear."""
SMALLEST_STEP_DEG = 0.01
RADIAN_TURN = 6.3
FEW = 0.1
"""Part of the readings up to which wrong ones are single ones."""
CHANCE_COPIES = 0.01
"""Part of the readings up to which equal ones are chance where no time tells them apart."""
FEWEST_ANGLES = 8
DECIMALS = 10**7
FINEST_LATTICE = 2**23
"""Counts per turn: a file's decimals show no finer ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataChecks:
    """What is wrong with a file, and what was noticed."""

    faults: tuple[DataFault, ...]
    notes: tuple[str, ...]


def data_checks(campaign: Campaign, joint: Joint) -> DataChecks:
    """All faults of the file at once; where units are wrong, only that is said: the rest would follow from it."""
    units = (*_unit_faults(campaign), *_size_faults(campaign, joint))
    if units:
        return DataChecks(faults=units, notes=())
    faults = [
        *_direction_faults(campaign),
        *clock_faults(campaign),
        *_copy_faults(campaign),
        *_face_faults(campaign, joint),
        *_lattice_faults(campaign, joint),
    ]
    curve, notes = curve_faults(campaign, joint, faults_before=bool(faults))
    return DataChecks(faults=(*faults, *curve), notes=(*notes, *_reference_note(campaign, joint)))


def _reference_note(campaign: Campaign, joint: Joint) -> tuple[str, ...]:
    """File and JOINT.yaml name different references: no reading is wrong by that, but one of the two files is."""
    if campaign.face is None or joint.reference.kind is ReferenceKind.POLYGON or not (campaign.face > 0).any():
        return ()
    faces = int(campaign.face.max())
    note = f"the campaign has polygon faces up to {faces}, the reference of JOINT.yaml is an encoder: one is wrong"
    return (note,)


def _fault(campaign: Campaign, kind: str, rows: Mask | None, text: str) -> DataFault:
    lines = () if rows is None else tuple(int(line) for line in campaign.row[rows])
    return DataFault(kind=kind, rows=lines, text=text)


def _unit_faults(campaign: Campaign) -> Iterator[DataFault]:
    error, angle, temperature = campaign.error_arcsec, campaign.angle_deg, campaign.temperature_c
    if float(np.ptp(error)) == 0.0:
        yield _fault(
            campaign, "errors_all_equal", None, f"all errors are {error[0]:g} arcsec: nothing was measured"
        )
    elif float(np.ptp(angle)) == 0.0:
        yield _fault(campaign, "angles_all_equal", None, f"all angles are {angle[0]:g} deg")
    elif float(np.ptp(angle)) < RADIAN_TURN and np.unique(np.round(angle, 3)).size >= FEWEST_ANGLES:
        yield _fault(
            campaign,
            "angle_unit",
            None,
            f"all angles lie within {np.ptp(angle):.4g}: degrees over the turn are expected; are they radians?",
        )
    if temperature is not None:
        lowest_c, highest_c = TEMPERATURE_LIMITS_C
        absurd = (temperature < lowest_c) | (temperature > highest_c)
        if absurd.any():
            yield _fault(
                campaign,
                "temperature_unit",
                absurd,
                f"temperatures such as {temperature[absurd][0]:g}: {lowest_c:g} to {highest_c:g} degC expected; "
                "are they in kelvin or degrees Fahrenheit?",
            )


def _size_faults(campaign: Campaign, joint: Joint) -> Iterator[DataFault]:
    """Errors beyond 5 deg: a turn left in the difference, another line count, slips of the pen, another unit."""
    error = campaign.error_arcsec
    off = error - float(np.median(error))
    absurd = np.abs(off) > LARGEST_ERROR_ARCSEC
    turned = absurd & (np.abs(off - ARCSEC_PER_TURN * np.rint(off / ARCSEC_PER_TURN)) < LARGEST_ERROR_ARCSEC)
    if absurd.any() and (ramp := ramp_fault(campaign, joint, np.ones(error.size, dtype=bool))) is not None:
        yield ramp
        return
    if turned.any():
        yield _fault(
            campaign,
            "whole_turn_jump",
            turned,
            f"{int(turned.sum())} errors differ by whole turns (1,296,000 arcsec) from the others: a turn was "
            "left in the difference of two angles",
        )
    elif (leaps := _angle_leaps(campaign)).any():
        yield _fault(
            campaign,
            "whole_turn_jump",
            leaps,
            f"at {int(leaps.sum())} readings the angle leaps by whole turns from one reading to the next: 2 pi "
            "was added or taken away at the wrong place",
        )
    if (wrong := absurd & ~turned).any():
        few = float(np.mean(wrong)) < FEW
        yield _fault(
            campaign,
            "outliers" if few else "error_unit",
            wrong,
            f"{int(wrong.sum())} errors of up to {np.abs(error[wrong]).max():.6g} arcsec, more than 5 deg: "
            + ("typing errors or slipped faces?" if few else "is the angle or the error in another unit?"),
        )


def _angle_leaps(campaign: Campaign) -> Mask:
    """Readings before which the angle leaps by whole turns, other than from 360 back to 0 or from 0 to 360."""
    leaps = np.zeros(len(campaign), dtype=bool)
    angle = campaign.angle_deg
    for rows in _runs_in_time(campaign):
        step = np.diff(angle[rows])
        if step.size < FEWEST_STEPS:
            continue
        usual = float(np.median(step))
        turns = np.rint((step - usual) / DEG_PER_TURN)
        room = 0.2 * abs(usual) + 0.5
        exact = (turns != 0) & (np.abs(step - usual - turns * DEG_PER_TURN) < room)
        single = (angle[rows] >= -1.0) & (angle[rows] < DEG_PER_TURN + 1.0)
        wrapped = single[1:] & single[:-1] & (np.abs(turns) == 1)
        leaps[rows[1:][exact & ~wrapped]] = True
    return leaps


def _runs_in_time(campaign: Campaign) -> Iterator[Integers]:
    """Indices of each run's readings in the order in which they were taken."""
    for run in np.unique(campaign.run):
        rows = np.flatnonzero(campaign.run == run)
        # A file sorted by something else than time falls back often, a clock that was set only once.
        if (
            campaign.time_s is not None
            and rows.size > 1
            and np.isfinite(campaign.time_s[rows]).all()
            and np.mean(np.diff(campaign.time_s[rows]) < 0.0) > RARELY
        ):
            rows = rows[np.argsort(campaign.time_s[rows], kind="stable")]
        yield rows


def _direction_faults(campaign: Campaign) -> Iterator[DataFault]:
    """Runs whose angles go the other way than `direction` or the sign of `velocity_deg_s` says."""
    against_direction = np.zeros(len(campaign), dtype=bool)
    against_velocity = np.zeros(len(campaign), dtype=bool)
    for rows in _runs_in_time(campaign):
        step = np.diff(campaign.angle_deg[rows])
        # A step through the end of the turn goes on in the same sense.
        step = np.where(np.abs(step) > DEG_PER_TURN / 2, step - DEG_PER_TURN * np.sign(step), step)
        moved = np.abs(step) > SMALLEST_STEP_DEG
        sense = np.sign(step)
        for column, against in (
            (campaign.direction, against_direction),
            (campaign.velocity_deg_s, against_velocity),
        ):
            if column is None:
                continue
            stated = np.sign(np.nan_to_num(column[rows]))
            # The first reading after a reversal has been reached in the new sense, but some files count it to the
            # old one.
            judged = moved & (stated[1:] != 0) & (stated[1:] == stated[:-1])
            for sign in (1.0, -1.0):
                here = judged & (stated[1:] == sign)
                if here.sum() >= FEWEST_STEPS and np.mean(sense[here] == -sign) >= CLEARLY:
                    against[rows[stated == sign]] = True
    for name, against in (("direction", against_direction), ("velocity_deg_s", against_velocity)):
        if against.any():
            runs = np.unique(campaign.run[against])
            yield _fault(
                campaign,
                "direction_swapped",
                against,
                f"in {runs.size} runs the angles go the other way than the column {name} says (+ is increasing "
                "indicated angle): its sign is swapped there, or the angles are mirrored",
            )


def _copy_faults(campaign: Campaign) -> Iterator[DataFault]:
    columns = [
        campaign.angle_deg,
        campaign.error_arcsec,
        campaign.run,
        campaign.temperature_c,
        campaign.time_s,
        campaign.direction,
    ]
    table = np.column_stack([each.astype(np.float64) for each in columns if each is not None])
    _, first = np.unique(np.nan_to_num(table), axis=0, return_index=True)
    copies = np.ones(len(campaign), dtype=bool)
    copies[first] = False
    if copies.any() and (campaign.time_s is not None or not _by_chance(copies)):
        yield _fault(
            campaign,
            "duplicated_rows",
            copies,
            "1 row repeats an earlier one in all columns"
            if copies.sum() == 1
            else f"{int(copies.sum())} rows repeat an earlier one in all columns",
        )
        return
    seen: dict[bytes, int] = {}
    for run in np.unique(campaign.run).tolist():
        here = campaign.run == run
        errors = campaign.error_arcsec[here]
        if errors.size < SHORTEST_COPY or float(np.ptp(errors)) == 0.0:
            continue
        other = seen.setdefault(errors.tobytes(), run)
        if other != run:
            yield _fault(
                campaign,
                "copied_run",
                here,
                f"run {run} has the errors of run {other} to the last digit: copied instead of measured?",
            )


def _by_chance(copies: Mask) -> bool:
    """Without a clock a few readings may agree in all digits: single ones, and few of them."""
    in_a_row = bool(np.any(copies[1:] & copies[:-1]))
    return not in_a_row and float(np.mean(copies)) < CHANCE_COPIES


def _face_faults(campaign: Campaign, joint: Joint) -> Iterator[DataFault]:
    """Angles against the polygon's faces: mirrored, stretched, or another polygon."""
    face, faces = campaign.face, joint.reference.faces
    if face is None or not (face > 0).any():
        return
    if faces is not None and (beyond := face > faces).any():
        yield _fault(
            campaign,
            "other_joint",
            beyond,
            f"face {int(face.max())} of a polygon that has {faces} according to JOINT.yaml: another joint's file?",
        )
        return
    pitch = DEG_PER_TURN / (faces or int(face.max()))
    shift = 0 if campaign.polygon_offset is None else campaign.polygon_offset
    nominal = np.asarray((face - 1 + shift) * pitch, dtype=np.float64)
    rows = face > 0
    follows, mirrored = (
        _agreement(campaign.angle_deg, sign * nominal, campaign.run, rows) for sign in (1.0, -1.0)
    )
    if follows >= CLEARLY:
        yield from _sign_faults(campaign, nominal, rows)
    elif mirrored >= CLEARLY:
        yield _fault(
            campaign,
            "angle_mirrored",
            rows,
            "the angles decrease while the numbers of the faces increase: the angle is mirrored (encoder counting "
            "in the other sense), or the faces are numbered backwards",
        )
    else:
        yield _fault(
            campaign,
            "wrong_line_count",
            rows,
            f"the angles do not follow the faces, {pitch:.4g} deg from one to the next"
            f"{_stretch(campaign, nominal, rows)}: wrong line count or counts_per_rev, or another polygon",
        )


def _agreement(angle: Floats, nominal: Floats, run: Integers, rows: Mask) -> float:
    """Median over runs of |mean exp i (angle - nominal)|: 1 where the angles follow, wherever their zero is."""
    unit = np.exp(1j * np.radians(angle - nominal))
    lengths = [
        abs(np.mean(unit[here])) for each in np.unique(run[rows]) if (here := rows & (run == each)).sum() > 2
    ]
    return float(np.median(lengths)) if lengths else 1.0


def _stretch(campaign: Campaign, nominal: Floats, rows: Mask) -> str:
    slopes = [
        float(np.polyfit(nominal[here], campaign.angle_deg[here], 1)[0])
        for each in np.unique(campaign.run[rows])
        if (here := rows & (campaign.run == each)).sum() > 2 and np.ptp(nominal[here]) > 0
    ]
    return f" (they grow {np.median(slopes):.5g} times as fast)" if slopes else ""


def _sign_faults(campaign: Campaign, nominal: Floats, rows: Mask) -> Iterator[DataFault]:
    """Where the shaft stopped at the autocollimator's null, angle less polygon is the error but for an offset."""
    group = np.unique(campaign.zero_group[rows], return_inverse=True)[1]
    off = campaign.angle_deg[rows] - nominal[rows]
    # From the first of each group, wherever the polygon sits on the shaft.
    off = angle_difference_deg(off, off[np.unique(group, return_index=True)[1]][group])
    shown, stated = (_less_mean(each, group) for each in (off * ARCSEC_PER_DEG, campaign.error_arcsec[rows]))
    scatter = float(np.std(shown) * np.std(stated))
    # Stops that are only near the null scatter by far more than any error and say nothing.
    if scatter == 0.0 or float(np.std(shown)) > 20.0 * float(np.std(stated)) + 1.0:
        return
    correlation = float(np.mean(shown * stated)) / scatter
    ratio = float(np.std(stated) / np.std(shown))
    if correlation < -SURELY_REVERSED:
        yield _fault(
            campaign,
            "error_sign_reversed",
            None,
            f"the errors run against the indicated angles (correlation {correlation:.2f}): indicated minus "
            "reference is expected",
        )
    elif correlation > SURELY_REVERSED and not 0.2 <= ratio <= 2.0:
        yield _fault(
            campaign,
            "error_unit",
            None,
            f"the errors are {ratio:.3g} times as large as the indicated angles show them: another unit?",
        )


def _less_mean(values: Floats, group: Integers) -> Floats:
    return values - (np.bincount(group, weights=values) / np.bincount(group))[group]


def _lattice_faults(campaign: Campaign, joint: Joint) -> Iterator[DataFault]:
    """Angles on the lattice of another number of counts than JOINT.yaml's, and of none that divides it."""
    counts = joint.encoder.counts_per_rev
    if counts > FINEST_LATTICE or _on_lattice(campaign.angle_deg, counts) >= CLEARLY / 2:
        return
    others = {2**bits for bits in range(8, 24)} | {joint.encoder.lines_per_rev} | _own_lattice(campaign.angle_deg)
    others |= {counts * up // down for up in (1, 2, 3, 4, 5, 8, 10) for down in (1, 2, 3, 4, 5, 8, 10)}
    found = [each for each in sorted(others - {counts}) if _on_lattice(campaign.angle_deg, each) >= CLEARLY]
    # A coarse lattice that few distinct angles happen to share proves nothing.
    distinct = np.unique(np.round(wrap_deg(campaign.angle_deg), 7)).size
    found = [each for each in found if counts % each != 0 and distinct >= FEWEST_ANGLES and each > 4 * distinct]
    if found:
        polygon = joint.reference.kind is ReferenceKind.POLYGON and joint.reference.faces in found
        if not polygon:
            yield _fault(
                campaign,
                "wrong_line_count",
                None,
                f"the indicated angles are whole multiples of 1/{found[0]} turn, not of 1/{counts} as JOINT.yaml "
                "has it: another encoder, or a wrong counts_per_rev",
            )


def _own_lattice(angle_deg: Floats) -> set[int]:
    """Counts per turn that the smallest steps between angles suggest; none where decimals make the lattice.

    The step is taken from the smallest difference and refined with ever larger ones, each of which is a whole
    number of steps as long as the step is known to half of one.
    """
    differences = np.unique(np.round(np.diff(np.unique(angle_deg)), 10))
    differences = differences[differences > DEG_PER_TURN / (2 * FINEST_LATTICE)]
    if differences.size < FEWEST_ANGLES:
        return set()
    found: set[int] = set()
    for part in (1, 2, 3):
        step = float(differences[0]) / part
        for difference in differences.tolist():
            steps = difference / step
            if abs(steps - round(steps)) < 0.25:
                step = difference / round(steps)
        counts = round(DEG_PER_TURN / step)
        # Steps of 0.0001 deg are those of a file's digits.
        if 2**8 <= counts <= FINEST_LATTICE and (360 * DECIMALS) % counts != 0:
            found.add(counts)
    return found


def _on_lattice(angle_deg: Floats, counts: int) -> float:
    """|mean exp i phase| of the angles within a count: 1 on the lattice, about 0 off it."""
    phase = np.mod(angle_deg / DEG_PER_TURN, 1.0) * counts
    return float(abs(np.mean(np.exp(2j * np.pi * phase))))
