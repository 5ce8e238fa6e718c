"""Physical parameters of a found effect, with their standard uncertainties."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.attribution import Member
from trueangle_training.diagnosis.problem import Problem

Floats = NDArray[np.float64]

_PAIR = re.compile(r"(.*?)_?(cos)_(.*)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value with its standard uncertainty (k = 1); both in the unit that the parameter's name carries."""

    value: float
    standard_uncertainty: float | None
    """None: chosen from a grid of shapes, known no better than the grid's step."""


def estimates(problem: Problem, members: Sequence[Member]) -> dict[str, Estimate]:
    """Amplitudes (with phases) and shape parameters; of several members of one effect the names are numbered."""
    found: dict[str, Estimate] = {}
    for number, member in enumerate(members):
        shape = problem.hypotheses[member.hypothesis_index]
        after = f"_{number + 1}" if number else ""
        mains = len(shape.coefficients)
        covariance = member.covariance[:mains, :mains]
        for name, estimate in _amplitudes(shape.coefficients, member.coefficients[:mains], covariance).items():
            found[name + after] = estimate
        for name, value in shape.shape.items():
            found[name + after] = Estimate(value=float(value), standard_uncertainty=None)
    return found


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
