"""What a subcommand of `trueangle` gets from the edge, and how it offers itself."""

import argparse
import datetime
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]  # noqa: SLF001 - argparse has no public name


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """The world outside the command."""

    today: datetime.date
    out: TextIO
    """Results."""
    err: TextIO
    """Progress and complaints."""


Run = Callable[[argparse.Namespace, Surroundings], int]
"""A command: parsed arguments in, exit code out; ContractError for what the user must mend."""

Register = Callable[["Subparsers"], None]
"""Adds a parser whose default `run` is the command's `Run`; draws in no heavy library."""
