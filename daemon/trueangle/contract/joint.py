"""JOINT.yaml and PLAN.yaml: the joint as the simulator knows it, and the campaign to be measured.

One versioned schema for simulate, train and diagnose. A parameter that is left out is calibrated from data;
`simulate` needs it and says so.
"""

from collections.abc import Mapping, Sequence
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
    names = [item.value for item in items]
    faults += [
        Fault(where=item.where, expected="each effect once", found=f"{item.value} again", advice="leave it out")
        for place, item in enumerate(items)
        if isinstance(item.value, str) and item.value in names[:place]
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


class SegmentKind(Enum):
    """What a segment's readings are compared with."""

    POLYGON = "polygon"
    """Face after face under the autocollimator; the shaft stands still at each reading."""
    SWEEP = "sweep"
    """A reference encoder, at any angles; the shaft may move."""


SetPoint = Annotated[float, Range(minimum=-50, maximum=150)]
Approach = Annotated[int, Range(minimum=-1, maximum=1)]


def _direction_faults(directions: Sequence[int]) -> list[Fault]:
    if directions and 0 not in directions and len(set(directions)) == len(directions):
        return []
    return [Fault(where="directions", expected="1, -1 or both, each once", found=str(list(directions)))]


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """A block of readings after those of the plan itself.

    At each temperature, `repeats` times: every load, at every speed, in every direction, in this order of nesting.
    Each of these passes is a run of its own, or all of them together are one (`one_run`).
    """

    kind: SegmentKind
    temperatures_c: tuple[SetPoint, ...]
    repeats: Annotated[int, Range(minimum=1, maximum=1000)] = 1
    directions: tuple[Approach, ...] = (1,)
    """+1 increasing angle, -1 the same angles backwards."""
    loads_nm: tuple[Annotated[float, Range(minimum=-10_000, maximum=10_000)], ...] = (0.0,)
    one_run: bool = False
    """All passes of a repeat under one set-up and one zero."""
    zero: PlanZero | None = None
    """One zero for all runs of the segment (sweeps: of all sweeps), or one for each run; None: polygon per run,
    sweeps one."""
    soak_h: Annotated[float, Range(minimum=0, maximum=1000)] | None = None
    """Before the first run of each temperature, with a ramp before every run; None: as in the plan."""
    ramp_c_per_h: Annotated[float, Range(minimum=-1000, maximum=1000)] = 0.0
    """The chamber's temperature from the first reading of each run on."""
    turns: Annotated[float, Range(minimum=0.001, maximum=1000)] = 1.0
    """Span of one pass; whole turns with a polygon."""
    polygon_offset: Annotated[float, Range(minimum=0, maximum=1000)] = 0.0
    """By how many face pitches the polygon was turned on the shaft; a fraction moves the stops."""
    from_deg: Annotated[float, Range(minimum=-3600, maximum=3600)] = 0.0
    """Lowest angle of a sweep."""
    speeds_deg_s: tuple[Annotated[float, Range(minimum=0, maximum=36_000)], ...] | None = None
    """Of sweeps: constant speeds; 0: stop and go. None: stop and go."""
    degrees_per_reading: Annotated[float, Range(minimum=0.001, maximum=36_000)] | None = None
    """Of sweeps; None: what the speed covers in `seconds_per_reading`."""
    seconds_per_reading: Annotated[float, Range(minimum=1e-6, maximum=3600)] | None = None
    """None: with a polygon as in the plan, in a sweep what the speed needs for `degrees_per_reading`."""

    def __post_init__(self) -> None:
        faults = _direction_faults(self.directions)
        for name in ("temperatures_c", "loads_nm"):
            if not getattr(self, name):
                faults.append(Fault(where=name, expected="at least one", found="none"))
        faults += self._sweep_faults() if self.kind is SegmentKind.SWEEP else self._polygon_faults()
        if faults:
            raise ContractError(faults)

    def _polygon_faults(self) -> list[Fault]:
        given = (("speeds_deg_s", self.speeds_deg_s), ("degrees_per_reading", self.degrees_per_reading))
        faults = [
            Fault(where=name, expected="none beside kind polygon", found=str(value))
            for name, value in given
            if value is not None
        ]
        if self.from_deg != 0.0:
            faults.append(Fault(where="from_deg", expected="0 beside kind polygon", found=f"{self.from_deg:g}"))
        if not float(self.turns).is_integer():
            faults.append(Fault(where="turns", expected="whole turns of a polygon", found=f"{self.turns:g}"))
        return faults

    def _sweep_faults(self) -> list[Fault]:
        faults: list[Fault] = []
        if self.polygon_offset != 0.0:
            found = f"{self.polygon_offset:g}"
            faults.append(Fault(where="polygon_offset", expected="0 beside kind sweep", found=found))
        speeds = self.stepping_speeds_deg_s
        if not speeds or (0.0 in speeds and len(speeds) > 1):
            expected = "speeds above 0, or 0 alone for stop and go"
            return [*faults, Fault(where="speeds_deg_s", expected=expected, found=str(list(speeds)))]
        given = (self.degrees_per_reading is not None) + (self.seconds_per_reading is not None)
        if given != (2 if 0.0 in speeds else 1):
            expected = "both in stop and go" if 0.0 in speeds else "one of the two at a constant speed"
            where = "degrees_per_reading, seconds_per_reading"
            faults.append(Fault(where=where, expected=expected, found=("neither", "one", "both")[given]))
        return faults

    @property
    def stepping_speeds_deg_s(self) -> tuple[float, ...]:
        """The speeds at which readings are taken, 0 where the shaft stands."""
        return (0.0,) if self.speeds_deg_s is None else self.speeds_deg_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """PLAN.yaml: which angles at which temperatures, how often; then what the segments add."""

    schema_version: Annotated[int, Range(minimum=SCHEMA_VERSION, maximum=SCHEMA_VERSION)]
    faces: Annotated[int, Range(minimum=3, maximum=1000)]
    temperatures_c: tuple[SetPoint, ...]
    repeats: Annotated[int, Range(minimum=1, maximum=1000)]
    directions: tuple[Approach, ...] = (1,)
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
    segments: tuple[Segment, ...] = ()
    """With segments `temperatures_c` may be empty: then there is nothing else."""
    chamber_c_per_h: Annotated[float, Range(minimum=0.1, maximum=100_000)] | None = None
    """How fast the chamber goes to a new set point when a soak begins; None: at once."""

    def __post_init__(self) -> None:
        faults = _direction_faults(self.directions)
        if self.zero is PlanZero.ONE and self.shift_faces != 0:
            expected = "0 beside zero: one, as a polygon turned on the shaft has a new zero"
            faults.append(Fault(where="shift_faces", expected=expected, found=f"{self.shift_faces:g}"))
        if not self.temperatures_c and not self.segments:
            faults.append(Fault(where="temperatures_c", expected="at least one temperature", found="none"))
        if faults:
            raise ContractError(faults)


def plan_from_document(document: Node) -> Plan:
    """PLAN.yaml."""
    return structure(Plan, document)


def plan_to_plain(plan: Plan) -> dict[str, Any]:
    """The plan as YAML data; reading it back gives an equal plan."""
    values: dict[str, Any] = plain(plan)
    return values if plan.segments else {name: value for name, value in values.items() if name != "segments"}


def effect_settings(values: Mapping[str, Any], *, name: str) -> Node:
    """Settings of an effect made in code rather than read from a file."""
    return document_from_plain(dict(values), source="made in code", path=f"effects.{name}")
