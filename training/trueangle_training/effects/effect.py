"""An effect of the library: physics written once, forwards for the simulator, backwards for the diagnosis."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.harmonics import HarmonicTerm

Floats = NDArray[np.float64]


class Nature(Enum):
    """How an effect comes again when the campaign is repeated."""

    MEAN = "mean"
    """The same curve of the conditions each time."""
    RANDOM = "random"
    """A new draw in each run."""
    EVENT = "event"
    """Happens in some runs."""
    VARIANCE = "variance"
    """Changes the scatter, not the mean."""


class Stage(Enum):
    """Where in the chain from shaft to file an effect acts: what its angle is, and what it changes."""

    SHAFT = "shaft"
    """A function of the true angle; changes the indicated one."""
    SCALE = "scale"
    """A function of the angle that the scale shows, shaft's errors included: of lines, not of turns."""
    READOUT = "readout"
    """Acts on the indicated angle with all its errors and noise."""
    REFERENCE = "reference"
    """Changes the error that is told, not the indicated angle."""
    SENSOR = "sensor"
    """Changes the temperature that is shown, not the angle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One physical parameter of an effect."""

    name: str
    """As in JOINT.yaml and report.json, unit included."""
    unit: str
    low: float
    """Prior range, low to high."""
    high: float
    source: str
    """Where the range comes from: clause, data sheet, paper or the shop's experience, said plainly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """One shape that an effect may have on given readings, linear in its coefficients.

    error_arcsec = main @ a + wiggle @ b, with b small beside a: a wiggle bends the shape a little, it is never the
    effect itself.
    """

    effect: str | None
    """Name in the library; None: a generic pattern that no effect of the library explains."""
    label: str
    """In plain words, such as "order 3, linear in temperature"."""
    cell: Cell
    main: Floats
    """[readings, columns] in arcsec per unit of the coefficient."""
    coefficients: tuple[str, ...]
    """Name of each main column's coefficient, unit included."""
    wiggle: Floats
    """[readings, columns], may have no column; scaled as `main`."""
    wiggle_size: float = 0.0
    """Expected size of the wiggle's coefficients relative to the main ones."""
    shape: Mapping[str, float] = field(default_factory=dict[str, float])
    """The parameters that are not linear, such as time_constant_s."""
    doubt_nats: float = 0.0
    """What speaks against it before a reading is seen, the same for all shapes of an effect."""
    family: str = ""
    """Shapes of one family share one prior probability; "" stands for the effect's name (of a generic pattern: its
    cell without the order)."""
    nature: Nature = Nature.MEAN
    """Filled in from the library where the diagnosis lays out its problem."""


class EffectSettings(Protocol):
    """The settings of one effect in JOINT.yaml, a dataclass that `contract.document.structure` can fill."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """The part that is a function of angle and temperature alone, as harmonics; () where there is none of it.

        None where the nominal parameters are left out. Raises ContractError, each fault placed by the name of the
        setting it is about.
        """
        ...

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """Indicated minus true, shape [readings], with the nominal parameters; 0 where they are left out.

        Random parts are drawn from `rng`; without one they are left out, which is their mean.
        """
        ...

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """[readings, columns]: the span in which re-calibration may move this effect; may have no column."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class LibraryEffect:
    """An entry of the library."""

    name: str
    nature: Nature
    physics: str
    """One sentence for a person."""
    formula: str
    source: str
    """Equation, clause, paper or data sheet."""
    parameters: tuple[Parameter, ...]
    cells: tuple[Cell, ...]
    """Where it can live."""
    proof: str
    """The experiment that would prove it."""
    missing_input: str | None
    """What a compensation by angle and temperature lacks ("direction", "speed", "load", ...); None: nothing."""
    settings: type[EffectSettings]
    hypotheses: Callable[[Conditions], Iterator[Hypothesis]]
    """Its shapes on these readings; none where the columns it needs are missing."""
    settings_of: Callable[[Hypothesis, Floats], dict[str, Any]]
    """JOINT.yaml settings of a found shape with its main coefficients: the inverse of `columns`."""
    needs: tuple[str, ...] = ()
    """Columns of the campaign, beside the angle, without which it has no hypotheses."""
    stage: Stage = Stage.SHAFT
