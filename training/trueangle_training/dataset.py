"""From a campaign file to readings that a model may be trained on: what must never be trained on is refused here.

A file with a wrong unit, a copied run or a mixed zero trains without complaint and then serves wrong angles that
look right. Every check says what it saw and in which lines, and all faults come at once.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Interval
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN, angle_difference_deg, wrap_deg
from trueangle_training.file_lines import leave_out_advice, lines_text
from trueangle_training.methods import TrainingReadings, distinct_angle_count
from trueangle_training.methods.base_series import SAME_TEMPERATURE_C
from trueangle_training.outliers import conspicuous_warnings, contradiction_faults, contradictions
from trueangle_training.temperature_places import (
    FEWEST_ANGLES,
    SAME_PLACE_DEG,
    base_place_faults,
    place_warnings,
    places_by_temperature,
    valid_temperature,
    whole_temperature_faults,
    widest_gap_deg,
)
from trueangle_training.temperature_units import base_temperature_warnings, mixed_unit_faults

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

SMALLEST_PEAK_TO_PEAK_ARCSEC = 0.2
"""No joint is that good: 0.2 arcsec are 720 arcsec taken for degrees."""
LARGEST_ERROR_ARCSEC = 18_000.0
TEMPERATURE_LIMITS_C = (-60.0, 150.0)
ANY_TEMPERATURE_C = 20.0
"""Stands for the temperature where it is not used; no figure depends on it."""
RADIAN_TURN = 6.3
FEWEST_ANGLES_TO_JUDGE = 8
LARGEST_SPAN_DEG = 36_000.0
SHORTEST_COPY = 3
SURELY_REVERSED = 0.7
ROWS_SHOWN = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrainingSet:
    """Readings fit for training, and the ranges in which a model made of them may be used."""

    readings: TrainingReadings
    datum_deg: float
    """Where the errors are counted from, [0, 360)."""
    valid_angle_deg: Interval
    valid_temperature_c: Interval
    notes: tuple[str, ...]
    """What was left out, in plain words."""
    warnings: tuple[str, ...] = ()
    """What is trained on although it is conspicuous, by file line."""

    @property
    def raw_rms_arcsec(self) -> float:
        """Root mean square of the errors before any correction, from the datum."""
        return float(np.sqrt(np.mean(self.readings.error_arcsec**2)))

    @property
    def raw_centred_rms_arcsec(self) -> float:
        """The same, counted from the mean of each zero group."""
        return centred_rms(self.readings.error_arcsec, self.readings)


def training_set(
    campaign: Campaign,
    *,
    base_temperature_c: float | None,
    base_order: int | None = None,
    joint_base_temperature_c: float | None = None,
    parameters: int = 0,
    validation_fraction: float = 0.0,
    faces: int | None = None,
    free_offsets: bool = False,
    temperature_used: bool = True,
) -> TrainingSet:
    """Check the campaign and make it a training set.

    `base_temperature_c` is that of methods which need runs at it, None for others, and `base_order` the harmonics
    that they are asked for there, None: as many as the angles allow; `joint_base_temperature_c` is the described
    joint's, near which a campaign is expected to have runs, None where no joint is described; `parameters` is the
    number that the method fits to the part of the readings that is not kept for validation; `faces` is the
    polygon's number where it is known; `free_offsets` says that the method estimates the zero of every group, so
    that groups may be zeroed anywhere; without `temperature_used` the column may be missing and nothing is asked
    of it. ContractError lists every fault with file and lines.
    """
    if not temperature_used:
        campaign = replace(campaign, temperature_c=np.full(len(campaign), ANY_TEMPERATURE_C))
    if campaign.temperature_c is None:
        found = "no such column, or no value in it"
        where = f"{campaign.source}, column temperature_c"
        raise ContractError([Fault(where=where, expected="the joint's temperature in degC", found=found)])
    with_temperature = ~np.isnan(campaign.temperature_c)
    temperature_c = campaign.temperature_c[with_temperature]
    notes = list(campaign.notes)
    if not with_temperature.all():
        left_out = campaign.row[~with_temperature]
        notes.append(f"{left_out.size} readings without a temperature were left out ({lines_text(left_out)})")
    angle_deg, error_arcsec = campaign.angle_deg[with_temperature], campaign.error_arcsec[with_temperature]
    valid_angle_deg, gap_faults = _valid_angle(campaign)
    whole_turn = valid_angle_deg.maximum - valid_angle_deg.minimum == DEG_PER_TURN
    datum_deg, zero_faults = _datum(campaign, free_offsets=free_offsets)
    # The first face is the encoder's zero; a stop a few arcminutes after it stands for it, and where every group's
    # zero is estimated any place of the turn may be the datum.
    datum_deg = 0.0 if whole_turn and (datum_deg <= SAME_PLACE_DEG or free_offsets) else datum_deg
    readings = TrainingReadings(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        temperature_c=temperature_c,
        run=campaign.run[with_temperature],
        zero_group=campaign.zero_group[with_temperature],
        datum_deg=datum_deg,
    )
    faults = [
        *_unit_faults(campaign),
        *(_temperature_faults(campaign, readings, base_temperature_c) if temperature_used else ()),
        *(base_place_faults(campaign, base_temperature_c, base_order) if temperature_used else ()),
        *_copy_faults(campaign),
        *_face_faults(campaign, faces),
        *_sign_faults(campaign, faces),
        *_number_faults(campaign, len(readings), parameters, validation_fraction),
        *zero_faults,
        *gap_faults,
    ]
    row = campaign.row[with_temperature]
    places = places_by_temperature(readings, row) if temperature_used and not faults else ()
    # Only data that are sound otherwise have a curve that temperatures and single readings can be held against.
    if temperature_used and not faults:
        faults = whole_temperature_faults(places, source=campaign.source)
    found = None if faults else contradictions(readings)
    if found is not None:
        faults = contradiction_faults(campaign, readings, row, found)
    # After the runs: one that is wrong as a whole bends the curve, and other temperatures then seem to be wrong.
    if temperature_used and not faults:
        faults = mixed_unit_faults(readings, row, source=campaign.source)
    if faults:
        raise ContractError(faults)
    # All that an encoder meets, where temperature is ignored.
    lowest_c, highest_c = TEMPERATURE_LIMITS_C
    return TrainingSet(
        readings=readings,
        datum_deg=datum_deg,
        valid_angle_deg=valid_angle_deg,
        valid_temperature_c=valid_temperature(places) or Interval(minimum=lowest_c, maximum=highest_c),
        notes=tuple(notes),
        warnings=(
            *base_temperature_warnings(
                readings.run_mean_temperature_c(),
                joint_base_temperature_c if temperature_used else None,
                source=campaign.source,
            ),
            *place_warnings(places, source=campaign.source),
            *(() if found is None else conspicuous_warnings(campaign, readings, row, found)),
        ),
    )


def centred_rms(values_arcsec: Floats, readings: TrainingReadings) -> float:
    """Root mean square of values at the readings, each less the mean of its zero group."""
    group = readings.offset_group
    means = np.bincount(group, weights=values_arcsec) / np.bincount(group)
    return float(np.sqrt(np.mean((values_arcsec - means[group]) ** 2)))


def without_rows(campaign: Campaign, rows: frozenset[int]) -> Campaign:
    """The campaign without the readings of these file lines, and a note that says so.

    ContractError where a line holds no reading.
    """
    unknown = sorted(rows - set(campaign.row.tolist()))
    if unknown:
        expected = f"lines of {campaign.source} that hold a reading"
        raise ContractError([Fault(where="--exclude-rows", expected=expected, found=lines_text(unknown))])
    keep = ~np.isin(campaign.row, sorted(rows))
    if not keep.any():
        raise ContractError([Fault(where="--exclude-rows", expected="readings left over", found="none")])
    columns = {
        field.name: values[keep]
        for field in fields(campaign)
        if isinstance(values := getattr(campaign, field.name), np.ndarray)
    }
    were = "readings were" if len(rows) > 1 else "reading was"
    note = f"{len(rows)} {were} left out by the user ({lines_text(sorted(rows))})"
    return replace(campaign, **columns, notes=(*campaign.notes, note))


def readings_needed(parameters: int, validation_fraction: float) -> int:
    """The smallest number of readings whose training part is larger than the number of parameters."""
    needed = parameters + 1
    while needed - round(validation_fraction * needed) <= parameters:
        needed += 1
    return needed


def _at_rows(campaign: Campaign, column: str, wrong: Mask) -> str:
    return f"{campaign.source} {lines_text(campaign.row[wrong])}, column {column}"


def _unit_faults(campaign: Campaign) -> list[Fault]:
    faults: list[Fault] = []
    error_arcsec, angle_deg = campaign.error_arcsec, campaign.angle_deg
    peak_to_peak = float(np.ptp(error_arcsec))
    if peak_to_peak < SMALLEST_PEAK_TO_PEAK_ARCSEC:
        where = f"{campaign.source}, column error_arcsec"
        expected = f"errors that spread over {SMALLEST_PEAK_TO_PEAK_ARCSEC:g} arcsec or more"
        found = f"{peak_to_peak:.3g} arcsec peak to peak"
        faults.append(Fault(where=where, expected=expected, found=found, advice="are they in degrees?"))
    absurd = np.abs(error_arcsec) > LARGEST_ERROR_ARCSEC
    if absurd.any():
        expected = f"errors up to {LARGEST_ERROR_ARCSEC:g} arcsec (5 deg)"
        found = f"up to {np.abs(error_arcsec).max():.6g}"
        advice = (
            "is the angle or the error in a wrong unit, or a turn left in the difference? "
            f"{leave_out_advice(campaign.row[absurd])}"
        )
        where = _at_rows(campaign, "error_arcsec", absurd)
        faults.append(Fault(where=where, expected=expected, found=found, advice=advice))
    span_deg = float(np.ptp(angle_deg))
    where = f"{campaign.source}, column angle_deg"
    # To the third decimal: single counts are no angles of their own, radians of a polygon still are.
    if span_deg < RADIAN_TURN and np.unique(np.round(angle_deg, 3)).size >= FEWEST_ANGLES_TO_JUDGE:
        found = f"all within {span_deg:.4g}"
        faults.append(
            Fault(
                where=where, expected="angles in degrees, over the turn", found=found, advice="are they radians?"
            )
        )
    if span_deg > LARGEST_SPAN_DEG:
        expected = f"angles in degrees, within {LARGEST_SPAN_DEG / DEG_PER_TURN:g} turns"
        found = f"a span of {span_deg:.6g}"
        faults.append(Fault(where=where, expected=expected, found=found, advice="are they arcseconds or counts?"))
    return faults


def _temperature_faults(
    campaign: Campaign, readings: TrainingReadings, base_temperature_c: float | None
) -> list[Fault]:
    assert campaign.temperature_c is not None  # noqa: S101 - the caller has looked
    where = f"{campaign.source}, column temperature_c"
    lowest_c, highest_c = TEMPERATURE_LIMITS_C
    absurd = (campaign.temperature_c < lowest_c) | (campaign.temperature_c > highest_c)
    if absurd.any():
        expected = f"temperatures from {lowest_c:g} to {highest_c:g} degC"
        found = f"{campaign.temperature_c[absurd][0]:g}"
        at = _at_rows(campaign, "temperature_c", absurd)
        return [Fault(where=at, expected=expected, found=found, advice="are they in kelvin?")]
    run_mean_c = readings.run_mean_temperature_c()
    groups_c = ", ".join(f"{mean_c:g}" for mean_c in np.unique(np.round(run_mean_c)))
    if np.ptp(run_mean_c) < SAME_TEMPERATURE_C:
        expected = f"runs at two or more temperatures, {SAME_TEMPERATURE_C:g} degC or more apart"
        found = f"runs at about {groups_c} degC only"
        advice = "a model of one temperature is no temperature compensation: measure at the ends of the use"
        return [Fault(where=where, expected=expected, found=found, advice=advice)]
    if base_temperature_c is None:
        return []
    if not (np.abs(run_mean_c - base_temperature_c) <= SAME_TEMPERATURE_C).any():
        expected = f"runs within {SAME_TEMPERATURE_C:g} degC of the base temperature {base_temperature_c:g} degC"
        found = f"runs at about {groups_c} degC"
        advice = "choose one of these as the base temperature"
        return [Fault(where=where, expected=expected, found=found, advice=advice)]
    return []


def _copy_faults(campaign: Campaign) -> list[Fault]:
    faults: list[Fault] = []
    first_line: dict[bytes, int] = {}
    copies: list[tuple[int, int]] = []
    for row, cells in zip(campaign.row.tolist(), _row_bytes(campaign), strict=True):
        if cells in first_line:
            copies.append((first_line[cells], row))
        first_line.setdefault(cells, row)
    if copies:
        shown = ", ".join(f"{copy} like {first}" for first, copy in copies[:ROWS_SHOWN])
        more = f", ... {len(copies)} in all" if len(copies) > ROWS_SHOWN else ""
        found = f"lines that repeat another one: {shown}{more}"
        faults.append(Fault(where=campaign.source, expected="each reading once", found=found))
    runs: dict[bytes, int] = {}
    for run in np.unique(campaign.run).tolist():
        errors = campaign.error_arcsec[campaign.run == run]
        if errors.size < SHORTEST_COPY:
            continue
        if errors.tobytes() in runs:
            other = runs[errors.tobytes()]
            found = f"run {run} with the errors of run {other} to the last digit"
            advice = "was a run copied instead of measured?"
            at = _at_rows(campaign, "error_arcsec", campaign.run == run)
            faults.append(Fault(where=at, expected="every run measured by itself", found=found, advice=advice))
        runs.setdefault(errors.tobytes(), run)
    return faults


def _row_bytes(campaign: Campaign) -> Iterable[bytes]:
    """All that the file says of each reading."""
    columns = [
        campaign.angle_deg,
        campaign.error_arcsec,
        campaign.run,
        campaign.temperature_c,
        campaign.time_s,
        campaign.direction,
        campaign.velocity_deg_s,
        campaign.load_nm,
        campaign.face,
    ]
    table = np.column_stack([column.astype(np.float64) for column in columns if column is not None])
    return (line.tobytes() for line in table)


def _face_faults(campaign: Campaign, faces: int | None) -> list[Fault]:
    if faces is None or campaign.face is None:
        return []
    beyond = campaign.face > faces
    if not beyond.any():
        return []
    found = f"face {int(campaign.face.max())}"
    at = _at_rows(campaign, "face", beyond)
    return [Fault(where=at, expected=f"faces 1 to {faces} of the joint's polygon", found=found)]


def _sign_faults(campaign: Campaign, faces: int | None) -> list[Fault]:
    """Angles and errors that contradict the faces: mirrored, in other units, or with the sign reversed.

    With the shaft stopped near the autocollimator's null, the indicated angle less the polygon's is the error but
    for a constant in each zero group. Nominal angles, and shafts stopped elsewhere, say nothing.
    """
    if campaign.face is None or (campaign.face < 1).any():
        return []
    pitch_deg = DEG_PER_TURN / (faces or int(campaign.face.max()))
    off_polygon_deg = angle_difference_deg(campaign.angle_deg, (campaign.face - 1).astype(np.float64) * pitch_deg)
    _, first, group = np.unique(campaign.zero_group, return_index=True, return_inverse=True)
    shown_arcsec = angle_difference_deg(off_polygon_deg, off_polygon_deg[first][group]) * ARCSEC_PER_DEG
    error_arcsec = campaign.error_arcsec - campaign.error_arcsec[first][group]
    astray = np.abs(shown_arcsec) > LARGEST_ERROR_ARCSEC
    if astray.any():
        return [
            Fault(
                where=_at_rows(campaign, "angle_deg", astray),
                expected=f"angles that follow the faces, {pitch_deg:.4g} deg from one to the next",
                found="angles more than 5 deg off",
                advice="are the angles in degrees, is the number of faces right, do they grow with the angle?",
            )
        ]
    scatter = float(np.std(shown_arcsec) * np.std(error_arcsec))
    if scatter == 0.0:
        return []
    correlation = float(
        np.mean((shown_arcsec - shown_arcsec.mean()) * (error_arcsec - error_arcsec.mean())) / scatter
    )
    slope = correlation * float(np.std(error_arcsec) / np.std(shown_arcsec))
    if correlation > SURELY_REVERSED and not 0.5 <= slope <= 2.0:
        return [
            Fault(
                where=f"{campaign.source}, column error_arcsec",
                expected="errors in arcsec, as large as the indicated angles show them",
                found=f"errors {slope:.3g} times as large (correlation {correlation:.2f})",
                advice="are they in another unit?",
            )
        ]
    if correlation > -SURELY_REVERSED:
        return []
    return [
        Fault(
            where=f"{campaign.source}, column error_arcsec",
            expected="errors as indicated minus reference",
            found=f"errors that run against the indicated angles (correlation {correlation:.2f})",
            advice="is the sign reversed? Then correction would double the error",
        )
    ]


def _number_faults(campaign: Campaign, count: int, parameters: int, validation_fraction: float) -> list[Fault]:
    faults: list[Fault] = []
    needed = readings_needed(parameters, validation_fraction)
    if count < needed:
        expected = (
            f"at least {needed} readings, so that the part to train on outnumbers the {parameters} parameters"
        )
        advice = "measure more faces, temperatures or repeats, or fit fewer hidden nodes"
        faults.append(Fault(where=campaign.source, expected=expected, found=str(count), advice=advice))
    places = distinct_angle_count(campaign.angle_deg, SAME_PLACE_DEG)
    if places < FEWEST_ANGLES:
        expected = f"at least {FEWEST_ANGLES} distinct angles in the turn"
        where = f"{campaign.source}, column angle_deg"
        faults.append(Fault(where=where, expected=expected, found=str(places)))
    return faults


def _datum(campaign: Campaign, *, free_offsets: bool) -> tuple[float, list[Fault]]:
    """Where the zero groups have their zero: the mean angle of their first readings, in [0, 360)."""
    _, first = np.unique(campaign.zero_group, return_index=True)
    starts_deg = campaign.angle_deg[first]
    from_first_deg = angle_difference_deg(starts_deg, float(starts_deg[0]))
    datum_deg = wrap_deg(float(starts_deg[0]) + float(np.mean(from_first_deg)))
    apart = np.abs(from_first_deg) > SAME_PLACE_DEG
    if not apart.any():
        return datum_deg, []
    if free_offsets:
        return wrap_deg(float(starts_deg[0])), []
    listed = ", ".join(f"{angle:.3f}" for angle in np.unique(np.round(wrap_deg(starts_deg), 3))[:ROWS_SHOWN])
    fault = Fault(
        where=f"{campaign.source} {lines_text(campaign.row[first[apart]])}, column angle_deg",
        expected=f"every zero group to begin within {SAME_PLACE_DEG:g} deg of {float(starts_deg[0]):.3f} deg",
        found=f"beginnings at {listed} deg",
        advice="errors zeroed at different angles differ by an unknown offset, which this method would take for "
        "error: zero every run at the same angle (shift_faces: 0 or a whole number), or choose --method linear",
    )
    return datum_deg, [fault]


def _valid_angle(campaign: Campaign) -> tuple[Interval, list[Fault]]:
    """The whole turn, or the covered part of it where a wide gap is left."""
    turn = Interval(minimum=0.0, maximum=DEG_PER_TURN)
    ordered = np.unique(wrap_deg(campaign.angle_deg))
    gaps_deg = np.diff(ordered, append=ordered[0] + DEG_PER_TURN)
    wide = np.flatnonzero(gaps_deg > widest_gap_deg(ordered))
    if wide.size == 0:
        return turn, []
    if wide.size == 1 and wide[0] == ordered.size - 1:
        return Interval(minimum=float(ordered[0]), maximum=float(ordered[-1])), []
    after_deg = wrap_deg(ordered[wide] + gaps_deg[wide])
    listed = ", ".join(f"{a:.1f} to {b:.1f} deg" for a, b in zip(ordered[wide], after_deg, strict=True))
    fault = Fault(
        where=f"{campaign.source}, column angle_deg",
        expected="angles over the whole turn, or over one part of it that does not cross 0",
        found=f"gaps from {listed}",
        advice="measure the missing angles, or set the encoder's zero into the unused part",
    )
    return turn, [fault]
