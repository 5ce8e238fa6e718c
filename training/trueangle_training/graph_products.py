"""Harmonics of the angle and functions of temperature, as nodes of an ONNX graph.

A runtime spends more on a node than on the arithmetic in it: all harmonics come from one Sin, and the functions of
temperature from one node a kind.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle_training.graph import Graph
from trueangle_training.methods.separable import TemperatureBasis, harmonics

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Harmonics:
    """cos nθ of every order, then sin nθ, then 1 where it is wanted."""

    orders: tuple[int, ...]
    one: bool = True

    @property
    def count(self) -> int:
        """How many there are."""
        return 2 * len(self.orders) + self.one

    def lines(self) -> tuple[Floats, Floats]:
        """Phases in rad as factors [count] of the angle in deg and offsets [count]; all are sines."""
        per_degree = np.array(self.orders, dtype=np.float64) * (np.pi / 180.0)
        right = np.full(per_degree.size, np.pi / 2)
        factors = np.concatenate([per_degree, per_degree, np.zeros(int(self.one))])
        return factors, np.concatenate([right, np.zeros(right.size), np.full(int(self.one), np.pi / 2)])

    def weights(self, values: Floats, orders: tuple[int, ...], datum_deg: float) -> Floats:
        """What multiplies h(θ) - h(datum), `values` [2 orders, ...] with cos and sin in turn, as [count, ...].

        The datum's share goes to the 1; orders that are not among these are left out of the rest.
        """
        result = np.zeros((self.count, *values.shape[1:]))
        for index, order in enumerate(orders):
            if order in self.orders:
                row = self.orders.index(order)
                result[row], result[row + len(self.orders)] = values[2 * index], values[2 * index + 1]
        if self.one:
            result[-1] = -np.tensordot(harmonics(np.array([datum_deg]), orders)[0], values, axes=1)
        return result


def temperature_functions(
    graph: Graph, basis: TemperatureBasis, shifts_c: tuple[float, ...], temperature_column: str
) -> str:
    """φ(T + shift) of each function for each shift in turn, [n, size · shifts].

    All begin as lines over T; a mask of constants then takes each from the node that bent it.
    """
    kinds = np.array([*(0,) * len(basis.powers), *(1,) * len(basis.tanh_slope), *(2,) * len(basis.bell_centre)])
    exponents = np.array([*basis.powers, *(1,) * (basis.size - len(basis.powers))], dtype=np.float64)
    slope, offset = _lines_over_t(basis)
    shifts = np.array(shifts_c) - basis.centre_c
    offsets = offset[:, None] + np.multiply.outer(slope / basis.scale_c, shifts)
    factors, kind, exponent = (np.repeat(each, shifts.size) for each in (slope / basis.scale_c, kinds, exponents))
    line = graph.lines(temperature_column, factors, offsets.ravel(), "temperature_lines")
    result = line
    if (exponent > 1.0).any():
        raised = graph.constant("exponents", np.maximum(exponent, 1.0))
        result = graph.node("Pow", [line, raised], "powers")
    if (kind == 1).any():
        bent = graph.node("Tanh", [line], "tanh")
        result = graph.node("Where", [graph.constant("is_tanh", kind == 1), bent, result], "with_tanh")
    if (kind == 2).any():
        square = graph.node("Mul", [line, line], "bell_square")
        bent = graph.node("Exp", [graph.node("Neg", [square], "bell_exponent")], "bell")
        result = graph.node("Where", [graph.constant("is_bell", kind == 2), bent, result], "with_bells")
    return result


def _lines_over_t(basis: TemperatureBasis) -> tuple[Floats, Floats]:
    """Slope and offset over t of what is raised, put into tanh, or squared for a bell; [size] each."""
    width = np.array(basis.bell_length) * np.sqrt(2.0)
    slope = [*(float(power > 0) for power in basis.powers), *basis.tanh_slope, *(1.0 / width)]
    offset = [*(float(power == 0) for power in basis.powers), *basis.tanh_offset]
    offset += list(-np.array(basis.bell_centre) / width)
    return np.array(slope), np.array(offset)
