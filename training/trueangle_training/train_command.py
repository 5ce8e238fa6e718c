"""`trueangle train`: from a campaign file to a model file.

Everything that can be judged beforehand is, so that nobody waits for a training whose result cannot be kept. torch
and onnx are drawn in only when the training begins: `trueangle --help` does not wait for them.
"""

import argparse
import contextlib
import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

import numpy as np

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.document import Node, document_from_plain, plain, structure
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint, JointEncoder, ReferenceKind
from trueangle.contract.metadata import (
    SCHEMA_VERSION,
    SIGN_CONVENTION,
    CalibrationRecord,
    FitErrors,
    ModelMetadata,
    ReferenceRecord,
)
from trueangle_training.command import Surroundings
from trueangle_training.documents import load_joint
from trueangle_training.files import check_writable, read_whole, write_whole
from trueangle_training.train_options import add_method_options, method_options

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.dataset import TrainingSet
    from trueangle_training.methods.fe_gabpnn import FeGabpnnOptions, FeGabpnnTraining

METHOD = "fe-gabpnn"
DEFAULT_BASE_TEMPERATURE_C = 20.0
IN_SAMPLE_NOTE = "(the readings it was trained on: says little about other angles and temperatures)"
VALIDATION_NOTE = "(random readings kept back to stop the training, at the same angles and temperatures)"
DATUM_NOTE = "a drift that is the same at all angles: runs zeroed one by one (Eq. 11) cannot show it"
SERVED_NOTE = "(the same readings as they would be served: each run's first reading adds its noise to the run)"
Progress = Callable[[int, int], None]


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "train",
        allow_abbrev=False,
        help="make a model file from a campaign file",
        description="Train a model of the encoder's error over angle and temperature (FE-GABPNN) and write it as "
        "an ONNX file that names its encoder, its campaign and the ranges in which it may be used.",
    )
    parser.add_argument("calibration", type=Path, metavar="CALIBRATION.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="JOINT.onnx")
    parser.add_argument("--joint", type=Path, metavar="JOINT.yaml", help="encoder, reference and base temperature")
    parser.add_argument(
        "--counts-per-rev", type=int, metavar="N", help="of the encoder, where no --joint is given"
    )
    parser.add_argument("--lines-per-rev", type=int, metavar="N", help="of the encoder, where no --joint is given")
    parser.add_argument("--base-temperature-c", type=float, metavar="T", help="where the Fourier base is taken")
    parser.add_argument("--name", help="of the joint (default: JOINT.yaml's, else the output's)")
    parser.add_argument("--calibrated", metavar="YYYY-MM-DD", help="day of the campaign (default: today)")
    parser.add_argument("--due", metavar="YYYY-MM-DD", help="day after which the calibration is past due")
    parser.add_argument("--seed", type=int, default=0, help="of split, start and genetic algorithm (default 0)")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="processor threads (default 1)")
    add_method_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Train, replay, write and report; 0."""
    campaign, joint, encoder, record = _inputs(arguments, surroundings)
    # These draw in torch: seconds that a fault in the files must not cost.
    from trueangle_training.dataset import training_set
    from trueangle_training.methods.fe_gabpnn import train_fe_gabpnn
    from trueangle_training.model_file import model_file
    from trueangle_training.network import parameter_count
    from trueangle_training.plausibility import check_model

    base_temperature_c = _base_temperature_c(arguments, joint)
    options = method_options(arguments, base_temperature_c=base_temperature_c, datum_deg=0.0)
    data = training_set(
        campaign,
        base_temperature_c=base_temperature_c,
        parameters=parameter_count(options.hidden_nodes),
        validation_fraction=options.validation_fraction,
        faces=None if joint is None else joint.reference.faces,
    )
    options = replace(options, datum_deg=data.datum_deg)
    title = f"training {METHOD} on {len(data.readings)} readings"
    with _progress(surroundings.err, title) as progress, _faults_placed_in(campaign.source):
        training = train_fe_gabpnn(data.readings, options, progress)
    check_model(training.model, data, source=campaign.source)
    metadata = _metadata(
        name=arguments.name or (joint.name if joint is not None else arguments.output.stem),
        data=data,
        options=options,
        training=training,
        encoder=encoder,
        record=replace(record, readings=len(data.readings)),
        reference=_reference(joint, campaign),
    )
    model = model_file(training.model, metadata)
    write_whole(arguments.output, model)
    _report(surroundings.out, metadata=metadata, data=data, training=training, campaign=campaign)
    surroundings.out.write(f"{'file':<17}{arguments.output}\n")
    surroundings.out.write(f"{'SHA-256':<17}{hashlib.sha256(model).hexdigest()}\n")
    return 0


def _inputs(
    arguments: argparse.Namespace, surroundings: Surroundings
) -> tuple[Campaign, Joint | None, JointEncoder, CalibrationRecord]:
    """All that can be read and judged without training; every fault of every file at once."""
    faults: list[Fault] = []
    campaign = joint = encoder = record = None
    try:
        check_writable(arguments.output)
        _check_not_an_input(arguments)
    except ContractError as error:
        faults += error.faults
    try:
        joint = None if arguments.joint is None else load_joint(arguments.joint)
        encoder = _encoder(arguments, joint)
    except ContractError as error:
        faults += error.faults
    try:
        campaign = read_campaign(read_whole(arguments.calibration), source=str(arguments.calibration))
        record = _calibration_record(arguments, surroundings, campaign)
    except ContractError as error:
        faults += error.faults
    if faults or campaign is None or encoder is None or record is None:
        raise ContractError(faults)
    return campaign, joint, encoder, record


def _check_not_an_input(arguments: argparse.Namespace) -> None:
    for given in (arguments.calibration, arguments.joint):
        if given is not None and given.exists() and arguments.output.exists() and given.samefile(arguments.output):
            expected = "another file than the inputs"
            raise ContractError([Fault(where="--output", expected=expected, found=str(arguments.output))])


def _encoder(arguments: argparse.Namespace, joint: Joint | None) -> JointEncoder:
    """The encoder that the model is bound to, from JOINT.yaml or from the command line, never from both."""
    given = {
        name: value
        for name in ("lines_per_rev", "counts_per_rev")
        if (value := getattr(arguments, name)) is not None
    }
    if joint is not None:
        if given:
            found = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            raise ContractError([Fault(where="--joint", expected="the encoder from JOINT.yaml only", found=found)])
        # The daemon compares the node's units per revolution with the model's, so they always stand there.
        encoder = joint.encoder
        return replace(encoder, settings=replace(encoder.settings, units_per_revolution=encoder.counts_per_rev))
    if len(given) < 2:
        raise ContractError(
            [
                Fault(
                    where="encoder",
                    expected="--joint JOINT.yaml, or --counts-per-rev and --lines-per-rev",
                    found=", ".join(f"only {name}" for name in given) or "neither",
                    advice="a model is bound to its encoder",
                )
            ]
        )
    encoder = structure(JointEncoder, document_from_plain(given, source="command line"))
    return replace(encoder, settings=EncoderSettings(units_per_revolution=encoder.counts_per_rev))


def _calibration_record(
    arguments: argparse.Namespace, surroundings: Surroundings, campaign: Campaign
) -> CalibrationRecord:
    date = arguments.calibrated or surroundings.today.isoformat()
    values = {
        "id": f"{arguments.calibration.stem}-{campaign.sha256[:12]}",
        "file_sha256": campaign.sha256,
        "readings": len(campaign),
        "date": date,
        **({} if arguments.due is None else {"due": arguments.due}),
    }
    record = structure(CalibrationRecord, document_from_plain(values, source="command line"))
    faults: list[Fault] = []
    if record.due is not None and record.due < record.date:
        expected = f"a day not before the calibration ({record.date})"
        faults.append(Fault(where="--due", expected=expected, found=record.due))
    if record.date > surroundings.today.isoformat():
        expected = f"today ({surroundings.today.isoformat()}) or before"
        faults.append(Fault(where="--calibrated", expected=expected, found=record.date))
    if faults:
        raise ContractError(faults)
    return record


def _base_temperature_c(arguments: argparse.Namespace, joint: Joint | None) -> float:
    if arguments.base_temperature_c is not None:
        return arguments.base_temperature_c
    return DEFAULT_BASE_TEMPERATURE_C if joint is None else joint.base_temperature_c


def _reference(joint: Joint | None, campaign: Campaign) -> ReferenceRecord:
    if joint is not None:
        reference = joint.reference
        # Nothing stated in JOINT.yaml is read as 0 there, and 0 would claim a perfect reference here.
        uncertainty = float(np.hypot(reference.autocollimator_arcsec, reference.polygon_arcsec)) or None
        return ReferenceRecord(
            kind=reference.kind.value,
            standard_uncertainty_arcsec=uncertainty,
            faces=reference.faces,
            certificate_id=reference.certificate_id,
        )
    if campaign.face is None:
        return ReferenceRecord(kind="not stated")
    faces = int(campaign.face.max())
    if faces == 0:
        return ReferenceRecord(kind=ReferenceKind.ENCODER.value)
    return ReferenceRecord(kind=ReferenceKind.POLYGON.value, faces=faces)


def _metadata(
    *,
    name: str,
    data: "TrainingSet",
    options: "FeGabpnnOptions",
    training: "FeGabpnnTraining",
    encoder: JointEncoder,
    record: CalibrationRecord,
    reference: ReferenceRecord,
) -> ModelMetadata:
    from trueangle_training.model_file import model_inputs, model_probes, package_versions

    settings = document_from_plain(plain(options), source="options")
    return ModelMetadata(
        schema_version=SCHEMA_VERSION,
        joint=name,
        method=METHOD,
        method_settings=cast("Mapping[str, Node]", settings.value),
        inputs=model_inputs(data.valid_angle_deg, data.valid_temperature_c),
        sign_convention=SIGN_CONVENTION,
        temperature_used=True,
        datum_deg=data.datum_deg,
        encoder=encoder,
        calibration=record,
        reference=reference,
        errors=FitErrors(
            in_sample_rmse_arcsec=training.residual_rms_arcsec,
            validation_rmse_arcsec=training.validation_rms_arcsec,
        ),
        seed=options.seed,
        versions=package_versions(),
        probes=model_probes(training.model, datum_deg=data.datum_deg, temperature_c=data.valid_temperature_c),
        notes=data.notes,
    )


@contextlib.contextmanager
def _faults_placed_in(source: str) -> Iterator[None]:
    """The method names arrays where its readings do not suit it; the user knows the file."""
    try:
        yield
    except ContractError as error:
        placed = [replace(fault, where=f"{source}, {fault.where}") for fault in error.faults]
        raise ContractError(placed) from error


@contextlib.contextmanager
def _progress(err: TextIO, title: str) -> Iterator[Progress]:
    """A bar on a terminal; elsewhere one line at the start, because a log is no place for a bar."""
    if not err.isatty():
        err.write(f"{title}\n")
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(file=err), transient=True) as bars:
        bar = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(bar, completed=done, total=total)


def _served_rms_arcsec(data: "TrainingSet", training: "FeGabpnnTraining") -> float:
    """RMS of the readings after correction, counted from the datum as the daemon serves angles."""
    readings = data.readings
    left = readings.error_arcsec - training.model.error_arcsec(readings.angle_deg, readings.temperature_c)
    return float(np.sqrt(np.mean(left**2)))


def _report(
    out: TextIO, *, metadata: ModelMetadata, data: "TrainingSet", training: "FeGabpnnTraining", campaign: Campaign
) -> None:
    angle, temperature = metadata.valid_angle_deg, metadata.valid_temperature_c
    rows = [
        ("joint", metadata.joint),
        ("method", f"{metadata.method}, seed {metadata.seed}"),
        ("stopped", f"after {training.epochs} epochs: {training.stop_reason.value}"),
        ("readings", f"{len(data.readings)} in {np.unique(data.readings.run).size} runs of {campaign.source}"),
        ("raw RMS", f"{data.raw_rms_arcsec:.2f} arcsec, from the datum at {metadata.datum_deg:.4g} deg"),
        ("in-sample RMSE", f"{training.residual_rms_arcsec:.2f} arcsec {IN_SAMPLE_NOTE}"),
        ("from the datum", f"{_served_rms_arcsec(data, training):.2f} arcsec {SERVED_NOTE}"),
        ("validation RMSE", f"{training.validation_rms_arcsec:.2f} arcsec {VALIDATION_NOTE}"),
        ("not visible", DATUM_NOTE),
        ("valid angles", f"{angle.minimum:g} .. {angle.maximum:g} deg"),
        ("valid temp.", f"{temperature.minimum:g} .. {temperature.maximum:g} degC"),
        *(("note", note) for note in data.notes),
    ]
    out.writelines(f"{name:<17}{text}\n" for name, text in rows)
