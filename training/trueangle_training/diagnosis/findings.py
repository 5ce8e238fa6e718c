"""What a diagnosis found, as `report.json` says it, and the rule that turns it into one word."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from trueangle_training.effects.cells import Cell
from trueangle_training.effects.effect import Nature

SCHEMA_VERSION = 1
NAMED_FROM = 0.9
"""Probability of a class from which it is named; below it the answer is `unknown`."""


class Conclusion(Enum):
    """The verdict in one word."""

    NONE = "none"
    """Nothing structural: what is left after re-calibration is noise."""
    NAMED = "named"
    UNKNOWN = "unknown"
    """Structure is there and no effect, or no class of effects, is likely enough to be named."""
    DATA_FAULT = "data_fault"
    """The file is broken; nothing is said about physics."""
    INSUFFICIENT = "insufficient"
    """This plan can show nothing, whatever the joint does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataFault:
    """A fault of the file, not of the joint."""

    kind: str
    """Stable name in snake_case, such as direction_swapped."""
    rows: tuple[int, ...]
    """1-based lines of the campaign file; empty: the whole file."""
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A found parameter; its unit is the end of its name."""

    value: float
    standard_uncertainty: float | None
    """k = 1; None: searched on a grid, whose step is all that is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """An effect that the simulator lacks."""

    effect: str
    """The likeliest member of the class."""
    probability: float
    members: tuple[str, ...]
    """All effects that could carry what was found under this plan; `class` in the file."""
    class_probability: float
    kind: Nature
    parameters: Mapping[str, Estimate]
    closes: float | None
    """Part of the structural gap that is lost without this cause alone; None: the gap is not significant."""
    closes_interval: tuple[float, float] | None = None
    label: str = ""
    """The found shape in plain words, such as "order 3, linear in temperature"."""
    cell: Cell | None = None

    @property
    def named(self) -> bool:
        """Whether the class is likely enough to be the answer."""
        return self.class_probability >= NAMED_FROM


@dataclass(frozen=True, slots=True, kw_only=True)
class Unexplained:
    """Structure that no named cause explains."""

    significant: bool = False
    nearest_effect: str | None = None
    nearest_share: float = 0.0
    """Part of the unexplained structure that the nearest effect can carry, 0..1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """One cell of the map."""

    cell: Cell
    share: float
    """Of the structural part, 0..1."""
    p_value: float | None
    """Family-wise; None: too few runs carry this cell to test it."""
    significant: bool
    runs_needed: int | None = None
    """Where `p_value` is None: how many runs would test it."""
    could_carry: float = 0.0
    """Of the structural part, 0..1, what this cell could carry in place of the cell that has its share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """How far simulator and joint are apart, on runs that were held out; None: could not be computed."""

    rmse_shipped_arcsec: float | None = None
    rmse_recalibrated_arcsec: float | None = None
    rmse_explained_arcsec: float | None = None
    floor_arcsec: float | None = None
    """Scatter of one reading about the mean of its condition."""
    parametric_share: float | None = None
    structural_share: float | None = None
    floor_share: float | None = None
    """The three shares of the shipped simulator's mean square add up to 1."""
    closure: float | None = None
    """Part of the structural gap that the causes close; None: the structural gap is not significant."""
    closure_interval: tuple[float, float] | None = None
    """95 %, over runs."""
    ceiling: float | None = None
    """Closure of a fit that may use any function of the conditions."""
    random_control: float | None = None
    """Closure by the same number of effects drawn by chance from the library."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One bar of the waterfall: the causes are added one after the other, the strongest first."""

    effect: str
    closure: float
    """Part of the structural gap that is closed with this effect and those before it."""
    interval: tuple[float, float] | None
    """95 %, over runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EndTask:
    """RMS error of the measured joint after compensation by models of four origins, on held-out runs."""

    method: str
    compensable: bool
    """Whether a function of angle and temperature can express what was found, or one of several effects."""
    missing_input: str | None = None
    """What a compensation of all that was found would need besides: direction, speed, load ..."""
    not_compensable: Mapping[str, str] = field(default_factory=dict[str, str])
    """Each found effect that cannot be compensated to the input that is missing for it; beside `compensable` the
    others can."""
    none_arcsec: float | None = None
    simulator_arcsec: float | None = None
    explained_arcsec: float | None = None
    oracle_arcsec: float | None = None
    """Trained on the measured readings."""

    @property
    def gap_left(self) -> float | None:
        """(explained² - oracle²) / (simulator² - oracle²); None: no gap to close."""
        if self.simulator_arcsec is None or self.explained_arcsec is None or self.oracle_arcsec is None:
            return None
        before = self.simulator_arcsec**2 - self.oracle_arcsec**2
        return (self.explained_arcsec**2 - self.oracle_arcsec**2) / before if before > 0 else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Drifting:
    """A re-calibrated parameter that does not stay the same: structure taken for parameters."""

    effect: str
    over: str
    """temperature, direction, speed or run"""
    p_value: float
    """Family-wise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What was diagnosed."""

    campaign: str
    campaign_sha256: str
    readings: int
    runs: int
    joint: str
    modelled_effects: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """The whole answer."""

    subject: Subject
    conclusion: Conclusion
    data_faults: tuple[DataFault, ...] = ()
    unexplained: Unexplained = field(default_factory=Unexplained)
    causes: tuple[Cause, ...] = ()
    """Likeliest first."""
    where: tuple[Place, ...] = ()
    """Largest share first; all cells that were looked at, significant or not."""
    gap: Gap = field(default_factory=Gap)
    waterfall: tuple[Step, ...] = ()
    end_task: EndTask = field(default_factory=lambda: EndTask(method="linear", compensable=True))
    drifting: tuple[Drifting, ...] = ()
    invisible: tuple[str, ...] = ()
    not_testable: Mapping[str, str] = field(default_factory=dict[str, str])
    """Effect to the reason in plain words."""
    next_measurement: str = ""
    notes: tuple[str, ...] = ()


def conclusion_of(
    *,
    data_faults: Sequence[DataFault],
    testable: bool,
    causes: Sequence[Cause],
    unexplained: Unexplained,
) -> Conclusion:
    """A fault of the file before all else, then what the plan cannot show, then what was found."""
    if data_faults:
        return Conclusion.DATA_FAULT
    if not testable:
        return Conclusion.INSUFFICIENT
    if any(cause.named for cause in causes):
        return Conclusion.NAMED
    if causes or unexplained.significant:
        return Conclusion.UNKNOWN
    return Conclusion.NONE


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the plan lets be seen of one effect."""

    effect: str
    visible_fraction: float | None
    """Largest over its shapes: part of its mean square left after re-calibration; None: not testable."""
    reason: str = ""
    """Why it is invisible or not testable, in plain words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Carried:
    """How much of one effect another could carry under this plan."""

    effect: str
    by: str
    fraction: float
    """0..1; from 0.95 the two form a class."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSight:
    """What a plan can see, known before any error is looked at: `design.json`."""

    subject: Subject
    effects: tuple[Seen, ...]
    pairs: tuple[Carried, ...]
    testable: tuple[str, ...]
    """Effects of the mean that would show; () makes the answer `insufficient` whatever the errors are."""
    invisible: tuple[str, ...]
    not_testable: Mapping[str, str]
    next_measurement: str
    notes: tuple[str, ...] = ()
