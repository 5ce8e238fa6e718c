"""A found effect under conditions other than those under which it was found."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import structure
from trueangle.contract.joint import effect_settings
from trueangle_training.diagnosis.attribution import Member
from trueangle_training.diagnosis.joint_update import rounded
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Nature

Floats = NDArray[np.float64]
Curve = Callable[[Conditions], Floats]
"""[readings] in arcsec under any conditions."""


def found_effect(problem: Problem, members: Sequence[Member]) -> Curve | None:
    """The sum of the found shapes of one effect, with the settings that JOINT.yaml would have for them.

    Without the little bends that the fit allows. None where each run brings a draw of its own, or no
    shape was found.
    """
    shapes = [(problem.hypotheses[member.hypothesis_index], member.coefficients) for member in members]
    if not shapes or any(shape.effect is None or shape.nature is not Nature.MEAN for shape, _ in shapes):
        return None
    all_settings = []
    for shape, coefficients in shapes:
        effect = problem.library[shape.effect or ""]
        plain = rounded(effect.settings_of(shape, coefficients[: shape.main.shape[1]]))
        all_settings.append(structure(effect.settings, effect_settings(plain, name=effect.name)))

    def curve(conditions: Conditions) -> Floats:
        parts = (settings.error_arcsec(conditions, problem.joint, None) for settings in all_settings)
        return sum(parts, np.zeros(len(conditions)))

    return curve
