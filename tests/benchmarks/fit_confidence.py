"""Fit the probability of a found class on cases with a known answer and with library errors injected.

    python -m tests.benchmarks.fit_confidence --cases 600 --seed 1 --processes 2

Cases come from the plant, which shares nothing with the library. In one of twenty the true effect is withheld
from the library, in three of ten all shapes of the library are bent by 15 % of another pattern. Printed:
coefficients for `trueangle_training/diagnosis/confidence.py`, with log loss and calibration by five-fold
cross-validation, of the fit and of the fit before it.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import Pool
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import minimize

from trueangle.contract.calibration import read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import joint_from_document
from trueangle_training.blind_check.marks import meets, withheld_truth
from trueangle_training.diagnosis.attribution import attribute
from trueangle_training.diagnosis.axes import axes_of
from trueangle_training.diagnosis.confidence import COEFFICIENTS, Grounds, features, probabilities
from trueangle_training.diagnosis.design_check import design_check
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.diagnosis.verdict import verdict_of
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.effect import Hypothesis
from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.reading_head.library_defects import LIBRARY_DEFECTS
from trueangle_training.plant.reading_head.unknown_defects import ON_RICH_PLAN
from trueangle_training.plant.wish import Wish

Floats = NDArray[np.float64]

INJECTED = {"none": 0.65, "withheld": 0.05, "bent": 0.3}
"""Errors of the library and their shares of the cases."""
BENT = 0.15
PRIOR = np.array([3.0, -1.0, -1.0, 1.0])
PRIOR_SD = np.array([1.0, 2.0, 2.0, 0.5])
"""Libraries are right in nineteen of twenty cases; a nat of evidence is worth a nat."""
ENRS = (0.2, 0.35, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """One name that was given, and whether its class held a true effect."""

    grounds: Grounds
    right: bool
    what: str
    """Case, truth and name, for whoever looks at the wrong ones."""


def judged(task: tuple[int, str]) -> list[Seen]:
    """All mean, random and event causes of one case."""
    seed, plan = task
    rng = np.random.default_rng([seed, 77])
    stratum = str(rng.choice(["single", "single", "single", "unknown", "pair", "noise"]))
    names = {
        "single": tuple(rng.choice(list(LIBRARY_DEFECTS), 1)),
        "unknown": tuple(rng.choice(list(ON_RICH_PLAN), 1)),
        "pair": tuple(rng.choice(list(LIBRARY_DEFECTS), 2, replace=False)),
        "noise": (),
    }[stratum]
    enr = float(rng.choice(ENRS))
    wish = Wish(
        seed=seed,
        plan="paper" if plan == "paper" else "rich",
        stratum=stratum,  # type: ignore[arg-type]
        enr=enr,
        names=tuple(str(name) for name in names),
        ratio=0.7,
    )
    try:
        case = draw_case(wish)
    except (CaseNotFoundError, KeyError):
        return []
    error = str(rng.choice(list(INJECTED), p=list(INJECTED.values())))
    true = {effect.name for effect in case.truth.effects}
    library = {name: entry for name, entry in EFFECTS.items() if error != "withheld" or name not in true}
    campaign = read_campaign(case.measured_csv.encode(), source="case.csv")
    joint = joint_from_document(document_from_plain(yaml.safe_load(case.joint_yaml), source="joint.yaml", path=""))
    problem = problem_of(campaign, joint, library=library)
    if error == "bent":
        problem = bent(problem, rng)
    verdict = verdict_of(problem, attribute(problem), design_check(problem.without_errors()))
    seen = [effect for effect in case.truth.effects if effect.visible]
    if error == "withheld":
        seen = [withheld_truth(effect) for effect in seen]
    return [
        Seen(
            grounds=cause.grounds,
            right=cause.effect in case.truth.carried_together
            or any(meets({"effect": cause.effect, "class": cause.effect_class}, effect) for effect in seen),
            what=f"{seed} {error} {enr:g} {sorted(true)} -> {cause.effect}",
        )
        for cause in verdict.causes
        if cause.grounds is not None
    ]


def bent(problem: Problem, rng: np.random.Generator) -> Problem:
    """Every shape of the library a little wrong, as a library's are."""
    axes = axes_of(problem.conditions)
    order = int(rng.integers(1, 5))
    pattern = np.cos(order * axes.angle_rad + rng.uniform(0, 2 * np.pi))
    if axes.temperature is not None:
        pattern = pattern * (1.0 + rng.normal(0.0, 0.5) * axes.temperature)
    factor = 1.0 + BENT * np.sqrt(2.0) * pattern
    return replace(problem, hypotheses=tuple(_bent(each, factor) for each in problem.hypotheses))


def _bent(each: Hypothesis, factor: Floats) -> Hypothesis:
    return each if each.effect is None else replace(each, main=each.main * factor[:, None])


def fitted(x: Floats, right: Floats) -> Floats:
    """Most probable coefficients; the priors only hold what few names tell within reason."""

    def cost(coefficients: Floats) -> float:
        p = np.clip(probabilities(x, coefficients), 1e-9, 1.0 - 1e-9)
        likelihood = float(np.sum(right * np.log(p) + (1.0 - right) * np.log(1.0 - p)))
        return 0.5 * float(np.sum(((coefficients - PRIOR) / PRIOR_SD) ** 2)) - likelihood

    bounds = [(None, None), (None, 0.0), (None, None), (0.0, None)]
    return np.asarray(minimize(cost, PRIOR, method="L-BFGS-B", bounds=bounds).x, dtype=np.float64)


def names_of(path: Path) -> list[Seen]:
    """Those that an earlier run saved."""
    plain = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    return [Seen(grounds=Grounds(**each["grounds"]), right=each["right"], what=each["what"]) for each in plain]


def _log_loss(p: Floats, right: Floats) -> float:
    p = np.clip(p, 1e-3, 1 - 1e-3)
    return float(-np.mean(right * np.log(p) + (1 - right) * np.log(1 - p)))


def _calibration_error(p: Floats, right: Floats) -> float:
    """Expected calibration error in ten bins of equal width."""
    place = np.minimum((p * 10).astype(int), 9)
    return float(
        sum(abs(np.sum(p[place == i]) - np.sum(right[place == i])) for i in range(10)) / max(right.size, 1)
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, diagnose, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--rich-share", type=float, default=0.1, help="part of the cases on the rich plan")
    parser.add_argument("--save", type=Path, help="the names and their grounds, one JSON line each")
    parser.add_argument(
        "--saved", type=Path, nargs="*", default=(), help="names of earlier runs to fit together with"
    )
    options = parser.parse_args(arguments)
    every = round(1.0 / options.rich_share) if options.rich_share > 0 else options.cases + 1
    tasks = [
        (options.seed * 1_000_000 + i, "rich" if i % every == every - 1 else "paper") for i in range(options.cases)
    ]
    with Pool(options.processes) as pool:
        seen = [each for many in pool.imap_unordered(judged, tasks) for each in many]
    if options.save:
        options.save.write_text("".join(json.dumps(asdict(each)) + "\n" for each in seen), "utf-8")
    seen += [each for path in options.saved for each in names_of(path)]
    x = np.array([features(each.grounds) for each in seen])
    right = np.array([float(each.right) for each in seen])
    rng = np.random.default_rng(0)
    fold = rng.integers(0, 5, size=right.size)
    p = np.empty(right.size)
    for i in range(5):
        p[fold == i] = probabilities(x[fold == i], fitted(x[fold != i], right[fold != i]))
    before = probabilities(x, np.array(COEFFICIENTS))
    print(f"{len(seen)} names in {options.cases} cases, {int(right.sum())} right")
    print(f"in use:  log loss {_log_loss(before, right):.3f}, ECE {_calibration_error(before, right):.3f}")
    print(f"fitted:  log loss {_log_loss(p, right):.3f}, ECE {_calibration_error(p, right):.3f} (five-fold)")
    print("COEFFICIENTS =", tuple(round(float(value), 3) for value in fitted(x, right)))
    for each, probability in zip(seen, p, strict=True):
        if probability >= 0.9 and not each.right:
            print(f"wrong at {probability:.3f}: {each.what} {each.grounds}")
    for level in (0.5, 0.7, 0.9, 0.95):
        above = p >= level
        print(f"p >= {level}: {int(above.sum())} names, {int(right[above].sum())} right")


if __name__ == "__main__":
    main()
