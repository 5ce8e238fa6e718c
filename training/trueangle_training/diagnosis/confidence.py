"""How probable a name is, from what speaks for it: a logistic regression on cases with a known answer.

Fitted by tests/benchmarks/fit_confidence.py --cases 700 --seed 41 (paper's plan): 323 names, 298 of them right.
Cases of the project's plant, single effects, pairs, unknown patterns and noise, effect-to-noise ratio 0.2 to 5;
library errors injected: the true effect withheld in 5 % of the cases, all shapes bent by 15 % in 30 %. Calibration
error by five-fold cross-validation 0.024; of 235 names at 0.9 or more 228 were right.
"""

from dataclasses import dataclass

import numpy as np

COEFFICIENTS = (-0.084, 0.188, 0.363, -0.072, -0.419)
"""Of `features`, in their order."""
LOWEST, HIGHEST = 0.01, 0.98
"""No finite number of cases tells more."""
MARGIN_COUNTED = 12.0
"""Nats; beyond it the library's errors decide, not the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grounds:
    """What the probability of a found class is judged by."""

    margin: float
    """Log evidence of the name less that of the best effect or generic pattern outside its class, nats."""
    log_evidence: float
    """Given the other members, penalty taken off, nats."""
    left: float
    """Share that the best generic pattern would still take, 0 to 1."""
    by_named_share: bool
    """The name stands although a generic pattern has more evidence."""


def features(grounds: Grounds) -> tuple[float, float, float, float, float]:
    """1, margin (counted to 12 nats either way), logarithm of the evidence, share left, rule used."""
    margin = float(np.clip(grounds.margin, -MARGIN_COUNTED, MARGIN_COUNTED))
    evidence = float(np.log(np.clip(grounds.log_evidence, 1.0, 1000.0)))
    return (1.0, margin, evidence, float(np.clip(grounds.left, 0.0, 1.0)), float(grounds.by_named_share))


def class_probability(grounds: Grounds) -> float:
    """Probability, 0 to 1, that the class holds the true effect."""
    value = float(np.dot(COEFFICIENTS, features(grounds)))
    return float(np.clip(1.0 / (1.0 + np.exp(-np.clip(value, -30.0, 30.0))), LOWEST, HIGHEST))
