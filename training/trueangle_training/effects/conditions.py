"""Under which conditions each reading of a campaign was taken: what every effect is a function of."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timeline:
    """What happened between the readings too: the heat of a joint does not begin anew with each run.

    Arrays of shape [knots], times not falling; two knots at one time are a step. Between knots the temperature is
    linear in time.
    """

    time_s: Floats
    temperature_c: Floats
    """Of the sensor beside the reading head."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """Readings without their errors; every array has shape [readings], in the order of the file.

    Optional columns are None where the campaign has none. An unknown direction is 0; a missing temperature, time,
    velocity or load is NaN, arrays having no other way.
    """

    angle_deg: Floats
    """Not wrapped. The true angle in the simulator, the indicated one in the diagnosis: arcseconds apart."""
    run: Integers
    zero_group: Integers
    lines_per_rev: int
    counts_per_rev: int
    base_temperature_c: float
    temperature_c: Floats | None = None
    """Of the sensor beside the reading head."""
    time_s: Floats | None = None
    direction: Floats | None = None
    """+1 approached with increasing angle, -1 decreasing, 0 not known."""
    velocity_deg_s: Floats | None = None
    load_nm: Floats | None = None
    face: Integers | None = None
    """Polygon face 1..n; 0 where a reference encoder was used."""
    polygon_offset: Integers | None = None
    faces: int | None = None
    """Of the polygon; None with a reference encoder."""
    joint: Joint | None = None
    """As JOINT.yaml has it: what an effect on other effects (the temperature sensor's error) is computed from."""
    timeline: Timeline | None = None
    """Known in the simulator; None: to be inferred from the readings."""

    def __len__(self) -> int:
        return int(self.angle_deg.size)

    def complete(self, name: str) -> Floats | None:
        """A float column where every reading has a value; None where it is missing, wholly or in part."""
        values: Floats | None = getattr(self, name)
        return None if values is None or np.isnan(values).any() else values

    def known_direction(self) -> Floats | None:
        """+1 or -1 for every reading; None where it is not known of all."""
        return None if self.direction is None or np.any(self.direction == 0) else self.direction

    def rows(self, kept: NDArray[np.bool_] | Integers) -> "Conditions":
        """The readings of a mask or of indices."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        arrays = {name: value[kept] for name, value in values.items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


def conditions_of(campaign: Campaign, joint: Joint) -> Conditions:
    """The conditions of a measured campaign."""
    return Conditions(
        angle_deg=campaign.angle_deg,
        run=campaign.run,
        zero_group=campaign.zero_group,
        lines_per_rev=joint.encoder.lines_per_rev,
        counts_per_rev=joint.encoder.counts_per_rev,
        base_temperature_c=joint.base_temperature_c,
        temperature_c=campaign.temperature_c,
        time_s=campaign.time_s,
        direction=None if campaign.direction is None else campaign.direction.astype(np.float64),
        velocity_deg_s=campaign.velocity_deg_s,
        load_nm=campaign.load_nm,
        face=campaign.face,
        polygon_offset=campaign.polygon_offset,
        faces=joint.reference.faces,
        joint=joint,
    )
