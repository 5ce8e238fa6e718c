"""The model file: graph, metadata and probes in one, replayed before anybody may have it."""

from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import TrueangleError
from trueangle.contract.metadata import (
    ANGLE_INPUT,
    METADATA_KEY,
    OPEN_SEAL,
    PROBE_TOLERANCE_ARCSEC,
    SEAL_KEY,
    TEMPERATURE_INPUT,
    Interval,
    ModelInput,
    ModelMetadata,
    Probes,
    metadata_to_json,
    sealed,
)
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.export import NO_ADDITIONS, attach_metadata, build_graph, check_agreement
from trueangle_training.methods import FittedModel
from trueangle_training.uncertainty import UncertaintyBudget, total_uncertainty_arcsec

Floats = NDArray[np.float64]

PACKAGES = ("trueangle", "numpy", "onnx", "onnxruntime")
PROBE_ANGLES = 24
CHECK_ANGLES = 3000


class DisagreementError(TrueangleError):
    """The exported graph does not give what the model gives: nothing may be written."""


def model_inputs(valid_angle_deg: Interval, valid_temperature_c: Interval) -> tuple[ModelInput, ...]:
    """The two inputs that every model has, with the ranges in which this one may be used."""
    return (
        ModelInput(name=ANGLE_INPUT, unit="deg", range=valid_angle_deg),
        ModelInput(name=TEMPERATURE_INPUT, unit="degC", range=valid_temperature_c),
    )


def package_versions(*, torch: bool) -> dict[str, str]:
    """What trained the model; `torch`: whether the method used it."""
    return {name: version(name) for name in (*PACKAGES, *(("torch",) if torch else ()))}


def model_probes(
    model: FittedModel, *, datum_deg: float, temperature_c: Interval, budget: UncertaintyBudget = NO_ADDITIONS
) -> Probes:
    """Angles all round, at the seam, at the datum and turns away from it; three temperatures."""
    # Off the polygon's faces and off the places where sines are round numbers.
    all_round = np.arange(PROBE_ANGLES) * (DEG_PER_TURN / PROBE_ANGLES) + 7.3
    seam = [0.0, 1e-6, 359.9999, -0.0001, 360.0]
    turns = [datum_deg, datum_deg + 360.0, datum_deg - 720.0, -123.456, 1234.5]
    angles_deg = np.concatenate([all_round, seam, turns])
    middle_c = (temperature_c.minimum + temperature_c.maximum) / 2
    temperatures_c = np.array([temperature_c.minimum, middle_c, temperature_c.maximum])
    angle_deg = np.tile(angles_deg, temperatures_c.size)
    at_c = np.repeat(temperatures_c, angles_deg.size)
    correction_arcsec = -model.error_arcsec(angle_deg, at_c)
    uncertainty_arcsec = total_uncertainty_arcsec(model, budget, angle_deg, at_c)
    return Probes(
        angle_deg=tuple(angle_deg.tolist()),
        temperature_c=tuple(at_c.tolist()),
        # Adding 0 turns the -0.0 of the datum into 0.0.
        correction_arcsec=tuple((correction_arcsec + 0.0).tolist()),
        uncertainty_arcsec=None if uncertainty_arcsec is None else tuple(uncertainty_arcsec.tolist()),
    )


def model_file(model: FittedModel, metadata: ModelMetadata, budget: UncertaintyBudget = NO_ADDITIONS) -> bytes:
    """The ONNX file's bytes; DisagreementError where ONNX Runtime does not reproduce the model and its probes."""
    proto = build_graph(model, budget)
    attach_metadata(proto, METADATA_KEY, metadata_to_json(metadata))
    attach_metadata(proto, SEAL_KEY, OPEN_SEAL)
    data = sealed(proto.SerializeToString(deterministic=True))
    probes = metadata.probes
    # Ranges beyond the valid ones are replayed too: the graph must clamp nothing.
    angle_deg = np.concatenate([np.array(probes.angle_deg), np.linspace(-1000.0, 1000.0, CHECK_ANGLES)])
    valid_c = metadata.valid_temperature_c
    grid_c = np.linspace(valid_c.minimum - 20.0, valid_c.maximum + 20.0, CHECK_ANGLES)
    temperature_c = np.concatenate([np.array(probes.temperature_c), np.roll(grid_c, CHECK_ANGLES // 3)])
    difference_arcsec = check_agreement(data, model, angle_deg, temperature_c, budget)
    if not difference_arcsec <= PROBE_TOLERANCE_ARCSEC:
        raise DisagreementError(
            f"exported graph: expected the model's corrections within {PROBE_TOLERANCE_ARCSEC:g} arcsec, "
            f"found {difference_arcsec:.3g} arcsec off under ONNX Runtime {version('onnxruntime')}; nothing was "
            "written; report this with the versions of onnx and onnxruntime"
        )
    return data
