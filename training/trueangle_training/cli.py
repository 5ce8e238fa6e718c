"""The command line of the laboratory, `trueangle`: the only place that knows the day and the process.

Exit codes: 0 done, 2 an input that must be mended (every fault on its own line of stderr), 130 interrupted.
"""

import argparse
import datetime
import os
import sys
from collections.abc import Sequence

from trueangle.contract.errors import TrueangleError
from trueangle_training import (
    blind_check_command,
    compare_command,
    demo_command,
    diagnose_command,
    errors_command,
    plan_command,
    report_command,
    reproduce_command,
    simulate_command,
    train_command,
)
from trueangle_training.command import Register, Run, Surroundings

COMMANDS: tuple[Register, ...] = (
    plan_command.register,
    errors_command.register,
    train_command.register,
    compare_command.register,
    report_command.register,
    reproduce_command.register,
    simulate_command.register,
    diagnose_command.register,
    blind_check_command.register,
    demo_command.register,
)
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, run, and turn what the user must mend into lines on stderr."""
    arguments = _parser().parse_args(argv)
    run: Run = arguments.run
    today = datetime.datetime.now(tz=datetime.UTC).astimezone().date()
    try:
        return run(arguments, Surroundings(today=today, out=sys.stdout, err=sys.stderr))
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; the interpreter must not try to write the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BAD_INPUT
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
