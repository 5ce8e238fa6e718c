"""The commands for people beside `run`: what is on the bus, setting it up, checking it, watching it, recording it.

One module a command. Each has `add_parser(commands)` for the command line and returns an exit code: 0 done, 1 the
device or the service did not do as asked, 2 bad input.
"""

import argparse
from typing import Protocol


class Commands(Protocol):
    """What argparse's `add_subparsers` returns, whose class is private."""

    def add_parser(
        self,
        name: str,
        *,
        help: str,  # noqa: A002 - argparse's own word
        description: str,
        epilog: str,
    ) -> argparse.ArgumentParser:
        """A parser for one command."""
        ...
