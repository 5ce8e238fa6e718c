"""The whole way in three processes: nodes behind a socketcand, `trueangled run`, and mbpoll as the PLC.

mbpoll (Debian, on libmodbus) and the socketcand protocol are not this project's; nothing is shared but bytes.
"""

import asyncio
import re
import shutil
import signal
from asyncio.subprocess import DEVNULL, PIPE, Process
from pathlib import Path

import pytest
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.running_service import (
    GOOD,
    LIMIT_S,
    MODELS,
    config_yaml,
    correction_arcsec,
    joint_yaml,
    port_of,
    raw_mas,
    same_angle,
)
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment

pytestmark = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt: mbpoll)")

COUNTS, CENTI_C = 2_345_678, 2840


async def mbpoll(port: int, *options: str) -> list[int]:
    """The values of one poll of unit 1, 0-based addresses, most significant word first."""
    process = await asyncio.create_subprocess_exec(
        *("mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-1", "-B", *options, "127.0.0.1"),
        stdin=DEVNULL,
        stdout=PIPE,
        stderr=PIPE,
    )
    out, _ = await asyncio.wait_for(process.communicate(), LIMIT_S)
    return [int(value) for value in re.findall(r"^\[\d+\]:\s+(-?\d+)", out.decode(), re.MULTILINE)]


async def log_until(process: Process, text: str, seen: list[str]) -> None:
    """Read the daemon's log up to the line that holds this text."""
    assert process.stderr is not None
    async with asyncio.timeout(LIMIT_S):
        while not any(text in line for line in seen):
            line = await process.stderr.readline()
            assert line, f"trueangled ended: {seen}"
            seen.append(line.decode())


async def stop(process: Process, seen: list[str]) -> int:
    """SIGTERM, and the rest of the log."""
    process.send_signal(signal.SIGTERM)
    _, rest = await asyncio.wait_for(process.communicate(), LIMIT_S)
    seen += rest.decode().splitlines()
    assert process.returncode is not None
    return process.returncode


def test_mbpoll_reads_the_corrected_angle_of_a_running_trueangled(tmp_path: Path) -> None:
    async def scenario() -> None:
        node = EncoderNode(1, lambda _id, _data: None, counts=lambda _: COUNTS, temperature_centi_c=CENTI_C)
        async with SocketcandServer(node) as bus:
            options = f"{{host: 127.0.0.1, port: {bus.port}}}"
            joint = joint_yaml(1, "base", model=str(MODELS / "good.onnx"))
            path = tmp_path / "arm.yaml"
            path.write_text(config_yaml(joint, interface="socketcand", channel="can0", options=options), "utf-8")
            process = await asyncio.create_subprocess_exec(
                *command("run", "--config", str(path)), env=environment(), stdin=DEVNULL, stdout=PIPE, stderr=PIPE
            )
            seen: list[str] = []
            try:
                await log_until(process, "event=joint_valid", seen)
                port = port_of(seen)
                assert port is not None
                assert await mbpoll(port, "-t", "3:int", "-r", "10", "-c", "1") == [int(GOOD)]
                corrected, raw, correction = await mbpoll(port, "-t", "3:int", "-r", "13", "-c", "3")
                expected = correction_arcsec(COUNTS, CENTI_C) * 1e3
                assert raw == raw_mas(COUNTS)
                assert abs(correction - expected) <= 0.51  # rounded once, after binary32
                assert same_angle(corrected, raw_mas(COUNTS) + expected, 1)  # raw and the sum are rounded
                assert abs(corrected - raw) > 1000  # more than an arcsecond: raw served as corrected would show
            finally:
                code = await stop(process, seen)
        assert code == 0, seen
        assert "event=stopped" in seen[-1]

    asyncio.run(scenario())
