"""The physics of encoder errors, written once: forwards for the simulator, backwards for the diagnosis.

A new effect is one file of `library` that defines `EFFECT`, and its name in `EFFECT_NAMES` of
`trueangle.contract.joint`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Node, structure
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import EFFECT_NAMES, Joint
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import EffectSettings, LibraryEffect, Nature, Stage
from trueangle_training.effects.harmonics import HarmonicSeries, HarmonicTerm, harmonic_series
from trueangle_training.effects.patterns import beside, no_columns

Floats = NDArray[np.float64]

EFFECTS: Mapping[str, LibraryEffect] = MappingProxyType(
    {
        name: cast("LibraryEffect", import_module(f"trueangle_training.effects.library.{name}").EFFECT)
        for name in EFFECT_NAMES
    }
)
"""Name to entry, in the order of `trueangle.contract.joint.EFFECT_NAMES`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """An effect of one joint with its nominal parameters."""

    library: LibraryEffect
    settings: EffectSettings
    terms: tuple[HarmonicTerm, ...]
    """The part that is a function of angle and temperature alone."""
    series: HarmonicSeries
    """The same as a sum."""

    @property
    def name(self) -> str:
        """As in JOINT.yaml."""
        return self.library.name

    @property
    def is_series(self) -> bool:
        """Whether the series is all of it: a function of angle and temperature, of low orders."""
        return self.library.missing_input is None and self.library.stage is Stage.SHAFT

    def error_arcsec(self, angle_deg: Floats, temperature_c: Floats | float) -> Floats:
        """The series at true angles and temperatures of any broadcastable shapes."""
        return self.series.error_arcsec(angle_deg, temperature_c)


def joint_settings(joint: Joint) -> dict[str, EffectSettings]:
    """The settings of each of the joint's effects, in the joint's order; ContractError with every fault."""
    found: dict[str, EffectSettings] = {}
    faults: list[Fault] = []
    for name, node in joint.effects.items():
        try:
            settings = structure(EFFECTS[name].settings, node)
            _terms(settings, node, joint)
        except ContractError as error:
            faults += error.faults
        else:
            found[name] = settings
    if faults:
        raise ContractError(faults)
    return found


def _terms(settings: EffectSettings, node: Node, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
    try:
        return settings.terms(joint)
    except ContractError as error:
        raise ContractError([_placed(fault, node) for fault in error.faults]) from error


def nominal_effects(joint: Joint) -> tuple[Effect, ...]:
    """The joint's effects with their nominal parameters, in the joint's order.

    ContractError with every fault: settings that do not fit, a nominal parameter that is left out.
    """
    effects: list[Effect] = []
    faults: list[Fault] = []
    for name, node in joint.effects.items():
        try:
            effects.append(_nominal_effect(EFFECTS[name], node, joint))
        except ContractError as error:
            faults += error.faults
    if faults:
        raise ContractError(faults)
    return tuple(effects)


def _nominal_effect(library: LibraryEffect, node: Node, joint: Joint) -> Effect:
    settings = structure(library.settings, node)
    terms = _terms(settings, node, joint)
    if terms is None:
        raise ContractError(
            [
                Fault(
                    where=node.where,
                    expected=f"nominal parameters ({', '.join(each.name for each in library.parameters)}, ...)",
                    found="none",
                    advice="an effect without them can be calibrated from data but not simulated",
                )
            ]
        )
    series = harmonic_series(terms, base_temperature_c=joint.base_temperature_c)
    return Effect(library=library, settings=settings, terms=terms, series=series)


def _placed(fault: Fault, node: Node) -> Fault:
    """The fault at the line of the setting that it names."""
    entries = node.value if isinstance(node.value, Mapping) else {}
    return replace(fault, where=entries.get(fault.where, node).where)


def nominal_error_arcsec(joint: Joint, conditions: Conditions) -> Floats:
    """What the joint's simulator says of the readings, shape [readings], random parts at their mean.

    Effects without nominal parameters add nothing. What acts on the readout alone has no mean.
    """
    total = np.zeros(len(conditions))
    for name, settings in joint_settings(joint).items():
        if EFFECTS[name].nature is not Nature.VARIANCE:
            total += settings.error_arcsec(conditions, joint, None)
    return total


def modelled_columns(joint: Joint, conditions: Conditions) -> tuple[Floats, tuple[str, ...]]:
    """[readings, columns] in which re-calibration may move the joint's effects, and the effect of each column.

    The columns need not be independent.
    """
    blocks: list[Floats] = [no_columns(len(conditions))]
    names: list[str] = []
    for name, block in _blocks(joint, conditions):
        blocks.append(block)
        names += [name] * block.shape[1]
    return beside(*blocks), tuple(names)


def _blocks(joint: Joint, conditions: Conditions) -> Iterator[tuple[str, Floats]]:
    for name, settings in joint_settings(joint).items():
        yield name, settings.columns(conditions, joint)
