"""How a command shows that it works, and where it puts the faults of what it calls."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TextIO

from trueangle.contract.errors import ContractError

Progress = Callable[[int, int], None]


@contextlib.contextmanager
def faults_placed_in(source: str) -> Iterator[None]:
    """The method names arrays where its readings do not suit it; the user knows the file."""
    try:
        yield
    except ContractError as error:
        placed = [replace(fault, where=f"{source}, {fault.where}") for fault in error.faults]
        raise ContractError(placed) from error


@contextlib.contextmanager
def progress_bar(err: TextIO, title: str) -> Iterator[Progress]:
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
