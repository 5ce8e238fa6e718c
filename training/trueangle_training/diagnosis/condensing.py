"""Fewer rows for the diagnosis: neighbours within a run are averaged, so that 10^6 readings fit into memory."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_ROWS = 12_000
_AVERAGED = ("angle_deg", "error_arcsec", "temperature_c", "time_s", "velocity_deg_s", "load_nm")
_KEPT = ("run", "zero_group", "row", "direction", "face", "polygon_offset")
_ENDS_A_BLOCK = ("run", "zero_group", "direction", "face", "polygon_offset")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Condensed:
    """A campaign of at most `MOST_ROWS` rows."""

    campaign: Campaign
    reading: Integers
    """[rows]: index in the full campaign of each row's first reading."""
    averaged: Integers
    """[rows]: number of readings behind each row, from 1."""
    notes: tuple[str, ...]


def condense(campaign: Campaign, *, most_rows: int = MOST_ROWS) -> Condensed:
    """Average neighbours within a run; where that does not help enough, leave readings out evenly and say so."""
    count = len(campaign)
    if count <= most_rows:
        whole = np.arange(count, dtype=np.int64)
        return Condensed(campaign=campaign, reading=whole, averaged=np.ones(count, dtype=np.int64), notes=())
    starts, size = _blocks(campaign, most_rows)
    notes = [f"{count} readings were averaged to {starts.size} rows of up to {size} neighbours within a run"]
    notes.append(f"patterns finer than {size} readings are averaged out; RMS, floor and shares are of these rows")
    averaged = np.diff(np.append(starts, count)).astype(np.int64)
    rows = _averaged(campaign, starts, averaged)
    if starts.size > most_rows:
        kept = np.unique(np.linspace(0, starts.size - 1, most_rows).astype(np.int64))
        notes = [
            f"{count} readings could not be averaged to {most_rows} rows: {kept.size}, evenly chosen, are used"
        ]
        rows, starts, averaged = _rows(rows, kept), starts[kept], averaged[kept]
    return Condensed(campaign=rows, reading=starts, averaged=averaged, notes=tuple(notes))


def _blocks(campaign: Campaign, most_rows: int) -> tuple[Integers, int]:
    """First reading of each block and the longest block, so that no block crosses a run, a turn or a reversal."""
    count = len(campaign)
    new = np.zeros(count, dtype=bool)
    new[0] = True
    for name in _ENDS_A_BLOCK:
        values = getattr(campaign, name)
        if values is not None:
            new[1:] |= values[1:] != values[:-1]
    new[1:] |= np.abs(np.diff(campaign.angle_deg)) > 90.0
    segment_start = np.flatnonzero(new)
    length = np.diff(np.append(segment_start, count))
    size = -(-count // most_rows)
    # Each segment ends with a block that is not full: the blocks grow until all of them fit.
    for _ in range(40):
        if int(np.sum(-(-length // size))) <= most_rows or size >= int(length.max()):
            break
        size = size + max(1, size // 8)
    place = np.arange(count) - np.repeat(segment_start, length)
    return np.flatnonzero(place % size == 0).astype(np.int64), int(size)


def _averaged(campaign: Campaign, starts: Integers, averaged: Integers) -> Campaign:
    values = {name: getattr(campaign, name) for name in (*_AVERAGED, *_KEPT)}
    changed = {
        name: np.add.reduceat(value, starts) / averaged if name in _AVERAGED else value[starts]
        for name, value in values.items()
        if value is not None
    }
    return replace(campaign, **changed)


def _rows(campaign: Campaign, kept: Integers) -> Campaign:
    values = {name: getattr(campaign, name) for name in (*_AVERAGED, *_KEPT)}
    return replace(campaign, **{name: value[kept] for name, value in values.items() if value is not None})
