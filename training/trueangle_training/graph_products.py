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

FAR_OUT = 40.0
"""1 - tanh(40) = 2 exp(-80) is far below half a unit in the last place of 1."""


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
    """φ(T + shift) of each function for each shift in turn, [n, size · shifts]."""
    tanh = (np.array(basis.tanh_slope), np.array(basis.tanh_offset))
    width = np.array(basis.bell_length) * np.sqrt(2.0)
    bells = (1.0 / width, -np.array(basis.bell_centre) / width)
    powers = basis.powers
    # Where 1 is the only power it costs no node of its own: it is a tanh far out, or else the top of a bell.
    if powers == (0,) and tanh[0].size:
        powers, tanh = (), _with_constant(tanh, FAR_OUT)
    elif powers == (0,) and bells[0].size:
        powers, bells = (), _with_constant(bells, 0.0)
    shifts = np.array(shifts_c) - basis.centre_c

    def lines(over_t: tuple[Floats, Floats], name: str) -> str:
        slope, offset = over_t[0] / basis.scale_c, over_t[1][:, None]
        offsets = (offset + np.multiply.outer(slope, shifts)).ravel()
        return graph.lines(temperature_column, np.repeat(slope, shifts.size), offsets, name)

    parts: list[str] = []
    if powers:
        exponents = np.repeat(np.array(powers, dtype=np.float64), shifts.size)
        is_one = np.array(powers) == 0
        # 1 is a line and no power, which would be 1 even where the temperature is not a number.
        line = lines((np.where(is_one, 0.0, 1.0), np.where(is_one, 1.0, 0.0)), "temperature_lines")
        raised = graph.constant("temperature_exponents", np.maximum(exponents, 1.0))
        parts.append(line if max(powers) < 2 else graph.node("Pow", [line, raised], "temperature_powers"))
    if tanh[0].size:
        parts.append(graph.node("Tanh", [lines(tanh, "tanh_argument")], "tanh"))
    if bells[0].size:
        line = lines(bells, "bell_argument")
        square = graph.node("Mul", [line, line], "bell_square")
        parts.append(graph.node("Exp", [graph.node("Neg", [square], "bell_exponent")], "bell"))
    return parts[0] if len(parts) == 1 else graph.node("Concat", parts, "functions", axis=1)


def _with_constant(lines: tuple[Floats, Floats], value: float) -> tuple[Floats, Floats]:
    """A line that is `value` everywhere, then the lines."""
    return np.concatenate([[0.0], lines[0]]), np.concatenate([[value], lines[1]])
