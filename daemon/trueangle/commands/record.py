"""`trueangled record`: what a running daemon serves, as the CSV that `trueangle diagnose` reads."""

import argparse
import asyncio
import datetime
import sys
import time
from pathlib import Path

from trueangle.commands import Commands
from trueangle.commands.modbus_target import ModbusTarget, add_target, target_of
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.recording import RecordedJoint, RowMaker
from trueangle.core.register_fields import SLOTS
from trueangle.core.register_reading import detail_block, read_detail
from trueangle.edges.modbus_client import ModbusReader
from trueangle.edges.recorder import PatientRecorder, RecordFiles, RecordLimits, file_stamp, utc_text
from trueangle.edges.terminal import Progress
from trueangle.errors import LinkError, NodeFault

MIB = 2**20
RETRY_S = 1.0


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "record",
        help="record what a running daemon serves, as CSV",
        description="Record what a running daemon serves, one CSV file after the other for each joint. "
        "Ctrl-C ends it.",
        epilog="Example: trueangled record --config /etc/trueangle/trueangled.yaml --out /srv/records",
    )
    add_target(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="directory for the files")
    parser.add_argument("--every-ms", type=int, default=100, metavar="MS", help="time between rows (default 100)")
    parser.add_argument("--slot", type=int, action="append", metavar="N", help="only this joint; repeatable")
    parser.add_argument("--max-mib", type=float, default=1000.0, help="of all files; the oldest is deleted first")
    parser.add_argument("--rotate-mib", type=float, default=20.0, help="of one file")
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
    try:
        with Progress(sys.stderr, "record") as progress:
            while options.for_s is None or time.monotonic() - started_s < options.for_s:
                try:
                    if not connected:
                        await reader.connect()
                        connected = True
                    for joint in joints:
                        await _row(reader, joint, makers[joint.slot], sink, started_s)
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
                due_s = max(due_s + options.every_ms * 1e-3, time.monotonic())
                await asyncio.sleep(due_s - time.monotonic())
    finally:
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
    reader: ModbusReader, joint: RecordedJoint, maker: RowMaker, sink: PatientRecorder, started_s: float
) -> None:
    block = detail_block(joint.slot)
    data = await reader.read(block.address, block.count)
    if data is None:
        raise NodeFault(f"{reader.where}: slot {joint.slot} is not served any more")
    reading = read_detail(data, joint.slot)
    if reading.torn:
        return
    now_s, moment = time.monotonic(), datetime.datetime.now(datetime.UTC)
    line = maker.row(reading, reference_deg=None, time_s=now_s - started_s, utc=utc_text(moment))
    sink.append(joint, line, now_s=now_s, stamp=file_stamp(moment))
