"""Each run in its own discrete cosine transform, where coloured noise becomes a scale for each row.

DCT-II diagonalises stationary noise up to end effects (it is the limit of the Karhunen-Loeve transform of a
first-order autoregression; Ahmed, Natarajan and Rao 1974), so that the colour can be estimated again without
transforming the designs anew.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LONGEST_BY_MATRIX = 400
CHUNK = 128


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunTransform:
    """Orthonormal cosine transform of every run by itself; rows keep their places."""

    rows: tuple[Integers, ...]
    """Of each run, the rows in the order of time."""
    run_index: Integers
    """[rows]: place of the row's run in `rows`."""
    half_cycles: Integers
    """[rows]: j of the cosine that a transformed row belongs to; 0 is the run's mean."""
    frequency_hz: Floats
    """[rows]: j / (2 duration); 1 reading = 1 s where no time is known."""
    bases: Mapping[int, Floats]
    """The cosines of every length of run that is short enough for a matrix: [length, length]."""

    def __call__(self, values: Floats) -> Floats:
        """Transform the columns of [rows] or [rows, columns]."""
        matrix = values[:, None] if values.ndim == 1 else values
        out = np.empty_like(matrix)
        for rows in self.rows:
            basis = self.bases.get(rows.size)
            out[rows] = _dct(matrix[rows]) if basis is None else basis.astype(matrix.dtype) @ matrix[rows]
        return out[:, 0] if values.ndim == 1 else out

    def of_stacked(self, columns: NDArray[np.floating]) -> NDArray[np.floating]:
        """Transform [columns, rows] along the rows."""
        out = np.empty_like(columns)
        for rows in self.rows:
            straight = bool(rows[-1] - rows[0] + 1 == rows.size and np.all(np.diff(rows) == 1))
            where: slice | Integers = slice(int(rows[0]), int(rows[-1]) + 1) if straight else rows
            basis = self.bases.get(rows.size)
            if basis is None:
                out[:, where] = _dct(np.ascontiguousarray(columns[:, where].T)).T
            else:
                out[:, where] = columns[:, where] @ basis.T.astype(columns.dtype)
        return out

    def inverse(self, values: Floats) -> Floats:
        """Back to readings; [rows]."""
        out = np.empty_like(values)
        for rows in self.rows:
            basis = self.bases.get(rows.size)
            out[rows] = _inverse_dct(values[rows]) if basis is None else basis.T @ values[rows]
        return out


def run_transform(run: Integers, time_s: Floats | None) -> RunTransform:
    """The transform of a campaign whose readings belong to `run`."""
    rows: list[Integers] = []
    index = np.empty(run.size, dtype=np.int64)
    cycles = np.empty(run.size, dtype=np.int64)
    frequency = np.empty(run.size)
    _, first = np.unique(run, return_index=True)
    for place, each in enumerate(run[np.sort(first)]):
        here = np.flatnonzero(run == each)
        if time_s is not None:
            here = here[np.argsort(time_s[here], kind="stable")]
        n = here.size
        duration = float(n)
        if time_s is not None and n > 1 and float(np.ptp(time_s[here])) > 0:
            duration = float(np.ptp(time_s[here])) * n / (n - 1)
        rows.append(here.astype(np.int64))
        index[here] = place
        cycles[here] = np.arange(n)
        frequency[here] = np.arange(n) / (2.0 * duration)
    lengths = {rows_of_run.size for rows_of_run in rows}
    return RunTransform(
        rows=tuple(rows),
        run_index=index,
        half_cycles=cycles,
        frequency_hz=frequency,
        bases={n: _matrix(n) for n in lengths if n <= LONGEST_BY_MATRIX},
    )


def _matrix(n: int) -> Floats:
    j, i = np.arange(n)[:, None], np.arange(n)[None, :]
    basis = np.sqrt(2.0 / n) * np.cos(np.pi * j * (2 * i + 1) / (2 * n))
    basis[0] = np.sqrt(1.0 / n)
    return basis


def _dct(values: NDArray[np.floating]) -> NDArray[np.floating]:
    n = values.shape[0]
    turn = np.exp(-0.5j * np.pi * np.arange(n) / n) * np.sqrt(2.0 / n)
    turn[0] *= np.sqrt(0.5)
    out = np.empty_like(values)
    for start in range(0, values.shape[1], CHUNK):
        block = values[:, start : start + CHUNK]
        # Even readings upwards, odd ones downwards: a transform of length n instead of 2 n (Makhoul 1980).
        folded = np.concatenate([block[::2], block[1::2][::-1]])
        out[:, start : start + CHUNK] = (np.fft.fft(folded, axis=0) * turn[:, None]).real
    return out


def _inverse_dct(values: Floats) -> Floats:
    n = values.size
    scaled = values * np.sqrt(2.0 / n)
    scaled[0] *= np.sqrt(0.5)
    turn = np.exp(0.5j * np.pi * np.arange(n) / n)
    folded = (np.fft.ifft(scaled * turn) * n).real
    out = np.empty(n)
    half = (n + 1) // 2
    out[::2] = folded[:half]
    out[1::2] = folded[half:][::-1]
    return out
