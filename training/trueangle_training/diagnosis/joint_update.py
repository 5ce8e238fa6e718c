"""The joint with what was found added and its parameters re-calibrated, in the form of JOINT.yaml."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import document_from_plain, structure
from trueangle.contract.errors import ContractError
from trueangle.contract.joint import Joint, effect_settings
from trueangle_training.diagnosis.scatter import Growth
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import EffectSettings, Hypothesis, LibraryEffect, Nature

Floats = NDArray[np.float64]

SAME_SPAN = 1e-6
"""Relative RMS up to which two curves are one."""
SIGNIFICANT_DIGITS = 7
QUADRATIC = "thermal_nonlinearity"
LISTS_SPAN = "orders"
PLACED_BY = ("order", "per_line", "per_turn", "run")
"""Keys of which one says to which harmonic, or to which run, an entry of a list belongs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundShape:
    """One shape of an effect with its coefficients, from a fit to measured readings."""

    hypothesis: Hypothesis
    coefficients: Floats
    """Of `hypothesis.main`."""
    curve_arcsec: Floats | None = None
    """[readings]: with the little bends that the fit allowed beside `main`; None: there were none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointUpdate:
    """New settings for the effects of a joint."""

    effects: Mapping[str, dict[str, Any]]
    """All effects of the new joint with their settings, in the order in which they are written."""
    comments: Mapping[str, str]
    """Effect to what was done to it, in plain words."""
    notes: tuple[str, ...]
    """What could not be taken over."""


def joint_update(
    joint: Joint,
    conditions: Conditions,
    library: Mapping[str, LibraryEffect],
    *,
    modelled: Mapping[str, Floats],
    found: Sequence[FoundShape],
    scatter: Mapping[str, dict[str, Any]] = MappingProxyType({}),
) -> JointUpdate:
    """Settings whose curves on these conditions are those of the fit.

    `modelled` gives each effect of the joint the coefficients of its `columns`; an effect without an entry, or
    whose curve its settings cannot express, keeps the settings that it had and a note says so. `scatter`: settings
    of effects that change the scatter and were found.
    """
    effects: dict[str, dict[str, Any]] = {}
    comments: dict[str, str] = {}
    notes: list[str] = []
    for name, node in joint.effects.items():
        shipped = node.plain() or {}
        coefficients = modelled.get(name)
        calibrated = None
        if coefficients is not None and coefficients.size:
            settings = structure(library[name].settings, node)
            calibrated = _calibrated(library, name, settings, conditions, joint, coefficients)
            if calibrated is None:
                notes.append(f"{name} could not be re-calibrated in the form of JOINT.yaml and was left as it was")
        if calibrated is None:
            effects[name] = merged(effects.get(name), shipped)
            continue
        for part, settings_of_part in calibrated.items():
            effects[part] = merged(effects.get(part), settings_of_part)
            comments[part] = (
                "re-calibrated" if part == name else f"re-calibrated, from the higher degree of {name}"
            )
    for name in dict.fromkeys(part.hypothesis.effect for part in found if part.hypothesis.effect is not None):
        parts = [part for part in found if part.hypothesis.effect == name]
        known = name in effects
        for part in parts:
            of_part = rounded(library[name].settings_of(part.hypothesis, part.coefficients))
            effects[name] = merged(effects.get(name), of_part)
        if not known:
            effects[name] = _bent(library, name, effects[name], parts, conditions, joint)
        labels = "; ".join(dict.fromkeys(part.hypothesis.label for part in parts if part.hypothesis.label))
        said = "re-calibrated and extended by what was found" if known else "found"
        comments[name] = f"{said}: {labels}" if labels else said
    for name, settings in scatter.items():
        effects[name] = merged(effects.get(name), rounded(settings))
        comments[name] = "found in the scatter"
    _list_every_face(effects, joint)
    _check(effects, library, joint)
    return JointUpdate(effects=effects, comments=comments, notes=tuple(notes))


def _bent(
    library: Mapping[str, LibraryEffect],
    name: str,
    settings: dict[str, Any],
    parts: Sequence[FoundShape],
    conditions: Conditions,
    joint: Joint,
) -> dict[str, Any]:
    """The settings with the bends of the fit taken in, as far as the effect's own columns can."""
    curves = [part.curve_arcsec for part in parts if part.curve_arcsec is not None]
    if library[name].nature is not Nature.MEAN or len(curves) < len(parts):
        return settings
    effect = structure(library[name].settings, effect_settings(settings, name=name))
    columns = effect.columns(conditions, joint)
    if columns.shape[1] == 0:
        return settings
    _, group = np.unique(conditions.zero_group, return_inverse=True)
    table = np.column_stack([np.sum(curves, axis=0), columns])
    table = table - np.stack([np.bincount(group, each) / np.bincount(group) for each in table.T], axis=1)[group]
    coefficients = np.linalg.lstsq(table[:, 1:], table[:, 0], rcond=SAME_SPAN)[0].astype(np.float64)
    return (_calibrated(library, name, effect, conditions, joint, coefficients) or {}).get(name, settings)


def growth_settings(growth: Growth, conditions: Conditions, *, scatter_arcsec: float) -> dict[str, Any]:
    """Settings of `noise_growth` that give the campaign's scatter and the ratio that was found.

    `scatter_arcsec`: root of the mean variance of a reading. The effect adds a u, u from 0 or |value| / highest up
    to 1, to a scatter s that stays: (s^2 + a^2) / (s^2 + a^2 u_low^2) = r^2 and s^2 + a^2 mean(u^2) = scatter^2.
    """
    values = {
        "temperature_c": conditions.temperature_c,
        "speed_deg_s": None if conditions.velocity_deg_s is None else np.abs(conditions.velocity_deg_s),
        "load_nm": None if conditions.load_nm is None else np.abs(conditions.load_nm),
    }[growth.condition]
    assert values is not None  # noqa: S101 - the growth was found over it
    low, high = float(values.min()), float(values.max())
    if growth.condition == "temperature_c":
        added = _added_at_top((values - low) / (high - low), growth.ratio, scatter_arcsec)
        return {"arcsec_per_k": added / (high - low), "from_temperature_c": low}
    added = _added_at_top(values / high, growth.ratio, scatter_arcsec)
    return {"arcsec_per_deg_s" if growth.condition == "speed_deg_s" else "arcsec_per_nm": added / high}


def _added_at_top(place: Floats, ratio: float, scatter_arcsec: float) -> float:
    """`a` of `growth_settings`; `place`: u of each reading."""
    mean_square = float(np.mean(place**2))
    steady = 1.0 - ratio**2 * float(place.min()) ** 2
    if steady <= 0.0:
        # No straight line through zero grows faster than its condition: all scatter is then of the effect.
        return scatter_arcsec / float(np.sqrt(mean_square))
    gain = max(ratio**2 - 1.0, 0.0) / steady
    return scatter_arcsec * float(np.sqrt(gain / (1.0 + gain * mean_square)))


def _list_every_face(effects: dict[str, dict[str, Any]], joint: Joint) -> None:
    """A face that the campaign did not use deviates by 0: the simulator asks for all of them."""
    listed = effects.get("reference_artefact", {}).get("faces_arcsec")
    if listed is not None:
        missing = (joint.reference.faces or 0) - len(listed)
        effects["reference_artefact"]["faces_arcsec"] = [*listed, *([0.0] * missing)]


def _check(effects: Mapping[str, dict[str, Any]], library: Mapping[str, LibraryEffect], joint: Joint) -> None:
    """ContractError where the new settings contradict each other, before a file holds them."""
    for name, values in effects.items():
        structure(library[name].settings, effect_settings(values, name=name)).terms(joint)


def _calibrated(
    library: Mapping[str, LibraryEffect],
    name: str,
    settings: EffectSettings,
    conditions: Conditions,
    joint: Joint,
    coefficients: Floats,
) -> dict[str, dict[str, Any]] | None:
    """Settings by effect whose curve is `columns` @ coefficients; None: the form cannot express it."""
    columns = settings.columns(conditions, joint)
    curve = columns @ coefficients
    shapes = list(library[name].hypotheses(conditions))
    drifts = [*shapes, *library[QUADRATIC].hypotheses(conditions)] if QUADRATIC in library else shapes
    tries = [
        lambda: _covered(library, shapes, columns, curve),
        lambda: _covered(library, drifts, columns, curve),
        *(
            lambda shape=shape: _in_own_shape(library[name], settings, shape, columns, coefficients)
            for shape in shapes
            if shape.main.shape[1] == columns.shape[1]
        ),
    ]
    for attempt in tries:
        candidate = attempt()
        if candidate and _same_curve(candidate, library, conditions, joint, curve):
            return candidate
    return None


def _covered(
    library: Mapping[str, LibraryEffect],
    shapes: Sequence[Hypothesis],
    columns: Floats,
    curve: Floats,
) -> dict[str, dict[str, Any]]:
    """The shapes that lie in the span of the columns, as few as fill it, with the coefficients of the curve.

    With the shapes of `thermal_nonlinearity` among them this takes a drift of degree 2, whose square JOINT.yaml
    keeps under an effect of its own.
    """
    chosen = _shapes_in(columns, shapes)
    if not chosen:
        return {}
    solution = np.linalg.lstsq(np.column_stack([shape.main for shape in chosen]), curve, rcond=None)[0].astype(
        np.float64
    )
    settings: dict[str, dict[str, Any]] = {}
    first = 0
    for shape in chosen:
        last = first + shape.main.shape[1]
        owner = shape.effect or ""
        part = rounded(library[owner].settings_of(shape, solution[first:last]))
        settings[owner] = merged(settings.get(owner), part)
        first = last
    return settings


def _shapes_in(columns: Floats, shapes: Sequence[Hypothesis]) -> list[Hypothesis]:
    basis = _orthonormal(columns)
    chosen: list[Hypothesis] = []
    span = np.zeros((columns.shape[0], 0))
    for shape in sorted(shapes, key=lambda each: each.main.shape[1]):
        if span.shape[1] == basis.shape[1]:
            break
        size = float(np.linalg.norm(shape.main))
        if size == 0.0 or np.linalg.norm(shape.main - basis @ (basis.T @ shape.main)) > SAME_SPAN * size:
            continue
        wider = _orthonormal(np.column_stack([span, shape.main]))
        if wider.shape[1] == span.shape[1] + shape.main.shape[1]:
            chosen.append(shape)
            span = wider
    return chosen


def _in_own_shape(
    effect: LibraryEffect, settings: EffectSettings, shape: Hypothesis, columns: Floats, coefficients: Floats
) -> dict[str, dict[str, Any]]:
    """Between the points of the grid: a shape of the library with the joint's own time constants, widths ..."""
    own = {key: getattr(settings, key, None) for key in shape.shape}
    own = {key: shape.shape[key] if value is None else value for key, value in own.items()}
    return {effect.name: rounded(effect.settings_of(replace(shape, main=columns, shape=own), coefficients))}


def _same_curve(
    settings: Mapping[str, dict[str, Any]],
    library: Mapping[str, LibraryEffect],
    conditions: Conditions,
    joint: Joint,
    curve: Floats,
) -> bool:
    """Whether the settings give the curve, but for a constant in each zero group."""
    made = np.zeros(len(conditions))
    try:
        for name, values in settings.items():
            effect = structure(library[name].settings, effect_settings(values, name=name))
            made = made + effect.error_arcsec(conditions, joint, None)
    except ContractError:
        return False
    off = made - curve
    _, group = np.unique(conditions.zero_group, return_inverse=True)
    off = off - (np.bincount(group, weights=off) / np.bincount(group))[group]
    scale = float(np.sqrt(np.mean(curve**2)))
    return float(np.sqrt(np.mean(off**2))) <= max(1e-5 * scale, 1e-6)


def merged(old: dict[str, Any] | None, new: dict[str, Any]) -> dict[str, Any]:
    """Settings of two parts of one effect together: lists one after the other, spans around both.

    Where both give one order its amplitude, or a number, the newer stands.
    """
    if not old:
        return dict(new)
    together = dict(old)
    for key, value in new.items():
        before = together.get(key)
        if key == LISTS_SPAN and before is not None:
            together[key] = [min(before[0], value[0]), max(before[1], value[1])]
        elif isinstance(value, list) and isinstance(before, list):
            together[key] = _joined(before, value)
        else:
            together[key] = value
    orders = [each["order"] for each in together.get("harmonics", ()) if "order" in each]
    if orders and LISTS_SPAN in together:
        first, last = together[LISTS_SPAN]
        together[LISTS_SPAN] = [min(first, *orders), max(last, *orders)]
    return together


def _joined(before: list[Any], after: list[Any]) -> list[Any]:
    replaced = {_place(each) for each in after} - {None}
    joined = [*(each for each in before if _place(each) not in replaced), *after]
    if all(_place(each) is not None for each in joined):
        joined.sort(key=lambda each: _place(each) or ("", 0.0))
    return joined


def _place(entry: Any) -> tuple[str, float] | None:
    """What an entry of a list is for; None: it stands for itself, as events and defects do."""
    if not isinstance(entry, dict) or "reading" in entry:
        return None
    return next(((key, float(entry[key])) for key in PLACED_BY if key in entry), None)


def rounded(settings: Any) -> Any:
    """Numbers as a person would write them: more digits than any fit supports, fewer than rounding leaves."""
    if isinstance(settings, dict):
        return {key: rounded(value) for key, value in settings.items()}
    if isinstance(settings, (list, tuple)):
        return [rounded(value) for value in settings]
    if isinstance(settings, (bool, str)) or settings is None:
        return settings
    if isinstance(settings, (int, np.integer)):
        return int(settings)
    return float(f"{float(settings):.{SIGNIFICANT_DIGITS}g}")


def _orthonormal(columns: Floats) -> Floats:
    if columns.shape[1] == 0:
        return columns
    size = np.sqrt(np.sum(columns**2, axis=0))
    kept = columns[:, size > 0] / size[size > 0]
    left, spread, _ = np.linalg.svd(kept, full_matrices=False)
    return left[:, spread > SAME_SPAN * spread.max(initial=0.0)]


def updated_joint(joint: Joint, update: JointUpdate) -> Joint:
    """The joint that the new file describes."""
    effects = document_from_plain(dict(update.effects), source="made in code", path="effects").value
    assert isinstance(effects, Mapping)  # noqa: S101 - made from a mapping just now
    return replace(joint, effects=effects)
