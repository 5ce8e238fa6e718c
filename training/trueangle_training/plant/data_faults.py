"""Campaigns that went wrong on paper: what a person or a program writes down falsely."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

TURN_ARCSEC = 1_296_000.0
COLUMN_NAMES = (
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """MEASURED.csv before it is written, arrays of shape [n]; every case has all columns."""

    angle_deg: Floats
    error_arcsec: Floats
    temperature_c: Floats
    run: Integers
    zero_group: Integers
    time_s: Floats
    direction: Integers
    velocity_deg_s: Floats
    load_nm: Floats
    face: Integers
    polygon_offset: Integers

    def to_csv(self, *, rows: Integers, empty: NDArray[np.bool_]) -> str:
        """The file's text: these rows, the error's cell empty where it is said."""
        out = [",".join(COLUMN_NAMES)]
        for i in rows.tolist():
            error = "" if empty[i] else f"{self.error_arcsec[i]:.4f}"
            out.append(
                f"{self.angle_deg[i]:.9f},{error},{self.temperature_c[i]:.4f},{self.run[i]},{self.zero_group[i]},"
                f"{self.time_s[i]:.2f},{self.direction[i]},{self.velocity_deg_s[i]:g},{self.load_nm[i]:g},"
                f"{self.face[i]},{self.polygon_offset[i]}"
            )
        return "\n".join(out) + "\n"


DATA_FAULTS = ("direction_swapped", "wrong_line_count", "wrap", "clock_offset", "outliers")


def damaged(columns: Columns, fault: str, rng: np.random.Generator) -> tuple[Columns, float]:
    """The columns with the fault, and by what factor the encoder's label is wrong (1 but for the line count)."""
    if fault == "direction_swapped":
        return replace(columns, direction=-columns.direction), 1.0
    if fault == "wrong_line_count":
        return _wrong_line_count(columns, rng)
    if fault == "wrap":
        return _wrapped(columns, rng), 1.0
    if fault == "clock_offset":
        return _clock_set(columns, rng), 1.0
    if fault == "outliers":
        wrong = rng.random(columns.angle_deg.size) < float(rng.uniform(0.02, 0.06))
        gross = rng.choice([-1.0, 1.0], size=wrong.size) * np.exp(
            rng.uniform(np.log(100), np.log(3e4), wrong.size)
        )
        return replace(
            columns, error_arcsec=np.where(wrong, columns.error_arcsec + gross, columns.error_arcsec)
        ), 1.0
    raise ValueError(f"fault: expected one of {', '.join(DATA_FAULTS)}, got {fault}")


def _wrong_line_count(columns: Columns, rng: np.random.Generator) -> tuple[Columns, float]:
    """Counts turned into angles with the label of another encoder: the error grows with the angle."""
    scale = float(rng.choice([0.5, 2.0, 1.0125, 0.99, 1.25]))
    angle_deg = columns.angle_deg * scale
    error = columns.error_arcsec.copy()
    added = (scale - 1.0) * columns.angle_deg * 3600.0
    for group in np.unique(columns.zero_group):
        rows = np.flatnonzero(columns.zero_group == group)
        error[rows] += added[rows] - added[rows[0]]
    return replace(columns, angle_deg=angle_deg, error_arcsec=error), scale


def _wrapped(columns: Columns, rng: np.random.Generator) -> Columns:
    """Encoder and reference roll over at different places: whole turns in the error between them."""
    first = float(rng.uniform(0.0, 330.0))
    between = ((columns.angle_deg - first) % 360.0) < float(rng.uniform(16.0, 120.0))
    turn = float(rng.choice([-1.0, 1.0])) * TURN_ARCSEC
    return replace(columns, error_arcsec=np.where(between, columns.error_arcsec + turn, columns.error_arcsec))


def _clock_set(columns: Columns, rng: np.random.Generator) -> Columns:
    """The clock was set back by hours in the middle of the campaign."""
    start = int(rng.integers(columns.time_s.size // 4, 3 * columns.time_s.size // 4))
    back_s = float(rng.uniform(2.0, 12.0)) * 3600.0
    late = np.arange(columns.time_s.size) >= start
    return replace(columns, time_s=np.where(late, columns.time_s - back_s, columns.time_s))
