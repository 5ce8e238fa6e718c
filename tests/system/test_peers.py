"""Modbus libraries that this project did not write, as PLCs of a running service.

Every answer must belong to its question: the ranges that are asked for differ in their content, and overlapped
answers are told apart by their transaction numbers alone.
"""

import asyncio
import json
import shutil
import struct
import subprocess
from asyncio.subprocess import PIPE
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.running_service import (
    GOOD,
    LIMIT_S,
    config_yaml,
    correction_arcsec,
    joint_yaml,
    on_wire,
    raw_mas,
    same_angle,
    started,
)

from trueangle.core.health import StatusBit

ROOT = Path(__file__).parents[2]
SOURCES, INSTALLED = ROOT / "tests" / "peers", ROOT / "build" / "peers"
COUNTS, CENTI_C = 2_345_678, 2840
JOINT = (
    joint_yaml(1, "base")
    .replace("stale_ms: 500", "stale_ms: 60000")
    .replace("heartbeat_ms: 500", "heartbeat_ms: 10000")
    .replace("stale_s: 1}", "stale_s: 60}")
)
"""However slow the machine, the joint stays valid while a peer reads."""
MODBUS_HEADER = Path("/usr/include/modbus/modbus.h")
READS = {(4, 0): 84, (3, 1000): 70, (4, 10): 12, (3, 1002): 4}
ROUNDS = 50


def node_peer(name: str) -> list[str]:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (INSTALLED / name / "node_modules").is_dir():
        pytest.skip(f"{name} is not installed: make peers")
    return ["node", str(INSTALLED / name / "read.js")]


def jsmodbus(_: Path) -> list[str]:
    return node_peer("jsmodbus")


def modbus_serial(_: Path) -> list[str]:
    return node_peer("modbus_serial")


def j2mod(_: Path) -> list[str]:
    if shutil.which("java") is None:
        pytest.skip("java is not installed")
    target = INSTALLED / "j2mod" / "target"
    if not (target / "lib").is_dir():
        pytest.skip("j2mod is not installed: make peers")
    return ["java", "-cp", f"{target / 'classes'}:{target / 'lib'}/*", "Read"]


def libmodbus_program(directory: Path) -> list[str]:
    if shutil.which("gcc") is None or not MODBUS_HEADER.exists():
        pytest.skip("gcc or libmodbus-dev is not installed")
    program = directory / "read"
    source = SOURCES / "libmodbus" / "read.c"
    flags = ("-Wall", "-Werror", f"-I{MODBUS_HEADER.parent}")
    subprocess.run(["gcc", *flags, str(source), "-lmodbus", "-o", str(program)], check=True, timeout=60)
    return [str(program)]


async def answers_of(command: list[str], port: int) -> list[tuple[int, int, bytes]]:
    """Function, address and register bytes, in the order in which the answers came."""
    process = await asyncio.create_subprocess_exec(*command, str(port), stdout=PIPE, stderr=PIPE)
    out, errors = await asyncio.wait_for(process.communicate(), 3 * LIMIT_S)
    assert process.returncode == 0, errors.decode()
    lines = [json.loads(line) for line in out.splitlines()]
    return [
        (line["function"], line["address"], struct.pack(f">{len(line['registers'])}H", *line["registers"]))
        for line in lines
    ]


def check(function: int, address: int, data: bytes) -> None:
    """Length, status, raw and corrected angle of the joint, from the place where this range has them."""
    assert len(data) == 2 * READS[function, address]
    status_at, raw_at, corrected_at = {
        0: (20, 30, 26),
        10: (0, 10, 6),
        1000: (4, 28, 12),
        1002: (0, None, None),
    }[address]
    assert int.from_bytes(data[status_at : status_at + 4], "big") == GOOD
    if raw_at is None or corrected_at is None:
        return
    raw, corrected = (int.from_bytes(data[at : at + 4], "big", signed=True) for at in (raw_at, corrected_at))
    assert raw == raw_mas(COUNTS)
    assert same_angle(corrected, raw_mas(COUNTS) + 1e3 * correction_arcsec(COUNTS, CENTI_C), 1)


@pytest.mark.parametrize("peer", [jsmodbus, modbus_serial, j2mod, libmodbus_program])
def test_a_peer_reads_two_hundred_ranges_and_each_answer_belongs_to_its_question(
    peer: Callable[[Path], list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    device = EncoderNode(
        1, lambda _id, _data: None, counts=lambda _: COUNTS, temperature_centi_c=CENTI_C, syncs_per_heartbeat=1_000
    )

    command = peer(tmp_path)

    async def scenario() -> None:
        async with on_wire(monkeypatch, CanWire(), device), started(config_yaml(JOINT), caplog) as r:
            await r.until_status(1, StatusBit.VALID)
            answers = await answers_of(command, r.port)
        assert Counter(answer[:2] for answer in answers) == dict.fromkeys(READS, ROUNDS)
        for answer in answers:
            check(*answer)

    asyncio.run(scenario())
