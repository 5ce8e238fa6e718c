"""`trueangle report`: one HTML file about a model file and the campaign it is held against."""

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle_training.command import Surroundings
from trueangle_training.dataset import without_rows
from trueangle_training.documents import load_joint
from trueangle_training.files import check_writable, read_whole
from trueangle_training.train_options import excluded_rows

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.report.compared import ComparedMethods
    from trueangle_training.report.inputs import ReportInputs, SweepPoint
    from trueangle_training.report.served import ServedModel


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "report",
        allow_abbrev=False,
        help="write a calibration report about a model file",
        description="Write one self-contained HTML file: identity, errors before and after, maps, harmonics, "
        "methods compared, uncertainty budget and what to know before using the model. The campaign may be the "
        "one of the training or another one of the same joint.",
    )
    parser.add_argument("model", type=Path, metavar="JOINT.onnx")
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="REPORT.html")
    parser.add_argument(
        "--joint", type=Path, metavar="JOINT.yaml", help="for the temperature sensor's uncertainty"
    )
    parser.add_argument("--compare", type=Path, metavar="compare.json", help="of trueangle compare")
    parser.add_argument(
        "--sweep",
        type=Path,
        metavar="SWEEP.json",
        help='hidden nodes: [{"hidden_nodes": 20, "rmse_arcsec": 0.85, "standard_error_arcsec": 0.01}, ...]',
    )
    parser.add_argument(
        "--exclude-rows", type=excluded_rows, default=frozenset(), metavar="N,N-M", help="lines to leave out"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Read, draw, write; 0."""
    inputs = _inputs(arguments, surroundings)
    from trueangle_training.report.writing import write_report

    write_report(arguments.output, inputs)
    surroundings.out.write(f"{'report':<17}{arguments.output}\n")
    return 0


def _inputs(arguments: argparse.Namespace, surroundings: Surroundings) -> "ReportInputs":
    """All files read; every fault of every file at once."""
    from trueangle_training.report.compared import read_comparison
    from trueangle_training.report.inputs import ReportInputs
    from trueangle_training.report.served import served_model

    faults: list[Fault] = []
    model: ServedModel | None = None
    campaign: Campaign | None = None
    joint: Joint | None = None
    comparison: ComparedMethods | None = None
    sweep: tuple[SweepPoint, ...] = ()
    try:
        check_writable(arguments.output)
    except ContractError as error:
        faults += error.faults
    try:
        model = served_model(read_whole(arguments.model), source=str(arguments.model))
    except ContractError as error:
        faults += error.faults
    try:
        campaign = read_campaign(read_whole(arguments.campaign), source=str(arguments.campaign))
        if arguments.exclude_rows:
            campaign = without_rows(campaign, arguments.exclude_rows)
    except ContractError as error:
        faults += error.faults
    try:
        joint = None if arguments.joint is None else load_joint(arguments.joint)
        if arguments.compare is not None:
            comparison = read_comparison(read_whole(arguments.compare), source=str(arguments.compare))
        if arguments.sweep is not None:
            sweep = read_sweep(read_whole(arguments.sweep), source=str(arguments.sweep))
    except ContractError as error:
        faults += error.faults
    if faults or model is None or campaign is None:
        raise ContractError(faults)
    return ReportInputs(
        campaign=campaign,
        model=model,
        metadata=model.metadata,
        model_file=str(arguments.model),
        model_sha256=model.sha256,
        made_on=surroundings.today,
        joint=joint,
        comparison=comparison,
        sweep=sweep,
    )


def read_sweep(data: bytes, *, source: str) -> "tuple[SweepPoint, ...]":
    """Points of a hidden-node sweep, rising; ContractError where they are none."""
    from trueangle_training.report.inputs import SweepPoint

    expected = "a list of {hidden_nodes, rmse_arcsec, standard_error_arcsec}"
    try:
        entries = cast("list[dict[str, Any]]", json.loads(data))
        points = [
            SweepPoint(
                hidden_nodes=int(entry["hidden_nodes"]),
                rmse_arcsec=float(entry["rmse_arcsec"]),
                standard_error_arcsec=None
                if entry.get("standard_error_arcsec") is None
                else float(entry["standard_error_arcsec"]),
            )
            for entry in entries
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ContractError([Fault(where=source, expected=expected, found=str(error))]) from error
    if not isinstance(entries, list) or not all(math.isfinite(point.rmse_arcsec) for point in points):
        raise ContractError(
            [Fault(where=source, expected=expected, found="no list, or an RMSE that is not finite")]
        )
    return tuple(sorted(points, key=lambda point: point.hidden_nodes))
