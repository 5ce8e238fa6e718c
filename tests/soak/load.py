"""Six joints behind a socketcand, eight clients that read on, others that come and go, reloads, nodes that reboot.

The daemon is a process of its own, so its memory and descriptors are its own. Every answer that a client reads is
held to the rule that a corrected angle is served exactly with VALID.
"""

import asyncio
import contextlib
import os
import random
import re
import signal
import struct
from asyncio.subprocess import DEVNULL, PIPE, Process
from dataclasses import dataclass, field
from pathlib import Path

from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request
from tests.fakes.running_service import MODELS, config_yaml, joint_yaml, port_of
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment
from tests.fuzz.memory import MemoryTrack, open_descriptors, resident_mib

from trueangle.contract.metadata import OPEN_SEAL, seal_holds, sealed

JOINTS, CLIENTS = 6, 8
READ_S, COME_AND_GO_S, RELOAD_S, REBOOT_S, MEASURE_S = 0.05, 0.2, 5.0, 3.0, 0.5
PATIENCE_S = 60.0
VALID, MARKER = 1, -(2**31)
_SLOT = struct.Struct(">IHiiihHH")


@dataclass
class Account:
    """What the soak has seen."""

    reads: int = 0
    valid: int = 0
    """Joints served as good, over all reads."""
    visits: int = 0
    """Clients that came and went."""
    reloads: int = 0
    reboots: int = 0
    descriptors_begin: int = 0
    descriptors_end: int = 0
    memory: MemoryTrack = field(default_factory=MemoryTrack)


def config(port: int, stale_ms: int) -> str:
    """Six joints, each with a model of its own."""
    joints = [
        joint_yaml(slot, f"joint {slot}", model=f"{slot}.onnx").replace("stale_ms: 500", f"stale_ms: {stale_ms}")
        for slot in range(1, JOINTS + 1)
    ]
    return config_yaml(
        *joints, interface="socketcand", channel="can0", options=f"{{host: 127.0.0.1, port: {port}}}"
    ).replace("modbus: {port: 0}", "modbus: {port: 0, max_connections_per_address: 32}")


def models(folder: Path) -> None:
    """One file for each joint, the same graph in all: the joint's name is changed and the file sealed anew."""
    data = (MODELS / "twin.onnx").read_bytes()
    (seal,) = [found for found in re.findall(rb"[0-9a-f]{64}", data) if seal_holds(data, found.decode())]
    for slot in range(1, JOINTS + 1):
        named = data.replace(b'"joint": "twin"', b'"joint": "twi%d"' % slot).replace(seal, OPEN_SEAL.encode())
        (folder / f"{slot}.onnx").write_bytes(sealed(named))


def _node(node_id: int) -> EncoderNode:
    def counts(sample: int) -> int:
        return (100_000 * node_id + 977 * sample) % COUNTS_PER_REV

    return EncoderNode(node_id, lambda _id, _data: None, counts=counts)


async def soak(seconds: float, folder: Path, rng: random.Random) -> Account:
    """Run the load; AssertionError where an answer breaks the rule or the daemon ends."""
    account = Account()
    models(folder)
    nodes = [_node(slot) for slot in range(1, JOINTS + 1)]
    async with SocketcandServer(*nodes) as bus:
        path = folder / "arm.yaml"
        path.write_text(config(bus.port, 500), "utf-8")
        process = await asyncio.create_subprocess_exec(
            *command("run", "--config", str(path)), env=environment(), stdin=DEVNULL, stdout=DEVNULL, stderr=PIPE
        )
        log = _Log(process)
        try:
            port = await log.port()
            async with asyncio.timeout(PATIENCE_S):
                while not log.count("event=joint_valid"):  # noqa: ASYNC110 - the log is another process
                    await asyncio.sleep(0.05)
            await _loaded(seconds, account, process, port, nodes, path, bus.port, rng)
            account.reloads = log.count("event=reloaded")
        finally:
            if process.returncode is None:
                process.send_signal(signal.SIGTERM)
            await asyncio.wait_for(process.wait(), PATIENCE_S)
            await log.end()
    assert process.returncode == 0, log.lines[-5:]
    return account


class _Log:
    """The daemon's log, read all the time so that it never waits for its reader."""

    def __init__(self, process: Process) -> None:
        self.lines: list[str] = []
        self._counts: dict[str, int] = {}
        self._task = asyncio.create_task(self._read(process))

    async def _read(self, process: Process) -> None:
        assert process.stderr is not None
        async for line in process.stderr:
            text = line.decode()
            self.lines = [*self.lines[-99:], text]
            for word in text.split():
                if word.startswith("event="):
                    self._counts[word] = self._counts.get(word, 0) + 1

    def count(self, event: str) -> int:
        return self._counts.get(event, 0)

    async def port(self) -> int:
        async with asyncio.timeout(PATIENCE_S):
            while (port := port_of(self.lines)) is None:
                assert not self._task.done(), self.lines
                await asyncio.sleep(0.02)
        return port

    async def end(self) -> None:
        await self._task


async def _loaded(
    seconds: float,
    account: Account,
    process: Process,
    port: int,
    nodes: list[EncoderNode],
    path: Path,
    bus_port: int,
    rng: random.Random,
) -> None:
    loop = asyncio.get_running_loop()
    end_s = loop.time() + seconds
    async with asyncio.TaskGroup() as tasks:
        work = [tasks.create_task(_read_on(port, account)) for _ in range(CLIENTS)]
        work += [
            tasks.create_task(_come_and_go(port, account, rng)),
            tasks.create_task(_reload(process, path, bus_port)),
            tasks.create_task(_reboot(nodes, account, rng)),
        ]
        while (left_s := end_s - loop.time()) > 0:
            await asyncio.sleep(min(left_s, max(MEASURE_S, seconds / 200)))
            assert process.returncode is None, "the daemon has ended"
            share = 1.0 - max(0.0, end_s - loop.time()) / seconds
            account.memory.readings.append((share, resident_mib(process.pid)))
            if not account.descriptors_begin and share >= 0.1:
                account.descriptors_begin = open_descriptors(process.pid)
        for task in work[CLIENTS:]:
            task.cancel()
        await asyncio.sleep(2 * COME_AND_GO_S)
        # With the eight that read on still there, as at the beginning.
        account.descriptors_end = open_descriptors(process.pid)
        for task in work[:CLIENTS]:
            task.cancel()


async def _read_on(port: int, account: Account) -> None:
    client = await ModbusTcpClient.connect(port)
    try:
        while True:
            answer = await client.ask(read_request(4, 0, 84))
            if answer[7] == 4:
                account.reads += 1
                account.valid += _checked(answer[9:])
            await asyncio.sleep(READ_S)
    finally:
        await client.close()


def _checked(registers: bytes) -> int:
    """How many joints are valid in this fast image."""
    valid = 0
    for slot in range(JOINTS):
        status, _, corrected, *_ = _SLOT.unpack_from(registers, 20 + 24 * slot)
        assert (corrected != MARKER) == bool(status & VALID), (slot, status, corrected)
        valid += status & VALID
    return valid


async def _come_and_go(port: int, account: Account, rng: random.Random) -> None:
    """Clients that read once, ask nonsense, leave half a request or break off."""
    while True:
        client = await ModbusTcpClient.connect(port)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            kind = rng.randrange(4)
            if kind == 0:
                await client.ask(read_request(3, 1000, 70))
            elif kind == 1:
                await client.send(rng.randbytes(rng.randrange(1, 300)))
            elif kind == 2:
                await client.send(read_request(4, 0, 84)[:5])
            else:
                await client.send(read_request(4, 0, 84) * 30)
        await client.close()
        account.visits += 1
        await asyncio.sleep(COME_AND_GO_S)


async def _reload(process: Process, path: Path, bus_port: int) -> None:
    stale_ms = 500
    while True:
        await asyncio.sleep(RELOAD_S)
        stale_ms = 1100 - stale_ms
        beside = path.with_suffix(".new")
        beside.write_text(config(bus_port, stale_ms), "utf-8")
        beside.replace(path)
        os.kill(process.pid, signal.SIGHUP)


async def _reboot(nodes: list[EncoderNode], account: Account, rng: random.Random) -> None:
    while True:
        await asyncio.sleep(REBOOT_S)
        rng.choice(nodes).reboot()
        account.reboots += 1
