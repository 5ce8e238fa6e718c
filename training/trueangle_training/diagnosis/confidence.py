"""How sure the diagnosis may be of a name: fitted on cases with a known answer, library errors injected.

Two things must be true for the class of a cause to be right. The best shape must not have won by chance, which
the margin over the best answer outside the class tells; and the library's shapes must be near enough to the truth,
which no amount of data tells: their share is the ceiling.

    p = logistic(a + b l) logistic(c + d m),  m: margin in nats, l: what the named-share rule leaves

Fitted by tests/benchmarks/fit_confidence.py, --cases 1000 --seed 8 --rich-share 0 and --cases 1000 --seed 9
--rich-share 0.08 together: 884 names, 831 of them right. Cases of the project's plant, single effects, pairs,
unknown patterns and noise, effect-to-noise ratio 0.2 to 5; library errors injected: the true effect withheld in
5 % of the cases, all shapes bent by 15 % in 30 %. Calibration error by five-fold cross-validation 0.012; of 812
names at 0.9 or more 782 were right.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from trueangle_training.diagnosis.choice import LEFT_TO_GENERIC

Floats = NDArray[np.float64]

COEFFICIENTS = (3.319, -3.15, -0.755, 1.082)
"""a, b, c, d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grounds:
    """What a cause's probability rests on."""

    margin: float
    """Log evidence of the name less that of the best effect or generic pattern outside its class, nats."""
    left: float
    """Share that the best generic pattern would still take, 0 to 1."""
    by_named_share: bool
    """The names were chosen among the library alone, because they explain nearly all."""


def features(grounds: Grounds) -> tuple[float, float]:
    """The margin in nats; what the rule leaves to a generic pattern, 1 where it ends, 0 without the rule.

    A rule that leaves next to nothing costs next to nothing.
    """
    left = float(np.clip(grounds.left / LEFT_TO_GENERIC, 0.0, 1.0))
    return (grounds.margin, left if grounds.by_named_share else 0.0)


def probabilities(features_of_names: Floats, coefficients: Floats) -> Floats:
    """[names]: probability, 0 to 1, that the class holds the true effect; features [names, 2]."""
    a, b, c, d = coefficients
    return expit(a + b * features_of_names[:, 1]) * expit(c + d * features_of_names[:, 0])


def class_probability(grounds: Grounds) -> float:
    """Probability, 0 to 1, that the class holds the true effect."""
    return float(probabilities(np.array([features(grounds)]), np.array(COEFFICIENTS))[0])
