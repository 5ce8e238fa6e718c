"""`trueangle plan`: a calibration plan, what it can see and takes, and a sheet to work from."""

import argparse
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import SCHEMA_VERSION, Plan, PlanZero
from trueangle_training.command import Surroundings
from trueangle_training.documents import dump_plan, load_joint
from trueangle_training.files import check_distinct, check_writable, write_all
from trueangle_training.plan_design import (
    DEFAULT_SETUP_MIN,
    PlanTime,
    coefficient_noise,
    orders_seen,
    plan_readings,
    plan_time,
    reading_noise_arcsec,
    recommended_shift,
    shifted,
)
from trueangle_training.progress import Progress, progress_bar
from trueangle_training.simulator.joint import SimulatedJoint, simulated_joint

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers
    from trueangle_training.plan_expectation import Expectation

Floats = NDArray[np.float64]

SEEDS = range(10)
NAMED_SHIFTS = {"none": 0.0, "third": 1.0 / 3.0, "half": 0.5}
SHEET_FORMS = (".html", ".csv")
MOST_TEMPERATURES = 200


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "plan",
        allow_abbrev=False,
        help="plan a calibration campaign and print a sheet to work from",
        description="Write a PLAN.yaml and a sheet to work from, and say what the plan can see, how long it takes "
        "and what uncertainty to expect.",
    )
    parser.add_argument("--faces", type=int, required=True, metavar="N", help="of the polygon")
    parser.add_argument(
        "--temperatures",
        type=temperatures_c,
        required=True,
        metavar="T,T,...",
        help="such as 10,15,...,40, in degC",
    )
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="runs at each temperature (default 3)")
    parser.add_argument(
        "--shift",
        type=shift_faces,
        metavar="third|half|none|N",
        help="turn the polygon on the shaft by this part of the face pitch before each repeat (default: a third "
        "from three repeats on, half with two; none with --one-zero)",
    )
    parser.add_argument("--both-directions", action="store_true", help="measure each repeat up and down")
    parser.add_argument(
        "--one-zero",
        action="store_true",
        help="keep one zero over all temperatures: the only way to see how the datum itself moves; that drift is "
        "shown in the report, not corrected",
    )
    parser.add_argument("--soak-h", type=float, default=4.0, metavar="H", help="at each temperature (default 4)")
    parser.add_argument("--seconds-per-reading", type=float, default=15.0, metavar="S", help="default 15")
    parser.add_argument(
        "--remount-min",
        type=float,
        default=DEFAULT_SETUP_MIN,
        metavar="MIN",
        help=f"to turn the polygon on the shaft and adjust again (default {DEFAULT_SETUP_MIN:g})",
    )
    parser.add_argument(
        "--joint",
        type=Path,
        metavar="JOINT.yaml",
        help="with nominal parameters: simulate the plan on it and state the true error to expect",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PLAN.yaml")
    parser.add_argument("--sheet", type=Path, metavar="SHEET.html|.csv", help="to work from")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Plan, write and explain; 0."""
    plan, joint = _inputs(arguments)
    # Draws in what judges campaigns, which a fault in the arguments must not wait for.
    from trueangle_training.plan_trainability import training_obstacle

    time = plan_time(plan, remount_min=arguments.remount_min)
    title = f"Calibration plan {arguments.output.stem}"
    files = [(arguments.output, dump_plan(plan).encode())]
    if arguments.sheet is not None:
        from trueangle_training.plan_sheet import sheet_csv, sheet_html

        html = arguments.sheet.suffix == ".html"
        text = sheet_html(plan, title, time) if html else sheet_csv(plan, title)
        files.append((arguments.sheet, text.encode()))
    obstacle = training_obstacle(plan)
    write_all(files)
    if obstacle is not None:
        surroundings.err.write(
            f"trueangle: warning: trueangle train refuses a campaign of this plan: {obstacle}\n"
        )
    surroundings.out.writelines(f"{line}\n" for line in _plan_lines(plan, time))
    surroundings.out.writelines(f"{line}\n" for line in _advice_lines(plan, arguments.remount_min))
    if joint is not None:
        surroundings.out.writelines(f"{line}\n" for line in _expectation_lines(plan, joint, surroundings))
    else:
        surroundings.out.writelines(f"{line}\n" for line in _typical_lines(plan))
    surroundings.out.write(f"{'file':<17}{arguments.output}\n")
    if arguments.sheet is not None:
        surroundings.out.write(f"{'sheet':<17}{arguments.sheet}\n")
    return 0


def temperatures_c(text: str) -> tuple[float, ...]:
    """10,15,20 or 10,15,...,40: the dots go on in the step of the two before them up to the one after them."""
    parts = [part.strip() for part in text.split(",")]
    values: list[float] = []
    for place, part in enumerate(parts):
        if part == "...":
            continue
        number = _finite(part)
        if place > 0 and parts[place - 1] == "...":
            if len(values) < 2:
                raise argparse.ArgumentTypeError("expected two temperatures before the dots, such as 10,15,...,40")
            step = values[-1] - values[-2]
            count = (number - values[-1]) / step if step else math.nan
            if not (0 < count <= MOST_TEMPERATURES) or abs(count - round(count)) > 1e-9:
                raise argparse.ArgumentTypeError(
                    f"{number:g} is not reached from {values[-1]:g} in steps of {step:g}"
                )
            start = values[-1]
            values += [round(start + step * k, 9) for k in range(1, round(count))]
        values.append(number)
    if parts[-1] == "...":
        raise argparse.ArgumentTypeError("expected a temperature after the dots, such as 10,15,...,40")
    if len(set(values)) != len(values):
        raise argparse.ArgumentTypeError("expected each temperature once; --repeats measures it again")
    return tuple(values)


def shift_faces(text: str) -> float:
    """A name, or a number of face pitches, 0 or more."""
    if text in NAMED_SHIFTS:
        return NAMED_SHIFTS[text]
    number = _finite(text)
    if number < 0:
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(NAMED_SHIFTS)} or a number of 0 or more, found {text}"
        )
    return number


def _finite(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"expected a number, found {text!r}")
    return number


def _inputs(arguments: argparse.Namespace) -> tuple[Plan, SimulatedJoint | None]:
    """Everything judged before anything is written; every fault at once."""
    faults: list[Fault] = []
    plan = joint = None
    for path in (arguments.output, arguments.sheet):
        try:
            if path is not None:
                check_writable(path)
        except ContractError as error:
            faults += error.faults
    try:
        check_distinct({"--output": arguments.output, "--sheet": arguments.sheet}, {"--joint": arguments.joint})
    except ContractError as error:
        faults += error.faults
    if arguments.sheet is not None and arguments.sheet.suffix not in SHEET_FORMS:
        expected = f"a name that ends with {' or '.join(SHEET_FORMS)}"
        faults.append(Fault(where="--sheet", expected=expected, found=str(arguments.sheet)))
    if not 0.0 <= arguments.remount_min < math.inf:
        faults.append(Fault(where="--remount-min", expected="0 or more", found=f"{arguments.remount_min:g}"))
    try:
        plan = _plan(arguments)
    except ContractError as error:
        faults += error.faults
    try:
        joint = None if arguments.joint is None else simulated_joint(load_joint(arguments.joint))
        if joint is not None and joint.joint.reference.faces != arguments.faces:
            expected = f"the {joint.joint.reference.faces} faces of {arguments.joint}"
            faults.append(Fault(where="--faces", expected=expected, found=str(arguments.faces)))
    except ContractError as error:
        faults += error.faults
    if faults or plan is None:
        raise ContractError(faults)
    return plan, joint


def _plan(arguments: argparse.Namespace) -> Plan:
    from trueangle.contract.document import document_from_plain
    from trueangle.contract.joint import plan_from_document

    shift = arguments.shift
    if shift is None:
        shift = 0.0 if arguments.one_zero else recommended_shift(arguments.repeats)
    values = {
        "schema_version": SCHEMA_VERSION,
        "faces": arguments.faces,
        "temperatures_c": list(arguments.temperatures),
        "repeats": arguments.repeats,
        "directions": [1, -1] if arguments.both_directions else [1],
        "shift_faces": shift,
        "soak_h": arguments.soak_h,
        "seconds_per_reading": arguments.seconds_per_reading,
        "zero": (PlanZero.ONE if arguments.one_zero else PlanZero.PER_RUN).value,
    }
    return plan_from_document(document_from_plain(values, source="command line"))


def _plan_lines(plan: Plan, time: PlanTime) -> Iterator[str]:
    runs = plan_readings(plan) // plan.faces
    seen = orders_seen(plan)
    set_c = ", ".join(f"{each:g}" for each in plan.temperatures_c)
    yield f"{'readings':<17}{plan_readings(plan)} in {runs} runs of {plan.faces} faces at {set_c} degC"
    yield (
        f"{'time':<17}{time.total_h:.1f} h: setting up {time.setup_h:.1f}, soaking {time.soak_h:.1f}, turning the "
        f"polygon {time.remount_h:.1f} ({time.remounts} times), reading {time.reading_h:.1f}"
    )
    yield (
        f"{'orders seen':<17}1 to {seen.highest}, from {seen.places} places of the turn; a higher harmonic reads "
        "like a lower one or like a zero, and the correction takes it for that"
    )
    noise = coefficient_noise(plan, 1.0)
    yield (
        f"{'noise':<17}of a Fourier coefficient, per arcsec of one reading: {noise.steady_arcsec:.3f} from all "
        f"readings, {noise.one_temperature_arcsec:.3f} from one temperature (sigma sqrt(2/N))"
    )
    if plan.zero is PlanZero.ONE:
        yield (
            f"{'zero':<17}one for all temperatures: shows how the datum itself moves, if nothing else moves; this "
            "drift is shown, not corrected: a model counts errors from the datum at the same temperature"
        )
    else:
        yield f"{'zero':<17}one a run: how the datum itself moves with temperature is not seen (--one-zero)"


def _advice_lines(plan: Plan, remount_min: float) -> Iterator[str]:
    if plan.zero is PlanZero.ONE:
        yield (
            f"{'advice':<17}a second campaign of one temperature with shifted repeats would show the orders above "
            f"{orders_seen(plan).highest}, which this plan cannot see"
        )
    elif plan.shift_faces % 1.0 == 0.0 and plan.repeats > 1:
        better = shifted(plan, recommended_shift(plan.repeats))
        seen, hours = orders_seen(better), plan_time(better, remount_min=remount_min).total_h
        more = hours - plan_time(plan, remount_min=remount_min).total_h
        yield (
            f"{'advice':<17}repeats shifted by {better.shift_faces:.3g} of the face pitch see orders up to "
            f"{seen.highest} with as many readings, for {more:.1f} h of turning the polygon"
        )
    elif plan.repeats < 2:
        yield f"{'advice':<17}with one repeat the noise is hardly known and nothing can be shifted: measure three"
    if len(plan.temperatures_c) < 3:
        yield f"{'advice':<17}with fewer than three temperatures no bend over temperature can be seen"


def _expectation_lines(plan: Plan, joint: SimulatedJoint, surroundings: Surroundings) -> Iterator[str]:
    sigma = reading_noise_arcsec(joint.joint)
    noise = coefficient_noise(plan, sigma)
    yield (
        f"{'noise here':<17}{sigma:.2f} arcsec a reading: {noise.steady_arcsec:.3f} a steady coefficient, "
        f"{noise.one_temperature_arcsec:.3f} at one temperature"
    )
    plain_plan = shifted(plan, 0.0)
    other = shifted(plan, recommended_shift(plan.repeats)) if plan == plain_plan else plain_plan
    plans = [("this plan", plan)]
    if other != plan:
        plans.append(("shifted" if plan == plain_plan else "not shifted", other))
    total, done = len(plans) * len(SEEDS), 0
    results: list[tuple[str, Expectation | str]] = []
    from trueangle_training.plan_expectation import expected_true_error

    with progress_bar(surroundings.err, f"simulating {total} campaigns on {joint.joint.name}") as progress:
        for name, each in plans:
            for_plan = expected_true_error(joint, each, seeds=SEEDS, progress=_counting_on(progress, done, total))
            results.append((name, for_plan))
            done += len(SEEDS)
    for name, result in results:
        yield f"{'expected':<17}{name}: {_expected_text(result)}"
    yield (
        f"{'':<17}true error of linear on the simulated joint {joint.joint.name}, from the datum at the same "
        "temperature, the reference's own error not counted"
    )


def _counting_on(progress: Progress, done: int, total: int) -> Callable[[], None]:
    """Tells `progress` one step more at each call."""
    count = itertools.count(done + 1)
    return lambda: progress(next(count), total)


def _expected_text(result: "Expectation | str") -> str:
    if isinstance(result, str):
        return f"not to be had: {result}"
    return (
        f"{result.rmse_arcsec:.3f} arcsec RMS ({result.lowest_arcsec:.3f} to {result.highest_arcsec:.3f}), "
        f"largest {result.largest_arcsec:.2f} (medians and range of {result.seeds} noise seeds)"
    )


def _typical_lines(plan: Plan) -> Iterator[str]:
    """What a shift is worth where nothing is known of the joint."""
    from trueangle_training.plan_expectation import example_joint, unseen_error

    joint = example_joint()
    at_c = joint.joint.base_temperature_c

    def error_arcsec(angle_deg: Floats) -> Floats:
        return joint.error_arcsec(angle_deg, at_c)

    plain = unseen_error(error_arcsec, shifted(plan, 0.0))
    highest = orders_seen(shifted(plan, 0.0)).highest
    yield (
        f"{'expected':<17}on a joint like the shipped {joint.joint.name}, whose orders above {highest} are "
        f"{plain.above_rms_arcsec:.2f} arcsec RMS together: {plain.rmse_arcsec:.2f} arcsec RMS of the corrected "
        "angle comes from them without shifted repeats, noise not counted"
    )
    shift = plan.shift_faces if plan.shift_faces % 1.0 else recommended_shift(plan.repeats)
    if shift:
        with_shift = unseen_error(error_arcsec, shifted(plan, shift))
        yield f"{'':<17}with repeats shifted by {shift:.3g} of the face pitch: {with_shift.rmse_arcsec:.2f}"
    yield f"{'':<17}give --joint JOINT.yaml with nominal parameters for the true error of your joint"
