"""Lines of a file in messages: some of them to read, and all of them to copy into an option."""

from collections.abc import Iterable

import numpy as np

LINES_SHOWN = 10
MOST_RANGES = 60
"""More are not left out by hand: the file is to be mended."""


def lines_text(lines: Iterable[int]) -> str:
    """The first of them, and how many there are."""
    listed = [str(int(line)) for line in lines]
    shown = ", ".join(listed[:LINES_SHOWN])
    if len(listed) > LINES_SHOWN:
        return f"lines {shown}, ... {len(listed)} in all"
    return f"lines {shown}" if len(listed) > 1 else f"line {shown}"


def line_ranges(lines: Iterable[int]) -> str | None:
    """All of them as `17,40-62`, what --exclude-rows takes; None: too scattered to be copied."""
    ordered = np.unique(np.fromiter(lines, dtype=np.int64))
    breaks = np.flatnonzero(np.diff(ordered) > 1) + 1
    parts = [part for part in np.split(ordered, breaks) if part.size]
    if len(parts) > MOST_RANGES:
        return None
    return ",".join(f"{part[0]}-{part[-1]}" if part.size > 1 else f"{part[0]}" for part in parts)


def leave_out_advice(lines: Iterable[int]) -> str:
    """What to do with wrong readings."""
    option = line_ranges(lines)
    return "Mend the file" if option is None else f"Mend the file, or leave them out with --exclude-rows {option}"
