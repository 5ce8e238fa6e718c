"""The correction of the two-dimensional polynomial, as nodes of an ONNX graph."""

import numpy as np

from trueangle.contract.metadata import TEMPERATURE_INPUT
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.graph import Graph
from trueangle_training.methods.poly2d import Poly2dModel


def poly2d_correction(graph: Graph, model: Poly2dModel, angle_column: str) -> str:
    """E(datum, T) - E(θ, T) away from the datum, [n]."""
    by_angle = _powers(graph, model, angle_column, 2.0 / DEG_PER_TURN, -1.0, "x")
    temperature_column = graph.column(TEMPERATURE_INPUT)
    by_temperature = _powers(
        graph, model, temperature_column, 1.0 / model.scale_c, -model.centre_c / model.scale_c, "t"
    )
    x_datum = model.datum_deg * 2.0 / DEG_PER_TURN - 1.0
    # The constant in x takes the datum's share, its own cancels.
    coefficients = -model.coefficients_arcsec
    coefficients[0] = -(x_datum ** np.arange(1.0, coefficients.shape[0])) @ coefficients[1:]
    over_angle = graph.node(
        "MatMul", [by_angle, graph.constant("coefficients_arcsec", coefficients)], "over_angle"
    )
    products = graph.node("Mul", [over_angle, by_temperature], "contributions")
    return graph.node("ReduceSum", [products, graph.second_axis()], "correction_from_datum", keepdims=0)


def _powers(graph: Graph, model: Poly2dModel, column: str, factor: float, offset: float, name: str) -> str:
    """1, x, x², ... of x = factor · column + offset, [n, degree + 1]."""
    exponents = np.arange(float(model.coefficients_arcsec.shape[0]))
    # 1 as itself and not as a power of x, which would be 1 where x is not a number.
    factors, offsets = np.where(exponents > 0.0, factor, 0.0), np.where(exponents > 0.0, offset, 1.0)
    line = graph.lines(column, factors, offsets, f"{name}_lines")
    raised = graph.constant("exponents", np.maximum(exponents, 1.0))
    return graph.node("Pow", [line, raised], f"{name}_powers")
