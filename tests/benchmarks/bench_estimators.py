"""Prints how near the methods come to an oracle that knows the thermal shapes, family by family.

Run as `python tests/benchmarks/bench_estimators.py [--joints 20] [--first-seed 1000] [--families n3q knee ...]`.
The score of a joint is the true RMSE on 0.5 deg by 1 degC, counted from the datum, over that of the oracle on the
same campaign; `bound` knows which harmonics carry which shape, but not the shape. The interval is the 95 %
bootstrap interval of the median. Coverage is the share of the grid with |error| <= 2 u, with the model's own
uncertainty and (in brackets) with the harmonics that the plan cannot see counted as well.
"""

import argparse
import os

# Before NumPy is imported: two workers with two threads each would only wait for one another.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys  # noqa: E402
import time  # noqa: E402
from dataclasses import dataclass, replace  # noqa: E402
from multiprocessing import Pool  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

_ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(_ROOT), str(_ROOT / "training"), str(_ROOT / "daemon")]

from tests.benchmarks.families import (  # noqa: E402
    FAMILIES,
    HIGHEST_SEEN,
    SHAPES,
    Campaign,
    FamilyJoint,
    draw_campaign,
    draw_joint,
    oracle_rms_arcsec,
    true_grid,
)

from trueangle_training.methods import TrainingReadings  # noqa: E402
from trueangle_training.methods.best import fit_best  # noqa: E402
from trueangle_training.methods.fe_gabpnn import doubted, fit_networks  # noqa: E402
from trueangle_training.methods.linear import LinearFit, fit_linear  # noqa: E402
from trueangle_training.methods.low_rank import GibbsSettings, fit_low_rank  # noqa: E402
from trueangle_training.methods.posterior import HarmonicPosterior  # noqa: E402

METHODS = ("linear", "fe-gabpnn", "best", "bound")
SEAM_FROM_DEG = 344.0
EVERY = 7
"""Uncertainty is looked at on every seventh point of the grid: it costs more than the error and varies slowly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """One method on one joint."""

    ratio: float
    """True RMSE over the oracle's."""
    seam_ratio: float
    """RMSE behind the last face over that of the whole turn."""
    coverage: float
    coverage_with_unseen: float
    seconds: float


def readings_of(campaign: Campaign) -> TrainingReadings:
    """As the laboratory takes them."""
    return TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )


def carried_modes(joint: FamilyJoint) -> NDArray[np.bool_]:
    """Which harmonics carry which shape, as `fit_low_rank` takes it."""
    carried = np.zeros((len(joint.shapes), HIGHEST_SEEN), dtype=bool)
    for term in joint.terms:
        carried[term.shape, term.order - 1] = True
    return carried


def fitted(method: str, linear: LinearFit, joint: FamilyJoint) -> HarmonicPosterior:
    """The method's posterior on a campaign reduced by `linear`."""
    if method == "linear":
        return linear.posterior
    if method == "fe-gabpnn":
        return doubted(linear, fit_networks(linear))
    if method == "best":
        return fit_best(linear).posterior
    settings = GibbsSettings(modes=len(joint.shapes), chains=4)
    return fit_low_rank(linear, settings=settings, carried=carried_modes(joint))


def scores(family: str, seed: int, methods: tuple[str, ...] = METHODS) -> dict[str, Score]:
    """Every method on one joint of the family."""
    joint = draw_joint(family, seed)
    campaign = draw_campaign(joint, seed)
    oracle_arcsec = oracle_rms_arcsec(joint, campaign)
    angle_deg, temperature_c, truth = true_grid(joint)
    some, away = slice(None, None, EVERY), angle_deg[::EVERY] > 0.0
    result: dict[str, Score] = {}
    for method in methods:
        start = time.perf_counter()
        linear = fit_linear(readings_of(campaign))
        model = linear.model_of(fitted(method, linear, joint))
        seconds = time.perf_counter() - start
        error = model.error_arcsec(angle_deg, temperature_c) - truth
        rms = float(np.sqrt(np.mean(error**2)))
        covered: list[float] = []
        for spreads in (model.spreads[:1], model.spreads):
            u = replace(model, spreads=spreads).uncertainty_arcsec(angle_deg[some], temperature_c[some])
            assert u is not None
            covered.append(float(np.mean(np.abs(error[some])[away] <= 2.0 * u[away])))
        seam = float(np.sqrt(np.mean(error[angle_deg >= SEAM_FROM_DEG] ** 2)))
        result[method] = Score(
            ratio=rms / oracle_arcsec,
            seam_ratio=seam / rms,
            coverage=covered[0],
            coverage_with_unseen=covered[1],
            seconds=seconds,
        )
    return result


def _job(job: tuple[str, int, tuple[str, ...]]) -> tuple[str, dict[str, Score]]:
    return job[0], scores(*job)


def _median_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(values, size=(2000, values.size)), axis=1)
    return float(np.quantile(medians, 0.025)), float(np.quantile(medians, 0.975))


def _line(name: str, all_scores: list[Score]) -> str:
    ratio = np.array([score.ratio for score in all_scores])
    low, high = _median_interval(ratio)
    coverage = np.mean([score.coverage for score in all_scores])
    with_unseen = np.mean([score.coverage_with_unseen for score in all_scores])
    return (
        f"  {name:10s} median {np.median(ratio):.3f} [{low:.2f}, {high:.2f}]  p95 {np.quantile(ratio, 0.95):.2f}  "
        f"worst {ratio.max():.2f}  covered {100 * coverage:.1f} % ({100 * with_unseen:.1f} %)  "
        f"seam {np.mean([score.seam_ratio for score in all_scores]):.2f}  "
        f"{np.median([score.seconds for score in all_scores]):.2f} s"
    )


def main() -> int:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--families", nargs="+", default=[*FAMILIES, *SHAPES], choices=[*FAMILIES, *SHAPES])
    parser.add_argument("--methods", nargs="+", default=[*METHODS], choices=METHODS)
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.joints)
    methods = tuple(arguments.methods)
    jobs = [(family, seed, methods) for family in arguments.families for seed in seeds]
    together: dict[str, list[Score]] = {method: [] for method in methods}
    outside_knee: dict[str, list[Score]] = {method: [] for method in methods}
    by_family: dict[str, dict[str, list[Score]]] = {}
    print(f"seeds {seeds.start} to {seeds.stop - 1}", flush=True)
    with Pool(arguments.processes) as pool:
        for family, result in pool.imap(_job, jobs, chunksize=1):
            kept = by_family.setdefault(family, {method: [] for method in methods})
            for method, score in result.items():
                kept[method].append(score)
                if family in FAMILIES:
                    together[method].append(score)
                if family in FAMILIES and family != "knee":
                    outside_knee[method].append(score)
            if len(kept[methods[0]]) == arguments.joints:
                print(family, *(_line(method, kept[method]) for method in methods), sep="\n", flush=True)
    for title, scored in (("all of the six", together), ("all outside knee", outside_knee)):
        if scored[methods[0]]:
            print(title, *(_line(method, scored[method]) for method in methods), sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
