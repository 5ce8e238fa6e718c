"""What `trueangle train` is given: campaign, joint and encoder, and what is recorded of them in the model file."""

import argparse
from dataclasses import dataclass, replace

import numpy as np

from trueangle.contract.calibration import Campaign, read_campaign
from trueangle.contract.document import document_from_plain, structure
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint, JointEncoder, ReferenceKind
from trueangle.contract.metadata import CalibrationRecord, ReferenceRecord
from trueangle_training.command import Surroundings
from trueangle_training.dataset import without_rows
from trueangle_training.documents import load_joint
from trueangle_training.files import check_distinct, check_writable, read_whole
from trueangle_training.train_options import option_faults

DEFAULT_BASE_TEMPERATURE_C = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainInputs:
    """All that is read before training."""

    campaign: Campaign
    joint: Joint | None
    """None: no JOINT.yaml was given."""
    encoder: JointEncoder | None
    """None: not stated."""
    record: CalibrationRecord


def train_inputs(arguments: argparse.Namespace, surroundings: Surroundings) -> TrainInputs:
    """All that can be read and judged without training; every fault of every file at once."""
    faults: list[Fault] = option_faults(arguments)
    campaign = joint = encoder = record = None
    try:
        check_writable(arguments.output)
        if arguments.report is not None:
            check_writable(arguments.report)
        check_distinct(
            {"--output": arguments.output, "--report": arguments.report},
            {
                "CALIBRATION.csv": arguments.calibration,
                "--joint": arguments.joint,
                "--from-simulator": arguments.from_simulator,
                "--plan": arguments.plan,
            },
        )
    except ContractError as error:
        faults += error.faults
    faults += _source_faults(arguments)
    try:
        described = arguments.joint or arguments.from_simulator
        joint = None if described is None else load_joint(described)
        encoder = _encoder(arguments, joint)
    except ContractError as error:
        faults += error.faults
    try:
        campaign = _campaign(arguments, joint)
        if campaign is not None and arguments.exclude_rows:
            campaign = without_rows(campaign, arguments.exclude_rows)
        record = None if campaign is None else _calibration_record(arguments, surroundings, campaign)
    except ContractError as error:
        faults += error.faults
    if faults or campaign is None or record is None:
        raise ContractError(faults)
    return TrainInputs(campaign=campaign, joint=joint, encoder=encoder, record=record)


def _source_faults(arguments: argparse.Namespace) -> list[Fault]:
    """Exactly one of a campaign file and a joint to simulate; what belongs to the one stands beside no other."""
    measured, simulated = arguments.calibration is not None, arguments.from_simulator is not None
    faults: list[Fault] = []
    if measured == simulated:
        expected = "CALIBRATION.csv or --from-simulator JOINT.yaml"
        faults.append(Fault(where="arguments", expected=expected, found="both" if measured else "neither"))
    if simulated and arguments.joint is not None:
        expected = "the joint from --from-simulator only"
        faults.append(Fault(where="--joint", expected=expected, found=str(arguments.joint)))
    if arguments.plan is not None and not simulated:
        expected = "--from-simulator JOINT.yaml beside it"
        faults.append(Fault(where="--plan", expected=expected, found="a campaign that is measured"))
    return faults


def _campaign(arguments: argparse.Namespace, joint: Joint | None) -> Campaign | None:
    """Measured or simulated; None: there is no joint to simulate, which is a fault of its own."""
    if arguments.calibration is not None:
        return read_campaign(read_whole(arguments.calibration), source=str(arguments.calibration))
    if joint is None or arguments.from_simulator is None:
        return None
    # Draws in the effects, which no measured campaign needs.
    from trueangle_training.train_simulation import simulated_calibration

    return simulated_calibration(joint, arguments.plan, seed=arguments.seed, source=arguments.from_simulator)


def _encoder(arguments: argparse.Namespace, joint: Joint | None) -> JointEncoder | None:
    """The encoder that the model is bound to, from JOINT.yaml or from the command line, never from both.

    None where neither says: the daemon then cannot tell the model's encoder from another's, and says so.
    """
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
    if not given:
        return None
    if len(given) < 2:
        raise ContractError(
            [
                Fault(
                    where="encoder",
                    expected="both --counts-per-rev and --lines-per-rev, or --joint JOINT.yaml",
                    found=", ".join(f"only {name}" for name in given),
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
        "id": f"{_calibration_name(arguments)}-{campaign.sha256[:12]}",
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


def _calibration_name(arguments: argparse.Namespace) -> str:
    """Of the campaign in the model file: a simulated one must not pass for a measurement."""
    if arguments.calibration is not None:
        return arguments.calibration.stem
    return f"simulation-{arguments.from_simulator.stem}"


def base_temperature_c(arguments: argparse.Namespace, joint: Joint | None) -> float:
    """Where the paper's methods take their base: the command line's, else the joint's, else 20 degC."""
    if arguments.base_temperature_c is not None:
        return arguments.base_temperature_c
    return DEFAULT_BASE_TEMPERATURE_C if joint is None else joint.base_temperature_c


def reference_record(joint: Joint | None, campaign: Campaign) -> ReferenceRecord:
    """What gave the reference angle, as far as it is stated."""
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
