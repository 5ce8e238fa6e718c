"""What a campaign says of the Fourier coefficients at a few temperatures: all that the better methods need.

F equally spaced faces are a constant and cos, sin of the orders 1 .. (F - 1) / 2, orthogonal and complete. A free
offset of each run takes up the constant, so a complete run is its discrete Fourier transform: F - 1 numbers with
independent errors of variance 2 σ² / F. The harmonics decouple, and the campaign becomes a short series over
temperature for each coefficient.

Shifted repeats, missing readings, unequal faces and sweeps have no such transform. There the same coefficients at
the same temperature nodes are the unknowns of a general linear model with one free offset a zero group, and the
harmonics are told apart by their priors (`JointLikelihood.marginal`). On complete campaigns both ways agree.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from trueangle.contract.errors import Fault
from trueangle.contract.units import angle_difference_deg, wrap_deg
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError, distinct_angle_count
from trueangle_training.methods.separable import harmonics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HIGHEST_ORDER = 24
"""Joints show hardly anything above; each order costs two unknowns a temperature."""
WORST_CONDITION = 5.0
"""Of the harmonics' design: 1 for equal faces, 4.7 with one of 23 missing. Orders beyond drown in noise."""
SAME_TEMPERATURE_C = 0.6
"""Temperatures that span less are one node: set temperatures are met within tenths of a degree."""
STEADY_RUN_C = 0.3
MOST_NODES = 15
REGULAR_FACE_DEG = 0.1
"""Readings this near their face are moved to it by the slope of the error; further off, its bend would count."""
FEWEST_NOISE_FREEDOMS = 30
LOW_ORDERS = 3
"""Eccentricity, tilt and a little more: what temperature changes in a joint, as far as the noise is concerned."""
SMALLEST_NOISE_ARCSEC = 1e-3
"""Far below any reading's resolution; keeps weights finite for readings without noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoefficientLikelihood:
    """Gaussian likelihood of each harmonic's coefficients at the nodes, the other harmonics and offsets taken out.

    The values of one harmonic are x = (cos at every node, sin at every node), shape [2 m]; up to a constant
    log L = -x'Px / 2 + x'q.
    """

    precision: Floats
    """P: [orders, 2 m, 2 m], or [1, 2 m, 2 m] where it is the same for all."""
    information: Floats
    """q: [orders, 2 m]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLikelihood:
    """The same for all harmonics together, where the plan does not tell them apart by itself."""

    precision: Floats
    """[orders, 2 m, orders, 2 m]."""
    information: Floats
    """[orders, 2 m]."""

    def marginal(self, factor: Floats) -> CoefficientLikelihood:
        """Each harmonic's likelihood with the others integrated over x = B w, w ~ N(0, I), flat where B says so.

        `factor` [orders, 2 m, 2 m], invertible: its first two columns are the constant values, whose size is left
        free; the other columns are a square root of the prior covariance. The inverse of one harmonic's posterior
        covariance is its own prior's precision plus what all readings say of it, so one inversion serves all.
        """
        orders, size = self.information.shape
        covariance, mean = self.posterior(factor)
        prior = np.eye(size)
        prior[:2, :2] = 0.0
        to_values = np.linalg.inv(factor)
        precision, information = np.empty((orders, size, size)), np.empty((orders, size))
        for order in range(orders):
            own = np.linalg.inv(covariance[order, :, order])
            precision[order] = to_values[order].T @ (own - prior) @ to_values[order]
            information[order] = to_values[order].T @ (own @ mean[order])
        return CoefficientLikelihood(precision=(precision + precision.swapaxes(1, 2)) / 2, information=information)

    def posterior(self, factor: Floats) -> tuple[Floats, Floats]:
        """Covariance [orders, 2 m, orders, 2 m] and mean [orders, 2 m] of all w."""
        orders, size = self.information.shape
        weighted = np.einsum("aimj,mjk->aimk", self.precision, factor, optimize=True)
        inner = np.einsum("aik,aimj->akmj", factor, weighted, optimize=True).reshape(orders * size, -1)
        prior = np.ones((orders, size))
        prior[:, :2] = 0.0
        covariance = _inverse(inner + np.diag(prior.ravel()))
        mean = covariance @ np.einsum("aik,ai->ak", factor, self.information).ravel()
        return covariance.reshape(orders, size, orders, size), mean.reshape(orders, size)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoefficientReadings:
    """A campaign reduced to Fourier coefficients at temperature nodes."""

    orders: tuple[int, ...]
    nodes_c: Floats
    """[m], rising, two or more."""
    sigma_arcsec: float
    """Standard deviation of one reading."""
    sigma_freedoms: int
    """Degrees of freedom behind it."""
    decoupled: CoefficientLikelihood | None
    """None: the plan couples the harmonics."""
    joint: JointLikelihood | None
    """None: the plan is complete and regular."""

    def with_steady_prior(self, variance: Floats) -> "CoefficientReadings":
        """The same, and N(0, variance) on the mean over the nodes of either component of an order, counted once.

        `variance` [orders], inf: none. The methods' flat prior of the constants then is this one; as the mean over
        the nodes is 1'x / m, it adds 1 1' / (m² variance) to the precision.
        """
        nodes = self.nodes_c.size
        added = np.kron(np.eye(2), np.full((nodes, nodes), nodes**-2.0)) / variance[:, None, None]
        joint, decoupled = self.joint, self.decoupled
        if decoupled is not None:
            decoupled = replace(decoupled, precision=decoupled.precision + added)
        if joint is not None:
            precision, each = joint.precision.copy(), np.arange(len(self.orders))
            precision[each, :, each] += added
            joint = replace(joint, precision=precision)
        return replace(self, joint=joint, decoupled=decoupled)


def _inverse(matrix: Floats) -> Floats:
    """Of a symmetric positive definite matrix, by Cholesky: half the work of the general inverse."""
    potrf, potri = get_lapack_funcs(("potrf", "potri"), (matrix,))
    factor, fault = potrf(matrix)
    if fault:
        # Rounding has taken the definiteness of a matrix that is nearly singular.
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    upper, _ = potri(factor)
    return np.asarray(np.triu(upper) + np.triu(upper, 1).T)


def reduce_to_coefficients(readings: TrainingReadings) -> CoefficientReadings:
    """Complete regular campaigns by the transform, all others by the general linear model.

    UnsuitableReadingsError lists what is missing: angles, temperatures, or repeats to know the noise from.
    """
    return reduce_curves(readings, readings.error_arcsec[:, None])[0]


def reduce_curves(readings: TrainingReadings, curves_arcsec: Floats) -> tuple[CoefficientReadings, ...]:
    """Several errors [n, curves] at the places of `readings`, whose own are not looked at; laid out once."""
    regular = regular_faces(readings)
    if regular is None:
        return _reduce_general(readings, curves_arcsec)
    return tuple(reduce_regular(replace(readings, error_arcsec=curve), regular) for curve in curves_arcsec.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class RegularFaces:
    """Equally spaced faces, each read once in every run, at a steady temperature."""

    count: int
    first_deg: float


def regular_faces(readings: TrainingReadings) -> RegularFaces | None:
    """The faces of a complete regular campaign; None for any other plan."""
    group = readings.offset_group
    sizes = np.bincount(group)
    count = int(sizes[0])
    if count < 3 or (sizes != count).any() or count > 2 * HIGHEST_ORDER + 2:
        return None
    pitch_deg = 360.0 / count
    first_deg = float(readings.angle_deg[0])
    steps = angle_difference_deg(readings.angle_deg, first_deg) / pitch_deg
    face = np.round(steps).astype(np.int64)
    off_deg = (steps - face) * pitch_deg
    first_deg += float(np.mean(off_deg))
    if np.abs(off_deg - np.mean(off_deg)).max() > REGULAR_FACE_DEG:
        return None
    if np.unique(np.stack([group, face % count]), axis=1).shape[1] != len(readings):
        return None
    means = np.bincount(group, weights=readings.temperature_c) / count
    if np.abs(readings.temperature_c - means[group]).max() > STEADY_RUN_C:
        return None
    _, nodes_c = _temperature_clusters(means)
    return None if nodes_c.size > MOST_NODES else RegularFaces(count=count, first_deg=wrap_deg(first_deg))


def reduce_regular(readings: TrainingReadings, faces: RegularFaces) -> CoefficientReadings:
    """The discrete Fourier transform of each run, averaged over the runs of a node."""
    orders = tuple(range(1, min((faces.count - 1) // 2, HIGHEST_ORDER) + 1))
    group = readings.offset_group
    runs = int(group.max()) + 1
    pitch_deg = 360.0 / faces.count
    face = np.round(angle_difference_deg(readings.angle_deg, faces.first_deg) / pitch_deg)
    at_face = harmonics(faces.first_deg + face * pitch_deg, orders)
    moved = harmonics(readings.angle_deg, orders) - at_face
    coefficients = np.zeros((runs, at_face.shape[1]))
    # Readings lie some arcminutes beside the faces, as far as the error itself: the second pass moves them there.
    for _ in range(3):
        at_faces_arcsec = readings.error_arcsec - np.einsum("ic,ic->i", moved, coefficients[group])
        coefficients = np.zeros_like(coefficients)
        np.add.at(coefficients, group, at_face * at_faces_arcsec[:, None] * (2.0 / faces.count))
    means_c = np.bincount(group, weights=readings.temperature_c) / faces.count
    node, nodes_c = _temperature_clusters(means_c)
    _check_temperatures(nodes_c)
    repeats = np.bincount(node)
    mean, at_node = np.zeros((nodes_c.size, coefficients.shape[1])), coefficients
    off_node = spline_interpolation(nodes_c, means_c) - np.eye(nodes_c.size)[node]
    # Runs miss the set temperature by a tenth of a degree: moved to the node, they differ by noise alone.
    for _ in range(2):
        at_node = coefficients - off_node @ mean
        mean = np.zeros_like(mean)
        np.add.at(mean, node, at_node / repeats[node][:, None])
    variance, freedoms = _noise_of_repeats(at_node, mean, node, nodes_c)
    sigma_arcsec = max(float(np.sqrt(variance * faces.count / 2.0)), SMALLEST_NOISE_ARCSEC)
    weight = np.tile(repeats * faces.count / (2.0 * sigma_arcsec**2), 2)
    by_order = mean.T.reshape(len(orders), 2 * nodes_c.size)
    return CoefficientReadings(
        orders=orders,
        nodes_c=nodes_c,
        sigma_arcsec=sigma_arcsec,
        sigma_freedoms=freedoms,
        decoupled=CoefficientLikelihood(precision=np.diag(weight)[None], information=by_order * weight),
        joint=None,
    )


def _noise_of_repeats(coefficients: Floats, mean: Floats, node: Integers, nodes_c: Floats) -> tuple[float, int]:
    """Variance of one run's coefficient: from repeats, else from what smooth curves over temperature leave."""
    count = coefficients.shape[1]
    freedoms = (node.size - nodes_c.size) * count
    if freedoms >= FEWEST_NOISE_FREEDOMS:
        return float(np.sum((coefficients - mean[node]) ** 2)) / freedoms, freedoms
    t = (nodes_c[node] - nodes_c.mean()) / np.ptp(nodes_c)
    for bent_columns, low, high in _leaner_shapes(count):
        squares, freedoms = 0.0, 0
        for part, powers in ((coefficients[:, :bent_columns], low), (coefficients[:, bent_columns:], high)):
            design = t[:, None] ** np.arange(min(powers, nodes_c.size))
            left = part - design @ np.linalg.lstsq(design, part, rcond=None)[0]
            squares += float(np.sum(left**2))
            freedoms += (node.size - design.shape[1]) * part.shape[1]
        if freedoms >= FEWEST_NOISE_FREEDOMS:
            return squares / freedoms, freedoms
    raise UnsuitableReadingsError([_no_noise_fault(freedoms)])


def _leaner_shapes(columns: int) -> Iterator[tuple[int, int, int]]:
    """From rich to lean: how many of the columns, the low orders first, have the first number of free values over
    temperature; the others have the second.

    Temperature bends the low orders of a joint and hardly the high ones. What a shape misses counts as noise:
    sigma comes out too large then, never too small.
    """
    half = 2 * (columns // 4)
    low = min(2 * LOW_ORDERS, columns)
    yield columns, 4, 2
    yield half, 4, 2
    yield low, 4, 2
    yield low, 4, 1
    yield low, 2, 1


def reduce_general(readings: TrainingReadings) -> CoefficientReadings:
    """The normal equations of coefficients at nodes, one free offset a zero group taken out by centring."""
    return _reduce_general(readings, readings.error_arcsec[:, None])[0]


def _reduce_general(readings: TrainingReadings, curves_arcsec: Floats) -> tuple[CoefficientReadings, ...]:
    _check_angles(readings)
    group = readings.offset_group
    orders = _determined_orders(readings)
    nodes_c = temperature_nodes(readings.temperature_c)
    _check_temperatures(nodes_c)
    by_angle = harmonics(wrap_deg(readings.angle_deg), orders)
    interpolation = spline_interpolation(nodes_c, readings.temperature_c)
    design = (by_angle[:, :, None] * interpolation[:, None, :]).reshape(len(readings), -1)
    design = centred(design, group)
    errors = centred(curves_arcsec, group)
    sigmas_arcsec, freedoms = _residual_noise(readings, by_angle, design, errors, group)
    size = 2 * nodes_c.size
    gram = (design.T @ design).reshape(len(orders), size, len(orders), size)
    products = (design.T @ errors).T.reshape(-1, len(orders), size)
    return tuple(
        CoefficientReadings(
            orders=orders,
            nodes_c=nodes_c,
            sigma_arcsec=sigma_arcsec,
            sigma_freedoms=freedoms,
            decoupled=None,
            joint=JointLikelihood(precision=gram / sigma_arcsec**2, information=product / sigma_arcsec**2),
        )
        for sigma_arcsec, product in zip(sigmas_arcsec.tolist(), products, strict=True)
    )


def _residual_noise(
    readings: TrainingReadings, by_angle: Floats, design: Floats, errors: Floats, group: Integers
) -> tuple[Floats, int]:
    """Sigma of each curve [n, curves] from what free values at all nodes leave, or else leaner shapes."""
    groups = int(group.max()) + 1
    freedoms = 0
    for matrix in _noise_designs(readings, by_angle, design, group):
        solution, _, rank, _ = np.linalg.lstsq(matrix, errors, rcond=1e-8)
        freedoms = len(errors) - groups - int(rank)
        if freedoms >= FEWEST_NOISE_FREEDOMS:
            variance = np.sum((errors - matrix @ solution) ** 2, axis=0) / freedoms
            return np.maximum(np.sqrt(variance), SMALLEST_NOISE_ARCSEC), freedoms
    raise UnsuitableReadingsError([_no_noise_fault(freedoms)])


def _noise_designs(
    readings: TrainingReadings, by_angle: Floats, design: Floats, group: Integers
) -> Iterator[Floats]:
    """Free values at all nodes, then the leaner shapes."""
    yield design
    if np.ptp(readings.temperature_c) <= SAME_TEMPERATURE_C:
        return
    ends_c = (float(readings.temperature_c.min()), float(readings.temperature_c.max()))
    over_c = {1: np.ones((len(readings), 1))}
    for values in (2, 4):
        over_c[values] = spline_interpolation(np.linspace(*ends_c, values), readings.temperature_c)
    for bent_columns, low, high in _leaner_shapes(by_angle.shape[1]):
        parts = ((by_angle[:, :bent_columns], over_c[low]), (by_angle[:, bent_columns:], over_c[high]))
        products = [(part[:, :, None] * shape[:, None, :]).reshape(len(readings), -1) for part, shape in parts]
        yield centred(np.concatenate(products, axis=1), group)


def _no_noise_fault(freedoms: int) -> Fault:
    return Fault(
        where="readings",
        expected=f"repeats that show the noise: {FEWEST_NOISE_FREEDOMS} readings or more beyond the model's need",
        found=f"{max(freedoms, 0)}",
        advice="measure more readings: another repeat of each temperature, or another temperature",
    )


def _check_angles(readings: TrainingReadings) -> None:
    places = distinct_angle_count(readings.angle_deg)
    if places < 3:
        raise UnsuitableReadingsError(
            [
                Fault(
                    where="angle_deg",
                    expected="at least 3 distinct angles, for harmonic 1",
                    found=str(places),
                    advice="measure complete turns over a polygon",
                )
            ]
        )


def _check_temperatures(nodes_c: Floats) -> None:
    if nodes_c.size < 2 or np.ptp(nodes_c) < 1.0:
        found = f"all between {nodes_c.min():.2f} and {nodes_c.max():.2f} degC"
        advice = "measure at more temperatures, or use a method without temperature"
        expected = "temperatures that differ by 1 degC or more"
        raise UnsuitableReadingsError(
            [Fault(where="temperature_c", expected=expected, found=found, advice=advice)]
        )


def _determined_orders(readings: TrainingReadings) -> tuple[int, ...]:
    """As many orders as the angles tell apart, from each other and from the offsets."""
    highest = min(HIGHEST_ORDER, (distinct_angle_count(readings.angle_deg) - 1) // 2)
    group = readings.offset_group
    for order in range(highest, 0, -1):
        orders = tuple(range(1, order + 1))
        design = centred(harmonics(wrap_deg(readings.angle_deg), orders), group)
        singular = np.linalg.svd(design, compute_uv=False)
        if singular[-1] * WORST_CONDITION >= singular[0]:
            return orders
    raise UnsuitableReadingsError(
        [
            Fault(
                where="angle_deg",
                expected="angles all around the circle",
                found=f"{distinct_angle_count(readings.angle_deg)} places that do not determine harmonic 1",
                advice="measure in the gaps",
            )
        ]
    )


def temperature_nodes(temperature_c: Floats) -> Floats:
    """Where the campaign's temperatures gather; an even grid where they do not."""
    _, nodes_c = _temperature_clusters(temperature_c)
    if nodes_c.size <= MOST_NODES:
        return nodes_c
    lowest_c, highest_c = float(temperature_c.min()), float(temperature_c.max())
    count = min(MOST_NODES, int(np.ceil((highest_c - lowest_c) / 2.5)) + 1)
    return np.linspace(lowest_c, highest_c, max(count, 3))


def _temperature_clusters(temperature_c: Floats) -> tuple[Integers, Floats]:
    """Which cluster each value belongs to, and the clusters' means; none spans more than `SAME_TEMPERATURE_C`."""
    order = np.argsort(temperature_c, kind="stable")
    cluster = np.empty(order.size, dtype=np.int64)
    number, first_c = -1, -np.inf
    for index in order:
        if temperature_c[index] - first_c > SAME_TEMPERATURE_C:
            number, first_c = number + 1, float(temperature_c[index])
        cluster[index] = number
    return cluster, np.bincount(cluster, weights=temperature_c) / np.bincount(cluster)


def centred(matrix: Floats, group: Integers) -> Floats:
    """Columns less their mean in each group: a free offset of the group, eliminated exactly."""
    count = np.bincount(group).astype(np.float64)
    sums = np.zeros((count.size, matrix.shape[1]))
    np.add.at(sums, group, matrix)
    return matrix - (sums / count[:, None])[group]


def spline_interpolation(nodes_c: Floats, temperature_c: Floats) -> Floats:
    """Natural cubic spline through values at the nodes, as a matrix [n, m]; straight lines beyond the ends.

    Second derivatives M solve h_i M_i / 6 + (h_i + h_i+1) M_i+1 / 3 + h_i+1 M_i+2 / 6 = differences of slopes.
    """
    count, step = nodes_c.size, np.diff(nodes_c)
    slopes = np.diff(np.eye(count), axis=0) / step[:, None]
    bend = np.zeros((count, count))
    if count > 2:
        system = (
            np.diag((step[:-1] + step[1:]) / 3.0) + np.diag(step[1:-1] / 6.0, 1) + np.diag(step[1:-1] / 6.0, -1)
        )
        bend[1:-1] = np.linalg.solve(system, np.diff(slopes, axis=0))
    inside_c = np.clip(temperature_c, nodes_c[0], nodes_c[-1])
    piece = np.clip(np.searchsorted(nodes_c, inside_c, side="right") - 1, 0, count - 2)
    width = step[piece]
    b = (inside_c - nodes_c[piece]) / width
    a = 1.0 - b
    values = a[:, None] * np.eye(count)[piece] + b[:, None] * np.eye(count)[piece + 1]
    curve = ((a**3 - a) * width**2 / 6.0)[:, None] * bend[piece] + ((b**3 - b) * width**2 / 6.0)[:, None] * bend[
        piece + 1
    ]
    at_start = slopes[0] - step[0] / 6.0 * bend[1]
    at_end = slopes[-1] + step[-1] / 6.0 * bend[-2]
    beyond = np.where((temperature_c < nodes_c[0])[:, None], at_start, at_end)
    return values + curve + (temperature_c - inside_c)[:, None] * beyond
