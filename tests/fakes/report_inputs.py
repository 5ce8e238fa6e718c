"""A campaign of a known joint, a model that knows it, and all that a report is made of."""

import datetime
from dataclasses import dataclass, replace

import numpy as np

from trueangle.contract.calibration import Campaign
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.joint import JointEncoder
from trueangle.contract.metadata import (
    SIGN_CONVENTION,
    CalibrationRecord,
    FitErrors,
    Interval,
    ModelMetadata,
    Probes,
    ReferenceRecord,
)
from trueangle_training.hidden_node_sweep import HiddenNodeSweep, SweepPoint
from trueangle_training.model_file import model_inputs
from trueangle_training.report.inputs import ReportInputs

SHA256 = "a" * 64
NOISE_ARCSEC = 0.5
FACES, RUNS_A_TEMPERATURE = 23, 3
TEMPERATURES_C = (10.0, 15.0, 20.0, 25.0, 30.0)
SLOPE_ARCSEC_PER_C = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownModel:
    """Corrects eccentricity that turns with temperature; serves a constant uncertainty or none."""

    u_arcsec: float | None = 0.3

    def correction_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
        return -true_error_arcsec(angle_deg, temperature_c)

    def uncertainty_arcsec(self, angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray | None:
        return None if self.u_arcsec is None else np.full(angle_deg.shape, self.u_arcsec)


def true_error_arcsec(angle_deg: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
    rad = np.radians(angle_deg)
    thermal = SLOPE_ARCSEC_PER_C * (temperature_c - 20.0) * np.sin(rad)
    return 50.0 * (np.cos(rad) - 1.0) + thermal


def made_campaign(seed: int = 0, *, source: str = "campaign.csv") -> Campaign:
    rng = np.random.default_rng(seed)
    runs = len(TEMPERATURES_C) * RUNS_A_TEMPERATURE
    angle_deg = np.tile(np.arange(FACES) * 360.0 / FACES, runs)
    temperature_c = np.repeat(TEMPERATURES_C, RUNS_A_TEMPERATURE * FACES)
    error_arcsec = true_error_arcsec(angle_deg, temperature_c) + rng.normal(0.0, NOISE_ARCSEC, angle_deg.size)
    run = np.repeat(np.arange(1, runs + 1), FACES)
    return Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec,
        run=run,
        zero_group=run,
        row=np.arange(2, run.size + 2),
        source=source,
        sha256=SHA256,
        temperature_c=temperature_c,
    )


def made_inputs(campaign: Campaign | None = None, **changes: object) -> ReportInputs:
    settings = EncoderSettings(serial_number=1234567, units_per_revolution=3276800)
    inputs = model_inputs(Interval(minimum=0.0, maximum=360.0), Interval(minimum=10.0, maximum=30.0))
    metadata = ModelMetadata(
        schema_version=1,
        joint="elbow",
        method="linear",
        method_settings={},
        inputs=inputs,
        sign_convention=SIGN_CONVENTION,
        temperature_used=True,
        datum_deg=0.0,
        calibration=CalibrationRecord(
            id="elbow-1", file_sha256=SHA256, readings=345, date="2025-03-01", due="2026-03-01"
        ),
        reference=ReferenceRecord(
            kind="polygon", standard_uncertainty_arcsec=0.125, faces=FACES, certificate_id="P-17"
        ),
        errors=FitErrors(held_out_rmse_arcsec=0.55, held_out_kind="leave-one-temperature-out"),
        seed=0,
        versions={"numpy": "2.0"},
        probes=Probes(angle_deg=(0.0,), temperature_c=(20.0,), correction_arcsec=(0.0,)),
        encoder=JointEncoder(lines_per_rev=16384, counts_per_rev=3276800, settings=settings),
    )
    made = ReportInputs(
        campaign=made_campaign() if campaign is None else campaign,
        model=KnownModel(),
        metadata=metadata,
        model_file="elbow.onnx",
        model_sha256="b" * 64,
        made_on=datetime.date(2025, 6, 1),
    )
    return replace(made, **changes)  # pyright: ignore[reportArgumentType]


def made_sweep(setting: str = "one training a point") -> HiddenNodeSweep:
    points = [
        SweepPoint(
            hidden_nodes=nodes, rmse_arcsec=rmse, standard_error_arcsec=0.02, at_temperature_arcsec=(rmse, rmse)
        )
        for nodes, rmse in ((5, 1.104), (20, 0.907))
    ]
    return HiddenNodeSweep(
        method="linear", setting=setting, temperatures=("10.0 degC", "30.0 degC"), points=tuple(points)
    )
