"""The paper's 2-n-1 network, eqs. (2)-(5) of Jia et al. 2020, for a whole population of parameter vectors at once.

    α_h = v_1h T + v_2h θ            (2)
    b_h = tansig(α_h - γ_h)          (4)
    ε   = sum over h of ω_h b_h - φ  (3), (5)

One network's parameters are one flat vector in the paper's encoding order (section 3.3),
[v_11 .. v_1n, v_21 .. v_2n, γ_1 .. γ_n, ω_1 .. ω_n, φ]; a population is a float64 tensor [members, 4 n + 1].
Readings run along the last axis, so that each row of the Jacobian is contiguous.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


def parameter_count(hidden_nodes: int) -> int:
    """Weights and biases of a 2-n-1 network."""
    return 4 * hidden_nodes + 1


def hidden_node_count(parameters: int) -> int:
    """The inverse of `parameter_count`; ValueError where no network has that many parameters."""
    nodes, remainder = divmod(parameters - 1, 4)
    if nodes < 1 or remainder:
        raise ValueError(
            f"parameters of a 2-n-1 network: expected 4 n + 1 with n of 1 or more, found {parameters}"
        )
    return nodes


def _hidden(parameters: Tensor, inputs: Tensor) -> Tensor:
    """b_h of eq. (4), shape [members, n, readings]."""
    members, count = parameters.shape
    nodes = hidden_node_count(count)
    first_layer = parameters[:, : 3 * nodes].reshape(members, 3, nodes).transpose(1, 2)
    signed_inputs = torch.cat([inputs.T, -torch.ones_like(inputs.T[:1])])
    # Eq. (4) as written: torch.exp is several times faster than torch.tanh in float64, and as exact here,
    # because the outputs are summed (an absolute error of 1e-16 counts, not a relative one near zero).
    return torch.matmul(first_layer, signed_inputs).mul_(-2.0).exp_().add_(1.0).reciprocal_().mul_(2.0).sub_(1.0)


def forward(parameters: Tensor, inputs: Tensor) -> Tensor:
    """The networks' outputs ε, shape [members, readings].

    `parameters` [members, 4 n + 1]; `inputs` [readings, 2], columns T and θ, both scaled by eq. (6).
    """
    nodes = hidden_node_count(parameters.shape[1])
    output_weights = parameters[:, None, 3 * nodes : 4 * nodes]
    return torch.matmul(output_weights, _hidden(parameters, inputs))[:, 0] - parameters[:, -1:]


def jacobian(parameters: Tensor, inputs: Tensor) -> Tensor:
    """dε / d parameters in closed form, shape [members, 4 n + 1, readings].

    With s_h = ω_h (1 - b_h²): dε/dv_1h = s_h T, dε/dv_2h = s_h θ, dε/dγ_h = -s_h, dε/dω_h = b_h, dε/dφ = -1.
    """
    members, count = parameters.shape
    nodes = hidden_node_count(count)
    result = parameters.new_empty(members, count, inputs.shape[0])
    by_temperature, by_angle, by_bias, activation = result[:, :-1].split(nodes, dim=1)
    activation.copy_(_hidden(parameters, inputs))
    # -s_h = ω_h b_h² - ω_h
    weights = parameters[:, 3 * nodes : 4 * nodes, None]
    torch.mul(activation, activation, out=by_bias)
    by_bias.sub_(1.0).mul_(weights)
    torch.mul(by_bias, -inputs[:, 0], out=by_temperature)
    torch.mul(by_bias, -inputs[:, 1], out=by_angle)
    result[:, -1] = -1.0
    return result


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkFit:
    """Fitting the network to readings: the least-squares problem that `levenberg_marquardt` solves."""

    inputs: Tensor
    """[readings, 2], columns T and θ, scaled by eq. (6)."""
    target: Tensor
    """[readings], scaled by eq. (6)."""

    def residual(self, parameters: Tensor) -> Tensor:
        """Target minus output, shape [members, readings]."""
        return self.target - forward(parameters, self.inputs)

    def jacobian(self, parameters: Tensor) -> Tensor:
        """d output / d parameters, shape [members, 4 n + 1, readings]."""
        return jacobian(parameters, self.inputs)

    def mean_square(self, parameters: Tensor) -> Tensor:
        """F of eq. (7) for each member, shape [members], in the scaled target's unit squared."""
        return self.residual(parameters).square().mean(dim=1)
