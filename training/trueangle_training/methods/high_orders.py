"""How large the steady harmonics from order 12 up are: a prior that the campaign gives itself.

Eccentricity, tilt and the errors of graduation up to order 11 stand far above the noise of a whole campaign; what
is above them comes down to it, and many orders are not there at all. Their estimates, y_n ~ N(b_n, v_n I) with
b_n = (cos, sin), are therefore shrunk,

    b_n = 0 with probability 1 - π, else b_n ~ N(0, s² (12 / n)^2p I),   n ≥ 12,

with π, s and p common to all of them and averaged over a grid by their evidence (empirical Bayes). At one point of
the grid order n is there with the odds π N(y_n; 0, v_n + t_n) : (1 - π) N(y_n; 0, v_n), t_n = s² (12 / n)^2p, and
its estimate then keeps the part t_n / (t_n + v_n). The mean κ_n of the part kept over all of this is that under a
Gaussian prior of variance v_n κ_n / (1 - κ_n), which serves every method.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LOWEST_HIGH_ORDER = 12
SIZES_ARCSEC = np.geomspace(0.02, 10.0, 16)
"""s, at order 12."""
FALLS = np.array([0.0, 1.0, 2.0, 3.0])
"""p."""
PRESENT_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
"""π."""
LEAST_KEPT, MOST_KEPT = 1e-3, 1.0 - 1e-6
"""The prior's variance stays above 0 and finite."""


def steady_prior_variance(orders: tuple[int, ...], estimate_arcsec: Floats, variance: Floats) -> Floats:
    """Prior variance of each steady coefficient in arcsec², [orders]; inf below order 12: no prior.

    `estimate_arcsec` [orders, 2] with a flat prior, and the `variance` [orders] of either component.
    """
    order = np.array(orders, dtype=np.float64)
    high = order >= LOWEST_HIGH_ORDER
    result = np.full(order.size, np.inf)
    if high.any():
        own = variance[high]
        kept = _part_kept(order[high], np.sum(estimate_arcsec[high] ** 2, axis=1), own)
        result[high] = own * kept / (1.0 - kept)
    return result


def steady_power(estimate_arcsec: Floats, variance: Floats, prior_variance: Floats) -> Floats:
    """Squared amplitude expected of each order in arcsec², [orders].

    |y|² - 2 v where the prior is flat, which may fall below 0; elsewhere that of the posterior, |κ y|² + 2 κ v
    with κ = 1 / (1 + v / prior variance).
    """
    square = np.sum(estimate_arcsec**2, axis=1)
    kept = 1.0 / (1.0 + variance / prior_variance)
    return np.where(np.isinf(prior_variance), square - 2.0 * variance, kept**2 * square + 2.0 * kept * variance)


def _part_kept(order: Floats, square: Floats, variance: Floats) -> Floats:
    """κ [orders] from |y|² and v; in the grid axes are (s and p, π, order)."""
    fall = (LOWEST_HIGH_ORDER / order) ** (2.0 * FALLS[:, None])
    slab = (SIZES_ARCSEC[:, None, None] ** 2 * fall).reshape(-1, 1, order.size)
    share = PRESENT_SHARES[:, None]
    absent = np.log1p(-share) + _log_density(square, variance)
    present = np.log(share) + _log_density(square, variance + slab)
    either = np.logaddexp(absent, present)
    evidence = either.sum(axis=2)
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    kept = np.exp(present - either) * slab / (slab + variance)
    return np.clip(np.einsum("gp,gpn->n", weight, kept), LEAST_KEPT, MOST_KEPT)


def _log_density(square: Floats, variance: Floats) -> Floats:
    """Of two components of that variance each, up to a constant."""
    return -np.log(variance) - square / (2.0 * variance)
