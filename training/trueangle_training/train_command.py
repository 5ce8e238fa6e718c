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
from trueangle_training.files import write_all
from trueangle_training.methods.registry import METHODS, load_method
from trueangle_training.progress import faults_placed_in, progress_bar
from trueangle_training.train_inputs import (
    DEFAULT_BASE_TEMPERATURE_C,
    TrainInputs,
    base_temperature_c,
    reference_record,
    train_inputs,
)
from trueangle_training.train_options import (
    AUTO,
    STATED_DEFAULTS,
    add_method_options,
    chosen_method,
    excluded_rows,
)

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.dataset import TrainingSet
    from trueangle_training.evaluation.baselines import BaselineScore
    from trueangle_training.evaluation.held_out import HeldOut
    from trueangle_training.hidden_node_sweep import HiddenNodeSweep
    from trueangle_training.methods import Fit, Method
    from trueangle_training.methods.choice import Choice
    from trueangle_training.uncertainty import UncertaintyBudget

TRAINED_FITNESS_S = 5.0
MANY_READINGS = 100_000
MANY_READINGS_TEXT = (
    "take minutes and gigabytes: the means of those taken at one place, in one run and at one temperature give "
    "nearly the same model in seconds"
)
QUICK_S = 2.0
"""Methods whose one training takes longer are held out only when asked for: one training more a temperature."""
MOST_FOLDS = 10
"""Dense sweeps with drifting temperature have more temperatures to leave out, and each training takes longer."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "train",
        allow_abbrev=False,
        help="make a model file from a campaign file",
        description="Train a model of the encoder's error over angle and temperature and write it as an ONNX file "
        "that names its encoder, its campaign and the ranges in which it may be used.",
    )
    parser.add_argument("calibration", type=Path, nargs="?", metavar="CALIBRATION.csv")
    parser.add_argument(
        "--from-simulator",
        type=Path,
        metavar="JOINT.yaml",
        help="train on a simulated campaign of this joint in place of a measured one",
    )
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="PLAN.yaml",
        help="what is simulated (default: 7 temperatures, 3 repeats shifted by a third of the face pitch)",
    )
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
        help="leave out each temperature in turn and state the error there, in the report for other numbers of "
        "hidden nodes as well (default: for quick methods)",
    )
    add_method_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Train, replay, write and report; 0."""
    inputs = train_inputs(arguments, surroundings)
    # These draw in onnx and the method's own libraries: seconds that a fault in the files must not cost.
    from trueangle_training.methods.stages import StagedMethod, Stages
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
    surroundings.err.writelines(f"trueangle: warning: {text}\n" for text in data.warnings)
    if len(data.readings) > MANY_READINGS:
        surroundings.err.write(f"trueangle: warning: {len(data.readings)} readings {MANY_READINGS_TEXT}\n")
    choice = None
    if method is None:
        choice = _choose(arguments, surroundings, data, base_c, source)
        method = choice.chosen
        surroundings.out.writelines(f"{line}\n" for line in choice_lines(choice))
    title = f"training {method.name} on {len(data.readings)} readings"
    with progress_bar(surroundings.err, title) as progress, faults_placed_in(source):
        fit = method.fit(data.readings, seed=arguments.seed, progress=progress)
    check_model(fit.model, data, source=source)
    # The trainings that judge the method leave out the same readings: each part is reduced once for all of them.
    method = method.sharing(Stages()) if isinstance(method, StagedMethod) else method
    judged = choice.held_out if choice is not None else _held_out(arguments, surroundings, data, method)
    held_out = None if isinstance(judged, str) else judged
    budget = _budget(inputs)
    metadata = _metadata(arguments, inputs, data, method, fit, judged, budget)
    model = model_file(fit.model, metadata, budget)
    files = [(arguments.output, model)]
    if arguments.report is not None:
        sweep = _sweep(arguments, surroundings, data, method)
        files.append((arguments.report, _report(arguments, surroundings, inputs, model, sweep)))
    write_all(files)
    baselines = _baselines(arguments, inputs, data, base_c)
    lines = report_lines(metadata, data, fit, held_out, baselines, budget, source=source)
    surroundings.out.writelines(f"{line}\n" for line in lines)
    surroundings.out.write(f"{'file':<17}{arguments.output}\n")
    surroundings.out.write(f"{'SHA-256':<17}{hashlib.sha256(model).hexdigest()}\n")
    return 0


def _report(
    arguments: argparse.Namespace,
    surroundings: Surroundings,
    inputs: TrainInputs,
    model: bytes,
    sweep: "HiddenNodeSweep | None",
) -> bytes:
    from trueangle_training.report.inputs import ReportInputs
    from trueangle_training.report.served import served_model
    from trueangle_training.report.writing import report_page

    served = served_model(model, source=str(arguments.output))
    report = ReportInputs(
        campaign=inputs.campaign,
        model=served,
        metadata=served.metadata,
        model_file=str(arguments.output),
        model_sha256=served.sha256,
        made_on=surroundings.today,
        joint=inputs.joint,
        sweep=sweep,
    )
    return report_page(report).encode()


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
    parameters, validation_fraction, base_order = 0, 0.0, None
    if method is not None and entry is not None and entry.paper_network:
        from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnPaper
        from trueangle_training.network import parameter_count

        assert isinstance(method, FeGabpnnPaper)  # noqa: S101 - what the registry says of it
        parameters = parameter_count(method.options.hidden_nodes)
        validation_fraction, base_order = method.options.validation_fraction, method.options.order
    return training_set(
        inputs.campaign,
        base_temperature_c=base_c if entry is not None and entry.needs_base_temperature else None,
        base_order=base_order,
        joint_base_temperature_c=None if inputs.joint is None else inputs.joint.base_temperature_c,
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
) -> "HeldOut | str":
    """Leave-one-temperature-out of the method, or why there is none."""
    from trueangle_training.evaluation.held_out import HeldOutKind, hold_out, temperature_folds

    folds = temperature_folds(data.readings)
    if not folds:
        return "it takes three temperatures or more"
    if arguments.held_out == "none":
        return "not wanted (--held-out none)"
    if arguments.held_out is None:
        seconds = _training_s(arguments, method)
        if seconds > QUICK_S or len(folds) > MOST_FOLDS:
            return f"{len(folds)} trainings of about {seconds:g} s or more each: --held-out temperature makes them"
    done = 0
    with progress_bar(surroundings.err, f"leaving out each of {len(folds)} temperatures") as progress:

        def step() -> None:
            nonlocal done
            done += 1
            progress(done, len(folds))

        held_out = hold_out(
            data.readings, method, HeldOutKind.TEMPERATURE, folds, seed=arguments.seed, progress=step
        )
    return held_out if held_out.known.any() else held_out.refused[0]


def _baselines(
    arguments: argparse.Namespace, inputs: TrainInputs, data: "TrainingSet", base_c: float
) -> "tuple[BaselineScore, ...]":
    """What the model must beat; without temperatures that is no correction alone."""
    from trueangle_training.evaluation.baselines import NoCorrection, baseline_methods, baseline_scores

    known = inputs.campaign.temperature_c is not None
    methods = baseline_methods(data.readings, base_temperature_c=base_c) if known else (NoCorrection(),)
    return baseline_scores(data.readings, methods, seed=arguments.seed)


def _training_s(arguments: argparse.Namespace, method: "Method") -> float:
    """About what one training takes: where individuals are trained before they are rated, dozens of times more."""
    entry = METHODS[method.name]
    trained = (
        entry.paper_network and (arguments.fitness or STATED_DEFAULTS["fitness"]) != STATED_DEFAULTS["fitness"]
    )
    return TRAINED_FITNESS_S if trained else entry.seconds


def _sweep(
    arguments: argparse.Namespace, surroundings: Surroundings, data: "TrainingSet", method: "Method"
) -> "HiddenNodeSweep | None":
    """Numbers of hidden nodes for the report; None: no network, not wanted, or seconds turn into a minute."""
    from trueangle_training.evaluation.held_out import temperature_folds
    from trueangle_training.hidden_node_sweep import announced_sweep

    quick = len(temperature_folds(data.readings)) <= MOST_FOLDS or METHODS[method.name].paper_network
    if arguments.held_out == "none" or not (quick or arguments.held_out == "temperature"):
        return None
    return announced_sweep(surroundings.err, data.readings, method, seed=arguments.seed)


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
    judged: "HeldOut | str",
    budget: "UncertaintyBudget",
) -> ModelMetadata:
    from trueangle_training.dataset import centred_rms
    from trueangle_training.model_file import model_inputs, model_probes, package_versions

    readings, joint = data.readings, inputs.joint
    settings = document_from_plain(dict(fit.settings), source="options")
    residual = readings.error_arcsec - fit.model.error_arcsec(readings.angle_deg, readings.temperature_c)
    held_out = None if isinstance(judged, str) else judged
    rmse = None if held_out is None else held_out.rmse_arcsec
    unjudged = (f"not judged at left-out temperatures: {judged}",) if isinstance(judged, str) else ()
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
        versions=package_versions(torch=METHODS[method.name].paper_network),
        probes=model_probes(
            fit.model, datum_deg=data.datum_deg, temperature_c=data.valid_temperature_c, budget=budget
        ),
        notes=(*data.notes, *data.warnings, *_binding_notes(inputs), *unjudged, *fit.notes),
    )
