"""Correction and uncertainty of a separable model, as nodes of an ONNX graph."""

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto

from trueangle.contract.metadata import TEMPERATURE_INPUT
from trueangle_training.graph import Graph
from trueangle_training.graph_products import Harmonics, temperature_functions
from trueangle_training.methods.separable import CoefficientSpread, SeparableModel
from trueangle_training.uncertainty import SLOPE_STEP_C, UncertaintyBudget

Floats = NDArray[np.float64]


def separable_outputs(
    graph: Graph, model: SeparableModel, budget: UncertaintyBudget, angle_column: str
) -> tuple[str, str | None]:
    """E(datum, T) - E(θ, T) and u(θ, T), [n] each, the latter None where the model knows none.

    Both are those away from the datum; there they are 0 but for rounding and the reference.
    """
    if model.spreads:
        return _WithSpreads(model, budget).outputs(graph, angle_column)
    temperature_column = graph.column(TEMPERATURE_INPUT)
    functions = temperature_functions(graph, model.basis, (0.0,), temperature_column)
    of = Harmonics(orders=model.orders)
    harmonics = graph.node("Sin", [graph.lines(angle_column, *of.lines(), "phase_rad")], "harmonics")
    weights = of.weights(-model.weights_arcsec.T, model.orders, model.datum_deg)
    weighted = graph.node("MatMul", [harmonics, graph.constant("weights_arcsec", weights)], "harmonics_weighted")
    products = graph.node("Mul", [weighted, functions], "contributions")
    return graph.node("ReduceSum", [products, graph.second_axis()], "correction_from_datum", keepdims=0), None


class _WithSpreads:
    """A model with spreads, and the harmonics that they need.

    Spreads that change with temperature are lines over it between two nodes and constant beyond the last: with the
    factor α + β T of an interval they need the harmonics times T and times 1. All else needs them times 1.
    """

    def __init__(self, model: SeparableModel, budget: UncertaintyBudget) -> None:
        self._model, self._budget = model, budget
        self._moving = [spread for spread in model.spreads if spread.nodes_c.size > 1]
        self._steady = [spread for spread in model.spreads if spread.nodes_c.size == 1]
        near = {*model.orders, *(order for spread in self._moving for order in spread.orders)}
        far = {order for spread in self._steady for order in spread.orders} - near
        self._near = Harmonics(orders=tuple(sorted(near)))
        self._far = Harmonics(orders=tuple(sorted(far)), one=False)
        self._tilted = slice(0, self._near.count if self._moving else 0)
        self._level = slice(self._tilted.stop, self._tilted.stop + self._near.count)
        self._beyond = slice(self._level.stop, self._level.stop + self._far.count)

    def outputs(self, graph: Graph, angle_column: str) -> tuple[str, str]:
        """Correction and uncertainty, [n] each."""
        temperature_column = graph.column(TEMPERATURE_INPUT)
        harmonics = self._harmonics(graph, angle_column, temperature_column)
        # The basis on either side of the temperature makes the slope over it.
        shifts_c = (0.0, SLOPE_STEP_C, -SLOPE_STEP_C) if self._budget.temperature_c > 0.0 else (0.0,)
        near = self._near_ones(graph, harmonics)
        corrections = self._corrections(graph, near, shifts_c, temperature_column)
        here = graph.constant("unshifted", np.eye(len(shifts_c))[:, :1])
        alone = graph.node("MatMul", [corrections, here], "correction_alone")
        axes = graph.constant("inner_axes", np.array([1, 2], dtype=np.int64))
        correction = graph.node("Squeeze", [alone, axes], "correction_from_datum")
        every = graph.node("Concat", [corrections, harmonics], "corrections_and_harmonics", axis=2)
        weights = graph.constant("steady_parts_arcsec", self._steady_parts(len(shifts_c)))
        parts = graph.node("MatMul", [every, weights], "steady_parts")
        if self._moving:
            moving = self._moving_parts(graph, near, temperature_column)
            parts = graph.node("Concat", [parts, moving], "parts", axis=2)
        return correction, graph.node("ReduceL2", [parts], "total", axes=[1, 2], keepdims=0)

    def _harmonics(self, graph: Graph, angle_column: str, temperature_column: str) -> str:
        """Times T or times 1 each, [n, 1, harmonics]."""
        blocks = (*([self._near.lines()] if self._moving else []), self._near.lines(), self._far.lines())
        factors, offsets = (np.concatenate([block[part] for block in blocks]) for part in (0, 1))
        sines = graph.node("Sin", [graph.lines(angle_column, factors, offsets, "phase_rad")], "harmonics")
        tilted = np.zeros(factors.size)
        tilted[self._tilted] = 1.0
        by = graph.lines(temperature_column, tilted, np.ones(tilted.size) - tilted, "temperature_or_1")
        products = graph.node("Mul", [sines, by], "harmonics_by_temperature")
        return graph.node("Unsqueeze", [products, graph.second_axis()], "harmonics_deep")

    def _near_ones(self, graph: Graph, harmonics: str) -> str:
        """Without those that only the steady spreads have."""
        if not self._far.count:
            return harmonics
        bounds = {"near_from": 0, "near_to": self._level.stop, "last_axis": 2}
        slicing = [graph.constant(name, np.array([bound], dtype=np.int64)) for name, bound in bounds.items()]
        return graph.node("Slice", [harmonics, *slicing], "near_harmonics")

    def _corrections(self, graph: Graph, near: str, shifts_c: tuple[float, ...], temperature_column: str) -> str:
        """The correction at T and at the other shifts from it, [n, 1, shifts]."""
        model = self._model
        weights = np.zeros((self._level.stop, model.basis.size))
        weights[self._level] = self._near.weights(-model.weights_arcsec.T, model.orders, model.datum_deg)
        by_function = graph.node("MatMul", [near, graph.constant("weights_arcsec", weights)], "harmonics_weighted")
        functions = temperature_functions(graph, model.basis, shifts_c, temperature_column)
        shape = graph.constant("functions_shape", np.array([-1, model.basis.size, len(shifts_c)], dtype=np.int64))
        deep = graph.node("Reshape", [functions, shape], "temperature_functions")
        return graph.node("MatMul", [by_function, deep], "corrections")

    def _moving_parts(self, graph: Graph, near: str, temperature_column: str) -> str:
        """What spreads that change with temperature add to the parts, [n, 1, parts]."""
        nodes_c = graph.constant("nodes_c", self._nodes_c())
        passed = graph.node("GreaterOrEqual", [temperature_column, nodes_c], "nodes_passed")
        counts = graph.node("Cast", [passed], "nodes_passed_count", to=TensorProto.INT64)
        # No temperature leads out of the table: one that is not a number has passed no node.
        interval = graph.node("ReduceSum", [counts, graph.second_axis()], "interval", keepdims=0)
        table = graph.constant("interval_factors_arcsec", self._interval_factors())
        factor = graph.node("Gather", [table, interval], "interval_factor", axis=0)
        return graph.node("MatMul", [near, factor], "moving_parts")

    def _steady_parts(self, shifts: int) -> Floats:
        """Sensor, reference and steady spreads as weights of corrections and harmonics, [both, parts]."""
        weights = np.zeros((self._beyond.stop, 2))
        weights[self._level.stop - 1, 1] = self._budget.reference_arcsec
        by_sensor = np.zeros((shifts, 2))
        by_sensor[1:, 0] = np.array([1.0, -1.0])[: shifts - 1] * (
            self._budget.temperature_c / (2.0 * SLOPE_STEP_C)
        )
        columns = [np.concatenate([by_sensor, weights])]
        for spread in self._steady:
            factor, orders = spread.factor_arcsec[:, 0], spread.orders
            weights = np.zeros((shifts + self._beyond.stop, factor.shape[1]))
            own = weights[shifts:]
            own[self._level] = self._near.weights(factor, orders, self._model.datum_deg)
            own[self._beyond] = self._far.weights(factor, orders, self._model.datum_deg)
            columns.append(weights)
        return np.concatenate(columns, axis=1)

    def _nodes_c(self) -> Floats:
        return np.unique(np.concatenate([spread.nodes_c for spread in self._moving]))

    def _interval_factors(self) -> Floats:
        """[β; α] of each interval, from below the first node to above the last; [nodes + 1, 2 harmonics, parts].

        Only its product with its own transpose counts, for which as many columns as rows will do.
        """
        nodes_c = self._nodes_c()
        at_nodes = np.concatenate([self._at(spread, nodes_c) for spread in self._moving], axis=2)
        rise = np.zeros((nodes_c.size + 1, *at_nodes.shape[1:]))
        rise[1:-1] = np.diff(at_nodes, axis=0) / np.diff(nodes_c)[:, None, None]
        start = np.concatenate([at_nodes[:1], at_nodes])
        start[1:] -= rise[1:] * nodes_c[:, None, None]
        both = np.concatenate([rise, start], axis=1)
        return np.stack([np.asarray(np.linalg.qr(one.T, mode="r")).T for one in both])

    def _at(self, spread: CoefficientSpread, nodes_c: Floats) -> Floats:
        """The spread's factor on the harmonics at all the nodes, [nodes, harmonics, r]."""
        hats = spread.hats(nodes_c)
        factor = np.einsum("mk,ckr->cmr", hats, spread.factor_arcsec)
        return self._near.weights(factor, spread.orders, self._model.datum_deg).swapaxes(0, 1)
