"""JOINT.yaml and PLAN.yaml: the joint as the simulator knows it, and the campaign to be measured.

One versioned schema for simulate, train and diagnose. A parameter that is left out is calibrated from data;
`simulate` needs it and says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any

from trueangle.contract.document import Node, Range, document_from_plain, plain, structure
from trueangle.contract.encoder import MAX_COUNTS_PER_REV, EncoderSettings
from trueangle.contract.errors import ContractError, Fault

SCHEMA_VERSION = 1

EFFECT_NAMES = (
    "eccentricity",
    "grating_tilt",
    "graduation_error",
    "localized_defect",
    "subdivision_error",
    "quantisation",
    "count_loss",
    "thermal_eccentricity",
    "thermal_tilt",
    "thermal_graduation",
    "thermal_nonlinearity",
    "thermal_lag",
    "temperature_sensor_error",
    "self_heating",
    "hysteresis",
    "windup",
    "bearing_wobble",
    "load_deflection",
    "index_drift",
    "read_latency",
    "reference_artefact",
    "run_to_run_eccentricity",
    "noise_growth",
)
"""The names that joints, simulator and reports use; extended, never renamed."""


class ReferenceKind(Enum):
    """What gave the reference angle."""

    POLYGON = "polygon"
    ENCODER = "encoder"


@dataclass(frozen=True, slots=True, kw_only=True)
class JointEncoder:
    """Encoder geometry and, where known, the identity and settings it had at calibration."""

    lines_per_rev: Annotated[int, Range(minimum=1, maximum=MAX_COUNTS_PER_REV)]
    counts_per_rev: Annotated[int, Range(minimum=2, maximum=MAX_COUNTS_PER_REV)]
    settings: EncoderSettings = field(default_factory=EncoderSettings)

    def __post_init__(self) -> None:
        if self.counts_per_rev < self.lines_per_rev:
            expected = f"at least lines_per_rev ({self.lines_per_rev})"
            raise ContractError([Fault(where="counts_per_rev", expected=expected, found=str(self.counts_per_rev))])
        units = self.settings.units_per_revolution
        if units is not None and units != self.counts_per_rev:
            raise ContractError(
                [
                    Fault(
                        where="settings",
                        expected=f"units_per_revolution equal to counts_per_rev ({self.counts_per_rev})",
                        found=str(units),
                    )
                ]
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The reference of the campaign and its standard uncertainties (k = 1)."""

    kind: ReferenceKind
    faces: Annotated[int, Range(minimum=3, maximum=1000)] | None = None
    """Faces of the polygon; None with a reference encoder."""
    autocollimator_arcsec: Annotated[float, Range(minimum=0, maximum=100)] = 0.0
    polygon_arcsec: Annotated[float, Range(minimum=0, maximum=100)] = 0.0
    certificate_id: str | None = None

    def __post_init__(self) -> None:
        if self.kind is ReferenceKind.POLYGON and self.faces is None:
            raise ContractError(
                [Fault(where="kind", expected="faces beside kind polygon", found="no number of faces")]
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSensor:
    """The joint's temperature sensor."""

    resolution_c: Annotated[float, Range(minimum=0, maximum=10)] = 0.0
    standard_uncertainty_c: Annotated[float, Range(minimum=0, maximum=10)] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Scatter of one reading about its mean, quantisation not included."""

    repeatability_arcsec: Annotated[float, Range(minimum=0, maximum=3600)] = 0.0
    """Standard deviation, white."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """A rotation joint: geometry, reference, noise, and the effects its simulator models."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    encoder: JointEncoder
    reference: Reference
    effects: Mapping[str, Node]
    """Effect name to its settings (a mapping, possibly empty), checked by the effect itself."""
    name: str = "joint"
    base_temperature_c: Annotated[float, Range(minimum=-50, maximum=150)] = 20.0
    noise: Noise = field(default_factory=Noise)
    temperature_sensor: TemperatureSensor = field(default_factory=TemperatureSensor)

    def __post_init__(self) -> None:
        faults = [
            Fault(
                where=f"effects.{name}",
                expected="an effect of the library",
                found=name,
                advice=", ".join(EFFECT_NAMES),
            )
            for name in self.effects
            if name not in EFFECT_NAMES
        ]
        if faults:
            raise ContractError(faults)


def joint_from_document(document: Node) -> Joint:
    """JOINT.yaml; `effects` may be a list of names (defaults) or a mapping of names to settings."""
    if isinstance(document.value, Mapping) and "effects" in document.value:
        effects = document.value["effects"]
        if isinstance(effects.value, (list, tuple)):
            named = _named_effects(effects)
            document = Node(
                value={**document.value, "effects": named},
                source=document.source,
                line=document.line,
                path=document.path,
            )
    return structure(Joint, document)


def _named_effects(effects: Node) -> Node:
    items = effects.value
    assert isinstance(items, (list, tuple))  # noqa: S101 - narrowed by the caller
    faults = [
        Fault(where=item.where, expected="an effect's name", found=repr(item.plain()))
        for item in items
        if not isinstance(item.value, str)
    ]
    if faults:
        raise ContractError(faults)
    named = {
        str(item.value): Node(value={}, source=item.source, line=item.line, path=f"effects.{item.value}")
        for item in items
    }
    return Node(value=named, source=effects.source, line=effects.line, path=effects.path)


def joint_to_plain(joint: Joint) -> dict[str, Any]:
    """The joint as YAML data; reading it back gives an equal joint."""
    return plain(joint)


class PlanZero(Enum):
    """Which readings are counted from the same zero."""

    PER_RUN = "per_run"
    """Every run is zeroed at its first reading, as eq. (11) of Jia et al. 2020 has it."""
    ONE = "one"
    """Polygon, encoder and autocollimator are left as they are over all temperatures: one zero for all runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """PLAN.yaml: which angles at which temperatures, how often."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    faces: Annotated[int, Range(minimum=3, maximum=1000)]
    temperatures_c: tuple[Annotated[float, Range(minimum=-50, maximum=150)], ...]
    repeats: Annotated[int, Range(minimum=1, maximum=1000)]
    directions: tuple[Annotated[int, Range(minimum=-1, maximum=1)], ...] = (1,)
    """Each repeat is measured once in each of these directions: +1 increasing angle, -1 decreasing."""
    shift_faces: Annotated[float, Range(minimum=0, maximum=1000)] = 0.0
    """Repeat k is measured with the polygon turned on the shaft by k times this many face pitches."""
    soak_h: Annotated[float, Range(minimum=0, maximum=1000)] = 4.0
    """Time at a new temperature before the first reading."""
    temperature_jitter_c: Annotated[float, Range(minimum=0, maximum=10)] = 0.1
    """Half width of the chamber's temperature about its set point."""
    seconds_per_reading: Annotated[float, Range(minimum=0, maximum=3600)] = 15.0
    zero: PlanZero = PlanZero.PER_RUN
    """One zero shows how the datum itself moves with temperature; turning the polygon on the shaft loses it."""

    def __post_init__(self) -> None:
        faults: list[Fault] = []
        if self.zero is PlanZero.ONE and self.shift_faces != 0:
            expected = "0 beside zero: one, as a polygon turned on the shaft has a new zero"
            faults.append(Fault(where="shift_faces", expected=expected, found=f"{self.shift_faces:g}"))
        if not self.temperatures_c:
            faults.append(Fault(where="temperatures_c", expected="at least one temperature", found="none"))
        if not self.directions or 0 in self.directions or len(set(self.directions)) < len(self.directions):
            found = str(list(self.directions))
            faults.append(Fault(where="directions", expected="1, -1 or both, each once", found=found))
        if faults:
            raise ContractError(faults)


def plan_from_document(document: Node) -> Plan:
    """PLAN.yaml."""
    return structure(Plan, document)


def plan_to_plain(plan: Plan) -> dict[str, Any]:
    """The plan as YAML data; reading it back gives an equal plan."""
    return plain(plan)


def effect_settings(values: Mapping[str, Any], *, name: str) -> Node:
    """Settings of an effect made in code rather than read from a file."""
    return document_from_plain(dict(values), source="made in code", path=f"effects.{name}")
