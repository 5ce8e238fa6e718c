"""Correction and uncertainty of a separable model, as nodes of an ONNX graph."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.graph import Graph
from trueangle_training.methods.separable import CoefficientSpread, SeparableModel, TemperatureBasis, harmonics

Floats = NDArray[np.float64]


def separable_correction(
    graph: Graph, model: SeparableModel, *, angle_column: str, temperature_column: str, prefix: str
) -> str:
    """E(datum, T) - E(θ, T), shape [n, 1]; the names of its nodes begin with `prefix`."""
    basis = _basis(graph, model.basis, temperature_column, prefix)
    weights = graph.constant("coefficients_arcsec", -_cosines_then_sines(model.weights_arcsec.T).T)
    coefficients = graph.node("MatMul", [basis, weights], f"{prefix}coefficients")
    from_datum = _harmonics_from_datum(graph, model.orders, model.datum_deg, angle_column, prefix)
    products = graph.node("Mul", [coefficients, from_datum], f"{prefix}contributions")
    axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    return graph.node("ReduceSum", [products, axis], f"{prefix}correction_column", keepdims=1)


def spread_square(
    graph: Graph,
    spread: CoefficientSpread,
    *,
    datum_deg: float,
    angle_column: str,
    temperature_column: str,
    name: str,
) -> str:
    """u² of one spread, shape [n, 1]; names of nodes and constants begin with `name`.

    Hat functions are differences of ramps that rise from 0 to 1 between two nodes: with the factor's differences
    from node to node, the ramps and a leading 1 interpolate as the hats do.
    """
    factor = _cosines_then_sines(spread.factor_arcsec)
    from_datum = _harmonics_from_datum(graph, spread.orders, datum_deg, angle_column, f"{name}_", f"{name}_")
    first = graph.constant(f"{name}_at_first_node", factor[:, 0])
    parts = graph.node("MatMul", [from_datum, first], f"{name}_of_first_node")
    if spread.nodes_c.size > 1:
        steps = _spread_steps(graph, spread.nodes_c, np.diff(factor, axis=1), from_datum, temperature_column, name)
        parts = graph.node("Add", [parts, steps], f"{name}_parts")
    square = graph.node("Mul", [parts, parts], f"{name}_parts_squared")
    axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    return graph.node("ReduceSum", [square, axis], f"{name}_squared", keepdims=1)


def _spread_steps(
    graph: Graph, nodes_c: Floats, steps_arcsec: Floats, from_datum: str, temperature_column: str, name: str
) -> str:
    """What the factor changes by from the first node on, shape [n, r]."""
    steps_c = np.diff(nodes_c)
    ramp = graph.linear(
        temperature_column, 1.0 / steps_c, -nodes_c[:-1] / steps_c, f"{name}_ramp_free", f"{name}_ramp"
    )
    low, high = graph.constant("ramp_low", np.array(0.0)), graph.constant("ramp_high", np.array(1.0))
    ramp = graph.node("Clip", [ramp, low, high], f"{name}_ramp")
    last_axis = graph.constant("last_axis", np.array([2], dtype=np.int64))
    middle_axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    wide = graph.node("Unsqueeze", [from_datum, last_axis], f"{name}_wide")
    deep = graph.node("Unsqueeze", [ramp, middle_axis], f"{name}_deep")
    products = graph.node("Mul", [wide, deep], f"{name}_products")
    size = steps_arcsec.shape[0] * steps_arcsec.shape[1]
    shape = graph.constant(f"{name}_shape", np.array([-1, size], dtype=np.int64))
    flat = graph.node("Reshape", [products, shape], f"{name}_flat")
    steps = graph.constant(f"{name}_steps", steps_arcsec.reshape(size, -1))
    return graph.node("MatMul", [flat, steps], f"{name}_of_steps")


def _cosines_then_sines(by_coefficient: Floats) -> Floats:
    """Rows cos, sin, cos, sin, ... as all cosines, then all sines: one Sin and one Cos node make the harmonics."""
    return np.concatenate([by_coefficient[0::2], by_coefficient[1::2]])


def _harmonics_from_datum(
    graph: Graph, orders: tuple[int, ...], datum_deg: float, angle_column: str, prefix: str, kind: str = ""
) -> str:
    """h(θ) - h(datum), shape [n, 2 orders], cosines first; `kind` begins the constants' names."""
    radians_per_degree = np.array(orders, dtype=np.float64)[None, :] * (np.pi / 180.0)
    weights = graph.constant(f"{kind}radians_per_degree", radians_per_degree)
    phase = graph.node("MatMul", [angle_column, weights], f"{prefix}phase_rad")
    cosine, sine = graph.node("Cos", [phase], f"{prefix}cosine"), graph.node("Sin", [phase], f"{prefix}sine")
    both = graph.node("Concat", [cosine, sine], f"{prefix}harmonics", axis=1)
    at_datum = _cosines_then_sines(harmonics(np.array([datum_deg]), orders)[0])
    return graph.node(
        "Sub", [both, graph.constant(f"{kind}harmonics_at_datum", at_datum)], f"{prefix}harmonics_from_datum"
    )


def _basis(graph: Graph, basis: TemperatureBasis, temperature_column: str, prefix: str) -> str:
    """φ(T), shape [n, size]."""
    per_c, centre = 1.0 / basis.scale_c, basis.centre_c / basis.scale_c
    parts = _powers(graph, basis, temperature_column, prefix)
    if basis.tanh_slope:
        slope = np.array(basis.tanh_slope)
        offset = np.array(basis.tanh_offset) - slope * centre
        argument = graph.linear(temperature_column, slope * per_c, offset, f"{prefix}tanh_argument", "tanh")
        parts.append(graph.node("Tanh", [argument], f"{prefix}tanh"))
    if basis.bell_centre:
        width = np.array(basis.bell_length) * np.sqrt(2.0)
        offset = -(np.array(basis.bell_centre) + centre) / width
        argument = graph.linear(temperature_column, per_c / width, offset, f"{prefix}bell_argument", "bell")
        square = graph.node("Mul", [argument, argument], f"{prefix}bell_square")
        parts.append(graph.node("Exp", [graph.node("Neg", [square], f"{prefix}bell_exponent")], f"{prefix}bell"))
    return parts[0] if len(parts) == 1 else graph.node("Concat", parts, f"{prefix}basis", axis=1)


def _powers(graph: Graph, basis: TemperatureBasis, temperature_column: str, prefix: str) -> list[str]:
    """One column a power, by repeated products: t² is t · t to the last bit, as in NumPy."""
    if not basis.powers:
        return []
    per_c, centre = np.array([1.0 / basis.scale_c]), np.array([-basis.centre_c / basis.scale_c])
    t = graph.linear(temperature_column, per_c, centre, f"{prefix}t_1", "t")
    one = graph.linear(temperature_column, np.array([0.0]), np.array([1.0]), f"{prefix}t_0", "one")
    columns = {0: one, 1: t}
    for exponent in range(2, max(basis.powers) + 1):
        columns[exponent] = graph.node("Mul", [columns[exponent - 1], t], f"{prefix}t_{exponent}")
    return [columns[exponent] for exponent in basis.powers]
