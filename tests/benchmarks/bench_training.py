"""Time of 200 Levenberg-Marquardt iterations of a 2-20-1 network: the batch against SciPy and a NumPy loop.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_training [--repeats 5]

All fit the paper's problem (483 readings of a simulated joint, less their mean at 20 degC, scaled to [0, 1]) from
the same random weights, float64, one thread. An iteration is one trial step; SciPy's is MINPACK's lmder with the
closed-form Jacobian, whose function evaluations are counted. The median of the repeats is printed, and the
paper's whole experiment once.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares

import trueangle_training.examples
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.levenberg_marquardt import LevenbergMarquardtOptions, levenberg_marquardt
from trueangle_training.methods.fe_gabpnn_paper import Fitness
from trueangle_training.network import NetworkFit, parameter_count
from trueangle_training.reproduction.experiment import ExperimentOptions, run_experiment
from trueangle_training.reproduction.grouped_fit import grouped_fit
from trueangle_training.reproduction.nominal_campaign import NominalCampaign, nominal_campaign
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

Floats = NDArray[np.float64]

EXAMPLES = Path(trueangle_training.examples.__file__).parent
NODES = 20
ITERATIONS = 200
BATCH = 20
SINGLE_STARTS = 4
"""SciPy and the loop take one network at a time: so many are timed and averaged."""


def example_campaign(seed: int) -> NominalCampaign:
    """The shipped joint, measured by the shipped plan."""
    plan = load_plan(EXAMPLES / "plan.yaml")
    joint = simulated_joint(load_joint(EXAMPLES / "joint.yaml"))
    return nominal_campaign(simulate_campaign(joint, plan, seed), plan)


def scaled_problem(campaign: NominalCampaign) -> tuple[Floats, Floats]:
    """Inputs [483, 2] and targets [483]."""
    angle_deg, temperature_c, _ = campaign.flat()
    remainder = (campaign.error_arcsec - campaign.mean_at_arcsec(20.0)).ravel()
    columns = [temperature_c, angle_deg, remainder]
    scaled = [(column - column.min()) / np.ptp(column) for column in columns]
    return np.stack(scaled[:2], axis=1), scaled[2]


def hidden(parameters: Floats, inputs: Floats) -> Floats:
    """tanh(v1 T + v2 θ - γ), [readings, nodes]."""
    v1, v2, gamma = parameters[: 3 * NODES].reshape(3, NODES)
    return np.tanh(np.outer(inputs[:, 0], v1) + np.outer(inputs[:, 1], v2) - gamma)


def output(parameters: Floats, inputs: Floats) -> Floats:
    """The network's output, [readings]."""
    return hidden(parameters, inputs) @ parameters[3 * NODES : 4 * NODES] - parameters[-1]


def output_jacobian(parameters: Floats, inputs: Floats) -> Floats:
    """d output / d parameters, [readings, parameters]."""
    activation = hidden(parameters, inputs)
    slope = (1.0 - activation**2) * parameters[3 * NODES : 4 * NODES]
    columns = [slope * inputs[:, :1], slope * inputs[:, 1:], -slope, activation, -np.ones((len(inputs), 1))]
    return np.concatenate(columns, axis=1)


def scipy_ms(inputs: Floats, target: Floats, root_weight: Floats, starts: Floats) -> float:
    """Milliseconds for ITERATIONS function evaluations of MINPACK."""
    tightest = float(np.finfo(np.float64).eps)
    spent_s, evaluations = 0.0, 0
    for start in starts:
        started_s = time.perf_counter()
        done = least_squares(
            lambda p: root_weight * (output(p, inputs) - target),
            start,
            # SciPy's stubs know the names of the difference schemes only.
            jac=lambda p: root_weight[:, None] * output_jacobian(p, inputs),  # pyright: ignore[reportArgumentType]
            method="lm",
            max_nfev=ITERATIONS,
            ftol=tightest,
            xtol=tightest,
            gtol=tightest,
        )
        spent_s += time.perf_counter() - started_s
        evaluations += int(done.nfev)
    return 1e3 * spent_s * ITERATIONS / evaluations


def loop_ms(inputs: Floats, target: Floats, starts: Floats) -> float:
    """The same algorithm as the batch for one network after the other, in NumPy."""
    started_s = time.perf_counter()
    for start in starts:
        parameters, damping = start.copy(), 1e-3
        residual = target - output(parameters, inputs)
        jacobian = output_jacobian(parameters, inputs)
        hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        for _ in range(ITERATIONS):
            step = np.linalg.solve(hessian + damping * np.eye(parameters.size), gradient)
            trial = target - output(parameters + step, inputs)
            if trial @ trial >= residual @ residual:
                damping *= 10.0
                continue
            parameters, residual, damping = parameters + step, trial, max(0.1 * damping, 1e-20)
            jacobian = output_jacobian(parameters, inputs)
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    return 1e3 * (time.perf_counter() - started_s) / len(starts)


def batch_ms(problem: object, starts: Floats) -> float:
    """Milliseconds a network for ITERATIONS epochs of the batch."""
    options = LevenbergMarquardtOptions(max_epochs=ITERATIONS)
    started_s = time.perf_counter()
    outcome = levenberg_marquardt(problem, torch.from_numpy(starts), options)  # pyright: ignore[reportArgumentType]
    return 1e3 * (time.perf_counter() - started_s) * ITERATIONS / sum(outcome.epochs)


def median_ms(measure: Callable[[], float], repeats: int) -> float:
    """The median of repeated measurements."""
    return statistics.median(measure() for _ in range(repeats))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--experiment", action="store_true", help="time the paper's experiment as well")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    campaign = example_campaign(0)
    inputs, target = scaled_problem(campaign)
    starts = np.random.default_rng(0).uniform(-1.0, 1.0, (BATCH, parameter_count(NODES)))
    few = starts[:SINGLE_STARTS]
    temperatures, repeats, faces = campaign.error_arcsec.shape
    by_group = target.reshape(temperatures, repeats, faces).transpose(0, 2, 1).reshape(-1, repeats)
    group_inputs = inputs.reshape(temperatures, repeats, faces, 2)[:, 0].reshape(-1, 2)
    group_mean, root = by_group.mean(axis=1), np.full(by_group.shape[0], np.sqrt(repeats))
    distinct = NetworkFit(inputs=torch.from_numpy(inputs), target=torch.from_numpy(target))
    grouped = grouped_fit(
        torch.from_numpy(np.ascontiguousarray(group_inputs)),
        torch.from_numpy(np.ascontiguousarray(by_group)),
        torch.ones((BATCH, *by_group.shape), dtype=torch.bool),
    )
    n = arguments.repeats
    yardstick = median_ms(lambda: scipy_ms(inputs, target, np.ones(target.size), few), n)
    rows = {
        "SciPy lm, 483 rows": yardstick,
        "SciPy lm, 161 weighted rows": median_ms(lambda: scipy_ms(group_inputs, group_mean, root, few), n),
        "NumPy loop, 483 rows": median_ms(lambda: loop_ms(inputs, target, few), n),
        f"batch of {BATCH}, 483 rows": median_ms(lambda: batch_ms(distinct, starts), n),
        f"batch of {BATCH}, 161 weighted rows": median_ms(lambda: batch_ms(grouped, starts), n),
    }
    print(f"{ITERATIONS} iterations of one 2-{NODES}-1 network, ms (median of {n}), and SciPy's 483 rows over it")
    for name, milliseconds in rows.items():
        print(f"  {name:<34}{milliseconds:8.1f}{yardstick / milliseconds:8.1f} x")
    if arguments.experiment:
        for fitness in (Fitness.UNTRAINED, Fitness.AFTER_LM):
            started_s = time.perf_counter()
            run_experiment(campaign, ExperimentOptions(fitness=fitness), 0)
            spent_s = time.perf_counter() - started_s
            print(f"the whole experiment, one noise seed, 20 trials, fitness {fitness.value}: {spent_s:.1f} s")


if __name__ == "__main__":
    main()
