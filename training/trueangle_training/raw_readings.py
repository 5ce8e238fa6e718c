"""From what the operator writes down to errors: eq. (11) of Jia et al., Sensors 2020, 20, 2603.

At face p of a polygon with n faces the encoder shows theta, the autocollimator delta. Counted from the first stop
of the run (face 1 where the polygon is mounted as usual) the error, indicated minus reference, is

    error_p = (theta_p - delta_p - d_p) - (theta_1 - delta_1 - d_1) - (p - 1) 360 / n

Signs
- delta is positive where the shaft stands further on than the face's own direction, in the sense in which the
  encoder counts up. Where an autocollimator counts the other way its readings are turned round before.
- d, the deviation in the polygon's certificate, is positive where the shaft has to turn further than
  (p - 1) 360 / n from face 1 until face p is seen, in the sense in which the face numbers rise. Face numbers must
  rise with the encoder's angle.

With the polygon re-mounted by k whole faces (`polygon_offset` k) the run begins at face (-k mod n) + 1, and the
nominal angles are counted from that face.
"""

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, derive_runs, derived_runs_note
from trueangle.contract.errors import Fault
from trueangle.contract.joint import PlanZero
from trueangle.contract.number_table import NumberTable, integer_faults, raise_faults, read_number_table
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN, angle_difference_deg
from trueangle_training.file_lines import lines_text

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

REQUIRED_COLUMNS = ("face", "angle_deg", "autocollimator_arcsec")
OPTIONAL_COLUMNS = ("temperature_c", "run", "time_s", "direction", "polygon_offset")
CERTIFICATE_COLUMNS = ("face", "deviation_arcsec")

LARGEST_AUTOCOLLIMATOR_ARCSEC = 7_200.0
"""Beyond the range of any autocollimator."""
LARGEST_DEVIATION_ARCSEC = 600.0
"""Ordinary polygons are within a few arcsec, rough ones within a minute: more is another unit."""
LARGEST_ERROR_DEG = 5.0
"""As in `dataset`: no encoder errs so far, a face or a number is wrong."""
FEWEST_FACES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawReadings:
    """Readings as written down, each array of shape [readings]; NaN where a float cell was empty."""

    face: Integers
    """1..n."""
    angle_deg: Floats
    """Encoder-indicated, any real."""
    autocollimator_arcsec: Floats
    run: Integers
    row: Integers
    """1-based line of the file."""
    source: str
    sha256: str
    polygon_offset: Integers
    """By how many whole faces the polygon was re-mounted; 0 where the file does not say."""
    temperature_c: Floats | None = None
    time_s: Floats | None = None
    direction: Integers | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.angle_deg.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonCertificate:
    """Deviations of a polygon's faces from their nominal directions."""

    deviation_arcsec: tuple[float, ...]
    """Of faces 1..n, sign as in the module's text."""
    source: str

    @property
    def faces(self) -> int:
        """n."""
        return len(self.deviation_arcsec)


def read_raw_readings(data: bytes, *, source: str) -> RawReadings:
    """Parse a file of raw readings; ContractError lists every fault by line."""
    table = read_number_table(data, source=source, required=REQUIRED_COLUMNS, optional=OPTIONAL_COLUMNS)
    columns = table.columns
    faults = integer_faults(table, "face", lowest=1)
    for name in ("run", "polygon_offset"):
        if name in columns:
            faults += integer_faults(table, name)
    if "direction" in columns:
        faults += _direction_faults(table)
    faults += _size_faults(
        table,
        "autocollimator_arcsec",
        LARGEST_AUTOCOLLIMATOR_ARCSEC,
        "is it in another unit, or an encoder angle?",
    )
    raise_faults(faults, source)
    notes = [f"column {name} is unknown and was ignored" for name in table.ignored]
    size = table.row.size
    direction = _integers(columns["direction"]) if "direction" in columns else None
    if "run" in columns:
        run = _integers(columns["run"])
    else:
        run = derive_runs(
            np.nan_to_num(columns["angle_deg"]),
            direction=direction,
            time_s=columns.get("time_s"),
            temperature_c=columns.get("temperature_c"),
        )
        notes.append(derived_runs_note(run))
    offset = columns.get("polygon_offset", np.zeros(size))
    return RawReadings(
        face=_integers(columns["face"]),
        angle_deg=columns["angle_deg"],
        autocollimator_arcsec=columns["autocollimator_arcsec"],
        run=run,
        row=table.row,
        source=source,
        sha256=hashlib.sha256(data).hexdigest(),
        polygon_offset=_integers(offset),
        temperature_c=columns.get("temperature_c"),
        time_s=columns.get("time_s"),
        direction=direction,
        notes=tuple(notes),
    )


def read_certificate(data: bytes, *, source: str) -> PolygonCertificate:
    """Parse a polygon certificate: every face from 1 on once, in any order."""
    table = read_number_table(data, source=source, required=CERTIFICATE_COLUMNS)
    faults = integer_faults(table, "face", lowest=1, highest=table.row.size)
    faults += [
        Fault(
            where=table.where(index, "deviation_arcsec"), expected="a deviation in arcsec", found="an empty cell"
        )
        for index in np.flatnonzero(np.isnan(table.columns["deviation_arcsec"])).tolist()
    ]
    faults += _size_faults(
        table, "deviation_arcsec", LARGEST_DEVIATION_ARCSEC, "is it in another unit, or an angle?"
    )
    if table.row.size < FEWEST_FACES:
        expected = f"the faces of a polygon, {FEWEST_FACES} or more"
        faults.append(Fault(where=source, expected=expected, found=str(table.row.size)))
    faces = table.columns["face"]
    repeated, counts = np.unique(faces[~np.isnan(faces)], return_counts=True)
    faults += [
        Fault(where=f"{source}, column face", expected="each face once", found=f"face {face:g} {count} times")
        for face, count in zip(repeated, counts, strict=True)
        if count > 1
    ]
    raise_faults(faults, source)
    ordered = table.columns["deviation_arcsec"][np.argsort(faces)]
    return PolygonCertificate(deviation_arcsec=tuple(ordered.tolist()), source=source)


def errors_by_equation_11(
    raw: RawReadings,
    *,
    faces: int,
    certificate: PolygonCertificate | None = None,
    zero: PlanZero = PlanZero.PER_RUN,
) -> Campaign:
    """The campaign of raw readings; every run is zeroed at its first stop, which is written first.

    With `PlanZero.ONE` all runs are counted from the first stop of the first run instead: only where polygon,
    encoder and autocollimator were left as they are over all of them.

    A reading without angle or autocollimator value is left out and noted; a run without its first stop is a fault,
    because zeroed elsewhere it would have another datum. `sha256` of the result is that of the raw file.
    ContractError lists every fault with its lines.
    """
    faults = _face_number_faults(raw, faces)
    if certificate is not None and certificate.faces != faces:
        expected = f"{faces} faces, as the polygon has"
        faults.append(Fault(where=certificate.source, expected=expected, found=str(certificate.faces)))
    raise_faults(faults, raw.source)
    complete = ~(np.isnan(raw.angle_deg) | np.isnan(raw.autocollimator_arcsec))
    order, first, notes, faults = _ordered_runs(raw, faces, complete)
    if zero is PlanZero.ONE and np.unique(raw.polygon_offset).size > 1:
        found = "a polygon that was re-mounted between runs"
        faults.append(Fault(where=raw.source, expected="one mounting with one zero", found=found))
    raise_faults(faults, raw.source)
    if zero is PlanZero.ONE:
        first = np.full_like(first, first[0])
    deviation = np.zeros(faces) if certificate is None else np.array(certificate.deviation_arcsec)
    zeroed = _errors(raw, faces, deviation, order, first)
    raise_faults(_far_off_faults(raw, faces, order, first, zeroed), raw.source)
    if not complete.all():
        left_out = raw.row[~complete]
        readings = "1 reading" if left_out.size == 1 else f"{left_out.size} readings"
        verb = "was" if left_out.size == 1 else "were"
        notes.append(f"{readings} without angle or autocollimator value {verb} left out ({lines_text(left_out)})")
    if certificate is None:
        notes.append("no polygon certificate: the deviations of its faces are in the errors")
    return Campaign(
        angle_deg=raw.angle_deg[order],
        error_arcsec=zeroed,
        run=raw.run[order],
        zero_group=raw.run[first],
        row=raw.row[order],
        source=raw.source,
        sha256=raw.sha256,
        temperature_c=None if raw.temperature_c is None else raw.temperature_c[order],
        time_s=None if raw.time_s is None else raw.time_s[order],
        direction=None if raw.direction is None else raw.direction[order],
        face=raw.face[order],
        polygon_offset=raw.polygon_offset[order] if raw.polygon_offset.any() else None,
        notes=(*raw.notes, *notes),
    )


def with_autocollimator_reversed(raw: RawReadings) -> RawReadings:
    """The readings of an autocollimator that counts against the encoder."""
    return replace(raw, autocollimator_arcsec=-raw.autocollimator_arcsec)


def _errors(raw: RawReadings, faces: int, deviation_arcsec: Floats, order: Integers, first: Integers) -> Floats:
    """Equation (11) for the readings `order`, each zeroed by its reading of `first`; turns taken off."""
    from_face_deg = raw.angle_deg - (raw.face - 1 + raw.polygon_offset) % faces * (DEG_PER_TURN / faces)
    small_arcsec = raw.autocollimator_arcsec + deviation_arcsec[raw.face - 1]
    # The difference is what is wrapped: an encoder whose zero is half a turn from face 1 is none the worse.
    differences_deg = angle_difference_deg(from_face_deg[order], from_face_deg[first])
    return differences_deg * ARCSEC_PER_DEG - (small_arcsec[order] - small_arcsec[first])


def _ordered_runs(
    raw: RawReadings, faces: int, complete: NDArray[np.bool_]
) -> tuple[Integers, Integers, list[str], list[Fault]]:
    """Which readings in which order, the reading that zeroes each, notes and faults."""
    order: list[int] = []
    first: list[int] = []
    notes: list[str] = []
    faults: list[Fault] = []
    for run in dict.fromkeys(raw.run.tolist()):
        here = np.flatnonzero(raw.run == run)
        lines = f"lines {raw.row[here].min()} to {raw.row[here].max()}"
        where = f"{raw.source} {lines}, run {run}"
        offsets = np.unique(raw.polygon_offset[here])
        if offsets.size > 1:
            found = ", ".join(str(each) for each in offsets)
            faults.append(Fault(where=where, expected="one polygon_offset a run", found=found))
            continue
        zero_face = int(-offsets[0] % faces) + 1
        usable = here[complete[here]]
        zeros = usable[raw.face[usable] == zero_face]
        if zeros.size == 0:
            found = "no such reading" if not (raw.face[here] == zero_face).any() else "one without a value"
            advice = "the run's errors are counted from it: measure it, or leave the run out"
            faults.append(
                Fault(where=where, expected=f"a reading of face {zero_face}", found=found, advice=advice)
            )
            continue
        if zeros[0] != usable[0]:
            notes.append(f"run {run}: the reading of face {zero_face} (line {raw.row[zeros[0]]}) was put first")
        kept = [int(zeros[0]), *(each for each in usable.tolist() if each != zeros[0])]
        order += kept
        first += [int(zeros[0])] * len(kept)
    return np.array(order, dtype=np.int64), np.array(first, dtype=np.int64), notes, faults


def _face_number_faults(raw: RawReadings, faces: int) -> list[Fault]:
    return [
        Fault(where=f"{raw.source} line {row}, column face", expected=f"a face from 1 to {faces}", found=str(face))
        for row, face in zip(raw.row.tolist(), raw.face.tolist(), strict=True)
        if face > faces
    ]


def _far_off_faults(
    raw: RawReadings, faces: int, order: Integers, first: Integers, error_arcsec: Floats
) -> list[Fault]:
    """Errors that no encoder makes: a wrong face number, a wrong unit, faces that run against the angle."""
    far = np.abs(error_arcsec) > LARGEST_ERROR_DEG * ARCSEC_PER_DEG
    if not far.any():
        return []
    away = order != first
    if away.any() and np.mean(far[away]) > 0.5:
        against_deg = (raw.face[first] - raw.face[order]).astype(np.float64) * (DEG_PER_TURN / faces)
        mirrored = angle_difference_deg(raw.angle_deg[order] - raw.angle_deg[first], against_deg)
        reversed_faces = bool(np.median(np.abs(mirrored)) < LARGEST_ERROR_DEG)
        return [
            Fault(
                where=raw.source,
                expected=f"encoder angles that rise by 360/{faces} deg from face to face",
                found="faces that run against the angle"
                if reversed_faces
                else f"most readings {LARGEST_ERROR_DEG:g} deg or more off that",
                advice="number the faces as the angle rises"
                if reversed_faces
                else "is the number of faces right (--faces), and are the angles in degrees?",
            )
        ]
    return [
        Fault(
            where=f"{raw.source} line {raw.row[order[index]]}",
            expected=f"an angle within {LARGEST_ERROR_DEG:g} deg of face {raw.face[order[index]]}",
            found=f"{raw.angle_deg[order[index]]:g} deg, {error_arcsec[index] / ARCSEC_PER_DEG:+.2f} deg off it",
            advice="is it a typing error?",
        )
        for index in np.flatnonzero(far)
    ]


def _direction_faults(table: NumberTable) -> list[Fault]:
    return [
        Fault(where=table.where(index, "direction"), expected="1 or -1", found=_shown(value))
        for index, value in enumerate(table.columns["direction"].tolist())
        if value not in (1.0, -1.0)
    ]


def _size_faults(table: NumberTable, name: str, largest: float, advice: str) -> list[Fault]:
    return [
        Fault(
            where=table.where(index, name),
            expected=f"up to {largest:g} arcsec",
            found=f"{value:g}",
            advice=advice,
        )
        for index, value in enumerate(table.columns[name].tolist())
        if abs(value) > largest
    ]


def _shown(value: float) -> str:
    return "an empty cell" if math.isnan(value) else f"{value:g}"


def _integers(values: Floats) -> Integers:
    return values.astype(np.int64)
