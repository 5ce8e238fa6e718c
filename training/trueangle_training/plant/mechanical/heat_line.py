"""Heat along a row of nodes: finite differences in space, exact in time for drivers linear over a step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]

GRID_S = 12.0
STIFF_ENOUGH = 1e-5
"""Rate over a step below which the exact weights lose their digits, and the trapezium's are as good."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """Nodes one behind the other, shape [m].

    C_j T_j' = G_j (T_j+1 - T_j) + G_j-1 (T_j-1 - T_j) + H_j (surroundings - T_j) + power_j
    """

    capacity_j_k: Floats
    between_w_k: Floats
    """[m - 1]"""
    film_w_k: Floats

    def temperatures_k(
        self, surroundings: Floats, power_w: Floats, *, heated: int, step_s: float, start: float = 0.0
    ) -> Floats:
        """All nodes at equal steps, shape [g, m].

        `surroundings` [g]; `power_w` [g] goes into the node `heated`; all nodes begin at `start`.
        """
        root = np.sqrt(self.capacity_j_k)
        rates, modes = np.linalg.eigh(self._conductance() / np.outer(root, root))
        drive = np.outer(surroundings, self.film_w_k / root)
        drive[:, heated] += power_w / root[heated]
        forced = drive @ modes
        begun = modes.T @ (root * start)
        courses = np.column_stack(
            [
                _mode(forced[:, j], rate=float(rates[j]), begun=float(begun[j]), step_s=step_s)
                for j in range(rates.size)
            ]
        )
        return (courses @ modes.T) / root

    def _conductance(self) -> Floats:
        loss = self.film_w_k.copy()
        loss[:-1] += self.between_w_k
        loss[1:] += self.between_w_k
        return np.diag(loss) - np.diag(self.between_w_k, 1) - np.diag(self.between_w_k, -1)


def _mode(drive: Floats, *, rate: float, begun: float, step_s: float) -> Floats:
    """y' = drive - rate y, from `begun` at the first step on."""
    way = rate * step_s
    decay, new, old = float(np.exp(-way)), 0.5 * step_s, 0.5 * step_s
    if way > STIFF_ENOUGH:
        mean = -float(np.expm1(-way)) / way
        new, old = (1.0 - mean) * step_s / way, (mean - decay) * step_s / way
    # The filter's memory before its second value: what the first one leaves.
    out, _ = lfilter([new, old], [1.0, -decay], drive[1:], zi=[old * drive[0] + decay * begun])
    return np.concatenate([[begun], np.asarray(out, dtype=np.float64)])


def uniform_row(*, nodes: int, diffusion_s: float, film_share: float = 0.0) -> Row:
    """A bar of unit capacity, cut evenly, whose first node is tied to the surroundings.

    `diffusion_s`: time constant of its slowest course when the far end is insulated, 4 L^2 / (pi^2 a).
    `film_share`: loss from all its surface over its conductance from end to end.
    """
    end_to_end = 4.0 / (np.pi**2 * diffusion_s)
    between = np.full(nodes - 1, end_to_end * nodes)
    film = np.full(nodes, film_share * end_to_end / nodes)
    film[0] += 2.0 * end_to_end * nodes
    return Row(capacity_j_k=np.full(nodes, 1.0 / nodes), between_w_k=between, film_w_k=film)
