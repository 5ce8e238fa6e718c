"""`trueangle simulate`: a campaign file from a joint that is only described."""

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueangle.contract.calibration import Campaign, campaign_to_csv
from trueangle.contract.errors import ContractError, Fault
from trueangle_training.command import Surroundings
from trueangle_training.documents import load_joint, load_plan
from trueangle_training.files import check_distinct, check_writable, write_whole
from trueangle_training.progress import progress_bar
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint
from trueangle_training.simulator.schedule import legs

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers

QUICKLY_MADE = 50_000
"""Readings up to which nobody waits."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "simulate",
        allow_abbrev=False,
        help="make a campaign file from a simulated joint",
        description="Simulate a calibration campaign: JOINT.yaml says how the joint errs, PLAN.yaml what is "
        "measured. The same files and seed give the same bytes.",
    )
    parser.add_argument("--joint", type=Path, required=True, metavar="JOINT.yaml")
    parser.add_argument("--plan", type=Path, required=True, metavar="PLAN.yaml")
    parser.add_argument("--seed", type=int, required=True, help="of all noise, 0 or more")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.csv")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Simulate and write; 0."""
    faults: list[Fault] = []
    joint = plan = None
    # Both files and the place for the result are looked at before any of their faults is told.
    try:
        joint = simulated_joint(load_joint(arguments.joint))
    except ContractError as error:
        faults += error.faults
    try:
        plan = load_plan(arguments.plan)
    except ContractError as error:
        faults += error.faults
    try:
        check_writable(arguments.output)
        check_distinct({"--output": arguments.output}, {"--joint": arguments.joint, "--plan": arguments.plan})
    except ContractError as error:
        faults += error.faults
    if arguments.seed < 0:
        faults.append(Fault(where="--seed", expected="0 or more", found=str(arguments.seed)))
    if faults or joint is None or plan is None:
        raise ContractError(faults)
    readings = sum(leg.true_deg.size for leg in legs(plan))
    shown = progress_bar(surroundings.err, f"simulating {readings} readings")
    with shown if readings > QUICKLY_MADE else contextlib.nullcontext(_silent) as progress:
        campaign = simulate_campaign(joint, plan, arguments.seed)
        progress(1, 2)
        _write(arguments, joint.joint.name, campaign)
    error_arcsec = campaign.error_arcsec
    surroundings.out.write(
        f"{arguments.output}: {len(campaign)} readings in {np.unique(campaign.run).size} runs; "
        f"error {error_arcsec.min():.1f} .. {error_arcsec.max():.1f} arcsec, "
        f"RMS {np.sqrt(np.mean(error_arcsec**2)):.1f} arcsec from the datum\n"
    )
    return 0


def _silent(done: int, total: int) -> None:
    """No bar where there is nothing to wait for."""


def _write(arguments: argparse.Namespace, joint: str, campaign: Campaign) -> None:
    comments = (
        f"Simulated by trueangle, not measured: joint {joint}, seed {arguments.seed}.",
        "error_arcsec = indicated - reference, zeroed at the first reading of each zero group (Eq. 11).",
    )
    write_whole(arguments.output, campaign_to_csv(campaign, comments=comments).encode())
