"""`trueangled verify`: a few reference angles against a joint's model, and one line that says what they mean."""

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from trueangle.commands import Commands
from trueangle.commands.modbus_target import add_target, target_of
from trueangle.config import load_config
from trueangle.contract.calibration import read_campaign
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.number_table import read_number_table
from trueangle.contract.units import ARCSEC_PER_DEG, wrap_deg
from trueangle.core.correction import CorrectionModel, correct_one
from trueangle.core.health import StatusBit
from trueangle.core.register_reading import DetailReading, detail_block, read_detail
from trueangle.core.verification import (
    ReferencePoint,
    Verdict,
    Verification,
    combined_uncertainty,
    verify,
)
from trueangle.edges.terminal import ask
from trueangle.errors import NodeFault
from trueangle.service import LoadedJoint, load_joints

STILL_DEG_S = 0.01
MAX_BYTES = 10_000_000


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "verify",
        help="check a joint's model with a few reference angles",
        description="Check a joint's model with a few reference angles. Exit code 0: good, 1: not good, 2: bad "
        "input. The file has the columns reference_deg, angle_deg (raw) and temperature_c, or is a campaign; "
        "'interactive' reads the running daemon at each angle that you type.",
        epilog="Example: trueangled verify --config trueangled.yaml --joint base --reference angles.csv "
        "--reference-u 0.5",
    )
    add_target(parser, config_required=True)
    parser.add_argument("--joint", required=True, metavar="NAME", help="of the configuration")
    parser.add_argument(
        "--reference",
        required=True,
        metavar="FILE.csv|interactive",
        help="reference angles, or to be asked for them",
    )
    parser.add_argument(
        "--reference-u", type=float, metavar="ARCSEC", help="standard uncertainty (k = 1) of the reference"
    )
    parser.add_argument(
        "--free-zero", action="store_true", help="the reference has a zero of its own: take an offset out"
    )
    parser.add_argument("--json", action="store_true", help="one JSON document instead of the table")
    parser.set_defaults(command=_verify)


def _verify(options: argparse.Namespace) -> int:
    config = load_config(options.config)
    joints = load_joints(config, base=options.config.parent, source=str(options.config))
    joint = next((joint for joint in joints if joint.config.name == options.joint), None)
    if joint is None:
        names = ", ".join(each.config.name for each in joints)
        raise ContractError([Fault(where="--joint", expected=f"one of {names}", found=options.joint)])
    if options.reference_u is not None and not 0 <= options.reference_u <= 3600:
        found = f"{options.reference_u:g}"
        raise ContractError([Fault(where="--reference-u", expected="0 to 3600", found=found)])
    if options.reference == "interactive":
        points = asyncio.run(_ask_points(options, joint))
        others: list[str] = []
    else:
        readings = _file_readings(Path(options.reference))
        points = _points(readings, joint, options.reference_u, source=options.reference)
        others = [] if options.free_zero else _fitting_others(readings, joints, joint, options)
    fewest = 2 if options.free_zero else 1
    if len(points) < fewest:
        expected = f"at least {fewest} reference angles"
        raise ContractError([Fault(where="--reference", expected=expected, found=str(len(points)))])
    result = verify(points, free_zero=options.free_zero)
    if others and result.verdict is not Verdict.GOOD:
        # Two eccentricities differ by a first harmonic, as a new mounting does: only the other model tells.
        result = replace(result, verdict=Verdict.WRONG_JOINT)
    if options.json:
        print(json.dumps({**asdict(result), "verdict": result.verdict.name.lower(), "fitting_models": others}))
    else:
        print(_report(joint.config.name, points, result, others))
    return 0 if result.verdict is Verdict.GOOD else 1


Reading = tuple[float, float, float]
"""Reference, raw, temperature: degrees, degrees, degC."""


def _file_readings(path: Path) -> list[Reading]:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES)
    except OSError as error:
        found = error.strerror or str(error)
        raise ContractError([Fault(where=str(path), expected="a readable file", found=found)]) from error
    if b"reference_deg" not in data:
        campaign = read_campaign(data, source=str(path))
        if campaign.temperature_c is None:
            raise ContractError([Fault(where=str(path), expected="the column temperature_c", found="none")])
        reference = campaign.angle_deg - campaign.error_arcsec / ARCSEC_PER_DEG
        rows = zip(reference.tolist(), campaign.angle_deg.tolist(), campaign.temperature_c.tolist(), strict=True)
    else:
        names = ("reference_deg", "angle_deg", "temperature_c")
        table = read_number_table(data, source=str(path), required=names)
        rows = zip(*(table.columns[name].tolist() for name in names), strict=True)
    # A recording has a reference angle in a few of its rows only.
    return [row for row in rows if all(value == value for value in row)]


def _points(
    readings: Sequence[Reading], joint: LoadedJoint, reference_u: float | None, *, source: str
) -> list[ReferencePoint]:
    """The model's word at each reading; ContractError lists those where it must not be used."""
    metadata = joint.model.metadata
    faults: list[Fault] = []
    points: list[ReferencePoint] = []
    for number, (reference, raw, temperature) in enumerate(readings, start=1):
        where = f"{source}, reading {number}"
        angle, degc = metadata.valid_angle_deg, metadata.valid_temperature_c
        if not angle.holds(wrap_deg(raw)):
            expected = f"an angle from {angle.minimum:g} to {angle.maximum:g} deg, as calibrated"
            faults.append(Fault(where=where, expected=expected, found=f"{raw:g}"))
        elif not degc.holds(temperature):
            expected = f"a temperature from {degc.minimum:g} to {degc.maximum:g} degC, as calibrated"
            faults.append(Fault(where=where, expected=expected, found=f"{temperature:g}"))
        else:
            points.append(_point(joint.model, joint, reference, raw, temperature, reference_u))
    if faults:
        raise ContractError(faults)
    return points


def _point(
    model: CorrectionModel,
    joint: LoadedJoint,
    reference: float,
    raw: float,
    temperature: float,
    reference_u: float | None,
) -> ReferencePoint:
    correction = correct_one(model, wrap_deg(raw), temperature)
    return ReferencePoint(
        reference_deg=wrap_deg(reference),
        raw_deg=wrap_deg(raw),
        corrected_deg=correction.corrected_deg(wrap_deg(raw)),
        uncertainty_arcsec=_uncertainty(joint, correction.uncertainty_arcsec, reference_u),
    )


def _uncertainty(joint: LoadedJoint, model_u: float | None, reference_u: float | None) -> float:
    """Of corrected - reference; where the model has none of its own, what its training says of it."""
    metadata = joint.model.metadata
    if model_u is None or model_u != model_u:
        errors = metadata.errors
        model_u = errors.held_out_rmse_arcsec or errors.validation_rmse_arcsec or errors.in_sample_rmse_arcsec
    if reference_u is None:
        reference_u = metadata.reference.standard_uncertainty_arcsec
    total = combined_uncertainty(model_u, reference_u)
    if total is None:
        expected = "the standard uncertainty of model or reference"
        advice = "neither model file nor command line states one"
        raise ContractError([Fault(where="--reference-u", expected=expected, found="none", advice=advice)])
    return total


def _fitting_others(
    readings: Sequence[Reading], joints: Sequence[LoadedJoint], joint: LoadedJoint, options: argparse.Namespace
) -> list[str]:
    """Other joints whose model makes these readings good: whose they may be."""
    names: list[str] = []
    for other in joints:
        if other is joint:
            continue
        try:
            points = _points(readings, other, options.reference_u, source=options.reference)
        except ContractError:
            continue
        if points and verify(points, free_zero=False).verdict is Verdict.GOOD:
            names.append(other.config.name)
    return names


async def _ask_points(options: argparse.Namespace, joint: LoadedJoint) -> list[ReferencePoint]:
    if not sys.stdin.isatty():
        raise ContractError([Fault(where="--reference interactive", expected="a terminal", found="none")])
    target = target_of(options)
    reader = target.reader()
    points: list[ReferencePoint] = []
    print("Bring the joint to a reference angle, let it stand still, type the angle in degrees; empty ends.")
    while True:
        text = ask(f"reference angle {len(points) + 1}: ", keyboard=sys.stdin, screen=sys.stdout)
        if not text:
            break
        try:
            reference = float(text)
        except ValueError:
            print(f"expected an angle in degrees, found {text!r}")
            continue
        # Anew each time: a person takes minutes, and the daemon closes idle connections.
        await reader.connect()
        try:
            block = detail_block(joint.config.slot)
            data = await reader.read(block.address, block.count)
        finally:
            await reader.close()
        if data is None:
            raise NodeFault(f"{reader.where}: slot {joint.config.slot} is not served there")
        reading = read_detail(data, joint.config.slot)
        if why := _unusable(reading):
            print(f"not taken: {why}")
            continue
        point = _served_point(reading, joint, reference, options.reference_u)
        points.append(point)
        print(f"corrected {point.corrected_deg:.6f} deg, raw {point.raw_deg:.6f} deg")
    return points


def _unusable(reading: DetailReading) -> str:
    if reading.torn:
        return "the registers changed while they were read; once more"
    if not reading.valid or reading.raw_deg is None or reading.correction_arcsec is None:
        return f"the joint is not valid ({reading.status & ~StatusBit.CONFIGURED!r})"
    if reading.velocity_deg_s is not None and abs(reading.velocity_deg_s) > STILL_DEG_S:
        return f"the joint moves ({reading.velocity_deg_s:+.3f} deg/s)"
    return ""


def _served_point(
    reading: DetailReading, joint: LoadedJoint, reference: float, reference_u: float | None
) -> ReferencePoint:
    assert reading.raw_deg is not None  # noqa: S101 - `_unusable` has looked
    assert reading.correction_arcsec is not None  # noqa: S101
    return ReferencePoint(
        reference_deg=wrap_deg(reference),
        raw_deg=reading.raw_deg,
        # Without the user's zero, which is no matter of the model.
        corrected_deg=wrap_deg(reading.raw_deg + reading.correction_arcsec / ARCSEC_PER_DEG),
        uncertainty_arcsec=_uncertainty(joint, reading.uncertainty_arcsec, reference_u),
    )


def _report(name: str, points: Sequence[ReferencePoint], result: Verification, others: Sequence[str]) -> str:
    lines = ['reference/deg  corrected/deg  difference/"   U(k=2)/"      E_n']
    for point, difference, normalised in zip(points, result.differences_arcsec, result.normalised, strict=True):
        lines.append(
            f"{point.reference_deg:13.6f}  {point.corrected_deg:13.6f}  {difference:+12.2f}"
            f"  {2 * point.uncertainty_arcsec:9.2f}  {normalised:+7.2f}"
        )
    lines.append(
        f'offset {result.offset_arcsec:+.2f}", first harmonic {result.first_harmonic_arcsec:.2f}"; '
        f'rms about the mean: raw {result.raw_rms_arcsec:.2f}", corrected {result.corrected_rms_arcsec:.2f}"'
    )
    if others and result.verdict is not Verdict.GOOD:
        lines.append(f"these readings fit the model of: {', '.join(others)}")
    lines.append(f"{name}: {result.verdict.value}")
    return "\n".join(lines)
