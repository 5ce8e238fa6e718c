"""What the figures of a diagnosis show of the readings; apart from the figures, whose library is slow to load."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """Every array has shape [readings]."""

    angle_deg: Floats
    run: Integers
    recalibrated_arcsec: Floats
    """Measured minus simulator, its parameters and zeros fitted."""
    explained_arcsec: Floats
    """The same with the causes added."""
    temperature_c: Floats | None = None
    direction: Floats | None = None
