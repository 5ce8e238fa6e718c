"""The lattice of places where a gap can lie: which order, under which conditions, in the mean or the scatter."""

from dataclasses import dataclass
from typing import Literal

Temperature = Literal["constant", "linear", "quadratic", "lagged", "step"]
Direction = Literal["even", "odd"]
Time = Literal["constant", "within_run", "between_runs"]
Slope = Literal["constant", "linear"]
Frame = Literal["encoder", "polygon"]
Moment = Literal["mean", "variance"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One place, as `report.json` writes it."""

    order: str
    """"0" to "60" (once a turn is "1"), "N", "2N", "4N" (per line), "non-integer" or "localized"."""
    temperature: Temperature = "constant"
    direction: Direction = "even"
    time: Time = "constant"
    speed: Slope = "constant"
    load: Slope = "constant"
    frame: Frame = "encoder"
    moment: Moment = "mean"
