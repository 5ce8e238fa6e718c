"""What a recording says of one joint: the columns of a campaign file, and the quality beside them.

Rules of this file: the first columns are those that `trueangle diagnose` and `train` read
(`contract.calibration`), so a recording with reference angles is a campaign; a value that is not known is an empty
cell; the last column is one that nobody calculates with, because a loss of power cuts the end of a file.
"""

import re
from dataclasses import dataclass

from trueangle.contract.calibration import RECORD_MARK
from trueangle.contract.units import ARCSEC_PER_DEG, angle_difference_deg
from trueangle.core.register_reading import DetailReading, status_words

COLUMNS = (
    "angle_deg",
    "error_arcsec",
    "temperature_c",
    "run",
    "time_s",
    "direction",
    "velocity_deg_s",
    "face",
    "reference_deg",
    "corrected_deg",
    "correction_arcsec",
    "uncertainty_arcsec",
    "age_ms",
    "sequence",
    "status",
    "utc",
)
SLOWEST_DEG_S = 0.001
"""Below, the direction of the approach is not told from noise."""
_OURS = re.compile(r"trueangle-(\d{8,})-slot\d\d-[A-Za-z0-9._-]*-\d{8}T\d{6}Z\.csv(\.part)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedJoint:
    """Which joint a file is about."""

    slot: int
    name: str

    @property
    def header(self) -> str:
        """What every file begins with, the line of columns last."""
        return (
            f"{RECORD_MARK}: slot {self.slot}, joint {self.name}; "
            "angle_deg is raw, error_arcsec = raw - reference\n" + ",".join(COLUMNS) + "\n"
        )

    def file_name(self, number: int, stamp: str) -> str:
        """The number comes first: it orders the files even where the clock was set back."""
        name = re.sub(r"[^A-Za-z0-9._-]", "_", self.name)
        return f"trueangle-{number:08d}-slot{self.slot:02d}-{name}-{stamp}.csv"


def recorded_number(file_name: str) -> int | None:
    """The number of a recorded file; None: not one of ours, never to be touched."""
    found = _OURS.fullmatch(file_name)
    return int(found[1]) if found else None


class RowMaker:
    """Rows of one joint; keeps the direction of its last movement."""

    def __init__(self) -> None:
        self._direction: int | None = None

    def row(self, reading: DetailReading, *, reference_deg: float | None, time_s: float, utc: str) -> str:
        """One line. `reference_deg`: the true angle at this moment, None where nobody told one."""
        velocity = reading.velocity_deg_s
        if velocity is not None and abs(velocity) >= SLOWEST_DEG_S:
            self._direction = 1 if velocity > 0 else -1
        error = None
        if reference_deg is not None and reading.raw_deg is not None:
            error = angle_difference_deg(reading.raw_deg, reference_deg) * ARCSEC_PER_DEG
        cells = (
            _cell(reading.raw_deg, 9),
            _cell(error, 4),
            _cell(reading.temperature_c, 4),
            "1",
            f"{time_s:.3f}",
            "" if self._direction is None else str(self._direction),
            _cell(velocity, 6),
            "0",
            _cell(reference_deg, 9),
            _cell(reading.corrected_deg, 9),
            _cell(reading.correction_arcsec, 4),
            _cell(reading.uncertainty_arcsec, 4),
            "" if reading.age_ms is None else str(reading.age_ms),
            "" if reading.sequence is None else str(reading.sequence),
            "|".join(status_words(reading.status)),
            utc,
        )
        return ",".join(cells) + "\n"


def _cell(value: float | None, places: int) -> str:
    return "" if value is None else f"{value:.{places}f}"
