"""The campaign file: one reading a row, as CSV (columns of MEASURED.csv).

Read by train, compare and diagnose, written by simulate and by the daemon's recorder. UTF-8, comma, decimal
point, header required; lines beginning with # are ignored; an empty cell is a missing value; unknown columns are
ignored with a note.
"""

import hashlib
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.number_table import raise_faults, read_number_table

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

REQUIRED_COLUMNS = ("angle_deg", "error_arcsec")
FLOAT_COLUMNS = ("temperature_c", "time_s", "velocity_deg_s", "load_nm")
INTEGER_COLUMNS = ("run", "zero_group", "direction", "face", "polygon_offset")
COLUMNS = (
    "angle_deg",
    "error_arcsec",
    "temperature_c",
    "run",
    "zero_group",
    "time_s",
    "direction",
    "velocity_deg_s",
    "load_nm",
    "face",
    "polygon_offset",
)
"""In the order in which they are written."""

RECORD_MARK = "# trueangled record"
"""How a file of the daemon's recorder begins. Only there is a last line without its end taken for cut off by a
loss of power: in a file of anybody else it is a line."""

NEW_RUN_GAP_S = 600.0
NEW_RUN_STEP_C = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """The readings of one calibration campaign; every array has shape [readings].

    Optional columns are None where the file has none (or none with a value in it). A missing cell of a float
    column is NaN, arrays having no other way; of `direction` it is 0; in the other integer columns it is a fault,
    because which run, zero or face a reading belongs to cannot be left open for some readings only.
    """

    angle_deg: Floats
    """Encoder-indicated angle, any finite real."""
    error_arcsec: Floats
    """Indicated minus reference."""
    run: Integers
    """Readings between two set-ups: the statistical unit."""
    zero_group: Integers
    """Readings that share one zero."""
    row: Integers
    """1-based line of the file, for messages."""
    source: str
    sha256: str
    """Of the file's bytes."""
    temperature_c: Floats | None = None
    time_s: Floats | None = None
    direction: Integers | None = None
    """+1 approached with increasing indicated angle, -1 decreasing, 0 not known (an empty cell)."""
    velocity_deg_s: Floats | None = None
    load_nm: Floats | None = None
    face: Integers | None = None
    """Polygon face 1..n; 0 where a reference encoder was used."""
    polygon_offset: Integers | None = None
    notes: tuple[str, ...] = ()
    """What was left out or assumed, in plain words."""

    def __len__(self) -> int:
        return int(self.angle_deg.size)


def read_campaign(data: bytes, *, source: str) -> Campaign:
    """Parse a campaign file; ContractError lists what is wrong by line."""
    whole, cut_note = _whole_lines(data)
    optional = tuple(name for name in COLUMNS if name not in REQUIRED_COLUMNS)
    table = read_number_table(whole, source=source, required=REQUIRED_COLUMNS, optional=optional)
    columns, lines = table.columns, table.row
    faults: list[Fault] = []
    for name in INTEGER_COLUMNS:
        if name in columns:
            _check_integers(name, columns[name], lines, source, faults)
    raise_faults(faults, source)
    notes = [*cut_note, *(f"column {name} is unknown and was ignored" for name in table.ignored)]
    complete = ~(np.isnan(columns["angle_deg"]) | np.isnan(columns["error_arcsec"]))
    if not complete.all():
        missing = lines[~complete]
        shown = ", ".join(str(line) for line in missing[:10]) + (", ..." if missing.size > 10 else "")
        left_out = "1 reading" if missing.size == 1 else f"{missing.size} readings"
        verb, line = ("was", "line") if missing.size == 1 else ("were", "lines")
        notes.append(f"{left_out} without angle or error {verb} left out ({line} {shown})")
    columns = {name: values[complete] for name, values in columns.items()}
    lines = lines[complete]
    if lines.size == 0:
        found = f"{complete.size} without angle or error" if complete.size else "none"
        advice = "a recording has an error only where a reference angle was told" if complete.size else ""
        raise ContractError([Fault(where=source, expected="at least one reading", found=found, advice=advice)])
    return _campaign(columns, lines, source, hashlib.sha256(data).hexdigest(), notes)


def _whole_lines(data: bytes) -> tuple[bytes, list[str]]:
    """A recording without the line that was being written when it ended, and a note of that.

    Half a line may look whole: 12.3 of 12.345. A file system may also leave zero bytes where the end was to be.
    """
    if not data.startswith(RECORD_MARK.encode()) or data.endswith(b"\n"):
        return data, []
    end = data.rstrip(b"\0").rfind(b"\n") + 1
    return data[:end], ["the last line of the recording is cut off and was left out"]


def _campaign(columns: dict[str, Floats], lines: Integers, source: str, sha256: str, notes: list[str]) -> Campaign:
    integers = {name: np.nan_to_num(columns[name]).astype(np.int64) for name in INTEGER_COLUMNS if name in columns}
    run = integers.get("run")
    if run is None:
        run = derive_runs(
            columns["angle_deg"],
            direction=integers.get("direction"),
            time_s=columns.get("time_s"),
            temperature_c=columns.get("temperature_c"),
        )
        notes.append(derived_runs_note(run))
    zero_group = integers.get("zero_group")
    if zero_group is None:
        zero_group = derive_zero_groups(run, face=integers.get("face"))
    return Campaign(
        angle_deg=columns["angle_deg"],
        error_arcsec=columns["error_arcsec"],
        run=run,
        zero_group=zero_group,
        row=lines,
        source=source,
        sha256=sha256,
        temperature_c=columns.get("temperature_c"),
        time_s=columns.get("time_s"),
        direction=integers.get("direction"),
        velocity_deg_s=columns.get("velocity_deg_s"),
        load_nm=columns.get("load_nm"),
        face=integers.get("face"),
        polygon_offset=integers.get("polygon_offset"),
        notes=tuple(notes),
    )


def _check_integers(name: str, values: Floats, lines: Integers, source: str, faults: list[Fault]) -> None:
    allowed = {"direction": "1 or -1", "face": "a whole number from 0"}.get(name, "a whole number")
    present = ~np.isnan(values)
    wrong = present & (values != np.round(values))
    if name == "direction":
        wrong |= present & ~np.isin(values, (-1.0, 1.0))
    if name == "face":
        wrong |= present & (values < 0)
    wrong |= np.abs(np.where(present, values, 0.0)) > 2**53
    if name != "direction":
        wrong |= ~present
    for i in np.flatnonzero(wrong):
        found = "an empty cell" if not present[i] else f"{values[i]:g}"
        faults.append(Fault(where=f"{source} line {lines[i]}, column {name}", expected=allowed, found=found))


def derived_runs_note(run: Integers) -> str:
    """How many runs `derive_runs` made."""
    count = int(np.unique(run).size)
    told_by = "angle, direction, time, temperature"
    return (
        f"no column run: all readings are one run by {told_by}"
        if count == 1
        else f"no column run: {count} runs were told apart by {told_by}"
    )


def derive_runs(
    angle_deg: Floats, *, direction: Integers | None, time_s: Floats | None, temperature_c: Floats | None
) -> Integers:
    """Run numbers where the file has none, shape [readings].

    A new run begins where the angle falls back by more than half its span, the direction changes, the time gap
    exceeds 10 minutes or the temperature steps by more than 1 degC.
    """
    starts = np.zeros(angle_deg.size, dtype=bool)
    span = float(np.ptp(angle_deg))
    along = np.diff(angle_deg)
    if direction is not None:
        along = along * direction[1:]
        starts[1:] |= direction[1:] != direction[:-1]
    starts[1:] |= along < -span / 2
    if time_s is not None:
        starts[1:] |= np.abs(np.diff(time_s)) > NEW_RUN_GAP_S
    if temperature_c is not None:
        starts[1:] |= np.abs(np.diff(temperature_c)) > NEW_RUN_STEP_C
    return np.cumsum(starts).astype(np.int64)


def derive_zero_groups(run: Integers, *, face: Integers | None) -> Integers:
    """Zero groups where the file has none, shape [readings].

    Each run with polygon faces is its own group (Eq. 11 zeroes it at its first row); all readings against a
    reference encoder (face 0) share one zero; without a face column each run is its own group.
    """
    if face is None:
        return run.copy()
    shared = int(run.max()) + 1
    return np.where(face > 0, run, shared).astype(np.int64)


def campaign_to_csv(campaign: Campaign, *, comments: Iterable[str] = ()) -> str:
    """The campaign as CSV text; reading it back gives the same readings."""
    out = io.StringIO()
    for comment in comments:
        for line in comment.splitlines():
            out.write(f"# {line}\n")
    present = [name for name in COLUMNS if getattr(campaign, name) is not None]
    out.write(",".join(present) + "\n")
    columns = [_cells(name, getattr(campaign, name)) for name in present]
    for cells in zip(*columns, strict=True):
        out.write(",".join(cells) + "\n")
    return out.getvalue()


def _cells(name: str, values: NDArray[np.float64] | NDArray[np.int64]) -> list[str]:
    if name == "direction":
        return [str(int(value)) if value else "" for value in values]
    if name in INTEGER_COLUMNS:
        return [str(int(value)) for value in values]
    return ["" if math.isnan(value) else repr(float(value)) for value in values]
