"""The day by which a calibration is judged: it never goes back while the process lives.

A clock set back must not make a past-due calibration good again.
"""

import datetime
from collections.abc import Callable


class LatestDay:
    """The latest day that a clock has shown."""

    def __init__(self, read: Callable[[], datetime.date]) -> None:
        self._read = read
        self._latest = read()

    def __call__(self) -> datetime.date:
        """Today, or the latest day seen where the clock was set back."""
        self._latest = max(self._latest, self._read())
        return self._latest


def is_past_due(today: datetime.date, calibrated: datetime.date | None, due: datetime.date | None) -> bool:
    """Whether the day after `due` has come; a day before the calibration says only that the clock is wrong.

    Without a due date nothing is ever past it.
    """
    return due is not None and (today > due or (calibrated is not None and today < calibrated))
