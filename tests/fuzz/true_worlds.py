"""One `true_angles` world after the other: for ever, or so many of them with what was served in all."""

import random
from collections import Counter
from collections.abc import Iterable

from tests.fuzz.true_angles import TruthFuzz


def served_in_worlds(seeds: Iterable[int], periods: int) -> Counter[str]:
    """How often each way of serving was met in so many periods of each world; AssertionError names a finding."""
    served: Counter[str] = Counter()
    for seed in seeds:
        fuzz = TruthFuzz(random.Random(seed))
        for _ in range(periods):
            fuzz.some_time()
        served += fuzz.served
    return served


class Worlds:
    """One world after the other; `some_time` is one period of the present one."""

    def __init__(self, rng: random.Random) -> None:
        self._rng, self._left = rng, 1000
        self._world = TruthFuzz(rng)

    def some_time(self) -> int:
        """One period; 1."""
        if not self._left:
            self._left, self._world = 1000, TruthFuzz(self._rng)
        self._left -= 1
        return self._world.some_time()
