"""The correction of the two-dimensional polynomial, as nodes of an ONNX graph."""

import numpy as np

from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.graph import Graph
from trueangle_training.methods.poly2d import Poly2dModel


def poly2d_correction(
    graph: Graph, model: Poly2dModel, *, angle_column: str, temperature_column: str, prefix: str
) -> str:
    """E(datum, T) - E(θ, T), shape [n, 1]; the names of its nodes begin with `prefix`."""
    highest = model.coefficients_arcsec.shape[0] - 1
    per_degree = np.array([2.0 / DEG_PER_TURN])
    x = graph.linear(angle_column, per_degree, np.array([-1.0]), f"{prefix}x_1", "x")
    by_angle = _powers(graph, x, highest, f"{prefix}x")
    per_c, centre = np.array([1.0 / model.scale_c]), np.array([-model.centre_c / model.scale_c])
    t = graph.linear(temperature_column, per_c, centre, f"{prefix}t_1", "t")
    by_temperature = _powers(graph, t, highest, f"{prefix}t")
    x_datum = model.datum_deg * 2.0 / DEG_PER_TURN - 1.0
    at_datum = graph.constant("x_powers_at_datum", x_datum ** np.arange(highest + 1, dtype=np.float64))
    from_datum = graph.node("Sub", [by_angle, at_datum], f"{prefix}x_powers_from_datum")
    coefficients = graph.constant("coefficients_arcsec", -model.coefficients_arcsec)
    over_angle = graph.node("MatMul", [from_datum, coefficients], f"{prefix}over_angle")
    products = graph.node("Mul", [over_angle, by_temperature], f"{prefix}contributions")
    axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    return graph.node("ReduceSum", [products, axis], f"{prefix}correction_column", keepdims=1)


def _powers(graph: Graph, column: str, highest: int, name: str) -> str:
    """1, x, x², ... as columns, [n, highest + 1]."""
    columns = [graph.linear(column, np.array([0.0]), np.array([1.0]), f"{name}_0", "one"), column]
    for exponent in range(2, highest + 1):
        columns.append(graph.node("Mul", [columns[-1], column], f"{name}_{exponent}"))
    return graph.node("Concat", columns, f"{name}_powers", axis=1)
