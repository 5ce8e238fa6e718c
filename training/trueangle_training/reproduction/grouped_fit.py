"""Fitting networks to readings that repeat few inputs, each network to a part of the readings of its own.

Where m readings share angle and temperature, their squared residuals about a prediction p are

    sum (y_i - p)² = m (mean y - p)² + sum (y_i - mean y)²

and the second term does not depend on p. One row of weight m stands for them: the normal equations, the accepted
steps and the place of the smallest validation error are those of the single readings.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from trueangle_training.network import forward, jacobian


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroupedNetworkFit:
    """The weighted least-squares problems of a population: a `MemberwiseProblem`."""

    inputs: Tensor
    """[groups, 2], columns T and θ, scaled by eq. (6)."""
    weighted_target: Tensor
    """[members, groups]: root of the weight times the group's mean target."""
    root_weight: Tensor
    """[members, groups]: root of how many of a member's readings a group holds; 0 where it holds none."""

    def residual(self, parameters: Tensor) -> Tensor:
        """Weighted target minus weighted output, [members, groups]."""
        return torch.addcmul(self.weighted_target, self.root_weight, forward(parameters, self.inputs), value=-1.0)

    def jacobian(self, parameters: Tensor) -> Tensor:
        """d weighted output / d parameters, [members, 4 n + 1, groups]."""
        return jacobian(parameters, self.inputs).mul_(self.root_weight[:, None, :])

    def of_members(self, members: Tensor) -> "GroupedNetworkFit":
        """The problem of some members."""
        return GroupedNetworkFit(
            inputs=self.inputs,
            weighted_target=self.weighted_target[members],
            root_weight=self.root_weight[members],
        )

    def sum_square(self, parameters: Tensor) -> Tensor:
        """Sum of squared residuals about the groups' means, [members]."""
        return self.residual(parameters).square().sum(dim=1)


def grouped_fit(inputs: Tensor, target: Tensor, member_rows: Tensor) -> GroupedNetworkFit:
    """Group the readings of each member.

    `inputs` [groups, 2]; `target` [groups, repeats] of all readings; `member_rows` bool [members, groups, repeats]
    says which of them a member is fitted to.
    """
    weight = member_rows.sum(dim=2).to(torch.float64)
    total = (member_rows * target).sum(dim=2)
    root = weight.sqrt()
    weighted_target = total / root.clamp(min=1.0)
    return GroupedNetworkFit(inputs=inputs, weighted_target=weighted_target, root_weight=root)
