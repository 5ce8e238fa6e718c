"""What the frame asks of a plant, and of one joint in one campaign that the plant has drawn.

A plant's package offers one `PLANT`; `plants.py` gathers them under their letters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.defect import AtSize, Defect
from trueangle_training.plant.listing import Encoder, Listing
from trueangle_training.plant.schedule import PlanName

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Columns of a campaign, shape [n]; all others are the schedule's."""

    angle_deg: Floats
    """Of the encoder, in whole counts."""
    error_arcsec: Floats
    """Each zero group counted from its first row (`zeroed`)."""
    temperature_c: Floats


def zeroed(error: Floats, zero_group: Integers) -> Floats:
    """Each group counted from its first row."""
    out = error.copy()
    for group in np.unique(zero_group):
        rows = np.flatnonzero(zero_group == group)
        out[rows] -= error[rows[0]]
    return out


class World(Protocol):
    """One joint in one campaign, before anything is wrong with it but what JOINT.yaml lists."""

    @property
    def conditions(self) -> Conditions:
        """What the readings were taken under."""
        ...

    @property
    def encoder(self) -> Encoder:
        """Its label."""
        ...

    @property
    def listing(self) -> Listing:
        """What JOINT.yaml lists; the listed effects are present."""
        ...

    @property
    def sensor_step_c(self) -> float:
        """Resolution of the temperature sensor."""
        ...

    def with_listing(self, listing: Listing) -> Self:
        """The same joint when other effects are listed, and so present."""
        ...

    def noise_of_one_reading(self) -> float:
        """Standard deviation about the zero groups' means, rounding to counts included, outliers left out."""
        ...

    def defect(self, name: str, rng: np.random.Generator) -> Defect:
        """One effect of the library or unknown family that this plant can make."""
        ...

    def curve_arcsec(self, sized: Sequence[AtSize]) -> Floats:
        """Indicated minus reference without noise and rounding, listed effects included, shape [n]."""
        ...

    def scatter_arcsec(self, sized: AtSize) -> Floats:
        """Standard deviation that a defect of kind variance adds to each reading, shape [n]."""
        ...

    def measured(self, sized: Sequence[AtSize], rng: np.random.Generator) -> Measured:
        """The campaign's columns, with noise and rounding."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plant:
    """One generator."""

    letter: str
    description: str
    library: tuple[str, ...]
    """Effects of the library that it can make."""
    unknown: Mapping[PlanName, tuple[str, ...]]
    """Families in no library that it can make and the plan can show."""
    draw_world: Callable[[PlanName, np.random.Generator], World]
