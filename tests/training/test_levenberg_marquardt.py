"""Batched Levenberg-Marquardt on problems whose answer is known."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from trueangle_training.levenberg_marquardt import (
    LevenbergMarquardtOptions,
    StopReason,
    levenberg_marquardt,
)
from trueangle_training.network import NetworkFit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """prediction = design @ parameters."""

    design: Tensor
    target: Tensor

    def residual(self, parameters: Tensor) -> Tensor:
        return self.target - parameters @ self.design.T

    def jacobian(self, parameters: Tensor) -> Tensor:
        return self.design.T.expand(parameters.shape[0], -1, -1)


class Rosenbrock:
    """Residuals 10 (y - x²) and 1 - x; the minimum, 0, is at (1, 1)."""

    def residual(self, parameters: Tensor) -> Tensor:
        x, y = parameters[:, 0], parameters[:, 1]
        return torch.stack([10.0 * (y - x * x), 1.0 - x], dim=1)

    def jacobian(self, parameters: Tensor) -> Tensor:
        x = parameters[:, 0]
        zero, one = torch.zeros_like(x), torch.ones_like(x)
        d_by_x = torch.stack([20.0 * x, one], dim=1)
        d_by_y = torch.stack([-10.0 * one, zero], dim=1)
        return torch.stack([d_by_x, d_by_y], dim=1)


class Root:
    """Residual √x - 0.1: a large step crosses to where √x is not a number; the minimum, 0, is at 0.01."""

    def residual(self, parameters: Tensor) -> Tensor:
        return parameters.sqrt() - 0.1

    def jacobian(self, parameters: Tensor) -> Tensor:
        return (-0.5 / parameters.sqrt())[:, :, None]


class Arc:
    """Prediction arctan x, target 0: the undamped step from 1.5 leads to -1.69, and the square up by 1.12."""

    def residual(self, parameters: Tensor) -> Tensor:
        return -parameters.atan()

    def jacobian(self, parameters: Tensor) -> Tensor:
        return (1.0 / (1.0 + parameters.square()))[:, :, None]


def line(seed: int = 5, readings: int = 12) -> Line:
    rng = np.random.default_rng(seed)
    return Line(
        design=torch.from_numpy(rng.normal(size=(readings, 3))), target=torch.from_numpy(rng.normal(size=readings))
    )


def test_one_step_solves_the_damped_system_of_the_docstring() -> None:
    problem = line()
    start = torch.tensor([[0.3, -0.2, 0.9], [0.0, 0.0, 0.0]], dtype=torch.float64)
    outcome = levenberg_marquardt(problem, start, LevenbergMarquardtOptions(max_epochs=1, initial_damping=0.7))
    design, target = problem.design.numpy(), problem.target.numpy()
    for member, x in enumerate(start.numpy()):
        # (JᵀJ + μ I) dx = Jᵀ r is the least-squares problem [J; √μ I] dx = [r; 0].
        stacked = np.vstack([design, np.sqrt(0.7) * np.eye(3)])
        step = np.linalg.lstsq(stacked, np.concatenate([target - design @ x, np.zeros(3)]))[0]
        assert outcome.parameters[member].numpy() == pytest.approx(x + step, abs=1e-13)


def test_a_linear_problem_ends_at_the_least_squares_solution() -> None:
    problem = line()
    outcome = levenberg_marquardt(problem, torch.zeros(1, 3, dtype=torch.float64), LevenbergMarquardtOptions())
    solution, squares, *_ = np.linalg.lstsq(problem.design.numpy(), problem.target.numpy())
    # It stops at a gradient of 1e-12, and JᵀJ of 12 normal deviates has eigenvalues above 1.
    assert outcome.parameters[0].numpy() == pytest.approx(solution, abs=1e-11)
    assert outcome.mean_square.item() == pytest.approx(squares[0] / 12, rel=1e-12)
    assert outcome.stop_reasons[0] in (StopReason.GRADIENT_SMALL, StopReason.DAMPING_LIMIT)


def test_rosenbrocks_valley_is_followed_from_every_start() -> None:
    start = torch.tensor([[-1.2, 1.0], [3.0, -4.0], [0.0, 0.0]], dtype=torch.float64)
    outcome = levenberg_marquardt(Rosenbrock(), start, LevenbergMarquardtOptions(max_epochs=200))
    assert outcome.parameters.numpy() == pytest.approx(np.ones((3, 2)), abs=1e-9)
    assert all(reason is not StopReason.EPOCHS_SPENT for reason in outcome.stop_reasons)


def test_members_do_not_influence_each_other() -> None:
    start = torch.tensor([[-1.2, 1.0], [3.0, -4.0]], dtype=torch.float64)
    options = LevenbergMarquardtOptions(max_epochs=7)
    together = levenberg_marquardt(Rosenbrock(), start, options)
    for member in range(2):
        alone = levenberg_marquardt(Rosenbrock(), start[member : member + 1], options)
        torch.testing.assert_close(together.parameters[member], alone.parameters[0])


def test_the_error_never_rises_from_epoch_to_epoch() -> None:
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    squares = [
        levenberg_marquardt(Rosenbrock(), start, LevenbergMarquardtOptions(max_epochs=epochs)).mean_square.item()
        for epochs in range(0, 60, 3)
    ]
    assert squares == sorted(squares, reverse=True)
    assert squares[-1] < squares[0] / 100


def test_a_step_that_raises_the_error_a_little_is_dropped() -> None:
    start = torch.tensor([[1.5]], dtype=torch.float64)
    outcome = levenberg_marquardt(Arc(), start, LevenbergMarquardtOptions(max_epochs=1))
    assert outcome.parameters.item() == 1.5
    assert outcome.epochs == (1,)
    arrived = levenberg_marquardt(Arc(), start, LevenbergMarquardtOptions())
    assert arrived.parameters.item() == pytest.approx(0.0, abs=1e-9)


def test_the_start_is_left_as_it_was() -> None:
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    levenberg_marquardt(Rosenbrock(), start, LevenbergMarquardtOptions(max_epochs=5))
    assert start.tolist() == [[-1.2, 1.0]]


def test_no_epochs_give_the_start_and_say_so() -> None:
    start = torch.tensor([[-1.2, 1.0]], dtype=torch.float64)
    outcome = levenberg_marquardt(Rosenbrock(), start, LevenbergMarquardtOptions(max_epochs=0))
    assert outcome.parameters.tolist() == start.tolist()
    assert outcome.epochs == (0,)
    assert outcome.stop_reasons == (StopReason.EPOCHS_SPENT,)


def test_a_start_at_the_minimum_stops_at_once() -> None:
    start = torch.ones(1, 2, dtype=torch.float64)
    outcome = levenberg_marquardt(Rosenbrock(), start, LevenbergMarquardtOptions())
    assert outcome.stop_reasons == (StopReason.GRADIENT_SMALL,)
    assert outcome.epochs == (0,)


def test_a_trial_that_is_not_a_number_is_dropped_and_damped() -> None:
    # From 1 the undamped step leads to sqrt(-0.8); with more damping the way is found.
    start = torch.ones(1, 1, dtype=torch.float64)
    outcome = levenberg_marquardt(Root(), start, LevenbergMarquardtOptions())
    assert outcome.parameters.item() == pytest.approx(0.01, abs=1e-9)


def test_a_start_without_finite_residuals_is_refused() -> None:
    with pytest.raises(ValueError, match="finite residuals"):
        levenberg_marquardt(Root(), -torch.ones(1, 1, dtype=torch.float64), LevenbergMarquardtOptions())


def test_single_precision_is_refused() -> None:
    with pytest.raises(ValueError, match=r"float64.*float32"):
        levenberg_marquardt(Rosenbrock(), torch.zeros(1, 2), LevenbergMarquardtOptions())


def test_training_stops_when_validation_rises_and_keeps_its_best_weights() -> None:
    # Fifteen readings that are noise, and a network that can pass through all of them.
    rng = np.random.default_rng(6)
    inputs = torch.from_numpy(rng.uniform(size=(30, 2)))
    target = torch.from_numpy(rng.uniform(size=30))
    training = NetworkFit(inputs=inputs[:15], target=target[:15])
    validation = NetworkFit(inputs=inputs[15:], target=target[15:])
    start = torch.from_numpy(rng.uniform(-1, 1, (5, 41)))
    outcome = levenberg_marquardt(training, start, LevenbergMarquardtOptions(), validation)
    assert outcome.validation_mean_square is not None
    assert outcome.stop_reasons == (StopReason.VALIDATION_ROSE,) * 5
    assert all(6 <= epochs < 100 for epochs in outcome.epochs)
    torch.testing.assert_close(validation.mean_square(outcome.parameters), outcome.validation_mean_square)
    # Not one of the first 100 iterates of the same descent validates better within the epochs that were run.
    for epochs in range(outcome.epochs[0] + 1):
        iterate = levenberg_marquardt(training, start[:1], LevenbergMarquardtOptions(max_epochs=epochs))
        assert validation.mean_square(iterate.parameters)[0] >= outcome.validation_mean_square[0] - 1e-12


def test_patience_counts_accepted_steps_without_a_better_validation() -> None:
    rng = np.random.default_rng(6)
    training = NetworkFit(
        inputs=torch.from_numpy(rng.uniform(size=(15, 2))), target=torch.from_numpy(rng.uniform(size=15))
    )
    validation = NetworkFit(inputs=training.inputs, target=1.0 - training.target)
    start = torch.from_numpy(rng.uniform(-1, 1, (1, 41)))
    short = levenberg_marquardt(training, start, LevenbergMarquardtOptions(patience=1), validation)
    long = levenberg_marquardt(training, start, LevenbergMarquardtOptions(patience=6), validation)
    assert short.epochs[0] < long.epochs[0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_epochs": -1},
        {"patience": 0},
        {"accepted_factor": 1.0},
        {"rejected_factor": 0.5},
        {"initial_damping": 0.0},
    ],
)
def test_options_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="Levenberg-Marquardt: expected"):
        LevenbergMarquardtOptions(**wrong)  # pyright: ignore[reportArgumentType]
