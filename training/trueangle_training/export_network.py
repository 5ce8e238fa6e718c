"""The correction of the paper's network around its Fourier base, as nodes of an ONNX graph."""

import numpy as np

from trueangle_training.graph import Graph
from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnModel


def network_correction(
    graph: Graph, model: FeGabpnnModel, *, angle_column: str, temperature_column: str, prefix: str
) -> str:
    """E(datum, T) - E(θ, T), shape [n, 1]; the names of its nodes begin with `prefix`."""
    steady = _steady_correction(graph, model, angle_column, prefix)
    thermal = _thermal_correction(graph, model, angle_column, temperature_column, prefix)
    return graph.node("Add", [steady, thermal], f"{prefix}correction_column")


def _steady_correction(graph: Graph, model: FeGabpnnModel, angle_column: str, prefix: str) -> str:
    """Fourier(datum) - Fourier(angle), shape [n, 1]."""
    base = model.base
    radians_per_degree = (np.arange(1, base.order + 1) * (np.pi / 180.0))[None, :].astype(np.float64)
    phase = graph.node(
        "MatMul", [angle_column, graph.constant("radians_per_degree", radians_per_degree)], f"{prefix}phase_rad"
    )
    sine = graph.node("Sin", [phase], f"{prefix}sine")
    cosine = graph.node("Cos", [phase], f"{prefix}cosine")
    harmonics = graph.node("Concat", [sine, cosine], f"{prefix}harmonics", axis=1)
    amplitudes = graph.constant("series_arcsec", -np.array([*base.sine_arcsec, *base.cosine_arcsec])[:, None])
    series = graph.node("MatMul", [harmonics, amplitudes], f"{prefix}series_correction")
    at_datum = base.evaluate(np.array([model.datum_deg])) - base.constant_arcsec
    return graph.node(
        "Add", [series, graph.constant("series_at_datum_arcsec", at_datum)], f"{prefix}steady_correction"
    )


def _thermal_correction(
    graph: Graph, model: FeGabpnnModel, angle_column: str, temperature_column: str, prefix: str
) -> str:
    """span · network(datum, T) - span · network(angle, T), shape [n, 1]; offset and φ cancel."""
    nodes = model.hidden_nodes
    by_temperature, by_angle, bias = np.array(model.parameters[: 3 * nodes]).reshape(3, nodes)
    per_degree_c = by_temperature / model.temperature_scaling.span
    per_degree = by_angle / model.angle_scaling.span
    offset = -bias - per_degree_c * model.temperature_scaling.minimum - per_degree * model.angle_scaling.minimum
    inputs = graph.node("Concat", [angle_column, temperature_column], f"{prefix}network_inputs", axis=1)
    weights = graph.constant("hidden_weights", np.stack([per_degree, per_degree_c]))
    weighted = graph.node("MatMul", [inputs, weights], f"{prefix}hidden_weighted")
    argument = graph.node("Add", [weighted, graph.constant("hidden_offset", offset)], f"{prefix}hidden_argument")
    argument_at_datum = graph.linear(
        temperature_column,
        per_degree_c,
        offset + per_degree * model.datum_deg,
        f"{prefix}hidden_argument_at_datum",
        "hidden_at_datum",
    )
    activation = graph.node("Tanh", [argument], f"{prefix}activation")
    activation_at_datum = graph.node("Tanh", [argument_at_datum], f"{prefix}activation_at_datum")
    difference = graph.node("Sub", [activation_at_datum, activation], f"{prefix}activation_difference")
    output_weights = np.array(model.parameters[3 * nodes : 4 * nodes])[:, None] * model.target_scaling.span
    output = graph.constant("output_weights_arcsec", output_weights)
    return graph.node("MatMul", [difference, output], f"{prefix}thermal_correction")
