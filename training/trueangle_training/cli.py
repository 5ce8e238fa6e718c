"""The command line of the laboratory, `trueangle`: the only place that knows the day and the process.

Exit codes: 0 done, 2 an input that must be mended (every fault on its own line of stderr), 130 interrupted.
"""

import argparse
import datetime
import sys
from collections.abc import Sequence

from trueangle.contract.errors import TrueangleError
from trueangle_training import demo_command, simulate_command, train_command
from trueangle_training.command import Register, Run, Surroundings

COMMANDS: tuple[Register, ...] = (train_command.register, simulate_command.register, demo_command.register)
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, run, and turn what the user must mend into lines on stderr."""
    arguments = _parser().parse_args(argv)
    run: Run = arguments.run
    today = datetime.datetime.now(tz=datetime.UTC).astimezone().date()
    try:
        return run(arguments, Surroundings(today=today, out=sys.stdout, err=sys.stderr))
    except TrueangleError as error:
        sys.stderr.writelines(f"trueangle: {line}\n" for line in str(error).splitlines())
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("trueangle: interrupted\n")
        return EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="trueangle",
        description="The laboratory: from calibration campaigns to models that trueangled serves.",
    )
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for register in COMMANDS:
        register(subparsers)
    return parser
