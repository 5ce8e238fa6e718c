"""`trueangle compare`: what each method would be worth on this campaign, judged by what it was not trained on."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle_training.command import Surroundings
from trueangle_training.dataset import TrainingSet, training_set, without_rows
from trueangle_training.documents import load_joint
from trueangle_training.files import check_distinct, check_writable, read_whole, write_whole
from trueangle_training.methods import Method
from trueangle_training.methods.registry import METHODS, load_method
from trueangle_training.progress import progress_bar
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint
from trueangle_training.train_inputs import base_temperature_c, reference_record
from trueangle_training.train_options import excluded_rows

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.hidden_node_sweep import HiddenNodeSweep

ALL = "all"
DEAREST_S = 2.0
"""Dearer methods are compared only when they are named: each is trained about seventeen times."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "compare",
        allow_abbrev=False,
        help="judge the methods on a campaign by what they were not trained on",
        description="Train each method without each temperature, without runs and without places of the turn, and "
        "say how wrong it is there, with intervals. On simulated campaigns also against the truth.",
    )
    parser.add_argument("calibration", type=Path, metavar="CALIBRATION.csv")
    parser.add_argument("--joint", type=Path, metavar="JOINT.yaml", help="reference and base temperature")
    parser.add_argument(
        "--truth", type=Path, metavar="JOINT.yaml", help="the joint that a campaign was simulated from"
    )
    parser.add_argument(
        "--methods",
        metavar="NAME,NAME",
        help=f"some of {', '.join(METHODS)}, or {ALL} (default: all that train within {DEAREST_S:g} s); the "
        "baselines none, angle-only and harmonics-poly are always shown",
    )
    parser.add_argument("--base-temperature-c", type=float, metavar="T", help="of the paper's methods")
    parser.add_argument(
        "--exclude-rows", type=excluded_rows, default=frozenset(), metavar="N,N-M", help="lines to leave out"
    )
    parser.add_argument("--seed", type=int, default=0, help="of whatever the methods draw by chance (default 0)")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("compare.json"), metavar="FILE", help="default compare.json"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Compare, write and report; 0."""
    campaign, joint, truth, names = _inputs(arguments)
    from trueangle_training.compare_report import ComparedData, report_json, report_lines
    from trueangle_training.evaluation.comparison import compare_methods
    from trueangle_training.evaluation.reading_noise import reading_noise
    from trueangle_training.evaluation.truth import datum_drift_arcsec

    faces = None if joint is None else joint.reference.faces
    data = _readings(campaign, joint)
    surroundings.err.writelines(f"trueangle: warning: {text}\n" for text in data.warnings)
    base_c = base_temperature_c(arguments, joint)
    if campaign.temperature_c is None:
        methods, refused = _methods_without_temperature(names)
    else:
        methods, refused = _suitable_methods(campaign, names, base_c, faces)
        methods = _with_baselines(methods, data, base_c)
    noise = reading_noise(data.readings)
    with progress_bar(surroundings.err, f"comparing {', '.join(method.name for method in methods)}") as progress:
        comparison = compare_methods(
            data.readings,
            methods,
            noise_arcsec=None if noise is None else noise.sigma_arcsec,
            joint=truth,
            seed=arguments.seed,
            clock=time.perf_counter,
            progress=progress,
            refused=refused,
        )
    compared = ComparedData(
        campaign=campaign,
        data=data,
        noise=noise,
        reference_arcsec=reference_record(joint, campaign).standard_uncertainty_arcsec,
        datum_drift_arcsec=None if truth is None else datum_drift_arcsec(truth, data.readings),
        seed=arguments.seed,
        sweeps=_sweeps(surroundings, data, methods, seed=arguments.seed),
    )
    write_whole(arguments.output, report_json(compared, comparison))
    surroundings.out.writelines(f"{line}\n" for line in report_lines(compared, comparison))
    surroundings.out.write(f"file: {arguments.output}\n")
    return 0


def _readings(campaign: Campaign, joint: Joint | None) -> TrainingSet:
    """What no method could use is refused here; what single methods need is asked of each."""
    faces = None if joint is None else joint.reference.faces
    if campaign.temperature_c is None:
        from trueangle_training.angle_only_campaign import angle_only_set

        return angle_only_set(campaign, faces=faces)
    return training_set(
        campaign,
        base_temperature_c=None,
        joint_base_temperature_c=None if joint is None else joint.base_temperature_c,
        faces=faces,
        free_offsets=True,
    )


def _with_baselines(methods: tuple[Method, ...], data: TrainingSet, base_c: float) -> tuple[Method, ...]:
    """What any method must beat is always there, named or not."""
    from trueangle_training.evaluation.baselines import baseline_methods

    named = {method.name for method in methods}
    baselines = baseline_methods(data.readings, base_temperature_c=base_c)
    return (*methods, *(method for method in baselines if method.name not in named))


def _methods_without_temperature(
    names: tuple[str, ...],
) -> tuple[tuple[Method, ...], tuple[tuple[str, str], ...]]:
    """Harmonics of the angle and no correction; all others need the temperature."""
    from trueangle_training.angle_only_campaign import AngleHarmonics
    from trueangle_training.evaluation.baselines import NoCorrection

    reason = "the campaign has no temperatures"
    refused = tuple((name, reason) for name in names if name != "angle-only")
    return (AngleHarmonics(), NoCorrection()), refused


def _sweeps(
    surroundings: Surroundings, data: TrainingSet, methods: tuple[Method, ...], *, seed: int
) -> "tuple[HiddenNodeSweep, ...]":
    """Of each method that has hidden nodes."""
    from trueangle_training.hidden_node_sweep import announced_sweep

    sweeps = [announced_sweep(surroundings.err, data.readings, method, seed=seed) for method in methods]
    return tuple(sweep for sweep in sweeps if sweep is not None)


def _inputs(
    arguments: argparse.Namespace,
) -> tuple[Campaign, Joint | None, SimulatedJoint | None, tuple[str, ...]]:
    """All that can be read and judged beforehand; every fault of every file at once."""
    faults: list[Fault] = []
    campaign = joint = truth = None
    names: tuple[str, ...] = ()
    try:
        check_writable(arguments.output)
        check_distinct(
            {"--output": arguments.output},
            {"CALIBRATION.csv": arguments.calibration, "--joint": arguments.joint, "--truth": arguments.truth},
        )
    except ContractError as error:
        faults += error.faults
    try:
        names = _names(arguments.methods)
    except ContractError as error:
        faults += error.faults
    try:
        truth = None if arguments.truth is None else simulated_joint(load_joint(arguments.truth))
        joint = truth.joint if truth is not None and arguments.joint is None else None
        joint = joint if arguments.joint is None else load_joint(arguments.joint)
    except ContractError as error:
        faults += error.faults
    try:
        campaign = read_campaign(read_whole(arguments.calibration), source=str(arguments.calibration))
        if arguments.exclude_rows:
            campaign = without_rows(campaign, arguments.exclude_rows)
    except ContractError as error:
        faults += error.faults
    if campaign is not None and campaign.temperature_c is None and truth is not None:
        expected = "a campaign with temperatures, at which the joint's true error can be told"
        faults.append(Fault(where="--truth", expected=expected, found=f"{arguments.calibration} without"))
    if arguments.seed < 0:
        faults.append(Fault(where="--seed", expected="0 or more", found=str(arguments.seed)))
    if faults or campaign is None:
        raise ContractError(faults)
    return campaign, joint, truth, names


def _names(text: str | None) -> tuple[str, ...]:
    if text is None:
        return tuple(name for name, entry in METHODS.items() if entry.seconds <= DEAREST_S)
    if text == ALL:
        return tuple(METHODS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    unknown = [name for name in names if name not in METHODS]
    if unknown:
        expected = f"some of {', '.join(METHODS)}, or {ALL}"
        raise ContractError([Fault(where="--methods", expected=expected, found=", ".join(unknown))])
    return names


def _suitable_methods(
    campaign: Campaign, names: tuple[str, ...], base_c: float, faces: int | None
) -> tuple[tuple[Method, ...], tuple[tuple[str, str], ...]]:
    """The methods that the campaign suits, and why the others do not."""
    methods: list[Method] = []
    refused: list[tuple[str, str]] = []
    for name in names:
        entry = METHODS[name]
        try:
            training_set(
                campaign,
                base_temperature_c=base_c if entry.needs_base_temperature else None,
                faces=faces,
                free_offsets=entry.free_offsets,
            )
        except ContractError as error:
            refused.append((name, "; ".join(str(fault) for fault in error.faults)))
        else:
            methods.append(load_method(name, base_temperature_c=base_c))
    if not methods:
        raise ContractError(
            [Fault(where=name, expected="readings that suit the method", found=reason) for name, reason in refused]
        )
    return tuple(methods), tuple(refused)
