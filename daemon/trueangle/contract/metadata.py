"""What a model file says of itself: one JSON document beside the graph, with probes to replay.

The document travels in the ONNX file's `metadata_props` under `METADATA_KEY`; its JSON schema is
`model-metadata.schema.json` in this package. Graph inputs and outputs are fixed here as well.
"""

import datetime
import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Annotated, Any

from trueangle.contract.document import Node, Pattern, Range, document_from_plain, plain, structure
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import JointEncoder
from trueangle.contract.units import DEG_PER_TURN

METADATA_KEY = "trueangle"
SEAL_KEY = "trueangle_sha256"
"""The SHA-256 of the whole file with the digest's own 64 digits written as zeros: shows damage that neither the
graph's checker nor the probes can see, such as a changed range or datum."""
OPEN_SEAL = "0" * 64
SCHEMA_VERSION = 1
SIGN_CONVENTION = "corrected = raw + correction"

ANGLE_INPUT = "angle_deg"
TEMPERATURE_INPUT = "temperature_c"
CORRECTION_OUTPUT = "correction_arcsec"
UNCERTAINTY_OUTPUT = "uncertainty_arcsec"

PROBE_TOLERANCE_ARCSEC = 1e-6
"""How closely a replayed probe must agree: far below any encoder, far above float64 rounding."""

Hash = Annotated[str, Pattern(regex="[0-9a-f]{64}", meaning="64 hexadecimal digits (SHA-256)")]
Date = Annotated[str, Pattern(regex=r"\d{4}-\d{2}-\d{2}", meaning="a date as YYYY-MM-DD")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A closed range of an input in which the model may be used."""

    minimum: float
    maximum: float

    def __post_init__(self) -> None:
        if self.maximum < self.minimum:
            expected = f"at least minimum ({self.minimum:g})"
            raise ContractError([Fault(where="maximum", expected=expected, found=f"{self.maximum:g}")])

    def holds(self, value: float) -> bool:
        """Whether the value lies in the range, ends included."""
        return self.minimum <= value <= self.maximum


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelInput:
    """One input of the graph: float64, shape [n]."""

    name: str
    unit: str
    range: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRecord:
    """The campaign behind the model."""

    id: str
    file_sha256: Hash
    readings: Annotated[int, Range(minimum=1)]
    date: Date
    due: Date | None = None
    """After this day the model is past due; None: no due date was set."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        for name in ("date", "due"):
            text = getattr(self, name)
            try:
                if text is not None:
                    datetime.date.fromisoformat(text)
            except ValueError:
                faults.append(Fault(where=name, expected="a day of the calendar, YYYY-MM-DD", found=str(text)))
        if faults:
            raise ContractError(faults)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceRecord:
    """The reference angle behind the model."""

    kind: str
    standard_uncertainty_arcsec: Annotated[float, Range(minimum=0)] | None = None
    """k = 1; None: not stated."""
    faces: int | None = None
    certificate_id: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FitErrors:
    """RMS of readings about the model's own error curve, its constant included; None: not evaluated."""

    in_sample_rmse_arcsec: float | None = None
    """Over the readings it was trained on, about the mean of each zero group: says little about other angles and
    temperatures."""
    validation_rmse_arcsec: float | None = None
    """Over the random part kept back for early stopping, so slightly optimistic."""
    held_out_rmse_arcsec: float | None = None
    """Over data that no step of the training saw."""
    held_out_kind: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Probes:
    """Inputs with the outputs they must give; all lists have the same length."""

    angle_deg: tuple[float, ...]
    temperature_c: tuple[float, ...]
    correction_arcsec: tuple[float, ...]
    uncertainty_arcsec: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        lengths = {len(self.angle_deg), len(self.temperature_c), len(self.correction_arcsec)}
        if self.uncertainty_arcsec is not None:
            lengths.add(len(self.uncertainty_arcsec))
        if lengths == {0} or len(lengths) > 1:
            found = ", ".join(str(n) for n in sorted(lengths))
            raise ContractError([Fault(where="angle_deg", expected="probe lists of one length", found=found)])


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelMetadata:
    """All that a model file says of itself."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    joint: str
    method: str
    method_settings: Mapping[str, Node]
    inputs: tuple[ModelInput, ...]
    """Exactly `angle_deg` (deg) and `temperature_c` (degC), in this order."""
    sign_convention: str
    temperature_used: bool
    datum_deg: Annotated[float, Range(minimum=0, maximum=DEG_PER_TURN)]
    """Where the correction is 0 at every temperature."""
    calibration: CalibrationRecord
    reference: ReferenceRecord
    errors: FitErrors
    seed: int
    versions: Mapping[str, str]
    """Package name to version of what trained the model."""
    probes: Probes
    encoder: JointEncoder | None = None
    """The encoder of the calibration; None: not stated, so nobody can tell it from another's."""
    probe_tolerance_arcsec: Annotated[float, Range(minimum=0, maximum=1e-6)] = PROBE_TOLERANCE_ARCSEC
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        found = [(item.name, item.unit) for item in self.inputs]
        if found != [(ANGLE_INPUT, "deg"), (TEMPERATURE_INPUT, "degC")]:
            expected = f"{ANGLE_INPUT} in deg, then {TEMPERATURE_INPUT} in degC"
            faults.append(Fault(where="inputs", expected=expected, found=str(found)))
        if self.sign_convention != SIGN_CONVENTION:
            faults.append(Fault(where="sign_convention", expected=SIGN_CONVENTION, found=self.sign_convention))
        if faults:
            raise ContractError(faults)

    @property
    def valid_angle_deg(self) -> Interval:
        """Angles in [0, 360] that the campaign covers."""
        return self.inputs[0].range

    @property
    def valid_temperature_c(self) -> Interval:
        """Temperatures that the campaign covers."""
        return self.inputs[1].range

    @property
    def encoder_settings(self) -> EncoderSettings:
        """The encoder as it was at calibration, as far as it was stated."""
        return EncoderSettings() if self.encoder is None else self.encoder.settings


def metadata_to_json(metadata: ModelMetadata) -> str:
    """The document as it stands in the model file: sorted keys, so equal models give equal bytes."""
    return json.dumps(plain(metadata), sort_keys=True, ensure_ascii=False, allow_nan=False)


def metadata_from_json(text: str, *, source: str) -> ModelMetadata:
    """Read and check the document; ContractError with every fault."""
    try:
        data = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        found = str(error)
        raise ContractError([Fault(where=source, expected="a JSON document", found=found)]) from error
    return structure(ModelMetadata, document_from_plain(data, source=source))


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def sealed(data: bytes) -> bytes:
    """The file with its digest in the place of `OPEN_SEAL`, which must stand in it exactly once."""
    if data.count(OPEN_SEAL.encode()) != 1:
        raise ValueError("the open seal must stand in the file exactly once")
    return data.replace(OPEN_SEAL.encode(), hashlib.sha256(data).hexdigest().encode())


def seal_holds(data: bytes, seal: str | None) -> bool:
    """Whether the file is, byte for byte, the one that was sealed."""
    if seal is None or not re.fullmatch("[0-9a-f]{64}", seal):
        return False
    return hashlib.sha256(data.replace(seal.encode(), OPEN_SEAL.encode())).hexdigest() == seal


def metadata_schema() -> dict[str, Any]:
    """The JSON schema that other tools may check the document with."""
    text = resources.files("trueangle.contract").joinpath("model-metadata.schema.json").read_text("utf-8")
    return json.loads(text)


def probe_disagreement(
    probes: Probes,
    *,
    correction_arcsec: list[float],
    uncertainty_arcsec: list[float] | None,
    tolerance_arcsec: float,
) -> str | None:
    """What the first disagreeing probe shows; None when every replayed value is within the tolerance."""
    pairs = [("correction_arcsec", probes.correction_arcsec, correction_arcsec)]
    if probes.uncertainty_arcsec is not None:
        if uncertainty_arcsec is None:
            return "probes state an uncertainty, the graph gives none"
        pairs.append(("uncertainty_arcsec", probes.uncertainty_arcsec, uncertainty_arcsec))
    for name, expected, got in pairs:
        for i, (want, value) in enumerate(zip(expected, got, strict=True)):
            if not math.isfinite(value) or abs(value - want) > tolerance_arcsec:
                at = f"angle {probes.angle_deg[i]:g} deg, {probes.temperature_c[i]:g} degC"
                return f"probe {i + 1} ({at}): {name} expected {want:.9g}, got {value:.9g}"
    return None
