"""`trueangled monitor`: every joint, live, read over Modbus as a PLC reads it."""

import argparse
import asyncio
import contextlib
import datetime
import json
import os
import signal
import sys
import time
from collections.abc import Mapping

from trueangle.commands import Commands
from trueangle.commands.modbus_target import add_target, target_of
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.health import ServiceBit
from trueangle.core.monitor_view import ASCII_SIGNS, UNICODE_SIGNS, MonitorState, Snapshot, render, snapshot_text
from trueangle.core.register_fields import MAP_VERSION
from trueangle.core.register_reading import GROUPS, GroupReading, SlotReading, fast_block, read_group, status_words
from trueangle.edges.modbus_client import ModbusReader
from trueangle.edges.terminal import CTRL_C, CTRL_D, FullScreen, speaks_unicode, wants_colour
from trueangle.errors import LinkError, NodeFault

RETRY_S = 1.0
_UP, _DOWN = ("\x1b[A", "\x1b[5~", "k"), ("\x1b[B", "\x1b[6~", "j", " ")


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "monitor",
        help="live view of every joint, over Modbus",
        description="Live view of every joint, read over Modbus as a PLC reads it. Keys: q quits, arrows scroll.",
        epilog="Example: trueangled monitor --host 192.0.2.7 --port 5020",
    )
    add_target(parser)
    parser.add_argument("--every-ms", type=int, default=200, metavar="MS", help="time between reads (default 200)")
    parser.add_argument("--json", action="store_true", help="one line of JSON a cycle, no screen")
    parser.add_argument("--once", action="store_true", help="one cycle, then end; exit code 1 unless all is valid")
    parser.set_defaults(command=_monitor)


def _monitor(options: argparse.Namespace) -> int:
    target = target_of(options)
    if not 20 <= options.every_ms <= 60_000:
        found = str(options.every_ms)
        raise ContractError([Fault(where="--every-ms", expected="20 to 60000", found=found)])
    reader = target.reader()
    if options.json or options.once:
        return asyncio.run(_stream(reader, target.names, options))
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        expected = "a terminal, or one of --json and --once"
        raise ContractError([Fault(where="monitor", expected=expected, found="no terminal")])
    return asyncio.run(_screen(reader, target.names, options.every_ms * 1e-3))


async def read_snapshot(reader: ModbusReader) -> Snapshot:
    """Every fast block that is served, each read whole; a torn one once more. LinkError, NodeFault as `read`."""
    slots: list[SlotReading] = []
    first: GroupReading | None = None
    torn = False
    for group in range(GROUPS):
        reading = await _read_group(reader, group)
        if reading is None:
            continue
        if reading.map_version != MAP_VERSION:
            raise NodeFault(
                f"{reader.where}: expected register map version {MAP_VERSION}, found {reading.map_version}; "
                "use the trueangled of that version"
            )
        first = first or reading
        torn |= reading.torn
        slots += () if reading.torn else reading.slots
        if len(slots) >= reading.joints_configured:
            break
    if first is None:
        raise NodeFault(f"{reader.where}: no fast block is served there; is it a trueangled?")
    return Snapshot(
        slots=tuple(slots), service=first.service, cycle=first.cycle, heartbeat=first.heartbeat, torn=torn
    )


async def _read_group(reader: ModbusReader, group: int) -> GroupReading | None:
    block = fast_block(group)
    reading = None
    for _ in range(2):
        data = await reader.read(block.address, block.count)
        if data is None:
            return None
        reading = read_group(data, group)
        if not reading.torn:
            break
    return reading


async def _screen(reader: ModbusReader, names: Mapping[int, str], every_s: float) -> int:
    loop = asyncio.get_running_loop()
    state = MonitorState(where=reader.where, names=names, since_s=time.monotonic())
    ended, stirred = asyncio.Event(), asyncio.Event()
    signs = UNICODE_SIGNS if speaks_unicode(sys.stdout) else ASCII_SIGNS

    def take(keys: str) -> None:
        if not keys or any(key in keys for key in ("q", "Q", CTRL_C, CTRL_D)):
            ended.set()
        elif keys in _DOWN:
            state.first_row += 1
        elif keys in _UP:
            state.first_row = max(0, state.first_row - 1)
        stirred.set()

    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        loop.add_signal_handler(number, take, "q")
    loop.add_signal_handler(signal.SIGWINCH, stirred.set)
    with FullScreen(sys.stdin, sys.stdout) as screen:
        stop_keys = screen.on_keys(loop, take)
        polling = asyncio.create_task(_poll(reader, state, every_s, stirred))
        try:
            while not ended.is_set() and not polling.done():
                width, height = screen.size()
                screen.show(
                    render(
                        state,
                        width=width,
                        height=height,
                        now_s=time.monotonic(),
                        clock=_clock(),
                        colour=wants_colour(os.environ),
                        signs=signs,
                    )
                )
                stirred.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stirred.wait(), 1.0)
        finally:
            stop_keys()
            polling.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await polling
            await reader.close()
    return 0


async def _poll(reader: ModbusReader, state: MonitorState, every_s: float, stirred: asyncio.Event) -> None:
    """Read, and connect again where the connection is lost; until cancelled."""
    connected = False
    while True:
        pause_s = every_s
        try:
            if not connected:
                await reader.connect()
                connected = True
            snapshot = await read_snapshot(reader)
            state.took(snapshot, time.monotonic())
        except (LinkError, NodeFault) as error:
            connected = connected and isinstance(error, NodeFault)
            state.lost(str(error), time.monotonic())
            pause_s = RETRY_S
        stirred.set()
        await asyncio.sleep(pause_s)


async def _stream(reader: ModbusReader, names: Mapping[int, str], options: argparse.Namespace) -> int:
    """Cycles as lines; the exit code tells whether all was valid in the last one."""
    state = MonitorState(where=reader.where, names=names, since_s=time.monotonic())
    connected = False
    try:
        while True:
            pause_s = options.every_ms * 1e-3
            try:
                if not connected:
                    await reader.connect()
                    connected = True
                state.took(await read_snapshot(reader), time.monotonic())
            except (LinkError, NodeFault) as error:
                connected = connected and isinstance(error, NodeFault)
                state.lost(str(error), time.monotonic())
                if options.once and not options.json:
                    raise
                pause_s = max(pause_s, RETRY_S)
            print(json.dumps(_cycle(state)) if options.json else _text(state), flush=True)
            if options.once:
                return 0 if _all_good(state) else 1
            await asyncio.sleep(pause_s)
    except (KeyboardInterrupt, asyncio.CancelledError):
        return 0
    finally:
        await reader.close()


def _text(state: MonitorState) -> str:
    return snapshot_text(state, now_s=time.monotonic(), clock=_clock()).rstrip()


def _all_good(state: MonitorState) -> bool:
    snapshot = state.snapshot
    return snapshot is not None and bool(snapshot.slots) and all(slot.valid for slot in snapshot.slots)


def _cycle(state: MonitorState) -> dict[str, object]:
    """One cycle for a program; null: not known."""
    snapshot = state.snapshot
    cycle: dict[str, object] = {
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"),
        "connected": state.connected,
        "reason": state.reason or None,
    }
    if snapshot is None:
        return cycle
    return cycle | {
        "cycle": snapshot.cycle,
        "heartbeat": snapshot.heartbeat,
        "torn": snapshot.torn,
        "service": [bit.name for bit in ServiceBit if bit in snapshot.service],
        "joints": [
            {
                "slot": slot.slot,
                "name": state.names.get(slot.slot),
                "valid": slot.valid,
                "status": status_words(slot.status),
                "corrected_deg": slot.corrected_deg,
                "raw_deg": slot.raw_deg,
                "correction_arcsec": slot.correction_arcsec,
                "temperature_c": slot.temperature_c,
                "age_ms": slot.age_ms,
                "uncertainty_arcsec": slot.uncertainty_arcsec,
            }
            for slot in snapshot.slots
        ],
    }


def _clock() -> str:
    return datetime.datetime.now().astimezone().strftime("%H:%M:%S")
