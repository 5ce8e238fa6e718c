"""Resident memory of this process over a run, and whether it rises."""

import gc
import os
from pathlib import Path

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
WARM_SHARE = 0.1
"""Caches fill and the allocator finds its size in the first tenth of a run; it is not counted."""
NOISE_MIB = 3.0
"""The allocator's own steps: arenas of 1 MiB come and go."""


def resident_mib(process: int | str = "self") -> float:
    """Resident set size of this or another process now."""
    return int(Path(f"/proc/{process}/statm").read_text("ascii").split()[1]) * _PAGE_BYTES / 2**20


def open_descriptors(process: int | str = "self") -> int:
    """File descriptors of this or another process."""
    return sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())


class MemoryTrack:
    """Readings at shares of a run; the rise is that of a straight line through those after the warm tenth."""

    def __init__(self) -> None:
        self.readings: list[tuple[float, float]] = []

    def read(self, share: float) -> None:
        """One reading, at this share of the run."""
        gc.collect()
        self.readings.append((share, resident_mib()))

    @property
    def warm(self) -> list[tuple[float, float]]:
        """The readings that count."""
        return [(share, mib) for share, mib in self.readings if share >= WARM_SHARE]

    @property
    def rise_mib(self) -> float:
        """Of the fitted line, from a tenth of the run to its end."""
        warm = self.warm
        if len(warm) < 2:
            return 0.0
        mean_share = sum(share for share, _ in warm) / len(warm)
        mean_mib = sum(mib for _, mib in warm) / len(warm)
        spread = sum((share - mean_share) ** 2 for share, _ in warm)
        slope = sum((share - mean_share) * (mib - mean_mib) for share, mib in warm) / spread
        return slope * (1.0 - WARM_SHARE)

    @property
    def rises(self) -> bool:
        """More than noise."""
        return self.rise_mib > NOISE_MIB
