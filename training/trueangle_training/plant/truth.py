"""What is really wrong in a case, and what the plan lets anyone see of it."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EffectTruth:
    """One effect that no entry of JOINT.yaml models."""

    name: str
    in_library: bool
    kind: str
    enr: float
    """RMS outside the re-calibratable span over the noise of one reading, as it came out."""
    visible_fraction: float
    visible: bool
    contained_in: dict[str, float]
    """Effects of the library that could carry at least half of it, with the share of energy they carry."""
    accepted_names: tuple[str, ...]
    """Itself if it is in the library, and all that could carry 95 % of it."""
    cells: tuple[CellTruth, ...]
    """Its own, and others of the lattice that carry it as well under this plan."""
    parameters: dict[str, float]
    curve_arcsec: Floats
    """[rows of the file with an error], before zeroing; a variance effect's is its standard deviation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """The answer to one case."""

    case_id: str
    seed: int
    plant: str
    plan: str
    stratum: str
    asked_enr: float
    noise_arcsec: float
    """Standard deviation of one reading about its run's mean, without outliers."""
    effects: tuple[EffectTruth, ...]
    listed: tuple[str, ...]
    """Effects in JOINT.yaml."""
    data_fault: str | None
    expected: str
    """none, named, unknown or data_fault."""
    carried_together: tuple[str, ...]
    """Of two effects: those of the library that could carry their sum."""
    structure_arcsec: Floats
    """[rows of the file with an error]: mean curves of all effects together."""

    def to_plain(self) -> dict[str, Any]:
        """JSON data, curves rounded to 0.1 milliarcsecond."""
        plain = asdict(self)
        plain["structure_arcsec"] = np.round(self.structure_arcsec, 4).tolist()
        for written, effect in zip(plain["effects"], self.effects, strict=True):
            written["curve_arcsec"] = np.round(effect.curve_arcsec, 4).tolist()
        return plain
