"""The correction of the paper's network around its Fourier base, as nodes of an ONNX graph."""

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.metadata import TEMPERATURE_INPUT
from trueangle_training.graph import Graph
from trueangle_training.graph_products import Harmonics
from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnModel

Floats = NDArray[np.float64]


def network_correction(graph: Graph, model: FeGabpnnModel, angle_column: str) -> str:
    """E(datum, T) - E(θ, T) away from the datum, [n]: one weighted sum of sines and tanhs of lines.

    Fourier(datum) - Fourier(θ) + span · network(datum, T) - span · network(θ, T); offset and φ cancel.
    """
    base, nodes = model.base, model.hidden_nodes
    harmonics = Harmonics(orders=tuple(range(1, base.order + 1)))
    at_datum = base.evaluate(np.array([model.datum_deg])) - base.constant_arcsec
    amplitudes = np.concatenate([-np.array(base.cosine_arcsec), -np.array(base.sine_arcsec), at_datum])
    sine_factors, sine_offsets = harmonics.lines()
    per_c, per_degree, offset = _hidden_lines(model)
    span = np.array(model.parameters[3 * nodes : 4 * nodes]) * model.target_scaling.span
    by_temperature = graph.lines(
        graph.column(TEMPERATURE_INPUT),
        np.concatenate([np.zeros(harmonics.count), per_c, per_c]),
        np.concatenate([sine_offsets, offset, offset + per_degree * model.datum_deg]),
        "over_temperature",
    )
    by_angle = graph.constant("per_degree", np.concatenate([sine_factors, per_degree, np.zeros(nodes)])[None, :])
    line = graph.node("Gemm", [angle_column, by_angle, by_temperature], "lines")
    is_sine = graph.constant("is_sine", np.arange(harmonics.count + 2 * nodes) < harmonics.count)
    sine, tanh = graph.node("Sin", [line], "sine"), graph.node("Tanh", [line], "tanh")
    functions = graph.node("Where", [is_sine, sine, tanh], "functions")
    return graph.total(functions, np.concatenate([amplitudes, -span, span]), "correction_from_datum")


def _hidden_lines(model: FeGabpnnModel) -> tuple[Floats, Floats, Floats]:
    """The hidden nodes' arguments per degC, per deg, and at 0 degC and 0 deg; [nodes] each."""
    by_temperature, by_angle, bias = np.array(model.parameters[: 3 * model.hidden_nodes]).reshape(3, -1)
    per_c = by_temperature / model.temperature_scaling.span
    per_degree = by_angle / model.angle_scaling.span
    offset = -bias - per_c * model.temperature_scaling.minimum - per_degree * model.angle_scaling.minimum
    return per_c, per_degree, offset
