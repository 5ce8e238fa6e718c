"""What a report is made of."""

import datetime
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint
from trueangle.contract.metadata import ModelMetadata
from trueangle_training.hidden_node_sweep import HiddenNodeSweep
from trueangle_training.methods import TrainingReadings
from trueangle_training.report.compared import ComparedMethods
from trueangle_training.report.served import Corrections

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportInputs:
    """All that a report shows; what is None is said to be missing."""

    campaign: Campaign
    """The readings the model is held against: those it was trained on, or others to verify it."""
    model: Corrections
    metadata: ModelMetadata
    model_file: str
    """Its name, as the user gave it."""
    model_sha256: str
    made_on: datetime.date
    joint: Joint | None = None
    """Temperature sensor and noise as stated; None: no JOINT.yaml was given."""
    comparison: ComparedMethods | None = None
    sweep: HiddenNodeSweep | None = None
    """None: the method has no hidden nodes, or they were not tried."""

    @property
    def of_training(self) -> bool:
        """Whether the campaign is the one that the model was trained on."""
        return self.campaign.sha256 == self.metadata.calibration.file_sha256

    @property
    def temperature_known(self) -> bool:
        """Whether the campaign has temperatures."""
        return self.campaign.temperature_c is not None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportReadings:
    """The readings that the report can use, each array of shape [readings], and the model's word at each."""

    readings: TrainingReadings
    row: NDArray[np.int64]
    """1-based lines of the campaign file."""
    left_arcsec: Floats
    """Error plus correction."""
    uncertainty_arcsec: Floats | None
    """The served standard uncertainty; None: none is served."""
    left_out: int
    """Readings without a temperature, where others have one."""


def report_readings(inputs: ReportInputs) -> ReportReadings:
    """Readings with all values; without any temperature the middle of the model's range stands for it."""
    campaign = inputs.campaign
    valid_c = inputs.metadata.valid_temperature_c
    middle_c = (valid_c.minimum + valid_c.maximum) / 2.0
    temperature_c = np.full(len(campaign), middle_c) if campaign.temperature_c is None else campaign.temperature_c
    known = ~np.isnan(temperature_c)
    angle_deg, temperature_c = campaign.angle_deg[known], temperature_c[known]
    readings = TrainingReadings(
        angle_deg=angle_deg,
        error_arcsec=campaign.error_arcsec[known],
        temperature_c=temperature_c,
        run=campaign.run[known],
        zero_group=campaign.zero_group[known],
        datum_deg=inputs.metadata.datum_deg % 360.0,
    )
    return ReportReadings(
        readings=readings,
        row=campaign.row[known],
        left_arcsec=readings.error_arcsec + inputs.model.correction_arcsec(angle_deg, temperature_c),
        uncertainty_arcsec=inputs.model.uncertainty_arcsec(angle_deg, temperature_c),
        left_out=int(np.count_nonzero(~known)),
    )
