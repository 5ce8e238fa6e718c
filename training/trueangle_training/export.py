"""A trained model as an ONNX graph that serves the correction and, where the method has it, its uncertainty.

The contract: inputs `angle_deg` and `temperature_c`, outputs `correction_arcsec` and `uncertainty_arcsec`, all
float64 of shape [n], n = 0 included. The graph reduces the angle modulo 360 itself and clamps nothing. The
correction is minus the estimated error, counted from the datum, and exactly 0 there; so is its uncertainty.
"""

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray

from trueangle.contract.metadata import ANGLE_INPUT, CORRECTION_OUTPUT, TEMPERATURE_INPUT, UNCERTAINTY_OUTPUT
from trueangle_training.export_poly2d import poly2d_correction
from trueangle_training.export_separable import separable_correction, spread_square
from trueangle_training.graph import Graph, reduced_angle
from trueangle_training.methods import FittedModel
from trueangle_training.methods.poly2d import Poly2dModel
from trueangle_training.methods.separable import SeparableModel
from trueangle_training.uncertainty import SLOPE_STEP_C, UncertaintyBudget, total_uncertainty_arcsec

Floats = NDArray[np.float64]

NO_ADDITIONS = UncertaintyBudget()


def build_graph(model: FittedModel, budget: UncertaintyBudget = NO_ADDITIONS) -> onnx.ModelProto:
    """The model's correction as an ONNX graph; the same model and budget give the same bytes."""
    graph = Graph()
    column_axis = graph.constant("column_axis", np.array([1], dtype=np.int64))
    angle = reduced_angle(graph)
    angle_column = graph.node("Unsqueeze", [angle, column_axis], "reduced_deg_column")
    temperature_column = graph.node("Unsqueeze", [TEMPERATURE_INPUT, column_axis], "temperature_c_column")
    column = _correction(graph, model, angle_column, temperature_column, "")
    from_datum = graph.node("Squeeze", [column, column_axis], "correction_from_datum")
    at_datum = graph.node("Equal", [angle, graph.constant("datum_deg", np.array(model.datum_deg))], "at_datum")
    zero = graph.constant("no_correction", np.array(0.0))
    graph.node("Where", [at_datum, zero, from_datum], CORRECTION_OUTPUT)
    outputs = [CORRECTION_OUTPUT]
    if isinstance(model, SeparableModel) and model.spreads:
        square = _total_square(graph, model, budget, angle_column, temperature_column)
        away = graph.node("Squeeze", [graph.node("Sqrt", [square], "total_column"), column_axis], "total")
        known = graph.node("Where", [at_datum, zero, away], "uncertainty_where_known")
        # A limited ramp takes NaN for a number; an unknown correction must not look certain.
        unknown = graph.node("IsNaN", [CORRECTION_OUTPUT], "correction_is_unknown")
        graph.node("Where", [unknown, CORRECTION_OUTPUT, known], UNCERTAINTY_OUTPUT)
        outputs.append(UNCERTAINTY_OUTPUT)
    return graph.model("correction", [ANGLE_INPUT, TEMPERATURE_INPUT], outputs)


def _correction(graph: Graph, model: FittedModel, angle_column: str, temperature_column: str, prefix: str) -> str:
    """Minus the error as nodes, shape [n, 1]."""
    if isinstance(model, SeparableModel):
        return separable_correction(
            graph, model, angle_column=angle_column, temperature_column=temperature_column, prefix=prefix
        )
    if isinstance(model, Poly2dModel):
        return poly2d_correction(
            graph, model, angle_column=angle_column, temperature_column=temperature_column, prefix=prefix
        )
    # Here, because it draws in torch, which separable models do without.
    from trueangle_training.export_network import network_correction
    from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnModel

    if isinstance(model, FeGabpnnModel):
        return network_correction(
            graph, model, angle_column=angle_column, temperature_column=temperature_column, prefix=prefix
        )
    raise TypeError(
        f"export: expected a separable model, a polynomial or the paper's network, found {type(model).__name__}"
    )


def _total_square(
    graph: Graph, model: SeparableModel, budget: UncertaintyBudget, angle_column: str, temperature_column: str
) -> str:
    """u² of the corrected angle, shape [n, 1], as in `uncertainty`."""
    total = graph.constant("reference_squared", np.array([[budget.reference_arcsec**2]]))
    for number, spread in enumerate(model.spreads, start=1):
        square = spread_square(
            graph,
            spread,
            datum_deg=model.datum_deg,
            angle_column=angle_column,
            temperature_column=temperature_column,
            name=f"spread_{number}",
        )
        total = graph.node("Add", [total, square], f"with_spread_{number}")
    if budget.temperature_c == 0.0:
        return total
    step = graph.constant("slope_step_c", np.array([SLOPE_STEP_C]))
    above_c = graph.node("Add", [temperature_column, step], "temperature_above")
    below_c = graph.node("Sub", [temperature_column, step], "temperature_below")
    above = _correction(graph, model, angle_column, above_c, "above_")
    below = _correction(graph, model, angle_column, below_c, "below_")
    difference = graph.node("Sub", [above, below], "difference_over_temperature")
    factor = graph.constant("sensor_factor", np.array([[budget.temperature_c / (2.0 * SLOPE_STEP_C)]]))
    by_sensor = graph.node("MatMul", [difference, factor], "by_sensor")
    return graph.node(
        "Add", [total, graph.node("Mul", [by_sensor, by_sensor], "by_sensor_squared")], "with_sensor"
    )


def attach_metadata(proto: onnx.ModelProto, key: str, text: str) -> None:
    """Set one entry of the file's metadata, in place; an entry of the same key is replaced."""
    for entry in proto.metadata_props:
        if entry.key == key:
            entry.value = text
            return
    proto.metadata_props.add(key=key, value=text)


def check_agreement(
    proto_bytes: bytes,
    model: FittedModel,
    angle_deg: Floats,
    temperature_c: Floats,
    budget: UncertaintyBudget = NO_ADDITIONS,
) -> float:
    """Largest difference in arcsec between ONNX Runtime, with its default optimisations, and the model itself.

    Over the correction and, where there is one, its uncertainty. Infinity where exactly one of the two is not a
    number, so that no comparison passes it, and where one has an uncertainty and the other has none.
    """
    onnxruntime.disable_telemetry_events()
    session = onnxruntime.InferenceSession(proto_bytes, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    feeds = {ANGLE_INPUT: angle_deg, TEMPERATURE_INPUT: temperature_c}
    served = dict(zip(names, session.run(names, feeds), strict=True))
    expected = {CORRECTION_OUTPUT: -model.error_arcsec(angle_deg, temperature_c)}
    uncertainty = total_uncertainty_arcsec(model, budget, angle_deg, temperature_c)
    if uncertainty is not None:
        expected[UNCERTAINTY_OUTPUT] = uncertainty
    if served.keys() != expected.keys():
        return float("inf")
    return max(_largest_difference(np.asarray(served[name]), expected[name]) for name in expected)


def _largest_difference(served: Floats, expected: Floats) -> float:
    if served.shape != expected.shape or served.dtype != np.float64:
        return float("inf")
    difference = np.abs(served - expected)
    difference[np.isnan(served) & np.isnan(expected)] = 0.0
    return float(np.max(np.nan_to_num(difference, nan=np.inf), initial=0.0))
