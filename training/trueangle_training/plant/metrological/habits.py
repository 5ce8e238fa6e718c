"""How an operator keeps to the plan: with pauses that nobody planned."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import Schedule

Floats = NDArray[np.float64]


def with_pauses(schedule: Schedule, *, after: NDArray[np.int64], pauses_s: Floats) -> Schedule:
    """Everything later than some readings (their rows in `after`) comes later by these pauses."""
    starts_s = schedule.time_s[after]
    order = np.argsort(starts_s)
    waited_s = np.concatenate([[0.0], np.cumsum(pauses_s[order])])

    def late(time_s: Floats) -> Floats:
        return time_s + waited_s[np.searchsorted(starts_s[order], time_s, side="left")]

    return replace(
        schedule,
        time_s=late(schedule.time_s),
        path_time_s=late(schedule.path_time_s),
        chamber_time_s=late(schedule.chamber_time_s),
    )


def with_habits(schedule: Schedule, rng: np.random.Generator) -> Schedule:
    """A pause of a minute or so after about one reading in forty, and a long one now and then.

    Only between readings that stand still: a sweep is driven by a machine.
    """
    still = np.flatnonzero(schedule.velocity_deg_s == 0.0)
    after = still[rng.random(still.size) < float(rng.uniform(0.01, 0.04))]
    pauses_s = rng.exponential(40.0, size=after.size) + 5.0
    return with_pauses(schedule, after=after, pauses_s=np.minimum(pauses_s, 280.0))
