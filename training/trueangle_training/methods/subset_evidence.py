"""The evidence of every subset of a network's hidden units under every slab, by eliminating unit after unit.

A subset S with slab s is worth  w'(B_S + 1/s)⁻¹w / 2 - log|1 + s B_S| / 2.  Each unit, a pair (cos, sin) of output
weights, is either left out or eliminated,

    A → A_rr - A_rp A_pp⁻¹ A_pr,   w → w_r - A_rp A_pp⁻¹ w_p,   A = B + 1/s at first,

and adds w_p'A_pp⁻¹w_p - log|s A_pp| where it is eliminated. Subsets share all eliminations that they begin with,
so 2^H subsets cost little more than a few solutions, and all members, harmonics and slabs go side by side.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def subset_log_likelihood(inner: Floats, weight: Floats, slab_variance: Floats) -> Floats:
    """log L of each subset and slab, [members, orders, subsets, slabs]; bit h of a subset's number is unit h.

    `inner` [members, orders or 1, 2 units, 2 units] is B, `weight` [members, orders, 2 units] is w, cos of every
    unit before sin; `slab_variance` [slabs].
    """
    members, orders, size = weight.shape
    units = size // 2
    by_unit = np.arange(size).reshape(2, units).T.ravel()
    # Members, harmonics and slabs last: every step below is then a few operations on long rows.
    pivots = inner[:, :, by_unit[:, None], by_unit].transpose(2, 3, 0, 1)[None, ..., None]
    matrix = np.repeat(pivots, slab_variance.size, axis=-1)
    matrix[0, np.arange(size), np.arange(size)] += 1.0 / slab_variance
    vector = np.repeat(weight[:, :, by_unit].transpose(2, 0, 1)[None, ..., None], slab_variance.size, axis=-1)
    value = np.zeros((1, members, orders, slab_variance.size))
    for _ in range(units):
        value, matrix, vector = _with_and_without(value, matrix, vector, slab_variance)
    return value.transpose(1, 2, 0, 3)


def _with_and_without(
    value: Floats, matrix: Floats, vector: Floats, slab_variance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Branches without the first unit left, then the same with it."""
    a, b, c = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]
    determinant = a * c - b * b
    a, b, c = a / determinant, b / determinant, c / determinant
    cosine, sine = vector[:, 0], vector[:, 1]
    solved_cosine, solved_sine = c * cosine - b * sine, a * sine - b * cosine
    gain = cosine * solved_cosine + sine * solved_sine - np.log(determinant * slab_variance**2)
    across, below = matrix[:, 0, 2:], matrix[:, 1, 2:]
    reach_cosine = c[:, None] * across - b[:, None] * below
    reach_sine = a[:, None] * below - b[:, None] * across
    rest, left = matrix[:, 2:, 2:], vector[:, 2:]
    reduced = rest - across[:, :, None] * reach_cosine[:, None]
    reduced -= below[:, :, None] * reach_sine[:, None]
    moved = left - across * solved_cosine[:, None] - below * solved_sine[:, None]
    return (
        np.concatenate([value, value + gain / 2.0]),
        np.concatenate([rest, reduced]),
        np.concatenate([left, moved]),
    )
