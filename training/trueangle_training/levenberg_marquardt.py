"""Levenberg-Marquardt for a population of least-squares problems of one shape.

The members share their data, or each has its own (`MemberwiseProblem`). Each member solves, at each epoch, with
its own damping μ,

    (JᵀJ + μ I) dx = Jᵀ r,    r = target - prediction(x),    J = d prediction / dx

A trial x + dx that lowers the sum of squares is taken and μ multiplied by 0.1; any other is dropped and μ
multiplied by 10 (Hagan and Menhaj 1994, the paper's reference 29). One epoch is one trial of every member still
running: one batched Cholesky factorisation. A member whose trial was dropped keeps its J, so only the others are
linearised anew.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

_CACHE_BYTES = 2**21
"""Jacobians are made and used up in slices of about this size: out of the cache they cost a quarter more."""


class LeastSquaresProblem(Protocol):
    """What is fitted; the leading axis runs over the members of the population."""

    def residual(self, parameters: Tensor) -> Tensor:
        """Target minus prediction, [members, readings], at `parameters` [members, n]."""
        ...

    def jacobian(self, parameters: Tensor) -> Tensor:
        """d prediction / d parameters, [members, n, readings]."""
        ...


@runtime_checkable
class MemberwiseProblem(Protocol):
    """A problem whose members have data of their own, such as different readings kept apart."""

    def residual(self, parameters: Tensor) -> Tensor:
        """As of `LeastSquaresProblem`, for all members."""
        ...

    def jacobian(self, parameters: Tensor) -> Tensor:
        """As of `LeastSquaresProblem`, for all members."""
        ...

    def of_members(self, members: Tensor) -> LeastSquaresProblem:
        """The problem of these members alone, in this order; `members` is int64 [chosen]."""
        ...


class StopReason(Enum):
    """Why a member's iteration ended; none of them is an error."""

    EPOCHS_SPENT = "the allowed number of epochs was used up"
    VALIDATION_ROSE = "the validation error did not fall for as many accepted steps as the patience allows"
    GRADIENT_SMALL = "the gradient vanished: a minimum was reached"
    DAMPING_LIMIT = "no step lowers the error any more: a minimum to machine precision"


@dataclass(frozen=True, slots=True, kw_only=True)
class LevenbergMarquardtOptions:
    """Settings that reproduce the paper's figures, where the paper leaves them open."""

    max_epochs: int = 100
    max_accepted_steps: int | None = None
    """Accepted steps after which a member stops; None: only `max_epochs` counts. MATLAB's trainlm, and with it
    much of the literature, calls an accepted step with all its trials one epoch."""
    patience: int = 6
    """Accepted steps in a row without a lower validation error before a member stops."""
    initial_damping: float = 1e-3
    accepted_factor: float = 0.1
    rejected_factor: float = 10.0
    largest_damping: float = 1e10
    smallest_damping: float = 1e-20
    smallest_gradient: float = 1e-12
    """Largest entry of |Jᵀ r| at which a member has arrived, in the problem's own units."""

    def __post_init__(self) -> None:
        if self.max_epochs < 0 or self.patience < 1:
            raise ValueError(
                "Levenberg-Marquardt: expected max_epochs of 0 or more and patience of 1 or more, "
                f"found {self.max_epochs} and {self.patience}"
            )
        if self.max_accepted_steps is not None and self.max_accepted_steps < 1:
            raise ValueError(
                "Levenberg-Marquardt: expected max_accepted_steps of 1 or more, or None, "
                f"found {self.max_accepted_steps}"
            )
        if not (0 < self.accepted_factor < 1 < self.rejected_factor):
            raise ValueError(
                "Levenberg-Marquardt: expected 0 < accepted_factor < 1 < rejected_factor, "
                f"found {self.accepted_factor} and {self.rejected_factor}"
            )
        if not (0 < self.smallest_damping <= self.initial_damping <= self.largest_damping):
            raise ValueError(
                "Levenberg-Marquardt: expected 0 < smallest_damping <= initial_damping <= largest_damping, "
                f"found {self.smallest_damping}, {self.initial_damping}, {self.largest_damping}"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevenbergMarquardtOutcome:
    """What became of each member; first axis [members]."""

    parameters: Tensor
    """[members, n]: those of the lowest validation error, or the last accepted without a validation set."""
    mean_square: Tensor
    """[members]: mean squared residual of the fitted readings at `parameters`."""
    validation_mean_square: Tensor | None
    """[members]: the same of the validation readings; None: there was no validation set."""
    epochs: tuple[int, ...]
    """Trials made, accepted or not."""
    stop_reasons: tuple[StopReason, ...]


def levenberg_marquardt(
    problem: LeastSquaresProblem,
    start: Tensor,
    options: LevenbergMarquardtOptions,
    validation: LeastSquaresProblem | None = None,
) -> LevenbergMarquardtOutcome:
    """Minimise each member's sum of squares from `start` [members, n] (float64, not changed).

    Not converging is an outcome, not an exception. A member whose start gives a residual that is not finite raises
    ValueError: there is nothing to descend from.
    """
    if start.dtype != torch.float64 or start.ndim != 2:
        raise ValueError(
            f"start: expected a float64 tensor [members, n], found {start.dtype} {tuple(start.shape)}"
        )
    population = _Population(problem, start, options, validation)
    for _ in range(options.max_epochs):
        if not population.running.numel():
            break
        population.advance()
    return population.outcome()


class _Population:
    """The state of all members between two epochs; `running` holds the indices of those not yet stopped."""

    def __init__(
        self,
        problem: LeastSquaresProblem,
        start: Tensor,
        options: LevenbergMarquardtOptions,
        validation: LeastSquaresProblem | None,
    ) -> None:
        self._problem, self._validation, self._options = problem, validation, options
        members, count = start.shape
        self.running = torch.arange(members)
        self._parameters = start.clone()
        self._residual = problem.residual(start)
        self._sum_square = self._residual.square().sum(dim=1)
        if not bool(torch.isfinite(self._sum_square).all()):
            raise ValueError("start: expected finite residuals for every member, found NaN or infinity")
        self._damping = torch.full((members,), options.initial_damping, dtype=torch.float64)
        self._hessian = start.new_empty(members, count, count)
        self._gradient = start.new_empty(members, count)
        self._outdated = self.running
        jacobian_bytes = 8 * count * self._residual.shape[1]
        self._members_per_slice = max(1, _CACHE_BYTES // jacobian_bytes)
        self._epochs = torch.zeros(members, dtype=torch.int64)
        self._accepted = torch.zeros(members, dtype=torch.int64)
        self._reasons = [StopReason.EPOCHS_SPENT] * members
        self._best_parameters = self._parameters.clone()
        self._best_validation = None if validation is None else _mean_square(validation, start)
        self._failures = torch.zeros(members, dtype=torch.int64)

    def advance(self) -> None:
        """One epoch: linearise where needed, one trial of every running member."""
        self._linearise()
        if not self.running.numel():
            return
        running = self.running
        step, solvable = self._steps(running)
        trial = self._parameters[running] + step
        residual = _of_members(self._problem, running).residual(trial)
        sum_square = residual.square().sum(dim=1)
        # A comparison with NaN is False: a trial that overflowed is dropped like one that went uphill.
        lower = solvable & (sum_square < self._sum_square[running])
        taken = running[lower]
        self._parameters[taken] = trial[lower]
        self._residual[taken] = residual[lower]
        self._sum_square[taken] = sum_square[lower]
        factor = torch.where(lower, self._options.accepted_factor, self._options.rejected_factor)
        damping = self._damping[running] * factor
        self._damping[running] = damping.clamp(min=self._options.smallest_damping)
        self._epochs[running] += 1
        self._outdated = taken
        self._stop(running[damping > self._options.largest_damping], StopReason.DAMPING_LIMIT)
        self._accepted[taken] += 1
        self._validate(taken)
        if self._options.max_accepted_steps is not None:
            spent = taken[self._accepted[taken] >= self._options.max_accepted_steps]
            self._stop(spent[torch.isin(spent, self.running)], StopReason.EPOCHS_SPENT)

    def _linearise(self) -> None:
        """JᵀJ and Jᵀr of the members that moved."""
        moved = self._outdated
        for members in moved.split(self._members_per_slice):
            jacobian = _of_members(self._problem, members).jacobian(self._parameters[members])
            self._hessian[members] = torch.bmm(jacobian, jacobian.transpose(1, 2))
            self._gradient[members] = torch.bmm(jacobian, self._residual[members, :, None])[:, :, 0]
        flat = self._gradient[moved].abs().amax(dim=1) <= self._options.smallest_gradient
        self._stop(moved[flat], StopReason.GRADIENT_SMALL)

    def _steps(self, members: Tensor) -> tuple[Tensor, Tensor]:
        """Solutions dx [members, n] and whether the damped matrix was numerically positive definite."""
        damped = self._hessian[members]
        damped.diagonal(dim1=1, dim2=2).add_(self._damping[members, None])
        factor, failed_at = torch.linalg.cholesky_ex(damped)
        step = torch.cholesky_solve(self._gradient[members, :, None], factor)[:, :, 0]
        return step, failed_at == 0

    def _validate(self, taken: Tensor) -> None:
        """Keep the weights of the lowest validation error; stop who has failed too often in a row."""
        if self._validation is None or self._best_validation is None or not taken.numel():
            return
        mean_square = _mean_square(_of_members(self._validation, taken), self._parameters[taken])
        better = mean_square < self._best_validation[taken]
        improved = taken[better]
        self._best_validation[improved] = mean_square[better]
        self._best_parameters[improved] = self._parameters[improved]
        self._failures[taken] += 1
        self._failures[improved] = 0
        self._stop(taken[self._failures[taken] >= self._options.patience], StopReason.VALIDATION_ROSE)

    def _stop(self, members: Tensor, reason: StopReason) -> None:
        if not members.numel():
            return
        for member in members.tolist():
            self._reasons[member] = reason
        self.running = self.running[~torch.isin(self.running, members)]
        self._outdated = self._outdated[~torch.isin(self._outdated, members)]

    def outcome(self) -> LevenbergMarquardtOutcome:
        """The members as they stand."""
        if self._best_validation is None:
            parameters, mean_square = self._parameters, self._sum_square / self._residual.shape[1]
        else:
            parameters = self._best_parameters
            mean_square = _mean_square(self._problem, parameters)
        return LevenbergMarquardtOutcome(
            parameters=parameters,
            mean_square=mean_square,
            validation_mean_square=self._best_validation,
            epochs=tuple(self._epochs.tolist()),
            stop_reasons=tuple(self._reasons),
        )


def _of_members(problem: LeastSquaresProblem, members: Tensor) -> LeastSquaresProblem:
    return problem.of_members(members) if isinstance(problem, MemberwiseProblem) else problem


def _mean_square(problem: LeastSquaresProblem, parameters: Tensor) -> Tensor:
    return problem.residual(parameters).square().mean(dim=1)
