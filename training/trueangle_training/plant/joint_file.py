"""JOINT.yaml of a case: what its simulator knows about the joint."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.schedule import FACES
from trueangle_training.plant.simulator_reach import harmonic

Floats = NDArray[np.float64]

NAMES = {1: "eccentricity", 2: "grating_tilt"}
THERMAL_NAMES = {1: "thermal_eccentricity", 2: "thermal_tilt"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Nominal:
    """A x + B y of one listed order, cosine and sine, in arcsec (thermal: arcsec per K)."""

    order: int
    thermal: bool
    cosine: float
    sine: float


def fitted_nominals(
    conditions: Conditions, error: Floats, *, constant: tuple[int, ...], thermal: tuple[int, ...]
) -> tuple[Nominal, ...]:
    """The listed orders of a noise-free error curve, by least squares with the offsets free."""
    groups = np.unique(conditions.schedule.zero_group)
    warm = (conditions.temperature_c - 20.0)[:, None]
    columns = [harmonic(conditions, k) for k in constant] + [harmonic(conditions, k) * warm for k in thermal]
    offsets = (conditions.schedule.zero_group[:, None] == groups[None, :]).astype(np.float64)
    fit = np.linalg.lstsq(np.column_stack([*columns, offsets, warm]), error, rcond=None)[0]
    keys = [(k, False) for k in constant] + [(k, True) for k in thermal]
    return tuple(
        Nominal(order=k, thermal=hot, cosine=float(fit[2 * i]), sine=float(fit[2 * i + 1]))
        for i, (k, hot) in enumerate(keys)
    )


def joint_yaml(
    *,
    lines_per_rev: int,
    counts_per_rev: int,
    repeatability_arcsec: float,
    sensor_step_c: float,
    constant: tuple[int, ...],
    thermal: tuple[int, ...],
    nominals: tuple[Nominal, ...] | None,
) -> str:
    """The file's text; without nominal parameters they are left out, to be calibrated."""
    lines = [
        "schema_version: 1",
        f"encoder: {{lines_per_rev: {lines_per_rev}, counts_per_rev: {counts_per_rev}}}",
        f"reference: {{kind: polygon, faces: {FACES}}}",
        f"noise: {{repeatability_arcsec: {repeatability_arcsec:.3f}}}",
        f"temperature_sensor: {{resolution_c: {sensor_step_c:g}}}",
    ]
    known = {(each.order, each.thermal): each for each in nominals or ()}
    entries = [f"  {NAMES[k]}: {_flow(known.get((k, False)))}" for k in constant if k in NAMES]
    high = [order for order in constant if order not in NAMES]
    if high:
        harmonics = "".join(
            f"\n      - {{order: {order}, {_pair(known[order, False])}}}"
            for order in high
            if (order, False) in known
        )
        entries.append(f"  graduation_error:\n    orders: [{min(high)}, {max(high)}]")
        if harmonics:
            entries.append(f"    harmonics:{harmonics}")
    entries += [f"  {THERMAL_NAMES[k]}: {_flow(known.get((k, True)))}" for k in thermal]
    lines += ["effects:", *entries] if entries else ["effects: {}"]
    return "\n".join(lines) + "\n"


def _pair(nominal: Nominal) -> str:
    amplitude = float(np.hypot(nominal.cosine, nominal.sine))
    phase_deg = float(np.rad2deg(np.arctan2(nominal.sine, nominal.cosine)))
    unit = "_per_k" if nominal.thermal else ""
    return f"amplitude_arcsec{unit}: {amplitude:.6f}, phase_deg: {phase_deg:.4f}"


def _flow(nominal: Nominal | None) -> str:
    return "{" + ("" if nominal is None else _pair(nominal)) + "}"
