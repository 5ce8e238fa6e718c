"""All bad clients at once against the running service, and a daemon that is killed: the joints go on."""

import asyncio
import random
import signal
from asyncio.subprocess import DEVNULL, PIPE, Process
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request
from tests.fakes.running_service import (
    MARKER,
    MODELS,
    FastSlot,
    Rig,
    config_yaml,
    joint_yaml,
    on_wire,
    port_of,
    raw_mas,
    started,
)
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment

from trueangle.core.health import StatusBit

REST = 1_234_567
PATIENCE_S = 60.0
CROWD = 300


def node(node_id: int) -> EncoderNode:
    return EncoderNode(node_id, lambda _id, _data: None, counts=lambda _: REST, syncs_per_heartbeat=1_000)


def patient(joint: str) -> str:
    """Limits that a loaded machine does not reach, so that only the clients could take the joint out."""
    return (
        joint.replace("stale_ms: 500", "stale_ms: 60000")
        .replace("heartbeat_ms: 500", "heartbeat_ms: 10000")
        .replace("stale_s: 1}", "stale_s: 60}")
    )


def test_no_crowd_of_clients_takes_a_joint_or_a_good_client_down(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Beyond the limit, garbage, half requests, clients that ask and never read: all while one reads on."""
    config = config_yaml(patient(joint_yaml(1, "base")), patient(joint_yaml(2, "elbow", model="twin.onnx")))
    rng = random.Random(7)  # noqa: S311 - chance that comes again

    async def bad_client(r: Rig, kind: int) -> ModbusTcpClient | None:
        try:
            client = await ModbusTcpClient.connect(r.port, f"127.0.0.{2 + kind}")
            if kind == 0:
                await client.send(rng.randbytes(200))
            elif kind == 1:
                await client.send(read_request(4, 0, 84)[:7])
            elif kind == 2:
                await client.send(read_request(4, 0, 84) * 30)  # and never reads
            elif kind == 3:
                for byte in read_request(4, 0, 84):
                    await client.send(bytes((byte,)))
            else:
                await client.send(b"".join(b"\0\1\0\0\0\2\1" + bytes((rng.randrange(256),)) for _ in range(20)))
        except ConnectionError:
            return None  # refused: the limit holds
        return client

    async def scenario() -> None:
        async with on_wire(monkeypatch, CanWire(), node(1), node(2)), started(config, caplog) as r:
            for slot in (1, 2):
                await r.until_status(slot, StatusBit.VALID)
            caplog.clear()
            reads: list[FastSlot] = []
            crowd: list[ModbusTcpClient | None] = []
            for number in range(CROWD):
                crowd.append(await bad_client(r, number % 5))
                if number % 10 == 0:
                    reads += [await r.fast(1), await r.fast(2)]
            r.still_running()
            assert all(StatusBit.VALID in read.status and read.raw_mas == raw_mas(REST) for read in reads)
            lines = [message for message in caplog.messages if "event=joint_not_valid" in message]
            assert not lines
            for event in ("event=modbus_broken_stream", "event=modbus_refused"):
                # Logged when it begins, then counted for a minute: a crowd fills no disk.
                assert sum(event in message for message in caplog.messages) == 1, event
            for client in crowd:
                if client is not None:
                    await client.close()

    asyncio.run(scenario())


async def run_daemon(path: Path, seen: list[str]) -> tuple[Process, int]:
    """A `trueangled` of its own, and its port once it listens."""
    process = await asyncio.create_subprocess_exec(
        *command("run", "--config", str(path)), env=environment(), stdin=DEVNULL, stdout=DEVNULL, stderr=PIPE
    )
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while (port := port_of(seen)) is None:
            line = await process.stderr.readline()
            assert line, seen
            seen.append(line.decode())
    return process, port


async def until_valid(port: int) -> None:
    """Reads until the joint is valid; before that there is no corrected angle, and never a wrong raw one."""
    client = await ModbusTcpClient.connect(port)
    async with asyncio.timeout(PATIENCE_S):
        while True:
            answer = await client.ask(read_request(4, 10, 12))
            if answer[7] == 4:
                status = int.from_bytes(answer[9:13], "big")
                corrected, raw = (int.from_bytes(answer[at : at + 4], "big", signed=True) for at in (15, 19))
                assert (corrected != MARKER) == bool(status & StatusBit.VALID)
                assert raw in (MARKER, raw_mas(REST))
                if status & StatusBit.VALID:
                    break
            await asyncio.sleep(0.02)
    await client.close()


def test_a_daemon_that_was_killed_starts_on_its_port_and_serves_again(tmp_path: Path) -> None:
    """Killed while clients are connected: nothing that it left, a port in TIME_WAIT included, is in the way."""

    async def scenario() -> None:
        async with SocketcandServer(node(1)) as bus:
            joint = patient(joint_yaml(1, "base", model=str(MODELS / "good.onnx")))
            options = f"{{host: 127.0.0.1, port: {bus.port}}}"
            path = tmp_path / "arm.yaml"

            def write(port: int) -> None:
                text = config_yaml(joint, interface="socketcand", channel="can0", port=port, options=options)
                path.write_text(text, "utf-8")

            write(0)
            process, port = await run_daemon(path, [])
            write(port)
            for last in (False, False, True):
                await until_valid(port)
                process.send_signal(signal.SIGTERM if last else signal.SIGKILL)
                await asyncio.wait_for(process.communicate(), PATIENCE_S)
                assert process.returncode == (0 if last else -signal.SIGKILL)
                if not last:
                    process, again = await run_daemon(path, [])
                    assert again == port

    asyncio.run(scenario())
