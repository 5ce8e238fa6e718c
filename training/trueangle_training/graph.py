"""An ONNX graph in the making, and what every exported model has in common.

Two rules keep ONNX Runtime's optimised float64 graph true to the model. Constant factors, such as n π / 180
before the sines and a target's span behind a network, live inside the MatMul constants: a scalar Mul beside a
MatMul is fused with it, and the fused scalar is kept in float32 (2e-5 arcsec). And only operators with a float64
kernel on the CPU provider occur.
"""

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from trueangle.contract.metadata import ANGLE_INPUT
from trueangle.contract.units import DEG_PER_TURN

Floats = NDArray[np.float64]

OPSET = 17
IR_VERSION = 8
"""The oldest that opset 17 may be stored in, so that older runtimes read the file as well."""
READINGS_AXIS = "n"
LOWEST_ZERO_DEG = -(2.0**-45)
"""Down to here x + 360 rounds to 360 deg, whose unit in the last place below is 2^-44."""


class Graph:
    """Nodes and constants in the order in which they are made; every result is named after what it holds."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[str, onnx.TensorProto] = {}

    def constant(self, name: str, values: Floats | NDArray[np.int64] | NDArray[np.bool_]) -> str:
        """A constant; the same name and values may be asked for again."""
        tensor = numpy_helper.from_array(np.ascontiguousarray(values).reshape(np.shape(values)), name)
        if self._constants.setdefault(name, tensor) != tensor:
            raise ValueError(f"constant {name}: expected the values it has already, found others")
        return name

    def node(self, operator: str, inputs: list[str], output: str, **attributes: int | list[int]) -> str:
        """One operator; its result's name."""
        node = helper.make_node(operator, inputs, [output], name=output)
        node.attribute.extend(helper.make_attribute(name, value) for name, value in attributes.items())
        self._nodes.append(node)
        return output

    def column(self, vector: str) -> str:
        """A vector [n] as [n, 1]."""
        return self.node("Unsqueeze", [vector, self.second_axis()], f"{vector}_column")

    def second_axis(self) -> str:
        """The axis of what belongs to one reading, as the constant that some operators want."""
        return self.constant("second_axis", np.array([1], dtype=np.int64))

    def total(self, columns: str, weights: Floats, output: str) -> str:
        """The sum of columns [n, k] times weights [k], as [n]."""
        # As a vector at once the runtime refuses n = 0.
        by = self.constant(f"{output}_weights", weights[:, None])
        summed = self.node("MatMul", [columns, by], f"{output}_column")
        return self.node("Squeeze", [summed, self.second_axis()], output)

    def lines(self, column: str, factors: Floats, offsets: Floats, output: str) -> str:
        """column [n, 1] times factors [k] plus offsets [k], as [n, k]."""
        by = self.constant(f"{output}_factors", np.asarray(factors, dtype=np.float64)[None, :])
        return self.node("Gemm", [column, by, self.constant(f"{output}_offsets", offsets)], output)

    def model(self, name: str, inputs: list[str], outputs: list[str]) -> onnx.ModelProto:
        """The checked model; inputs and outputs are float64 vectors of one length."""
        proto = helper.make_model(
            helper.make_graph(
                self._nodes,
                name,
                [_vector(put) for put in inputs],
                [_vector(put) for put in outputs],
                initializer=list(self._constants.values()),
            ),
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="trueangle",
        )
        onnx.checker.check_model(proto, full_check=True)
        return proto


def _vector(name: str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.DOUBLE, [READINGS_AXIS])


def reduced_angle(graph: Graph) -> str:
    """The angle in [0, 360): the C remainder has the dividend's sign, and -1e-20 + 360 rounds to 360 itself."""
    turn = graph.constant("turn_deg", np.array(DEG_PER_TURN))
    zero = graph.constant("zero_deg", np.array(0.0))
    remainder = graph.node("Mod", [ANGLE_INPUT, turn], "remainder_deg", fmod=1)
    negative = graph.node("Less", [remainder, zero], "remainder_is_negative")
    raised = graph.node("Add", [remainder, turn], "remainder_raised_deg")
    positive = graph.node("Where", [negative, raised, remainder], "positive_deg")
    return graph.node("Mod", [positive, turn], "reduced_deg", fmod=1)


def angle_and_datum(graph: Graph, datum_deg: float, *, periodic: bool) -> tuple[str, str]:
    """The angle within a turn, and whether it is the datum's; `periodic`: -90 does for 270 deg."""
    if periodic and datum_deg == 0.0:
        # Half the nodes: what the reduction to [0, 360) would make 0 lies in one short range of the remainder.
        remainder = graph.node(
            "Mod", [ANGLE_INPUT, graph.constant("turn_deg", np.array(DEG_PER_TURN))], "remainder_deg", fmod=1
        )
        ends = [
            graph.constant("lowest_zero_deg", np.array(LOWEST_ZERO_DEG)),
            graph.constant("zero_deg", np.array(0.0)),
        ]
        limited = graph.node("Clip", [remainder, *ends], "limited_deg")
        return remainder, graph.node("Equal", [remainder, limited], "at_datum")
    angle = reduced_angle(graph)
    return angle, graph.node("Equal", [angle, graph.constant("datum_deg", np.array(datum_deg))], "at_datum")
