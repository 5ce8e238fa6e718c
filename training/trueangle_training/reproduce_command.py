"""`trueangle reproduce`: the paper's experiment on the shipped joint, beside the paper's figures."""

import argparse
import json
import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint, Plan
from trueangle_training.command import Surroundings
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.files import write_all
from trueangle_training.progress import Progress, progress_bar

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.reproduction.experiment import NoiseSeedResult
    from trueangle_training.reproduction.nominal_campaign import NominalCampaign

FITNESS_CHOICES = ("untrained", "after-lm", "handed-on")
FITNESS_VALUES = {"untrained": "untrained", "after-lm": "after_lm", "handed-on": "after_lm_handed_on"}
DEFAULT_MULTISTART_SEEDS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class _Job:
    """One noise seed, as a process is told of it."""

    joint_path: Path
    plan_path: Path
    seed: int
    trials: int
    fitness: str
    multistart_after_lm: bool


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "reproduce",
        allow_abbrev=False,
        help="the paper's tables and figures on the shipped joint",
        description="Tables 1 and 2 and Figures 7 to 10 of Jia et al. 2020 (Sensors 20, 2603) on simulated "
        "readings, as means over noise seeds with standard errors, beside the published figures. A noise seed "
        "takes about 7 s with --fitness untrained and about a minute with the others.",
    )
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="noise seeds 0 to N - 1 (default 20)")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="trials of each network (default 20)")
    parser.add_argument(
        "--fitness",
        choices=FITNESS_CHOICES,
        default="after-lm",
        help="what eq. (7) rates: untrained weights (the text; fast), weights after 20 LM steps, or the same with "
        "the trained weights handed on; both slower ones show all (default after-lm)",
    )
    parser.add_argument(
        "--multistart-seeds",
        type=int,
        default=DEFAULT_MULTISTART_SEEDS,
        metavar="N",
        help="seeds for which the 20-step fitness is compared with plain multistart, which doubles their time "
        f"(default {DEFAULT_MULTISTART_SEEDS})",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("reproduction"), metavar="DIR", help="default reproduction"
    )
    parser.add_argument("--joint", type=Path, metavar="JOINT.yaml", help="default: the shipped example")
    parser.add_argument("--plan", type=Path, metavar="PLAN.yaml", help="default: the shipped example")
    parser.add_argument(
        "--processes", type=int, default=os.cpu_count() or 1, metavar="N", help="at once (default: processors)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Simulate, train, write tables and figures; 0."""
    example = resources.files("trueangle_training.examples")
    with (
        resources.as_file(example.joinpath("joint.yaml")) as joint_path,
        resources.as_file(example.joinpath("plan.yaml")) as plan_path,
    ):
        joint_path, plan_path = arguments.joint or joint_path, arguments.plan or plan_path
        joint, plan = _inputs(arguments, joint_path, plan_path)
        jobs = [
            _Job(
                joint_path=joint_path,
                plan_path=plan_path,
                seed=seed,
                trials=arguments.trials,
                fitness=FITNESS_VALUES[arguments.fitness],
                multistart_after_lm=seed < arguments.multistart_seeds,
            )
            for seed in range(arguments.seeds)
        ]
        title = f"{arguments.seeds} noise seeds, {arguments.trials} trials of each network"
        with progress_bar(surroundings.err, title) as progress:
            results = sorted(_results(jobs, arguments.processes, progress), key=lambda each: each.seed)
    _write(arguments.out, _campaign(joint, plan, 0), results, surroundings)
    return 0


def _inputs(arguments: argparse.Namespace, joint_path: Path, plan_path: Path) -> tuple[Joint, Plan]:
    faults = [
        Fault(
            where=f"--{name}", expected=f"{lowest} or more", found=str(getattr(arguments, name.replace("-", "_")))
        )
        for name, lowest in (("seeds", 1), ("trials", 1), ("processes", 1), ("multistart-seeds", 0))
        if getattr(arguments, name.replace("-", "_")) < lowest
    ]
    joint = plan = None
    try:
        joint = load_joint(joint_path)
    except ContractError as error:
        faults += error.faults
    try:
        plan = load_plan(plan_path)
    except ContractError as error:
        faults += error.faults
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        found = error.strerror or type(error).__name__
        faults.append(Fault(where=str(arguments.out), expected="a directory that can be made", found=found))
    if faults or joint is None or plan is None:
        raise ContractError(faults)
    # A plan that the experiment cannot be made with is refused before any process starts.
    _campaign(joint, plan, 0)
    return joint, plan


def _campaign(joint: Joint, plan: Plan, seed: int) -> "NominalCampaign":
    from trueangle_training.reproduction.nominal_campaign import nominal_campaign
    from trueangle_training.simulator.campaign import simulate_campaign
    from trueangle_training.simulator.joint import simulated_joint

    return nominal_campaign(simulate_campaign(simulated_joint(joint), plan, seed), plan)


def _results(jobs: list[_Job], processes: int, progress: Progress) -> "Iterator[NoiseSeedResult]":
    """As they are done; in this process where one is enough."""
    at_once = min(processes, len(jobs))
    if at_once == 1:
        for done, job in enumerate(jobs, start=1):
            yield _one_seed(job)
            progress(done, len(jobs))
        return
    # Not forked: torch's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=at_once, mp_context=context, initializer=_leave_interrupts) as pool:
        futures = [pool.submit(_one_seed, job) for job in jobs]
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                yield future.result()
                progress(done, len(jobs))
        except BaseException:
            # A worker would finish its minutes of training, and the pool would wait for it.
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def _leave_interrupts() -> None:
    """An interrupt of the terminal reaches every process; this one is ended by the first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _one_seed(job: _Job) -> "NoiseSeedResult":
    """All of one noise seed on one thread."""
    import torch

    from trueangle_training.methods.fe_gabpnn_paper import Fitness
    from trueangle_training.reproduction.experiment import ExperimentOptions, run_experiment

    threads_before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        campaign = _campaign(load_joint(job.joint_path), load_plan(job.plan_path), job.seed)
        options = ExperimentOptions(
            trials=job.trials, fitness=Fitness(job.fitness), multistart_after_lm=job.multistart_after_lm
        )
        return run_experiment(campaign, options, job.seed)
    finally:
        torch.set_num_threads(threads_before)


def _write(
    out: Path, campaign: "NominalCampaign", results: "list[NoiseSeedResult]", surroundings: Surroundings
) -> None:
    from trueangle_training.reproduction.experiment import base_index
    from trueangle_training.reproduction.plots import figure_images
    from trueangle_training.reproduction.report import figure_8_json, report_lines
    from trueangle_training.reproduction.summary import summarise

    summary = summarise(results, base=base_index(campaign))
    text = "".join(f"{line}\n" for line in report_lines(summary))
    data = json.dumps({"format": 1, "seeds": [asdict(each) for each in results]}, allow_nan=False)
    files = {
        "tables.md": text.encode(),
        "results.json": (data + "\n").encode(),
        "figure-8.json": figure_8_json(summary),
        **figure_images(campaign, results[0], summary),
    }
    write_all([(out / name, content) for name, content in files.items()])
    surroundings.out.write(text)
    surroundings.out.write(
        f"\nwritten to {out}: tables.md, results.json, figure-7.png to figure-10.png, figure-8.json\n"
    )
