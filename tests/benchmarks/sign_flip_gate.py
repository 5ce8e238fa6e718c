"""Do sign-flips of whole runs add anything to the evidence as a gate?

    python -m tests.benchmarks.sign_flip_gate --cases 150 --seed 5

Of noise-only campaigns and of campaigns with one planted effect (effect-to-noise ratio 0.2 or 0.35) the best
family is taken, its log evidence and the p-value of its block under 400 random flips of whole runs. Printed: how
well each, and both together, tell planted from noise (area under the curve, power at 1 % and 3 % false alarms).
"""

import argparse
from collections.abc import Sequence
from multiprocessing import Pool

import numpy as np
import yaml
from numpy.typing import NDArray
from tests.benchmarks.fit_confidence import fitted

from trueangle.contract.calibration import read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import joint_from_document
from trueangle_training.diagnosis.attribution import weighed_evidence
from trueangle_training.diagnosis.evidence import scores
from trueangle_training.diagnosis.problem import problem_of
from trueangle_training.diagnosis.selection import family_evidence
from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.reading_head.library_defects import LIBRARY_DEFECTS
from trueangle_training.plant.wish import Wish

Floats = NDArray[np.float64]

FLIPS = 400
SCATTER = ("noise_growth", "quantisation")


def measured(task: tuple[int, bool]) -> tuple[float, float] | None:
    """Log evidence of the best family and the p-value of its best block."""
    seed, planted = task
    rng = np.random.default_rng([seed, 5])
    effect = str(rng.choice([name for name in LIBRARY_DEFECTS if name not in SCATTER]))
    wish = Wish(
        seed=seed,
        plan="paper",
        stratum="single" if planted else "noise",
        enr=float(rng.choice([0.2, 0.35])),
        names=(effect,) if planted else (),
    )
    try:
        case = draw_case(wish)
    except CaseNotFoundError:
        return None
    if planted and not case.truth.effects[0].visible:
        return None
    campaign = read_campaign(case.measured_csv.encode(), source="case.csv")
    joint = joint_from_document(document_from_plain(yaml.safe_load(case.joint_yaml), source="joint.yaml", path=""))
    evidence, families, noise = weighed_evidence(problem_of(campaign, joint))
    found = scores(evidence, [])
    by_family = family_evidence(found.log_evidence, families)
    family = int(np.argmax(by_family))
    block = int(np.argmax(np.where(families.of_block == family, found.log_evidence, -np.inf)))
    own = evidence.column_range(block)
    columns = np.asarray(evidence.columns[own], dtype=np.float64)
    columns = columns - evidence.inside[:, own].T @ evidence.nuisance
    run = noise.transform.run_index
    count = int(run.max()) + 1
    by_run = np.stack([np.bincount(run, weights=column * evidence.error, minlength=count) for column in columns])
    values, vectors = np.linalg.eigh(columns @ columns.T)
    shrunk = 1.0 / (values + float(found.tau[block]) ** -2)
    signs = np.concatenate([np.ones((1, count)), rng.choice([-1.0, 1.0], size=(FLIPS, count))])
    energy = np.sum(shrunk * (signs @ by_run.T @ vectors) ** 2, axis=1)
    return float(by_family[family]), float(np.mean(energy >= energy[0] - 1e-9))


def _area(score: Floats, planted: Floats) -> float:
    better = score[planted == 1][:, None] - score[planted == 0][None, :]
    return float(np.mean((better > 0) + 0.5 * (better == 0)))


def _power(score: Floats, planted: Floats, alarms: float) -> float:
    return float(np.mean(score[planted == 1] > np.quantile(score[planted == 0], 1.0 - alarms)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, weigh, flip, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=150)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    tasks = [(options.seed * 100_000 + i, i % 2 == 1) for i in range(2 * options.cases)]
    with Pool(options.processes) as pool:
        found = pool.map(measured, tasks, chunksize=4)
    kept = [(pair, task[1]) for pair, task in zip(found, tasks, strict=True) if pair is not None]
    log_evidence = np.array([pair[0] for pair, _ in kept])
    log_p = np.log(np.array([pair[1] for pair, _ in kept]))
    planted = np.array([float(each) for _, each in kept])
    print(f"{int(planted.sum())} planted, {int((1 - planted).sum())} noise only")
    x = np.column_stack([np.ones(planted.size), np.clip(log_evidence, -5, 25), log_p])
    fold = np.random.default_rng(0).integers(0, 5, size=planted.size)
    both = np.empty(planted.size)
    for i in range(5):
        both[fold == i] = x[fold == i] @ fitted(x[fold != i], planted[fold != i])
    for name, score in (("evidence", log_evidence), ("flips", -log_p), ("both (five-fold)", both)):
        powers = ", ".join(f"power at {a:.0%}: {_power(score, planted, a):.3f}" for a in (0.01, 0.03))
        print(f"{name}: area {_area(score, planted):.3f}, {powers}")
    for name, group in (("noise", planted == 0), ("planted", planted == 1)):
        floor = np.exp(log_p[group]) <= 2.0 / FLIPS
        print(f"{name}: at the smallest p values {int(floor.sum())} of {int(group.sum())}")


if __name__ == "__main__":
    main()
