"""One thing that is wrong, and where it lies in the words of the report's lattice."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class CellTruth:
    """Where an effect lies, in the words of the report's lattice."""

    order: str
    temperature: str = "constant"
    direction: str = "even"
    time: str = "constant"
    speed: str = "constant"
    load: str = "constant"
    frame: str = "encoder"
    moment: str = "mean"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Defect:
    """One thing that is wrong with the joint or the measurement, of a size to be chosen."""

    name: str
    """Of the effect in reports, or of the unknown family."""
    in_library: bool
    kind: str
    """mean, random, event or variance."""
    contribute: Callable[[float], Any]
    """Size to what it does to the plant's chain, in the plant's own terms; size 1 is about an arcsecond."""
    cells: tuple[CellTruth, ...]
    parameters: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AtSize:
    """A defect at a size."""

    defect: Defect
    size: float

    @property
    def part(self) -> Any:
        """What it does to the chain of the plant that made it."""
        return self.defect.contribute(self.size)
