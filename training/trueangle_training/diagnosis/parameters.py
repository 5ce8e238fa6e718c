"""Physical parameters of a found effect, with their standard uncertainties."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import structure
from trueangle.contract.joint import effect_settings
from trueangle_training.diagnosis.attribution import Member
from trueangle_training.diagnosis.joint_update import rounded
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]

SAME_CURVE = 1e-3
"""Relative difference up to which two columns are one: shapes have the angle a little smoothed."""
_PAIR = re.compile(r"(.*?)_?(cos)_(.*)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value with its standard uncertainty (k = 1); both in the unit that the parameter's name carries."""

    value: float
    standard_uncertainty: float | None
    """None: chosen from a grid of shapes, known no better than the grid's step."""


def estimates(problem: Problem, members: Sequence[Member]) -> dict[str, Estimate]:
    """Amplitudes (with phases) and shape parameters; of several members of one effect the names are numbered.

    Bends that the effect's own settings can express are parameters too, as an updated JOINT.yaml holds them.
    """
    parts = [_Part.of(problem, member) for member in members]
    for part in parts:
        for other in parts:
            if other is not part:
                part.hand_over(other)
    found: dict[str, Estimate] = {}
    for number, (part, member) in enumerate(zip(parts, members, strict=True)):
        after = f"_{number + 1}" if number else ""
        for name, estimate in _amplitudes(part.names, part.values, part.covariance).items():
            found[name + after] = estimate
        for name, value in problem.hypotheses[member.hypothesis_index].shape.items():
            found[name + after] = Estimate(value=float(value), standard_uncertainty=None)
    return found


@dataclass(slots=True, kw_only=True, eq=False)
class _Part:
    """The coefficients of one member that have a name."""

    names: tuple[str, ...]
    mains: int
    values: Floats
    covariance: Floats

    @classmethod
    def of(cls, problem: Problem, member: Member) -> "_Part":
        """The main coefficients, then the bends that are written."""
        shape = problem.hypotheses[member.hypothesis_index]
        mains = len(shape.coefficients)
        bends = _written_bends(problem, member)
        kept = [*range(mains), *(mains + place for place in bends)]
        return cls(
            names=(*shape.coefficients, *bends.values()),
            mains=mains,
            values=member.coefficients[kept].copy(),
            covariance=member.covariance[np.ix_(kept, kept)].copy(),
        )

    def hand_over(self, other: "_Part") -> None:
        """Bends that are the main part of another member are added to it: the file has one entry for both."""
        shared = [i for i in range(self.mains, len(self.names)) if self.names[i] in other.names[: other.mains]]
        theirs = [other.names.index(self.names[i]) for i in shared]
        other.values[theirs] += self.values[shared]
        other.covariance[np.ix_(theirs, theirs)] += self.covariance[np.ix_(shared, shared)]
        left = [i for i in range(len(self.names)) if i not in shared]
        self.names = tuple(self.names[i] for i in left)
        self.values, self.covariance = self.values[left], self.covariance[np.ix_(left, left)]


def _written_bends(problem: Problem, member: Member) -> dict[int, str]:
    """Place among the wiggle's columns to the name of the coefficient, of bends that the update takes over.

    They are named as the main column of another shape of the same effect that is the same curve.
    """
    shape = problem.hypotheses[member.hypothesis_index]
    name = shape.effect
    if name is None or shape.nature is not Nature.MEAN or name in problem.joint.effects:
        return {}
    effect = problem.library[name]
    plain = rounded(effect.settings_of(shape, member.coefficients[: len(shape.coefficients)]))
    own = structure(effect.settings, effect_settings(plain, name=name)).columns(problem.conditions, problem.joint)
    found: dict[int, str] = {}
    for place, bend in enumerate(shape.wiggle.T):
        if not _among(bend, own):
            continue
        for other in problem.hypotheses:
            if other.effect == name and other.shape == shape.shape:
                names = [n for n, main in zip(other.coefficients, other.main.T, strict=True) if _same(bend, main)]
                if names:
                    found[place] = names[0]
                    break
    return found


def _among(column: Floats, columns: Floats) -> bool:
    return any(_same(column, other) for other in columns.T)


def _same(one: Floats, other: Floats) -> bool:
    return bool(np.linalg.norm(one - other) <= SAME_CURVE * np.linalg.norm(other))


def _amplitudes(names: Sequence[str], values: Floats, covariance: Floats) -> dict[str, Estimate]:
    """Cosine and sine of one order become amplitude and phase; other coefficients stay as they are."""
    place = {name: i for i, name in enumerate(names)}
    found: dict[str, Estimate] = {}
    for name, i in place.items():
        pair = _PAIR.fullmatch(name)
        if pair is not None:
            j = place.get(name.replace("cos_", "sin_", 1))
            if j is not None:
                found.update(_polar(pair[1], pair[3], values[[i, j]], covariance[np.ix_([i, j], [i, j])]))
                continue
        if name.replace("sin_", "cos_", 1) in place and name != name.replace("sin_", "cos_", 1):
            continue
        found[name] = Estimate(value=float(values[i]), standard_uncertainty=math.sqrt(max(covariance[i, i], 0.0)))
    return found


def _polar(before: str, unit: str, pair: Floats, covariance: Floats) -> dict[str, Estimate]:
    """First-order propagation from cosine and sine to amplitude and phase (GUM, JCGM 100:2008, 5.2)."""
    amplitude = float(np.hypot(*pair))
    head = f"{before}_" if before else ""
    if amplitude == 0:
        return {
            f"{head}amplitude_{unit}": Estimate(value=0.0, standard_uncertainty=float(np.sqrt(covariance[0, 0])))
        }
    along = pair / amplitude
    across = np.array([-along[1], along[0]])
    sigma_along = float(np.sqrt(max(along @ covariance @ along, 0.0)))
    sigma_across = float(np.sqrt(max(across @ covariance @ across, 0.0)))
    phase_sigma = min(math.degrees(sigma_across / amplitude), 180.0 / math.sqrt(3.0))
    return {
        f"{head}amplitude_{unit}": Estimate(value=amplitude, standard_uncertainty=sigma_along),
        f"{head}phase_deg": Estimate(
            value=math.degrees(math.atan2(pair[1], pair[0])), standard_uncertainty=phase_sigma
        ),
    }
