"""`trueangle train`: from a campaign file to a model file.

Everything that can be judged beforehand is, so that nobody waits for a training whose result cannot be kept. Heavy
libraries are drawn in only when the training begins, torch only by the methods that need it.
"""

import argparse
import hashlib
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from trueangle.contract.document import Node, document_from_plain
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import SCHEMA_VERSION, SIGN_CONVENTION, FitErrors, ModelMetadata
from trueangle_training.command import Surroundings
from trueangle_training.files import write_whole
from trueangle_training.methods.registry import METHODS, load_method
from trueangle_training.progress import faults_placed_in, progress_bar
from trueangle_training.train_inputs import (
    DEFAULT_BASE_TEMPERATURE_C,
    TrainInputs,
    base_temperature_c,
    reference_record,
    train_inputs,
)
from trueangle_training.train_options import AUTO, add_method_options, chosen_method, excluded_rows

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.dataset import TrainingSet
    from trueangle_training.evaluation.held_out import HeldOut
    from trueangle_training.methods import Fit, Method
    from trueangle_training.methods.choice import Choice
    from trueangle_training.uncertainty import UncertaintyBudget

QUICK_S = 2.0
"""Methods whose one training takes longer are held out only when asked for: one training more a temperature."""
PLAIN_PLACES = 30
SHIFTED_COST = 5.0
"""Repeats shifted against each other have more places than a polygon has faces and train so many times as long."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "train",
        allow_abbrev=False,
        help="make a model file from a campaign file",
        description="Train a model of the encoder's error over angle and temperature and write it as an ONNX file "
        "that names its encoder, its campaign and the ranges in which it may be used.",
    )
    parser.add_argument("calibration", type=Path, metavar="CALIBRATION.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="JOINT.onnx")
    parser.add_argument("--joint", type=Path, metavar="JOINT.yaml", help="encoder, reference and base temperature")
    parser.add_argument(
        "--counts-per-rev", type=int, metavar="N", help="of the encoder, where no --joint is given"
    )
    parser.add_argument("--lines-per-rev", type=int, metavar="N", help="of the encoder, where no --joint is given")
    parser.add_argument(
        "--base-temperature-c",
        type=float,
        metavar="T",
        help=f"where the paper's methods take their Fourier base (default: the joint's, else "
        f"{DEFAULT_BASE_TEMPERATURE_C:g})",
    )
    parser.add_argument(
        "--exclude-rows",
        type=excluded_rows,
        default=frozenset(),
        metavar="N,N-M",
        help="lines of the campaign file to leave out; the model file says so",
    )
    parser.add_argument("--report", type=Path, metavar="REPORT.html", help="write the calibration report as well")
    parser.add_argument("--name", help="of the joint (default: JOINT.yaml's, else the output's)")
    parser.add_argument("--calibrated", metavar="YYYY-MM-DD", help="day of the campaign (default: today)")
    parser.add_argument("--due", metavar="YYYY-MM-DD", help="day after which the calibration is past due")
    parser.add_argument("--seed", type=int, default=0, help="of whatever the method draws by chance (default 0)")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="processor threads (default 1)")
    parser.add_argument(
        "--held-out",
        choices=("temperature", "none"),
        help="leave out each temperature in turn and state the error there (default: for quick methods)",
    )
    add_method_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Train, replay, write and report; 0."""
    inputs = train_inputs(arguments, surroundings)
    # These draw in onnx and the method's own libraries: seconds that a fault in the files must not cost.
    from trueangle_training.model_file import model_file
    from trueangle_training.plausibility import check_model
    from trueangle_training.train_report import choice_lines, report_lines

    source = inputs.campaign.source
    base_c = base_temperature_c(arguments, inputs.joint)
    if inputs.campaign.temperature_c is None:
        method = _method_without_temperature(arguments, source)
    else:
        method = None if arguments.method == AUTO else chosen_method(arguments, base_temperature_c=base_c)
    data = _training_set(arguments, inputs, method, base_c)
    choice = None
    if method is None:
        choice = _choose(arguments, surroundings, data, base_c, source)
        method = choice.chosen
        surroundings.out.writelines(f"{line}\n" for line in choice_lines(choice))
    title = f"training {method.name} on {len(data.readings)} readings"
    with progress_bar(surroundings.err, title) as progress, faults_placed_in(source):
        fit = method.fit(data.readings, seed=arguments.seed, progress=progress)
    check_model(fit.model, data, source=source)
    held_out = choice.held_out if choice is not None else _held_out(arguments, surroundings, data, method)
    budget = _budget(inputs)
    metadata = _metadata(arguments, inputs, data, method, fit, held_out, budget)
    model = model_file(fit.model, metadata, budget)
    write_whole(arguments.output, model)
    if arguments.report is not None:
        _write_report(arguments, surroundings, inputs, model)
    lines = report_lines(metadata, data, fit, held_out, budget, source=source)
    surroundings.out.writelines(f"{line}\n" for line in lines)
    surroundings.out.write(f"{'file':<17}{arguments.output}\n")
    surroundings.out.write(f"{'SHA-256':<17}{hashlib.sha256(model).hexdigest()}\n")
    return 0


def _write_report(
    arguments: argparse.Namespace, surroundings: Surroundings, inputs: TrainInputs, model: bytes
) -> None:
    from trueangle_training.report.inputs import ReportInputs
    from trueangle_training.report.served import served_model
    from trueangle_training.report.writing import write_report

    served = served_model(model, source=str(arguments.output))
    report = ReportInputs(
        campaign=inputs.campaign,
        model=served,
        metadata=served.metadata,
        model_file=str(arguments.output),
        model_sha256=served.sha256,
        made_on=surroundings.today,
        joint=inputs.joint,
    )
    write_report(arguments.report, report)


def _method_without_temperature(arguments: argparse.Namespace, source: str) -> "Method":
    """Harmonics of the angle, if the user agreed to a model that ignores temperature."""
    if arguments.method not in ("angle-only", "linear", AUTO):
        fault = Fault(
            where=f"{source}, column temperature_c",
            expected=f"temperatures for the method {arguments.method}",
            found="no such column",
            advice="measure them, or choose --method angle-only for a model that ignores temperature",
        )
        raise ContractError([fault])
    from trueangle_training.angle_only_campaign import AngleHarmonics

    return AngleHarmonics()


def _binding_notes(inputs: TrainInputs) -> tuple[str, ...]:
    """What the daemon will not be able to notice, because nobody stated it at calibration."""
    settings = EncoderSettings() if inputs.encoder is None else inputs.encoder.settings
    meanings = {
        "serial_number": "another encoder",
        "operating_parameters": "a reversed code sequence",
        "preset_value": "a preset",
    }
    missing = [meaning for name, meaning in meanings.items() if getattr(settings, name) is None]
    if not missing:
        return ()
    return (
        f"not bound to its encoder's settings (JOINT.yaml, encoder.settings): {', '.join(missing)} goes unnoticed",
    )


def _training_set(
    arguments: argparse.Namespace, inputs: TrainInputs, method: "Method | None", base_c: float
) -> "TrainingSet":
    """The campaign checked for what the method needs; for `auto`, for what all its candidates need."""
    if inputs.campaign.temperature_c is None:
        from trueangle_training.angle_only_campaign import angle_only_set

        return angle_only_set(
            inputs.campaign, faces=None if inputs.joint is None else inputs.joint.reference.faces
        )
    from trueangle_training.dataset import training_set

    entry = METHODS.get(arguments.method)
    parameters, validation_fraction = 0, 0.0
    if method is not None and entry is not None and entry.paper_network:
        from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnPaper
        from trueangle_training.network import parameter_count

        assert isinstance(method, FeGabpnnPaper)  # noqa: S101 - what the registry says of it
        parameters = parameter_count(method.options.hidden_nodes)
        validation_fraction = method.options.validation_fraction
    return training_set(
        inputs.campaign,
        base_temperature_c=base_c if entry is not None and entry.needs_base_temperature else None,
        parameters=parameters,
        validation_fraction=validation_fraction,
        faces=None if inputs.joint is None else inputs.joint.reference.faces,
        free_offsets=entry is None or entry.free_offsets,
    )


def _choose(
    arguments: argparse.Namespace, surroundings: Surroundings, data: "TrainingSet", base_c: float, source: str
) -> "Choice":
    from trueangle_training.methods.choice import automatic_names, choose

    methods = [load_method(name, base_temperature_c=base_c) for name in automatic_names()]
    title = f"choosing among {', '.join(method.name for method in methods)}"
    with progress_bar(surroundings.err, title) as progress, faults_placed_in(source):
        return choose(data.readings, methods, seed=arguments.seed, clock=time.perf_counter, progress=progress)


def _held_out(
    arguments: argparse.Namespace, surroundings: Surroundings, data: "TrainingSet", method: "Method"
) -> "HeldOut | None":
    """Leave-one-temperature-out of the method; None: not wanted, or too few temperatures."""
    from trueangle_training.evaluation.held_out import HeldOutKind, hold_out, temperature_folds
    from trueangle_training.methods import distinct_angle_count

    plain = distinct_angle_count(data.readings.angle_deg) <= PLAIN_PLACES
    quick = METHODS[method.name].seconds * (1.0 if plain else SHIFTED_COST) <= QUICK_S
    wanted = arguments.held_out == "temperature" or (arguments.held_out is None and quick)
    folds = temperature_folds(data.readings) if wanted else ()
    if not folds:
        return None
    done = 0
    with progress_bar(surroundings.err, f"leaving out each of {len(folds)} temperatures") as progress:

        def step() -> None:
            nonlocal done
            done += 1
            progress(done, len(folds))

        held_out = hold_out(
            data.readings, method, HeldOutKind.TEMPERATURE, folds, seed=arguments.seed, progress=step
        )
    return held_out if held_out.known.any() else None


def _budget(inputs: TrainInputs) -> "UncertaintyBudget":
    """What reference and sensor add, from JOINT.yaml; nothing where nothing is stated."""
    from trueangle_training.uncertainty import UncertaintyBudget

    reference = reference_record(inputs.joint, inputs.campaign)
    return UncertaintyBudget(
        reference_arcsec=reference.standard_uncertainty_arcsec or 0.0,
        temperature_c=0.0 if inputs.joint is None else inputs.joint.temperature_sensor.standard_uncertainty_c,
    )


def _metadata(
    arguments: argparse.Namespace,
    inputs: TrainInputs,
    data: "TrainingSet",
    method: "Method",
    fit: "Fit",
    held_out: "HeldOut | None",
    budget: "UncertaintyBudget",
) -> ModelMetadata:
    from trueangle_training.dataset import centred_rms
    from trueangle_training.model_file import model_inputs, model_probes, package_versions

    readings, joint = data.readings, inputs.joint
    settings = document_from_plain(dict(fit.settings), source="options")
    residual = readings.error_arcsec - fit.model.error_arcsec(readings.angle_deg, readings.temperature_c)
    rmse = None if held_out is None else held_out.rmse_arcsec
    if fit.model.datum_deg != data.datum_deg:
        found = f"{fit.model.datum_deg:g} deg"
        raise ContractError([Fault(where="model", expected=f"datum {data.datum_deg:g} deg", found=found)])
    return ModelMetadata(
        schema_version=SCHEMA_VERSION,
        joint=arguments.name or (joint.name if joint is not None else arguments.output.stem),
        method=method.name,
        method_settings=cast("Mapping[str, Node]", settings.value),
        inputs=model_inputs(data.valid_angle_deg, data.valid_temperature_c),
        sign_convention=SIGN_CONVENTION,
        temperature_used=fit.model.temperature_used,
        datum_deg=data.datum_deg,
        encoder=inputs.encoder,
        calibration=replace(inputs.record, readings=len(readings)),
        reference=reference_record(joint, inputs.campaign),
        errors=FitErrors(
            in_sample_rmse_arcsec=centred_rms(residual, readings),
            held_out_rmse_arcsec=rmse,
            held_out_kind=None if held_out is None or rmse is None else held_out.kind.value,
        ),
        seed=arguments.seed,
        versions=package_versions(),
        probes=model_probes(
            fit.model, datum_deg=data.datum_deg, temperature_c=data.valid_temperature_c, budget=budget
        ),
        notes=(*data.notes, *_binding_notes(inputs), *fit.notes),
    )
