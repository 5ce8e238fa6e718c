"""What a person sees of the demo: a live table on a terminal, a plain line now and then elsewhere."""

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from trueangle_training.demo.judge import JointJudge, rms

BAR_CELLS = 12
BAR_FULL_ARCSEC = 120.0
PLAIN_EVERY_S = 5.0


def live_table(judges: Sequence[JointJudge], elapsed_s: float, duration_s: float) -> Table:
    """True angle, raw and corrected error of each joint at its latest sample, with their RMS so far."""
    table = Table(
        title=f"angles served over Modbus against the true ones: {elapsed_s:4.1f} of {duration_s:g} s",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        caption=f"errors in arcsec from the datum; bar: raw red, corrected green, {BAR_FULL_ARCSEC:g} at most",
    )
    for column in ("joint", "true\ndeg", "\ndegC", "raw\nerror", "corrected\nerror", "raw\nRMS", "corrected\nRMS"):
        table.add_column(column, justify="left" if column == "joint" else "right", no_wrap=True)
    table.add_column("raw error,\nof it left", no_wrap=True, width=BAR_CELLS)
    for judge in judges:
        table.add_row(*_row(judge))
    return table


def _row(judge: JointJudge) -> list[str | Text]:
    reading = judge.last
    if reading is None or not judge.raw_arcsec:
        return [judge.name, "-", "-", "-", Text("waiting", style="yellow"), "-", "-", ""]
    raw, corrected = judge.raw_arcsec[-1], judge.corrected_arcsec[-1]
    temperature = "-" if reading.temperature_c is None else f"{reading.temperature_c:.2f}"
    shown = Text(f"{corrected:+.2f}", style="green") if reading.valid else Text("not valid", style="bold red")
    bar = Text.assemble(("█" * _cells(corrected), "green"), ("░" * (_cells(raw) - _cells(corrected)), "red"))
    return [
        judge.name,
        f"{judge.last_true_deg:.4f}",
        temperature,
        f"{raw:+.1f}",
        shown,
        f"{rms(judge.raw_arcsec):.2f}",
        f"{rms(judge.corrected_arcsec):.2f}",
        bar,
    ]


def _cells(error_arcsec: float) -> int:
    return min(BAR_CELLS, round(abs(error_arcsec) / BAR_FULL_ARCSEC * BAR_CELLS))


class Screen:
    """Shows the running demo; on anything but a terminal a plain line every few seconds."""

    def __init__(self, console: Console, duration_s: float) -> None:
        self._console, self._duration_s = console, duration_s
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._last_plain_s = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, judges: Sequence[JointJudge], elapsed_s: float) -> None:
        """Draw the present state."""
        if self._live is not None:
            self._live.update(live_table(judges, elapsed_s, self._duration_s), refresh=True)
        elif elapsed_s - self._last_plain_s >= PLAIN_EVERY_S:
            self._last_plain_s = elapsed_s
            parts = [f"{j.name} {rms(j.raw_arcsec):.1f} -> {rms(j.corrected_arcsec):.2f}" for j in judges]
            self._console.print(f"  {elapsed_s:5.1f} s  RMS arcsec raw -> corrected: " + ", ".join(parts))
