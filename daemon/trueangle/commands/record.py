"""`trueangled record`: what a running daemon serves, as the CSV that `trueangle diagnose` reads."""

import argparse
import asyncio
import datetime
import math
import os
import sys
import time
from collections import deque
from pathlib import Path

from trueangle.commands import Commands
from trueangle.commands.modbus_target import ModbusTarget, add_target, target_of
from trueangle.commands.verify import STILL_DEG_S
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.health import StatusBit
from trueangle.core.recording import RecordedJoint, RowMaker
from trueangle.core.register_fields import SLOTS
from trueangle.core.register_reading import DetailReading, detail_block, read_detail
from trueangle.edges.journal import visible
from trueangle.edges.modbus_client import ModbusReader
from trueangle.edges.recorder import PatientRecorder, RecordFiles, RecordLimits, file_stamp, utc_text
from trueangle.edges.terminal import Progress
from trueangle.errors import LinkError, NodeFault

MIB = 2**20
RETRY_S = 1.0
_NOT_OF_NOW = (
    StatusBit.STALE
    | StatusBit.NODE_NOT_READY
    | StatusBit.BUS_DOWN
    | StatusBit.POSITION_JUMP
    | StatusBit.NODE_ID_CLASH
    | StatusBit.ENCODER_DIFFERS
    | StatusBit.NODE_FAULT
    | StatusBit.NOT_REFERENCED
)
"""Raw angles that a true one must not be held against."""


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "record",
        help="record what a running daemon serves, as CSV",
        description="Record what a running daemon serves, one CSV file after the other for each joint. "
        "Ctrl-C ends it. With --references each line on standard input is the true angle at that moment, in "
        "degrees, of the one joint that is recorded, at standstill: such rows have an error, and trueangle "
        "diagnose and train read them. The end of the input then ends the recording.",
        epilog="Example: trueangled record --config /etc/trueangle/trueangled.yaml --out /srv/records",
    )
    add_target(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="directory for the files")
    parser.add_argument("--every-ms", type=int, default=100, metavar="MS", help="time between rows (default 100)")
    parser.add_argument("--slot", type=int, action="append", metavar="N", help="only this joint; repeatable")
    parser.add_argument("--references", action="store_true", help="take reference angles from standard input")
    parser.add_argument(
        "--max-mib", type=float, default=1000.0, metavar="MIB", help="of all files; the oldest is deleted first"
    )
    parser.add_argument("--rotate-mib", type=float, default=20.0, metavar="MIB", help="of one file")
    parser.add_argument("--for", type=float, dest="for_s", metavar="S", help="end after so many seconds")
    parser.set_defaults(command=_record)


def _record(options: argparse.Namespace) -> int:
    target = target_of(options)
    faults: list[Fault] = []
    if not options.out.is_dir():
        faults.append(Fault(where="--out", expected="an existing directory", found=str(options.out)))
    if not 10 <= options.every_ms <= 3_600_000:
        faults.append(Fault(where="--every-ms", expected="10 to 3600000", found=str(options.every_ms)))
    if not 0 < 2 * options.rotate_mib <= options.max_mib:
        faults.append(
            Fault(where="--rotate-mib", expected="at most half of --max-mib", found=f"{options.rotate_mib:g}")
        )
    faults += [
        Fault(where="--slot", expected=f"1 to {SLOTS}", found=str(slot))
        for slot in options.slot or ()
        if not 1 <= slot <= SLOTS
    ]
    if faults:
        raise ContractError(faults)
    try:
        return asyncio.run(_run(target, options))
    except KeyboardInterrupt:
        return 0


async def _run(target: ModbusTarget, options: argparse.Namespace) -> int:
    limits = RecordLimits(
        max_bytes=round(options.max_mib * MIB), rotate_bytes=round(options.rotate_mib * MIB), rotate_s=None
    )
    sink = PatientRecorder(RecordFiles(options.out, limits), options.out)
    reader = target.reader()
    await reader.connect()
    joints = await _joints(reader, target, options.slot)
    makers = {joint.slot: RowMaker() for joint in joints}
    started_s = time.monotonic()
    due_s, said, connected = started_s, "", True
    references = _References(joints) if options.references else None
    try:
        with Progress(sys.stderr, "record") as progress:
            while options.for_s is None or time.monotonic() - started_s < options.for_s:
                try:
                    if not connected:
                        await reader.connect()
                        connected = True
                    for joint in joints:
                        await _row(reader, joint, makers[joint.slot], sink, started_s, references)
                    trouble = f"stopped: {sink.reason}" if sink.stopped else ""
                except (LinkError, NodeFault) as error:
                    connected = connected and isinstance(error, NodeFault)
                    trouble = str(error)
                    due_s = time.monotonic() + RETRY_S
                if trouble != said:
                    print(f"trueangled: {trouble or 'recording again'}", file=sys.stderr)
                    said = trouble
                lasted_s = time.monotonic() - started_s
                progress(
                    lasted_s / options.for_s if options.for_s else 0.0, f"{sink.lines} rows, {lasted_s:.0f} s"
                )
                if references is not None and references.ended:
                    break
                due_s = max(due_s + options.every_ms * 1e-3, time.monotonic())
                await asyncio.sleep(due_s - time.monotonic())
    finally:
        if references is not None:
            references.close()
        sink.close()
        await reader.close()
        print(f"{sink.lines} rows recorded in {options.out}, {sink.lines_lost} lost")
    return 1 if sink.stopped or said else 0


async def _joints(reader: ModbusReader, target: ModbusTarget, only: list[int] | None) -> tuple[RecordedJoint, ...]:
    """The joints that are served, found by reading."""
    found: list[RecordedJoint] = []
    for slot in only or range(1, SLOTS + 1):
        block = detail_block(slot)
        if await reader.read(block.address, block.count) is not None:
            found.append(RecordedJoint(slot=slot, name=target.names.get(slot, f"slot{slot}")))
        elif only:
            served = f"{target.host}:{target.port}"
            raise ContractError([Fault(where="--slot", expected=f"a joint that {served} serves", found=str(slot))])
    if not found:
        raise NodeFault(f"{reader.where}: no joint is served there; is it a trueangled?")
    return tuple(found)


async def _row(
    reader: ModbusReader,
    joint: RecordedJoint,
    maker: RowMaker,
    sink: PatientRecorder,
    started_s: float,
    references: "_References | None",
) -> None:
    block = detail_block(joint.slot)
    data = await reader.read(block.address, block.count)
    if data is None:
        raise NodeFault(f"{reader.where}: slot {joint.slot} is not served any more")
    reading = read_detail(data, joint.slot)
    if reading.torn:
        return
    reference_deg = None if references is None else references.next(reading)
    now_s, moment = time.monotonic(), datetime.datetime.now(datetime.UTC)
    line = maker.row(reading, reference_deg=reference_deg, time_s=now_s - started_s, utc=utc_text(moment))
    sink.append(joint, line, now_s=now_s, stamp=file_stamp(moment))


class _References:
    """True angles from standard input, a line each, taken with the next reading of the joint at standstill."""

    def __init__(self, joints: tuple[RecordedJoint, ...]) -> None:
        if len(joints) != 1:
            found = ", ".join(f"slot {joint.slot}" for joint in joints)
            raise ContractError([Fault(where="--references", expected="one joint: --slot N", found=found)])
        self._begun = b""
        self._lines: deque[str] = deque()
        self._open = True
        try:
            asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._read)
        except OSError as error:
            expected = "a terminal or a pipe on standard input"
            raise ContractError([Fault(where="--references", expected=expected, found="a file")]) from error

    @property
    def ended(self) -> bool:
        """Whether the input has ended and every line was taken."""
        return not (self._open or self._lines)

    def close(self) -> None:
        """Read no more."""
        if self._open:
            self._open = False
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())

    def next(self, reading: DetailReading) -> float | None:
        """The true angle at this reading, if one was told and the joint stands; a line is never used twice."""
        if not self._lines:
            return None
        text = self._lines.popleft().strip()
        why = _unusable(text, reading)
        shown = f"{reading.raw_deg:.6f} deg raw" if reading.raw_deg is not None else "no raw angle"
        print(f"reference {visible(text)}: " + (f"not taken: {why}" if why else f"taken at {shown}"), flush=True)
        return None if why else _angle_deg(text)

    def _read(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        *lines, self._begun = (self._begun + data).split(b"\n")
        if not data:
            lines, self._begun = [self._begun], b""
            self.close()
        self._lines += [line.decode("utf-8", "replace") for line in lines if line.strip()]


def _angle_deg(text: str) -> float | None:
    try:
        angle_deg = float(text)
    except ValueError:
        return None
    return angle_deg if math.isfinite(angle_deg) else None


def _unusable(text: str, reading: DetailReading) -> str:
    """Why this reference must not be held against this reading; empty where it may."""
    if _angle_deg(text) is None:
        return "expected an angle in degrees"
    if reading.raw_deg is None or reading.status & _NOT_OF_NOW:
        words = " ".join(bit.name or "" for bit in _NOT_OF_NOW & reading.status) or "none"
        return f"the joint has no position of now ({words})"
    if reading.velocity_deg_s is None:
        return "the joint's velocity is not known"
    if abs(reading.velocity_deg_s) > STILL_DEG_S:
        return f"the joint moves ({reading.velocity_deg_s:+.3f} deg/s)"
    return ""
