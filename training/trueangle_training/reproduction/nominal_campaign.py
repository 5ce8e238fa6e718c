"""A complete polygon campaign as the paper's methods see it: nominal angles, nominal temperatures, errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Plan
from trueangle.contract.units import DEG_PER_TURN

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NominalCampaign:
    """Errors over a grid of temperatures, repeats and faces."""

    angle_deg: Floats
    """[faces]: 360 (k - 1) / faces."""
    temperature_c: Floats
    """[temperatures]: set points."""
    error_arcsec: Floats
    """[temperatures, repeats, faces]: indicated minus reference, each run zeroed at its first face, eq. (11)."""

    @property
    def readings(self) -> int:
        """Number of readings, 483 in the paper."""
        return int(self.error_arcsec.size)

    def mean_at_arcsec(self, temperature_c: float) -> Floats:
        """Mean error of each face at one set point, [faces]."""
        (index,) = np.flatnonzero(self.temperature_c == temperature_c)
        return self.error_arcsec[index].mean(axis=0)

    def flat(self) -> tuple[Floats, Floats, Floats]:
        """Angle, temperature and error of each reading, [readings], in the order of `error_arcsec`."""
        temperature_c, _, angle_deg = np.meshgrid(
            self.temperature_c, np.arange(self.error_arcsec.shape[1]), self.angle_deg, indexing="ij"
        )
        return angle_deg.ravel(), temperature_c.ravel(), self.error_arcsec.ravel()


def nominal_campaign(campaign: Campaign, plan: Plan) -> NominalCampaign:
    """The campaign measured (or simulated) by `plan`, one direction, unshifted; ContractError for other plans."""
    shape = (len(plan.temperatures_c), plan.repeats, plan.faces)
    faults: list[Fault] = []
    if plan.directions != (1,) or plan.shift_faces != 0:
        expected = "directions [1] and shift_faces 0, as in the paper"
        faults.append(Fault(where="plan", expected=expected, found=f"{plan.directions}, {plan.shift_faces:g}"))
    if len(set(plan.temperatures_c)) != len(plan.temperatures_c):
        faults.append(Fault(where="plan", expected="each temperature once", found=str(plan.temperatures_c)))
    if len(campaign) != int(np.prod(shape)):
        expected = f"{int(np.prod(shape))} readings of a complete campaign"
        faults.append(Fault(where=campaign.source, expected=expected, found=str(len(campaign))))
    if faults:
        raise ContractError(faults)
    return NominalCampaign(
        angle_deg=np.arange(plan.faces, dtype=np.float64) * (DEG_PER_TURN / plan.faces),
        temperature_c=np.array(plan.temperatures_c, dtype=np.float64),
        error_arcsec=campaign.error_arcsec.reshape(shape),
    )
