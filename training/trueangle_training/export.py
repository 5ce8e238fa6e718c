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
from trueangle_training.export_separable import separable_outputs
from trueangle_training.graph import Graph, angle_and_datum
from trueangle_training.methods import FittedModel
from trueangle_training.methods.poly2d import Poly2dModel
from trueangle_training.methods.separable import SeparableModel
from trueangle_training.uncertainty import UncertaintyBudget, total_uncertainty_arcsec

Floats = NDArray[np.float64]

NO_ADDITIONS = UncertaintyBudget()
MOST_AT_ONCE = 500
"""Readings a run: each takes its interval's factor of the uncertainty along, 150 kB on the largest plans."""


def build_graph(model: FittedModel, budget: UncertaintyBudget = NO_ADDITIONS) -> onnx.ModelProto:
    """The model's correction as an ONNX graph; the same model and budget give the same bytes."""
    graph = Graph()
    angle, at_datum = angle_and_datum(graph, model.datum_deg, periodic=isinstance(model, SeparableModel))
    correction, uncertainty = _outputs(graph, model, budget, graph.column(angle))
    zero = graph.constant("zero", np.array(0.0))
    graph.node("Where", [at_datum, zero, correction], CORRECTION_OUTPUT)
    outputs = [CORRECTION_OUTPUT]
    if uncertainty is not None:
        graph.node("Where", [at_datum, zero, uncertainty], UNCERTAINTY_OUTPUT)
        outputs.append(UNCERTAINTY_OUTPUT)
    return graph.model("correction", [ANGLE_INPUT, TEMPERATURE_INPUT], outputs)


def _outputs(
    graph: Graph, model: FittedModel, budget: UncertaintyBudget, angle_column: str
) -> tuple[str, str | None]:
    """Minus the error and, where the method has it, the uncertainty, [n] each; not yet 0 at the datum."""
    if isinstance(model, SeparableModel):
        return separable_outputs(graph, model, budget, angle_column)
    if isinstance(model, Poly2dModel):
        return poly2d_correction(graph, model, angle_column), None
    # Here, because it draws in torch, which separable models do without.
    from trueangle_training.export_network import network_correction
    from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnModel

    if isinstance(model, FeGabpnnModel):
        return network_correction(graph, model, angle_column), None
    raise TypeError(
        f"export: expected a separable model, a polynomial or the paper's network, found {type(model).__name__}"
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
    served = dict(zip(names, _run(session, names, angle_deg, temperature_c), strict=True))
    expected = {CORRECTION_OUTPUT: -model.error_arcsec(angle_deg, temperature_c)}
    uncertainty = total_uncertainty_arcsec(model, budget, angle_deg, temperature_c)
    if uncertainty is not None:
        expected[UNCERTAINTY_OUTPUT] = uncertainty
    if served.keys() != expected.keys():
        return float("inf")
    return max(_largest_difference(np.asarray(served[name]), expected[name]) for name in expected)


def _run(
    session: onnxruntime.InferenceSession, names: list[str], angle_deg: Floats, temperature_c: Floats
) -> list[Floats]:
    parts: list[list[Floats]] = []
    for first in range(0, max(angle_deg.size, 1), MOST_AT_ONCE):
        some = slice(first, first + MOST_AT_ONCE)
        feeds = {ANGLE_INPUT: angle_deg[some], TEMPERATURE_INPUT: temperature_c[some]}
        parts.append([np.asarray(answer) for answer in session.run(names, feeds)])
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _largest_difference(served: Floats, expected: Floats) -> float:
    if served.shape != expected.shape or served.dtype != np.float64:
        return float("inf")
    difference = np.abs(served - expected)
    difference[np.isnan(served) & np.isnan(expected)] = 0.0
    return float(np.max(np.nan_to_num(difference, nan=np.inf), initial=0.0))
