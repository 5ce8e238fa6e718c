"""`trueangle errors`: from raw readings of polygon and autocollimator to a campaign file, by eq. (11)."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueangle.contract.calibration import campaign_to_csv
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint, PlanZero, ReferenceKind
from trueangle_training.command import Surroundings
from trueangle_training.documents import load_joint
from trueangle_training.files import check_distinct, check_writable, read_whole, write_whole
from trueangle_training.raw_readings import (
    FEWEST_FACES,
    PolygonCertificate,
    RawReadings,
    errors_by_equation_11,
    read_certificate,
    read_raw_readings,
    with_autocollimator_reversed,
)

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers

ZEROES = {
    PlanZero.PER_RUN: "error_arcsec = indicated - reference, zeroed at the first stop of each run (Eq. 11).",
    PlanZero.ONE: "error_arcsec = indicated - reference, all runs counted from the first reading of all.",
}
SIGNS = (
    "Autocollimator: positive where the shaft stands further on, as the encoder counts up.",
    "Certificate: positive where a face lies further on than nominal, as the face numbers rise; subtracted.",
)


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "errors",
        allow_abbrev=False,
        help="make a campaign file from raw readings of polygon and autocollimator",
        description="Turn readings as they were written down (columns face, angle_deg, autocollimator_arcsec, and "
        "where known temperature_c, run, time_s, direction, polygon_offset) into errors: indicated minus "
        "reference, zeroed at the first face of each run, the polygon's certified deviations taken off. "
        + " ".join(SIGNS),
    )
    parser.add_argument("raw", type=Path, metavar="RAW.csv")
    parser.add_argument("--joint", type=Path, metavar="JOINT.yaml", help="for the polygon's number of faces")
    parser.add_argument(
        "--certificate", type=Path, metavar="CERT.csv", help="of the polygon: columns face, deviation_arcsec"
    )
    parser.add_argument("--faces", type=int, metavar="N", help="of the polygon, where no --joint is given")
    parser.add_argument(
        "--reverse-autocollimator", action="store_true", help="its readings fall where the encoder's angle rises"
    )
    parser.add_argument(
        "--one-zero",
        action="store_true",
        help="polygon, encoder and autocollimator were left as they are: count all runs from the first reading",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CAMPAIGN.csv")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Read, reckon, write; 0."""
    raw, certificate, joint = _inputs(arguments)
    faces, assumed = _faces(arguments, raw, certificate, joint)
    if arguments.reverse_autocollimator:
        raw = with_autocollimator_reversed(raw)
    zero = PlanZero.ONE if arguments.one_zero else PlanZero.PER_RUN
    campaign = errors_by_equation_11(raw, faces=faces, certificate=certificate, zero=zero)
    notes = (*assumed, *campaign.notes)
    made_from = f"Made by trueangle errors from raw readings, SHA-256 {raw.sha256}."
    comments = (made_from, ZEROES[zero], *SIGNS, *(f"Note: {note}" for note in notes))
    write_whole(arguments.output, campaign_to_csv(campaign, comments=comments).encode())
    error_arcsec = campaign.error_arcsec
    surroundings.out.write(
        f"{arguments.output}: {len(campaign)} readings of {faces} faces in {np.unique(campaign.run).size} runs; "
        f"error {error_arcsec.min():.1f} .. {error_arcsec.max():.1f} arcsec\n"
    )
    surroundings.out.writelines(f"note: {note}\n" for note in notes)
    return 0


def _inputs(arguments: argparse.Namespace) -> tuple[RawReadings, PolygonCertificate | None, Joint | None]:
    """All files read; every fault of every file at once."""
    faults: list[Fault] = []
    raw = certificate = joint = None
    try:
        check_writable(arguments.output)
        check_distinct(
            {"--output": arguments.output},
            {"RAW.csv": arguments.raw, "--joint": arguments.joint, "--certificate": arguments.certificate},
        )
    except ContractError as error:
        faults += error.faults
    try:
        raw = read_raw_readings(read_whole(arguments.raw), source=str(arguments.raw))
    except ContractError as error:
        faults += error.faults
    try:
        if arguments.certificate is not None:
            path = arguments.certificate
            certificate = read_certificate(read_whole(path), source=str(path))
    except ContractError as error:
        faults += error.faults
    try:
        joint = None if arguments.joint is None else load_joint(arguments.joint)
        if joint is not None and joint.reference.kind is not ReferenceKind.POLYGON:
            found = joint.reference.kind.value
            faults.append(Fault(where=f"{arguments.joint}, reference.kind", expected="polygon", found=found))
    except ContractError as error:
        faults += error.faults
    if arguments.faces is not None and arguments.faces < FEWEST_FACES:
        faults.append(Fault(where="--faces", expected=f"{FEWEST_FACES} or more", found=str(arguments.faces)))
    if faults or raw is None:
        raise ContractError(faults)
    return raw, certificate, joint


def _faces(
    arguments: argparse.Namespace, raw: RawReadings, certificate: PolygonCertificate | None, joint: Joint | None
) -> tuple[int, tuple[str, ...]]:
    """The polygon's number of faces, and what was assumed about it; ContractError where two sources differ."""
    stated = {
        "--faces": arguments.faces,
        "--joint": None if joint is None else joint.reference.faces,
        "--certificate": None if certificate is None else certificate.faces,
    }
    known = {name: faces for name, faces in stated.items() if faces is not None}
    if len(set(known.values())) > 1:
        found = ", ".join(f"{faces} by {name}" for name, faces in known.items())
        raise ContractError([Fault(where="the polygon", expected="one number of faces", found=found)])
    if known:
        return next(iter(known.values())), ()
    highest = int(raw.face.max())
    if highest < FEWEST_FACES:
        expected = f"the polygon's number of faces, by --faces, --joint or --certificate, or {FEWEST_FACES} read"
        raise ContractError([Fault(where=raw.source, expected=expected, found=f"faces up to {highest}")])
    return highest, (f"the polygon is taken to have {highest} faces, the highest number in the file",)
