"""The 2-n-1 network, eqs. (2)-(5), and its closed-form Jacobian."""

import math

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian as automatic_jacobian

from trueangle_training.network import NetworkFit, forward, hidden_node_count, jacobian, parameter_count


def random_population(members: int, hidden_nodes: int, seed: int = 3) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.uniform(-2.0, 2.0, (members, parameter_count(hidden_nodes))))


def random_inputs(readings: int, seed: int = 4) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).uniform(0.0, 1.0, (readings, 2)))


def output_by_hand(parameters: list[float], temperature: float, angle: float) -> float:
    """Eqs. (2)-(5) symbol by symbol for one network and one reading."""
    n = (len(parameters) - 1) // 4
    v_1, v_2, gamma, omega = (parameters[i * n : (i + 1) * n] for i in range(4))
    phi = parameters[-1]
    beta = 0.0
    for h in range(n):
        alpha = v_1[h] * temperature + v_2[h] * angle
        beta += omega[h] * math.tanh(alpha - gamma[h])
    return beta - phi


def output_by_matrices(parameters: torch.Tensor, inputs: torch.Tensor) -> torch.Tensor:
    """The same for all readings, from operations that torch can differentiate by itself."""
    v_1, v_2, gamma, omega = parameters[:-1].reshape(4, -1)
    alpha = torch.outer(inputs[:, 0], v_1) + torch.outer(inputs[:, 1], v_2)
    return torch.tanh(alpha - gamma) @ omega - parameters[-1]


def test_forward_follows_the_equations_in_the_papers_order() -> None:
    parameters, inputs = random_population(3, 4), random_inputs(5)
    outputs = forward(parameters, inputs)
    for member in range(3):
        for reading in range(5):
            temperature, angle = inputs[reading].tolist()
            by_hand = output_by_hand(parameters[member].tolist(), temperature, angle)
            # Sums of nine terms of order 1: a few units of 2e-16.
            assert outputs[member, reading].item() == pytest.approx(by_hand, abs=1e-14)


def test_jacobian_agrees_with_automatic_differentiation() -> None:
    parameters, inputs = random_population(3, 20), random_inputs(7)
    closed_form = jacobian(parameters, inputs)
    assert closed_form.shape == (3, 81, 7)
    for member in range(3):
        automatic = automatic_jacobian(lambda vector: output_by_matrices(vector, inputs), parameters[member])
        assert isinstance(automatic, torch.Tensor)
        torch.testing.assert_close(closed_form[member], automatic.T, rtol=0.0, atol=1e-13)


def test_jacobian_agrees_with_central_differences() -> None:
    parameters, inputs = random_population(1, 2), random_inputs(4)
    step = 1e-5
    closed_form = jacobian(parameters, inputs)[0]
    for gene in range(parameters.shape[1]):
        moved = parameters.repeat(2, 1)
        moved[0, gene] += step
        moved[1, gene] -= step
        above, below = forward(moved, inputs)
        # Truncation step² / 6 times a third derivative of order 10.
        torch.testing.assert_close(closed_form[gene], (above - below) / (2 * step), rtol=0.0, atol=1e-8)


def test_saturated_nodes_give_finite_outputs_and_derivatives() -> None:
    parameters = random_population(2, 3) * 1e6
    inputs = random_inputs(6)
    assert torch.isfinite(forward(parameters, inputs)).all()
    assert torch.isfinite(jacobian(parameters, inputs)).all()


def test_one_member_alone_gives_what_it_gives_in_a_population() -> None:
    parameters, inputs = random_population(4, 5), random_inputs(9)
    torch.testing.assert_close(forward(parameters, inputs)[2:3], forward(parameters[2:3], inputs))
    torch.testing.assert_close(jacobian(parameters, inputs)[2:3], jacobian(parameters[2:3], inputs))


def test_mean_square_is_that_of_the_residual() -> None:
    inputs = random_inputs(4)
    parameters = torch.zeros(1, 5, dtype=torch.float64)
    parameters[0, -1] = -0.5
    fit = NetworkFit(inputs=inputs, target=torch.tensor([0.5, 0.5, 1.5, -0.5], dtype=torch.float64))
    # The output is 0.5 everywhere, so the residuals are 0, 0, 1, -1.
    assert fit.mean_square(parameters).tolist() == [0.5]


@pytest.mark.parametrize("count", [0, 1, 4, 80])
def test_a_vector_that_is_no_network_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"4 n \\+ 1.*found {count}"):
        hidden_node_count(count)


def test_twenty_nodes_have_eighty_one_parameters() -> None:
    assert parameter_count(20) == 81
    assert hidden_node_count(81) == 20
