"""`trueangle blind-check`: how often the diagnosis is right on cases whose truth is sealed until the end."""

import argparse
import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.command import Surroundings
from trueangle_training.files import check_writable, read_whole
from trueangle_training.progress import Progress, progress_bar

if TYPE_CHECKING:
    from trueangle_training.command import Subparsers

Json = dict[str, Any]

EXIT_WORSE = 1
FAMILY_ROW = "right class, ENR >= 0.5"
SLACK = 0.01
"""Of medians and calibration errors, which are no counts."""


def register(subparsers: "Subparsers") -> None:
    """Offer the command."""
    parser = subparsers.add_parser(
        "blind-check",
        allow_abbrev=False,
        help="how often the diagnosis is right, on sealed cases of independent plants",
        description="Draw cases of plants that share nothing with the diagnosis, seal their truth (SHA-256 "
        "printed before anything is diagnosed), diagnose them in processes that are told nothing, open the seal "
        "and score. Writes result.json, result.html, marks.jsonl and full reports of the worst cases. A call with "
        "the same folder goes on where the last one was cut off. Exit code 0: scored; 1: a case crashed, or a "
        "figure is worse than --no-worse-than allows; 2: an input that must be mended.",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="made if it is not there")
    parser.add_argument("--cases", type=_positive, metavar="N", help="in all; default: the targets' sizes")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--plant", choices=("A", "B", "C", "all"), default="all")
    parser.add_argument("--plan", choices=("paper", "rich", "both"), default="both")
    parser.add_argument(
        "--withhold", metavar="EFFECT", help="take it from simulator and library, then put it back; or: all"
    )
    parser.add_argument("--processes", type=_positive, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument("--quick", action="store_true", help="no map, no closure, no end task")
    parser.add_argument("--no-reports", action="store_true", help="no full reports of worst and random cases")
    parser.add_argument("--log", type=Path, metavar="FILE", help="looks at sets, kept with the code; one is added")
    parser.add_argument(
        "--in-family", type=Path, metavar="RESULT.json", help="of the plant that the diagnosis was improved on"
    )
    parser.add_argument(
        "--no-worse-than", type=Path, metavar="LOOKS", help="a file as of --log: the last look at the same set"
    )
    parser.set_defaults(run=run)


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected 1 or more, got {text}")
    return number


def run(arguments: argparse.Namespace, surroundings: Surroundings) -> int:
    """Draw, seal, diagnose, open, score."""
    # Before numpy is loaded, here and in the processes that draw: two threads each would fight over the cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from trueangle_training.blind_check import check, looks
    from trueangle_training.blind_check.wording import summary_lines

    order = _order(arguments, surroundings)
    before = None
    if arguments.no_worse_than is not None:
        before = _last_look(arguments.no_worse_than, order.conditions)

    def say(line: str) -> None:
        surroundings.out.write(f"{line}\n")
        surroundings.out.flush()

    @contextlib.contextmanager
    def bar(title: str) -> Iterator[Progress]:
        with progress_bar(surroundings.err, title) as progress:
            yield progress

    result = check.run(order, say=say, bar=bar)
    for line in summary_lines(result):
        say(line)
    if arguments.log is not None and not result["seen"]["same_diagnosis"]:
        looks.append(arguments.log, looks.look_of(result))
    say(f"{'written':<17}{order.folder}: {check.RESULT_HTML}, {check.RESULT_JSON}, {check.MARKS}")
    faults = [] if before is None else looks.worse_than(looks.look_of(result), before, slack=SLACK)
    surroundings.err.writelines(f"trueangle: worse than before: {fault}\n" for fault in faults)
    return EXIT_WORSE if faults or result["crashed"] else 0


def _order(arguments: argparse.Namespace, surroundings: Surroundings) -> "Any":
    """All that can be judged before the first case is drawn; every fault at once."""
    from trueangle_training.blind_check import looks
    from trueangle_training.blind_check.case_set import effects_of
    from trueangle_training.blind_check.check import RESULT_JSON, Order
    from trueangle_training.plant.plants import PLANTS

    plants = tuple(PLANTS) if arguments.plant == "all" else (arguments.plant,)
    faults: list[Fault] = []
    if not set(plants) <= set(PLANTS):
        faults.append(Fault(where="--plant", expected=f"one of {', '.join(PLANTS)}", found=arguments.plant))
    else:
        known = effects_of(plants)
        if arguments.withhold is not None and arguments.withhold not in (*known, "all"):
            expected = f"an effect that the plant makes ({', '.join(known)}), or all"
            faults.append(Fault(where="--withhold", expected=expected, found=arguments.withhold))
    before: list[Json] | None = None
    family: tuple[int, int] | None = None
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
        check_writable(arguments.out / RESULT_JSON)
    except OSError as error:
        found = error.strerror or type(error).__name__
        faults.append(Fault(where=str(arguments.out), expected="a folder that can be made", found=found))
    except ContractError as error:
        faults += error.faults
    try:
        before = None if arguments.log is None else looks.looks_in(arguments.log)
        family = None if arguments.in_family is None else _family(arguments.in_family)
    except ContractError as error:
        faults += error.faults
    if faults:
        raise ContractError(faults)
    return Order(
        folder=arguments.out,
        cases=arguments.cases,
        seed=arguments.seed,
        plants=plants,
        plan=arguments.plan,
        withhold=arguments.withhold,
        quick=arguments.quick,
        processes=arguments.processes,
        reports=not arguments.no_reports,
        looks=before,
        family=family,
        today=surroundings.today,
    )


def _family(path: Path) -> tuple[int, int]:
    """Right classes and cases of an earlier result."""
    try:
        rows = json.loads(read_whole(path))["figures"]
        row = next(row for row in rows if row["name"] == FAMILY_ROW)
        return row["hits"], row["cases"]
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        expected = f"a result.json of this command with the figure {FAMILY_ROW!r}"
        raise ContractError([Fault(where=str(path), expected=expected, found=type(error).__name__)]) from error


def _last_look(path: Path, conditions: Json) -> Json:
    from trueangle_training.blind_check import looks

    same = [
        look for look in looks.looks_in(path) if look["set"] == {key: conditions[key] for key in looks.SET_KEYS}
    ]
    if not same:
        expected = f"a look at the set {', '.join(f'{key} {conditions[key]}' for key in looks.SET_KEYS)}"
        raise ContractError([Fault(where=str(path), expected=expected, found="none")])
    return same[-1]
