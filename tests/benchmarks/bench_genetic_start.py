"""Prints what the genetic algorithm adds to `fe-gabpnn`: against plain multistart with equal computing.

Run as `python tests/benchmarks/bench_genetic_start.py [--joints 20] [--first-seed 4000] [--families n3q ...]`.
Both rate as many hidden layers, individuals times (generations + 1) for each number of hidden nodes: one by the
genetic algorithm, the other drawn at random from where the first generation is drawn. From there on they are the
same: the fittest 20, Levenberg-Marquardt, the average by evidence. A joint's figure is the log of the ratio of
true errors, genetic over multistart, below 0 where the genetic algorithm helps; intervals are 95 % of Student's t
over joints. Beside it, by how many nats the best network's evidence differs.
"""

import argparse
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from dataclasses import dataclass  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from scipy.stats import t as student_t  # noqa: E402

_ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(_ROOT), str(_ROOT / "training"), str(_ROOT / "daemon")]

from tests.benchmarks.families import FAMILIES, SHAPES, draw_campaign, draw_joint, true_grid  # noqa: E402

from trueangle_training.methods import TrainingReadings  # noqa: E402
from trueangle_training.methods.coefficient_network import fitness  # noqa: E402
from trueangle_training.methods.fe_gabpnn import (  # noqa: E402
    DEFAULT_SETTINGS,
    GENE_RANGE,
    NetworkAverage,
    average_networks,
    evolved_starts,
    fittest_starts,
    hidden_units,
    trained_population,
)
from trueangle_training.methods.linear import LinearFit, fit_linear  # noqa: E402

Floats = NDArray[np.float64]
Starts = Callable[[LinearFit, int, np.random.Generator], Floats]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Genetic algorithm against multistart on one joint."""

    log_ratio: float
    """log(true RMSE with the genetic algorithm / with multistart)."""
    evidence_nats: float
    """Evidence of the best network, genetic minus multistart."""


def genetic_starts(linear: LinearFit, units: int, rng: np.random.Generator) -> Floats:
    """As the method takes them."""
    return evolved_starts(linear.mixture.likelihood, hidden_units(linear), units, DEFAULT_SETTINGS, rng)


def random_starts(linear: LinearFit, units: int, rng: np.random.Generator) -> Floats:
    """The fittest of as many random hidden layers as the genetic algorithm rates."""
    count = DEFAULT_SETTINGS.individuals * (DEFAULT_SETTINGS.generations + 1)
    genes = rng.uniform(-GENE_RANGE, GENE_RANGE, (count, 2 * units))
    return fittest_starts(genes, fitness(linear.mixture.likelihood, hidden_units(linear), genes))


def trained(linear: LinearFit, starts: Starts, seed: int) -> NetworkAverage:
    """The method's training from these starts."""
    rng, hidden = np.random.default_rng(seed), hidden_units(linear)
    populations = [
        trained_population(linear.mixture.likelihood, hidden, starts(linear, units, rng))
        for units in DEFAULT_SETTINGS.hidden_nodes
    ]
    return average_networks(linear, hidden, populations)


def pair(family: str, seed: int) -> Pair:
    """Both on one joint of the family, on the same readings."""
    joint = draw_joint(family, seed)
    campaign = draw_campaign(joint, seed)
    readings = TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )
    linear = fit_linear(readings)
    angle_deg, temperature_c, truth = true_grid(joint)
    rms: list[float] = []
    nats: list[float] = []
    for starts in (genetic_starts, random_starts):
        networks = trained(linear, starts, seed)
        error = linear.model_of(networks.posterior).error_arcsec(angle_deg, temperature_c) - truth
        rms.append(float(np.sqrt(np.mean(error**2))))
        nats.append(max(networks.log_evidence))
    return Pair(log_ratio=float(np.log(rms[0] / rms[1])), evidence_nats=nats[0] - nats[1])


def _interval(values: list[float]) -> str:
    mean, count = float(np.mean(values)), len(values)
    reach = float(student_t.ppf(0.975, count - 1)) * float(np.std(values, ddof=1)) / count**0.5
    return f"{mean:+.4f} [{mean - reach:+.4f}, {mean + reach:+.4f}]"


def _line(name: str, pairs: list[Pair]) -> str:
    ratios = [each.log_ratio for each in pairs]
    better = sum(ratio < 0.0 for ratio in ratios)
    return (
        f"{name:12s} log error ratio {_interval(ratios)}  at most {max(np.abs(ratios)):.3f}  genetic better on "
        f"{better} of {len(pairs)}  evidence {_interval([each.evidence_nats for each in pairs])} nats"
    )


def main() -> int:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=4000)
    parser.add_argument("--families", nargs="+", default=["n3q", "spread", "knee"], choices=[*FAMILIES, *SHAPES])
    arguments = parser.parse_args()
    if arguments.joints < 2:
        parser.error("--joints: expected 2 or more, for an interval")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.joints)
    print(f"seeds {seeds.start} to {seeds.stop - 1}", flush=True)
    together: list[Pair] = []
    for family in arguments.families:
        pairs = [pair(family, seed) for seed in seeds]
        together += pairs
        print(_line(family, pairs), flush=True)
    print(_line("all", together))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
