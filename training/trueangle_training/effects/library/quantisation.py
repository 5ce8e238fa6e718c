"""Resolution coarser than stated: the angle stands on a lattice of fewer counts."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.encoder import MAX_COUNTS_PER_REV
from trueangle.contract.joint import Joint
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter, Stage
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import no_columns

Floats = NDArray[np.float64]

FEWEST_STEPS = 20
LARGEST_RATIO = 4096
_SCREENED = 500
_SAME_LENGTH = 1e-6
_CONCENTRATED = 0.9
"""Mean resultant length on a lattice; rounding on the way to the file may take a little of 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantisationSettings:
    """The counts that the angle really has."""

    counts_per_rev: Annotated[int, Range(minimum=2, maximum=MAX_COUNTS_PER_REV)] | None = None
    """Fewer than `encoder.counts_per_rev`, which the bus still speaks; None: those of the encoder."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Its mean is 0."""
        return None if self.counts_per_rev is None else ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; `angle_deg` is the indicated angle before it is rounded."""
        counts_per_rev = self.counts_per_rev
        if counts_per_rev is None:
            return np.zeros(len(conditions))
        counts = conditions.angle_deg * (counts_per_rev / DEG_PER_TURN)
        return (np.rint(counts) - counts) * (DEG_PER_TURN * ARCSEC_PER_DEG / counts_per_rev)

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """None: it does not move the mean."""
        return no_columns(len(conditions))


def coarser_counts_per_rev(conditions: Conditions) -> int | None:
    """The fewest counts on whose lattice all angles stand; None where there is none coarser than stated.

    Looked for among the stated counts over whole numbers, powers of two, and lines times whole numbers. A lattice
    of m counts shows in the mean of exp(i m θ), whose length is 1 on it and about n^-1/2 otherwise. Angle and
    lattice have one zero.
    """
    angle_deg = np.unique(np.rint(conditions.angle_deg * (conditions.counts_per_rev / DEG_PER_TURN)))
    angle_deg = angle_deg * (DEG_PER_TURN / conditions.counts_per_rev)
    few = angle_deg[:: max(1, angle_deg.size // _SCREENED)]
    # Stops of a polygon stand on coarse lattices by themselves: more of the lattice must be seen than stops.
    fewest = max(FEWEST_STEPS, 2 * (conditions.faces or 0))
    found: list[tuple[float, int]] = []
    for counts_per_rev in _candidates(conditions):
        if _concentration(few, counts_per_rev) > _CONCENTRATED:
            steps = np.unique(np.rint(angle_deg * (counts_per_rev / DEG_PER_TURN))).size
            # Each step is one angle, or the angles only happen to stand near the lattice.
            if fewest <= steps == angle_deg.size:
                found.append((_concentration(angle_deg, counts_per_rev), counts_per_rev))
    # Of readings close together neighbouring lattices are hit nearly as well: the best one is meant.
    best = max((length for length, _ in found), default=0.0)
    exact = [counts_per_rev for length, counts_per_rev in found if length > best - _SAME_LENGTH]
    return min(exact) if best > _CONCENTRATED else None


def _concentration(angle_deg: Floats, counts_per_rev: int) -> float:
    phase_rad = 2 * np.pi * np.mod(angle_deg * (counts_per_rev / DEG_PER_TURN), 1.0)
    return float(np.hypot(np.mean(np.cos(phase_rad)), np.mean(np.sin(phase_rad))))


def _candidates(conditions: Conditions) -> list[int]:
    """Up to half the stated counts: a lattice close to the stated one cannot be told from it."""
    stated, lines = conditions.counts_per_rev, conditions.lines_per_rev
    whole = {stated // ratio for ratio in range(2, LARGEST_RATIO + 1) if stated % ratio == 0}
    binary = {2**bits for bits in range(8, 31)}
    interpolated = {lines * times for times in range(1, 1025)}
    return sorted(count for count in whole | binary | interpolated if 256 <= count <= stated // 2)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """None: no curve of the mean; see `variance_hypotheses`."""
    yield from ()


def variance_hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """The lattice that was found, if any; `main` is its rounding error's standard deviation in arcsec."""
    counts_per_rev = coarser_counts_per_rev(conditions)
    if counts_per_rev is not None:
        step_arcsec = DEG_PER_TURN * ARCSEC_PER_DEG / counts_per_rev
        yield Hypothesis(
            effect="quantisation",
            label=f"{counts_per_rev} counts a turn, {step_arcsec:.3g} arcsec each",
            cell=Cell(order="0", moment="variance"),
            main=np.full((len(conditions), 1), step_arcsec / np.sqrt(12.0)),
            coefficients=("scale",),
            wiggle=no_columns(len(conditions)),
            shape={"counts_per_rev": float(counts_per_rev)},
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The counts."""
    return {"counts_per_rev": int(hypothesis.shape["counts_per_rev"])}


EFFECT = LibraryEffect(
    name="quantisation",
    nature=Nature.VARIANCE,
    physics="The encoder resolves less than its counts say: the angle jumps in coarser steps.",
    formula="E = rounding to 1296000 / M arcsec, standard deviation of a step over the root of 12",
    source="uniform rounding error, GUM (JCGM 100) F.2.2.1",
    parameters=(
        Parameter(
            name="counts_per_rev",
            unit="1",
            low=256,
            high=float(MAX_COUNTS_PER_REV),
            source="data sheets: 8 to 30 bits a turn",
        ),
    ),
    cells=(Cell(order="0", moment="variance"),),
    proof="Turn the joint by a tenth of a count at a time, or list the distinct position values of a slow sweep.",
    missing_input="resolution: what was rounded away is lost",
    settings=QuantisationSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    stage=Stage.READOUT,
)
