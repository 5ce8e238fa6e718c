"""Order 1 with a new amplitude and phase in each run: the joint or its grating is seated anew."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import Amplitude, Phase
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import no_columns, order_columns, polar

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeatedRun:
    """What one run of a campaign was found to have."""

    run: Annotated[int, Range(minimum=-(2**53), maximum=2**53)]
    amplitude_arcsec: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class RunToRunEccentricitySettings:
    """The size of the draws, and draws that are known."""

    amplitude_arcsec: Amplitude | None = None
    """Root of the mean square amplitude over runs; a run's cos and sin parts are normal. None: calibrated."""
    runs: tuple[SeatedRun, ...] = ()
    """Runs of the diagnosed campaign; any other run is drawn."""

    def __post_init__(self) -> None:
        runs = [seated.run for seated in self.runs]
        if len(set(runs)) < len(runs):
            twice = next(run for run in runs if runs.count(run) > 1)
            raise ContractError([Fault(where="runs", expected="each run once", found=f"run {twice} again")])

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is the same in every run."""
        return None if self.amplitude_arcsec is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        runs, place = np.unique(conditions.run, return_inverse=True)
        parts = np.zeros((runs.size, 2))
        if rng is not None:
            parts = rng.normal(0.0, (self.amplitude_arcsec or 0.0) / np.sqrt(2.0), size=parts.shape)
        for seated in self.runs:
            phase_rad = np.radians(seated.phase_deg)
            of_run = seated.amplitude_arcsec * np.array([np.cos(phase_rad), np.sin(phase_rad)])
            parts[runs == seated.run] = of_run
        return np.sum(order_columns(conditions.angle_deg, [1]) * parts[place], axis=1)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Order 1 of each run by itself."""
        return _own_order(conditions)[1]


def _own_order(conditions: Conditions) -> tuple[NDArray[np.int64], Floats]:
    """The runs, and cos and sin of each, shape [readings, 2 runs]."""
    runs = np.unique(conditions.run)
    waves = order_columns(conditions.angle_deg, [1])
    belongs = (conditions.run[:, None] == runs[None, :]).astype(np.float64)
    return runs, (belongs[:, :, None] * waves[:, None, :]).reshape(len(conditions), 2 * runs.size)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """One shape; none with a single run, where nothing changes from run to run."""
    runs, columns = _own_order(conditions)
    if runs.size < 2:
        return
    yield Hypothesis(
        effect="run_to_run_eccentricity",
        label="order 1 of each run",
        cell=Cell(order="1", time="between_runs"),
        main=columns,
        coefficients=tuple(f"run_{run}_{part}_arcsec" for run in runs.tolist() for part in ("cos", "sin")),
        wiggle=no_columns(len(conditions)),
    )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The draws found and their size."""
    parts = coefficients.reshape(-1, 2)
    runs = [int(name.split("_")[1]) for name in hypothesis.coefficients[::2]]
    found = zip(runs, parts.tolist(), strict=True)
    return {
        "amplitude_arcsec": float(np.sqrt(np.mean(np.sum(parts**2, axis=1)))),
        "runs": [{"run": run, **polar(cos, sin, "amplitude_arcsec")} for run, (cos, sin) in found],
    }


EFFECT = LibraryEffect(
    name="run_to_run_eccentricity",
    nature=Nature.RANDOM,
    physics="The coupling or the grating seats anew with each set-up: order 1 differs from run to run.",
    formula="E = a_r cos θ + b_r sin θ, a_r and b_r normal, new in each run r",
    source="re-seating of couplings and clampings; shop experience",
    parameters=(
        Parameter(
            name="amplitude_arcsec",
            unit="arcsec",
            low=0.0,
            high=20.0,
            source="shop experience: 0 to 2 um of re-seating at 25 mm radius",
        ),
    ),
    cells=(Cell(order="1", time="between_runs"),),
    proof="Clamp the joint anew between runs at one temperature, then leave it clamped: only the former scatter.",
    missing_input="a reference in each set-up",
    settings=RunToRunEccentricitySettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
