"""A trained model as an ONNX graph that serves the correction.

The contract: inputs `angle_deg` and `temperature_c`, output `correction_arcsec`, all float64 of shape [n], n = 0
included. The graph reduces the angle modulo 360 itself and clamps nothing. The correction is minus the estimated
error, counted from the datum, and exactly 0 there.

Two rules keep ONNX Runtime's optimised float64 graph true to the model. Constant factors, such as n π / 180
before the sines and the target's span behind the network, live inside the MatMul constants: a scalar Mul beside a
MatMul is fused with it, and the fused scalar is kept in float32 (2e-5 arcsec). And only operators with a float64
kernel on the CPU provider occur.
"""

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from trueangle.contract.metadata import ANGLE_INPUT, CORRECTION_OUTPUT, TEMPERATURE_INPUT
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.methods import ErrorModel
from trueangle_training.methods.fe_gabpnn import FeGabpnnModel

Floats = NDArray[np.float64]

OPSET = 17
IR_VERSION = 8
"""The oldest that opset 17 may be stored in, so that older runtimes read the file as well."""
READINGS_AXIS = "n"


class _Graph:
    """Nodes and constants in the order in which they are made; every result is named after what it holds."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, values: Floats | NDArray[np.int64]) -> str:
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def node(self, operator: str, inputs: list[str], output: str, **attributes: int) -> str:
        node = helper.make_node(operator, inputs, [output], name=output)
        node.attribute.extend(helper.make_attribute(name, value) for name, value in attributes.items())
        self.nodes.append(node)
        return output


def build_graph(model: FeGabpnnModel) -> onnx.ModelProto:
    """The model's correction as an ONNX graph; the same model gives the same bytes."""
    graph = _Graph()
    column_axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    angle = _reduced_angle(graph)
    angle_column = graph.node("Unsqueeze", [angle, column_axis], "reduced_deg_column")
    temperature_column = graph.node("Unsqueeze", [TEMPERATURE_INPUT, column_axis], "temperature_c_column")
    steady = _steady_correction(graph, model, angle_column)
    thermal = _thermal_correction(graph, model, angle_column, temperature_column)
    column = graph.node("Add", [steady, thermal], "correction_column")
    from_datum = graph.node("Squeeze", [column, column_axis], "correction_from_datum")
    datum = graph.constant("datum_deg", np.array(model.datum_deg))
    at_datum = graph.node("Equal", [angle, datum], "at_datum")
    zero = graph.constant("no_correction", np.array(0.0))
    graph.node("Where", [at_datum, zero, from_datum], CORRECTION_OUTPUT)
    proto = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "correction",
            [_vector(ANGLE_INPUT), _vector(TEMPERATURE_INPUT)],
            [_vector(CORRECTION_OUTPUT)],
            initializer=graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="trueangle",
    )
    onnx.checker.check_model(proto, full_check=True)
    return proto


def _vector(name: str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.DOUBLE, [READINGS_AXIS])


def _reduced_angle(graph: _Graph) -> str:
    """The angle in [0, 360): the C remainder has the dividend's sign, and -1e-20 + 360 rounds to 360 itself."""
    turn = graph.constant("turn_deg", np.array(DEG_PER_TURN))
    zero = graph.constant("zero_deg", np.array(0.0))
    remainder = graph.node("Mod", [ANGLE_INPUT, turn], "remainder_deg", fmod=1)
    negative = graph.node("Less", [remainder, zero], "remainder_is_negative")
    raised = graph.node("Add", [remainder, turn], "remainder_raised_deg")
    positive = graph.node("Where", [negative, raised, remainder], "positive_deg")
    full_turn = graph.node("GreaterOrEqual", [positive, turn], "is_full_turn")
    return graph.node("Where", [full_turn, zero, positive], "reduced_deg")


def _steady_correction(graph: _Graph, model: FeGabpnnModel, angle_column: str) -> str:
    """Fourier(datum) - Fourier(angle), shape [n, 1]."""
    base = model.base
    radians_per_degree = (np.arange(1, base.order + 1) * (np.pi / 180.0))[None, :].astype(np.float64)
    phase = graph.node(
        "MatMul", [angle_column, graph.constant("radians_per_degree", radians_per_degree)], "phase_rad"
    )
    harmonics = graph.node(
        "Concat", [graph.node("Sin", [phase], "sine"), graph.node("Cos", [phase], "cosine")], "harmonics", axis=1
    )
    amplitudes = -np.array([*base.sine_arcsec, *base.cosine_arcsec])[:, None]
    series = graph.node("MatMul", [harmonics, graph.constant("series_arcsec", amplitudes)], "series_correction")
    at_datum = base.evaluate(np.array([model.datum_deg])) - base.constant_arcsec
    return graph.node("Add", [series, graph.constant("series_at_datum_arcsec", at_datum)], "steady_correction")


def _thermal_correction(graph: _Graph, model: FeGabpnnModel, angle_column: str, temperature_column: str) -> str:
    """span · network(datum, T) - span · network(angle, T), shape [n, 1]; offset and φ cancel."""
    nodes = model.hidden_nodes
    by_temperature, by_angle, bias = np.array(model.parameters[: 3 * nodes]).reshape(3, nodes)
    per_degree_c = by_temperature / model.temperature_scaling.span
    per_degree = by_angle / model.angle_scaling.span
    offset = -bias - per_degree_c * model.temperature_scaling.minimum - per_degree * model.angle_scaling.minimum
    inputs = graph.node("Concat", [angle_column, temperature_column], "network_inputs", axis=1)
    weights = graph.constant("hidden_weights", np.stack([per_degree, per_degree_c]))
    weighted = graph.node("MatMul", [inputs, weights], "hidden_weighted")
    argument = graph.node("Add", [weighted, graph.constant("hidden_offset", offset)], "hidden_argument")
    weights_at_datum = graph.constant("hidden_temperature_weights", per_degree_c[None, :])
    weighted_at_datum = graph.node("MatMul", [temperature_column, weights_at_datum], "hidden_weighted_at_datum")
    offset_at_datum = graph.constant("hidden_offset_at_datum", offset + per_degree * model.datum_deg)
    argument_at_datum = graph.node("Add", [weighted_at_datum, offset_at_datum], "hidden_argument_at_datum")
    activation = graph.node("Tanh", [argument], "activation")
    activation_at_datum = graph.node("Tanh", [argument_at_datum], "activation_at_datum")
    difference = graph.node("Sub", [activation_at_datum, activation], "activation_difference")
    output_weights = np.array(model.parameters[3 * nodes : 4 * nodes])[:, None] * model.target_scaling.span
    output = graph.constant("output_weights_arcsec", output_weights)
    return graph.node("MatMul", [difference, output], "thermal_correction")


def attach_metadata(proto: onnx.ModelProto, key: str, text: str) -> None:
    """Set one entry of the file's metadata, in place; an entry of the same key is replaced."""
    for entry in proto.metadata_props:
        if entry.key == key:
            entry.value = text
            return
    proto.metadata_props.add(key=key, value=text)


def check_agreement(proto_bytes: bytes, model: ErrorModel, angle_deg: Floats, temperature_c: Floats) -> float:
    """Largest difference in arcsec between ONNX Runtime, with its default optimisations, and the model itself.

    Infinity where exactly one of the two is not a number, so that no comparison passes it.
    """
    onnxruntime.disable_telemetry_events()
    session = onnxruntime.InferenceSession(proto_bytes, providers=["CPUExecutionProvider"])
    feeds = {ANGLE_INPUT: angle_deg, TEMPERATURE_INPUT: temperature_c}
    served = np.asarray(session.run([CORRECTION_OUTPUT], feeds)[0])
    expected = -model.error_arcsec(angle_deg, temperature_c)
    if served.shape != expected.shape or served.dtype != np.float64:
        return float("inf")
    difference = np.abs(served - expected)
    difference[np.isnan(served) & np.isnan(expected)] = 0.0
    return float(np.max(np.nan_to_num(difference, nan=np.inf), initial=0.0))
