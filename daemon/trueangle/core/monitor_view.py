"""The live view of all joints as text: what is read goes in, lines of a terminal come out. No terminal here.

Rules of this file: nothing old looks new. Without a connection, and while the registers stand still, no angle is
shown at all. Colour only repeats what a word and a sign already say, so that a red lamp or a colour-blind eye
loses nothing.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from trueangle.core.health import STATUS_MEANING, ServiceBit, StatusBit
from trueangle.core.register_reading import SlotReading, status_words

MINUTE_S = 60.0
STILL_S = 2.0
"""Registers whose cycle counter stands so long are no longer believed: the daemon renews them every 10 ms."""
SPARK_CELLS = 12
BOLD, REVERSE, DIM, RESET = "\x1b[1m", "\x1b[7m", "\x1b[2m", "\x1b[0m"
GREEN, YELLOW, RED = "\x1b[32m", "\x1b[33m", "\x1b[31m"
_INFORMATION = (
    StatusBit.HELD
    | StatusBit.RAW_SERVED
    | StatusBit.LATENCY_COMPENSATED
    | StatusBit.USER_PRESET
    | StatusBit.HEAD_LOST
)
_HEADER = 'slot joint    state           corrected     raw/deg   corr/"  T/degC  age/ms'
_NEVER_SHOWN_AS_FAULT = ServiceBit.ALL_VALID | ServiceBit.COMMANDS_ENABLED


@dataclass(frozen=True, slots=True, kw_only=True)
class Signs:
    """The signs of the view."""

    good: str
    fault: str
    note: str
    spark: str
    """From low to high."""
    above: str
    below: str


UNICODE_SIGNS = Signs(good="✔", fault="✖", note="●", spark="▁▂▃▄▅▆▇█", above="↑", below="↓")
ASCII_SIGNS = Signs(good="+", fault="X", note="o", spark="_.-=^", above="^", below="v")


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """All that was read in one cycle."""

    slots: tuple[SlotReading, ...]
    service: ServiceBit
    cycle: int
    heartbeat: int
    torn: bool = False


@dataclass(slots=True)
class MonitorState:
    """What the view knows; times are monotonic seconds."""

    where: str
    names: Mapping[int, str]
    connected: bool = False
    since_s: float = 0.0
    """When the connection came or went."""
    reason: str = "connecting"
    snapshot: Snapshot | None = None
    moved_s: float = 0.0
    """When the cycle counter last changed."""
    first_row: int = 0
    losses: int = 0
    history: dict[int, deque[tuple[float, float]]] = field(default_factory=dict[int, "deque[tuple[float, float]]"])
    """Correction by slot with its time, over the last minute."""

    def took(self, snapshot: Snapshot, now_s: float) -> None:
        """A whole cycle was read."""
        if not self.connected:
            self.connected, self.since_s, self.reason = True, now_s, ""
        if self.snapshot is None or snapshot.cycle != self.snapshot.cycle:
            self.moved_s = now_s
        self.snapshot = snapshot
        for reading in snapshot.slots:
            kept = self.history.setdefault(reading.slot, deque())
            if reading.valid and reading.correction_arcsec is not None:
                kept.append((now_s, reading.correction_arcsec))
            while kept and kept[0][0] < now_s - MINUTE_S:
                kept.popleft()

    def lost(self, reason: str, now_s: float) -> None:
        """The connection is gone: what was read before counts no more."""
        if self.connected or not self.since_s:
            self.losses += self.connected
            self.connected, self.since_s = False, now_s
        self.reason, self.snapshot = reason, None

    def stands_still(self, now_s: float) -> bool:
        """Whether the served registers are not renewed."""
        return self.connected and now_s - self.moved_s > STILL_S


def render(
    state: MonitorState, *, width: int, height: int, now_s: float, clock: str, colour: bool, signs: Signs
) -> list[str]:
    """The screen: exactly `height` lines at most, none wider than `width` signs; colours come on top of that."""
    paint = _paint if colour else _plain
    lines = [_fit(f"trueangle monitor  {state.where}", clock, width), *_banner(state, width, now_s, paint, signs)]
    lines.append("")
    with_spark = width >= len(_HEADER) + 2 + 6
    cells = min(SPARK_CELLS, width - len(_HEADER) - 2) if with_spark else 0
    title = _HEADER + (f"  {'last minute':<{cells}}"[: cells + 2] if with_spark else "")
    lines.append(paint(title[:width], BOLD))
    slots = _shown_slots(state, now_s)
    faults = _fault_lines(state, slots, width, paint, signs)
    room = max(1, height - len(lines) - 2)
    fault_room = min(len(faults), max(room - len(slots) * (1 if with_spark else 2), room // 3))
    lines_each = 1 if with_spark else 2
    rows = max(1, (room - fault_room) // lines_each)
    first = min(state.first_row, max(0, len(slots) - rows))
    state.first_row = first
    for reading in slots[first : first + rows]:
        lines += _joint_lines(state, reading, width, cells, now_s, paint, signs)
    lines += faults[:fault_room]
    hidden = (slots[:first], slots[first + rows :])
    footer = "q quit" + _hidden_text(hidden, signs)
    lines = lines[: height - 1]
    lines += [""] * (height - 1 - len(lines))
    return [*lines, paint(footer[:width], DIM)][:height]


def snapshot_text(state: MonitorState, *, now_s: float, clock: str) -> str:
    """The same once, for a pipe: no colour, every joint."""
    count = len(state.snapshot.slots) if state.snapshot else 0
    lines = render(
        state, width=110, height=8 + 3 * count + 2, now_s=now_s, clock=clock, colour=False, signs=ASCII_SIGNS
    )
    return "\n".join(line.rstrip() for line in lines[:-1]).rstrip() + "\n"


def sparkline(points: Sequence[tuple[float, float]], *, now_s: float, cells: int, signs: str) -> str:
    """The means of the last minute in `cells` equal parts, scaled to their own range; a blank where none is."""
    sums = [[0.0, 0] for _ in range(cells)]
    for at_s, value in points:
        place = int((at_s - (now_s - MINUTE_S)) / MINUTE_S * cells)
        if 0 <= place <= cells:
            part = sums[min(place, cells - 1)]
            part[0] += value
            part[1] += 1
    means = [total / count if count else None for total, count in sums]
    known = [mean for mean in means if mean is not None]
    if not known:
        return " " * cells
    low, span = min(known), max(known) - min(known)
    # Below the resolution of the register a change is none: a flat line in the middle.
    top = len(signs) - 1
    return "".join(
        " " if mean is None else signs[top // 2 if span < 0.002 else round((mean - low) / span * top)]
        for mean in means
    )


def _shown_slots(state: MonitorState, now_s: float) -> tuple[SlotReading, ...]:
    if state.snapshot is None or state.stands_still(now_s):
        return ()
    return state.snapshot.slots


def _banner(state: MonitorState, width: int, now_s: float, paint: "_Paint", signs: Signs) -> list[str]:
    lasting = f"{max(0.0, now_s - state.since_s):.0f} s"
    if not state.connected:
        text = f" {signs.fault} NO CONNECTION for {lasting}: {state.reason}; trying again "
        return [paint(text[:width], REVERSE, BOLD, RED)]
    snapshot = state.snapshot
    if snapshot is None or state.stands_still(now_s):
        still_s = now_s - state.moved_s
        text = f" {signs.fault} REGISTERS STAND STILL for {still_s:.0f} s: the angles in them are not shown "
        return [paint(text[:width], REVERSE, BOLD, RED)]
    lost = f", lost {state.losses} time{'s' * (state.losses != 1)}" if state.losses else ""
    troubles = [bit.name or "" for bit in ServiceBit if bit in snapshot.service & ~_NEVER_SHOWN_AS_FAULT]
    bad = sum(not reading.valid for reading in snapshot.slots)
    if bad:
        troubles.insert(0, f"{bad} of {len(snapshot.slots)} joints NOT VALID")
    if troubles:
        text = f" {signs.fault} FAULT  {', '.join(troubles)} "
        first = paint(text[:width], REVERSE, BOLD, RED)
    else:
        first = paint(f" {signs.good} OK  all {len(snapshot.slots)} joints valid"[:width], GREEN, BOLD)
    torn = "  (torn read)" if snapshot.torn else ""
    return [first, _fit(f" connected for {lasting}{lost}{torn}", f"cycle {snapshot.cycle}", width)]


def _joint_lines(
    state: MonitorState,
    reading: SlotReading,
    width: int,
    cells: int,
    now_s: float,
    paint: "_Paint",
    signs: Signs,
) -> list[str]:
    name = state.names.get(reading.slot, "")[:8]
    begin = f"{reading.slot:>4} {name:<8} "
    word = "VALID" if reading.valid else _first_reason(reading.status)
    if reading.valid and reading.status & _INFORMATION:
        badge = paint(f"{signs.note} {word}".ljust(15)[:15], YELLOW, BOLD)
    elif reading.valid:
        badge = paint(f"{signs.good} {word}".ljust(15)[:15], GREEN)
    else:
        badge = paint(f"{signs.fault} {word}".ljust(15)[:15], REVERSE, BOLD, RED)
    numbers = (
        f" {_number(reading.corrected_deg, 10, 6)} {_number(reading.raw_deg, 11, 6)}"
        f" {_number(reading.correction_arcsec, 8, 2, sign=True)} {_number(reading.temperature_c, 7, 2)}"
        f" {'-' if reading.age_ms is None else reading.age_ms:>7}"
    )
    spark = sparkline(
        tuple(state.history.get(reading.slot, ())), now_s=now_s, cells=cells or SPARK_CELLS, signs=signs.spark
    )
    uncertainty = f'u(k=1) {_number(reading.uncertainty_arcsec, 0, 2)}"'
    room = max(0, width - len(begin) - 15)
    if cells:
        return [begin + badge + numbers[:room] + "  " + spark]
    second = f"{'':14}{uncertainty:<16} last minute [{spark}] {_span(state, reading.slot)}"
    return [(begin + badge + numbers[:room]), second[:width].rstrip()]


def _span(state: MonitorState, slot: int) -> str:
    values = [value for _, value in state.history.get(slot, ())]
    return f'{min(values):+.2f} to {max(values):+.2f}"' if values else ""


def _fault_lines(
    state: MonitorState, slots: Sequence[SlotReading], width: int, paint: "_Paint", signs: Signs
) -> list[str]:
    """What is wrong in words, then what is only to be known."""
    faults: list[str] = []
    notes: list[str] = []
    for reading in slots:
        name = state.names.get(reading.slot, "")
        for bit in reading.status & ~(StatusBit.CONFIGURED | StatusBit.VALID):
            sign, lines = (signs.note, notes) if bit in _INFORMATION else (signs.fault, faults)
            text = f" {sign} {reading.slot} {name} {bit.name}: {STATUS_MEANING.get(bit, 'see the newer table')}"
            lines.append(paint(text[:width], BOLD))
    return [*faults, *notes]


def _first_reason(status: StatusBit) -> str:
    words = [word for word in status_words(status) if word not in ("VALID",)]
    reasons = [word for word in words if word not in _INFORMATION_WORDS] or words
    return (
        (reasons[0] + ("+" if len(reasons) > 1 else "")).replace("TEMPERATURE", "TEMP") if reasons else "NOT VALID"
    )


_INFORMATION_WORDS = tuple(bit.name for bit in _INFORMATION)


def _hidden_text(hidden: tuple[Sequence[SlotReading], Sequence[SlotReading]], signs: Signs) -> str:
    texts: list[str] = []
    for slots, arrow, where in ((hidden[0], signs.above, "above"), (hidden[1], signs.below, "below")):
        if slots:
            bad = sum(not reading.valid for reading in slots)
            texts.append(f"{arrow} {len(slots)} more {where}" + (f", {bad} NOT VALID" if bad else ""))
    return "".join(f"   {text}" for text in texts)


def _number(value: float | None, width: int, places: int, *, sign: bool = False) -> str:
    text = "-" if value is None else f"{value:{'+' if sign else ''}.{places}f}"
    return f"{text:>{width}}"


def _fit(left: str, right: str, width: int) -> str:
    return f"{left:<{max(0, width - len(right) - 1)}} {right}"[:width]


class _Paint:
    """Text with attributes around it."""

    def __init__(self, *, colour: bool) -> None:
        self._colour = colour

    def __call__(self, text: str, *attributes: str) -> str:
        return f"{''.join(attributes)}{text}{RESET}" if self._colour else text


_paint, _plain = _Paint(colour=True), _Paint(colour=False)
