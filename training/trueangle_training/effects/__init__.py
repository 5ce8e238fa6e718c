"""The physics of encoder errors, written once: forwards for the simulator, backwards for the diagnosis.

A new effect is one entry of a file of this package and one line of `EFFECTS`. All effects of the library here are
functions of the true mechanical angle and the joint's temperature, E = indicated - true.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from trueangle.contract.document import Node, structure
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle_training.effects.constant import ECCENTRICITY, GRADUATION_ERROR, GRATING_TILT
from trueangle_training.effects.harmonics import harmonic_series
from trueangle_training.effects.kinds import Effect, EffectKind
from trueangle_training.effects.thermal import (
    THERMAL_ECCENTRICITY,
    THERMAL_GRADUATION,
    THERMAL_NONLINEARITY,
    THERMAL_TILT,
)

EFFECTS: Mapping[str, EffectKind] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            ECCENTRICITY,
            GRATING_TILT,
            GRADUATION_ERROR,
            THERMAL_ECCENTRICITY,
            THERMAL_TILT,
            THERMAL_GRADUATION,
            THERMAL_NONLINEARITY,
        )
    }
)
"""Name to entry; every name is one of `trueangle.contract.joint.EFFECT_NAMES`."""


def nominal_effects(joint: Joint) -> tuple[Effect, ...]:
    """The joint's effects with their nominal parameters, in the joint's order.

    ContractError with every fault: an effect that is not simulated, settings that do not fit, a nominal parameter
    that is left out.
    """
    effects: list[Effect] = []
    faults: list[Fault] = []
    for name, node in joint.effects.items():
        try:
            effects.append(_nominal_effect(name, node, joint))
        except ContractError as error:
            faults += error.faults
    if faults:
        raise ContractError(faults)
    return tuple(effects)


def _nominal_effect(name: str, node: Node, joint: Joint) -> Effect:
    kind = EFFECTS.get(name)
    if kind is None:
        expected = f"one of the effects {', '.join(EFFECTS)}"
        found = f"{name}, which is not simulated by this version"
        raise ContractError([Fault(where=node.where, expected=expected, found=found)])
    settings = structure(kind.settings, node)
    try:
        terms = settings.terms(joint)
    except ContractError as error:
        raise ContractError([_placed(fault, node) for fault in error.faults]) from error
    if terms is None:
        raise ContractError(
            [
                Fault(
                    where=node.where,
                    expected="nominal parameters (amplitudes and phases)",
                    found="none",
                    advice="an effect without them can be calibrated from data but not simulated",
                )
            ]
        )
    series = harmonic_series(terms, base_temperature_c=joint.base_temperature_c)
    return Effect(name=name, terms=terms, series=series)


def _placed(fault: Fault, node: Node) -> Fault:
    """The fault at the line of the setting that it names."""
    entries = node.value if isinstance(node.value, Mapping) else {}
    return replace(fault, where=entries.get(fault.where, node).where)
