"""One weighted row for readings that share their inputs: the same fit as with the single readings."""

import numpy as np
import pytest
import torch

from trueangle_training.levenberg_marquardt import LevenbergMarquardtOptions, levenberg_marquardt
from trueangle_training.network import NetworkFit, parameter_count
from trueangle_training.reproduction.grouped_fit import grouped_fit

NODES = 3
GROUPS, REPEATS = 12, 3
RNG = np.random.default_rng(4)
INPUTS = torch.from_numpy(RNG.uniform(0.0, 1.0, (GROUPS, 2)))
TARGET = torch.from_numpy(RNG.uniform(0.0, 1.0, (GROUPS, REPEATS)))
ROWS = torch.from_numpy(RNG.uniform(size=(2, GROUPS, REPEATS)) < 0.8)
"""Two members, each with readings of its own."""
START = torch.from_numpy(RNG.uniform(-1.0, 1.0, (2, parameter_count(NODES))))


def single_readings(member: int) -> NetworkFit:
    groups, repeats = np.nonzero(ROWS[member].numpy())
    return NetworkFit(inputs=INPUTS[groups], target=TARGET[groups, repeats])


@pytest.mark.parametrize("member", [0, 1])
def test_normal_equations_are_those_of_the_single_readings(member: int) -> None:
    single, parameters = single_readings(member), START[member : member + 1]
    grouped = grouped_fit(INPUTS, TARGET, ROWS).of_members(torch.tensor([member]))
    for fit in (single, grouped):
        assert fit.jacobian(parameters).shape[1] == parameter_count(NODES)

    def equations(fit: object) -> tuple[np.ndarray, np.ndarray]:
        jacobian = fit.jacobian(parameters)[0]  # pyright: ignore[reportAttributeAccessIssue]
        residual = fit.residual(parameters)[0]  # pyright: ignore[reportAttributeAccessIssue]
        return (jacobian @ jacobian.T).numpy(), (jacobian @ residual).numpy()

    for of_single, of_group in zip(equations(single), equations(grouped), strict=True):
        np.testing.assert_allclose(of_group, of_single, atol=1e-12)


@pytest.mark.parametrize("member", [0, 1])
def test_trained_networks_are_those_of_the_single_readings(member: int) -> None:
    options = LevenbergMarquardtOptions(max_epochs=12)
    together = levenberg_marquardt(grouped_fit(INPUTS, TARGET, ROWS), START, options)
    alone = levenberg_marquardt(single_readings(member), START[member : member + 1], options)
    # Twelve steps grow a rounding of 1e-16 by the systems' condition.
    np.testing.assert_allclose(together.parameters[member], alone.parameters[0], atol=1e-6)
    assert together.epochs[member] == alone.epochs[0]


def test_sums_of_squares_differ_by_the_scatter_within_groups_only() -> None:
    grouped = grouped_fit(INPUTS, TARGET, ROWS)
    single = single_readings(0)
    weight = ROWS[0].sum(dim=1)
    means = torch.where(weight > 0, (ROWS[0] * TARGET).sum(dim=1) / weight.clamp(min=1), 0.0)
    within = (ROWS[0] * (TARGET - means[:, None]).square()).sum()
    whole = single.residual(START[:1]).square().sum()
    assert grouped.sum_square(START)[0].item() == pytest.approx((whole - within).item(), abs=1e-12)


def test_a_member_stops_after_its_accepted_steps() -> None:
    options = LevenbergMarquardtOptions(max_epochs=200, max_accepted_steps=4)
    limited = levenberg_marquardt(single_readings(0), START[:1], options)
    free = levenberg_marquardt(single_readings(0), START[:1], LevenbergMarquardtOptions(max_epochs=200))
    assert limited.epochs[0] < free.epochs[0]
    assert limited.mean_square[0] > free.mean_square[0]
    # A step more lowers the error: the limit, not convergence, has stopped it.
    further = LevenbergMarquardtOptions(max_epochs=200, max_accepted_steps=5)
    assert levenberg_marquardt(single_readings(0), START[:1], further).mean_square[0] < limited.mean_square[0]


def test_no_accepted_step_at_all_is_no_setting() -> None:
    with pytest.raises(ValueError, match="max_accepted_steps"):
        LevenbergMarquardtOptions(max_accepted_steps=0)
