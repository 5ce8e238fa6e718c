"""`trueangle report`: one HTML file about a model file and the campaign it is held against."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle_training.command import Surroundings
from trueangle_training.dataset import training_set, without_rows
from trueangle_training.documents import load_joint
from trueangle_training.files import check_distinct, check_writable, read_whole, write_whole
from trueangle_training.methods.registry import DEFAULT_BASE_TEMPERATURE_C, METHODS, load_method
from trueangle_training.train_options import excluded_rows

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.hidden_node_sweep import HiddenNodeSweep
    from trueangle_training.report.compared import ComparedMethods
    from trueangle_training.report.inputs import ReportInputs
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
        "--exclude-rows", type=excluded_rows, default=frozenset(), metavar="N,N-M", help="lines to leave out"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Read, draw, write; 0."""
    inputs = _inputs(arguments, surroundings)
    inputs = replace(inputs, sweep=_sweep(inputs, surroundings))
    from trueangle_training.report.writing import report_page

    write_whole(arguments.output, report_page(inputs).encode())
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
    try:
        check_writable(arguments.output)
        check_distinct(
            {"--output": arguments.output},
            {
                "JOINT.onnx": arguments.model,
                "CAMPAIGN.csv": arguments.campaign,
                "--joint": arguments.joint,
                "--compare": arguments.compare,
            },
        )
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
    )


def _sweep(inputs: "ReportInputs", surroundings: Surroundings) -> "HiddenNodeSweep | None":
    """That of the comparison, else one made of these readings; None: no network, or unfit for training."""
    from trueangle_training.hidden_node_sweep import announced_sweep, has_hidden_nodes

    name, campaign, comparison = inputs.metadata.method, inputs.campaign, inputs.comparison
    if comparison is not None and comparison.campaign_sha256 == campaign.sha256:
        compared = comparison.sweep(name)
        if compared is not None:
            return compared
    if not has_hidden_nodes(name):
        return None
    settings = inputs.metadata.method_settings
    base_c = settings["base_temperature_c"].plain() if "base_temperature_c" in settings else None
    base_c = float(base_c) if isinstance(base_c, int | float) else DEFAULT_BASE_TEMPERATURE_C
    entry = METHODS[name]
    try:
        data = training_set(
            campaign,
            base_temperature_c=base_c if entry.needs_base_temperature else None,
            faces=None if inputs.joint is None else inputs.joint.reference.faces,
            free_offsets=entry.free_offsets,
        )
    except ContractError as error:
        # A campaign to verify a model may be too small or too odd to train on; the report shows all the rest.
        surroundings.err.write(f"no hidden-node sweep: {error.faults[0]}\n")
        return None
    method = load_method(name, base_temperature_c=base_c)
    return announced_sweep(surroundings.err, data.readings, method, seed=inputs.metadata.seed)
