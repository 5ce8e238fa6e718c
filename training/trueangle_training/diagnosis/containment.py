"""How much of one pattern another can carry under a plan: what decides whether two effects can be told apart.

All in plain readings, after what is re-calibrated has been projected out: no noise enters, so that the plan can be
judged before the data are read.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.diagnosis.cleaning import orthonormal
from trueangle_training.diagnosis.problem import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_VISIBLE = 0.01
"""Share of a shape's energy that re-calibration must leave for the shape to count as visible."""
SINGLE_PRECISION_BEYOND = 4_000_000
_FLAT = 1e-4
"""Of a column's mean energy: directions of a block below it are the plan's, not the shape's."""
_AT_ONCE = 4_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spans:
    """Of every library hypothesis an orthonormal basis of its main columns, re-calibration projected out."""

    basis: NDArray[np.floating]
    """[directions of all hypotheses, rows]"""
    owner: Integers
    """[directions]: the hypothesis, ascending."""
    nuisance: Floats
    """[rows, rank]: orthonormal."""
    visible: Floats
    """[hypotheses]: share of the energy of the columns that re-calibration leaves; 0 of generic patterns."""

    def projected(self, curve: Floats) -> Floats:
        """[readings]: what re-calibration leaves of a curve."""
        return curve - self.nuisance @ (self.nuisance.T @ curve)

    def carried(self, curve: Floats) -> Floats:
        """[hypotheses]: share of the curve's visible energy that each hypothesis's main columns can carry."""
        seen = self.projected(curve)
        energy = float(seen @ seen)
        if energy <= 0:
            return np.zeros(self.visible.size)
        products = (self.basis @ seen.astype(self.basis.dtype)).astype(np.float64)
        shares = np.bincount(self.owner, weights=products**2, minlength=self.visible.size)
        return np.minimum(shares / energy, 1.0)

    def carried_by(self, columns: Floats, curve: Floats) -> float:
        """Share of the curve's visible energy that columns [readings, columns] can carry."""
        seen = self.projected(curve)
        energy = float(seen @ seen)
        basis = orthonormal(columns - self.nuisance @ (self.nuisance.T @ columns))
        return 0.0 if energy <= 0 else float(np.sum((basis.T @ seen) ** 2)) / energy

    def carried_at_best(self, hypotheses: Integers, *, average: bool) -> Floats:
        """[hypotheses]: largest share of a pattern of the given hypotheses that each of all can carry.

        Of the pattern that suits the other best (the largest squared canonical correlation), or with `average` the
        mean over random patterns.
        """
        count = self.visible.size
        best = np.zeros(count)
        chosen = np.flatnonzero(np.isin(self.owner, hypotheses))
        products = (self.basis[chosen] @ self.basis.T).astype(np.float64)
        for hypothesis in hypotheses:
            own = products[self.owner[chosen] == hypothesis]
            size = own.shape[0]
            if size == 0:
                continue
            if average or size == 1:
                energy = np.sum(own**2, axis=0) / size
                best = np.maximum(best, np.bincount(self.owner, weights=energy, minlength=count))
                continue
            squares = np.empty((count, size, size))
            for i in range(size):
                for j in range(i + 1):
                    both = np.bincount(self.owner, weights=own[i] * own[j], minlength=count)
                    squares[:, i, j] = squares[:, j, i] = both
            best = np.maximum(best, np.linalg.eigvalsh(squares)[:, -1])
        return best


def spans_of(problem: Problem) -> Spans:
    """Project and orthonormalise every hypothesis of the library."""
    rows = len(problem)
    width = np.array([each.main.shape[1] for each in problem.hypotheses], dtype=np.int64)
    named = np.array([each.effect is not None for each in problem.hypotheses], dtype=bool)
    single = rows * int(width.sum()) > SINGLE_PRECISION_BEYOND
    kind = np.float32 if single else np.float64
    nuisance = orthonormal(problem.nuisance())
    inside = np.ascontiguousarray(nuisance.T.astype(kind))
    visible = np.zeros(width.size)
    bases: dict[int, NDArray[np.floating]] = {}
    for size in np.unique(width):
        blocks = np.flatnonzero((width == size) & named)
        for some in np.array_split(blocks, max(1, -(-blocks.size * rows * int(size) // _AT_ONCE))):
            if some.size == 0:
                continue
            stacked = np.concatenate([problem.hypotheses[i].main.T for i in some]).astype(kind)
            energy = np.einsum("ij,ij->i", stacked, stacked, dtype=np.float64).reshape(some.size, -1).sum(axis=1)
            stacked -= (stacked @ inside.T) @ inside
            columns = stacked.reshape(some.size, int(size), rows)
            gram = (columns @ columns.transpose(0, 2, 1)).astype(np.float64)
            left = np.trace(gram, axis1=1, axis2=2)
            visible[some] = np.clip(left / np.maximum(energy, 1e-300), 0.0, 1.0)
            values, vectors = np.linalg.eigh(gram)
            for i, place in enumerate(some):
                if visible[place] >= LEAST_VISIBLE:
                    used = values[i] > _FLAT * energy[i] / float(size)
                    root = vectors[i][:, used] / np.sqrt(values[i, used])
                    bases[int(place)] = root.T.astype(kind) @ columns[i]
    places = sorted(bases)
    owner = np.concatenate([np.full(bases[place].shape[0], place) for place in places] or [np.empty(0, dtype=int)])
    return Spans(
        basis=np.concatenate([bases[place] for place in places] or [np.empty((0, rows), dtype=kind)]),
        owner=owner.astype(np.int64),
        nuisance=nuisance,
        visible=visible,
    )
