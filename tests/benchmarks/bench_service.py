"""The service as a process, six healthy nodes on a socketcand: time to listen, to angles, to stop; memory; reload;
how old the angles are that a PLC reads, and how soon it sees that a joint has fallen silent.

Wall-clock of a whole process on this machine: quote with its load.
"""

import asyncio
import os
import re
import signal
import statistics
import struct
import tempfile
import time
from asyncio.subprocess import DEVNULL, PIPE, Process
from pathlib import Path

from tests.fakes.encoder_node import EncoderNode
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request
from tests.fakes.running_service import MODELS, config_yaml, joint_yaml
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment

from trueangle.contract.metadata import OPEN_SEAL, SEAL_KEY, sealed
from trueangle.edges.onnx_model import load_model

ROUNDS, JOINTS = 5, 6
LIMIT_S = 60.0
ALL_VALID = 1
STALE_MS, SYNC_MS = 50, 10
READS = 1000
FIRST_SLOT, SLOT_REGISTERS, AGE = 10, 12, 10
"""0-based, of deploy/registers.md: where slot 1 stands, and its age in ms within a slot."""


def write_models(folder: Path) -> list[str]:
    """Six files of one model, each with an id of its own: no two joints may have the same file."""
    good = (MODELS / "good.onnx").read_bytes()
    calibration_id = load_model(MODELS / "good.onnx").metadata.calibration.id.encode()
    seals = re.findall(rb"[0-9a-f]{64}", good[good.index(SEAL_KEY.encode()) :])
    opened = good.replace(seals[0], OPEN_SEAL.encode())
    names: list[str] = []
    for number in range(JOINTS):
        changed = opened.replace(calibration_id, calibration_id[:-1] + b"%d" % number)
        names.append(str(folder / f"joint{number}.onnx"))
        Path(names[-1]).write_bytes(sealed(changed))
    return names


async def answered(plc: ModbusTcpClient, true: int) -> float:
    """Poll the service status (register 7) as a PLC until ALL_VALID is this; the monotonic time."""
    async with asyncio.timeout(LIMIT_S):
        while True:
            answer = await plc.ask(read_request(4, 0, 10))
            if answer[7] == 4 and int.from_bytes(answer[23:25], "big") & 1 == true:
                return time.monotonic()
            await asyncio.sleep(0.002)


async def ages_ms(plc: ModbusTcpClient) -> list[int]:
    """What a PLC that reads every 2 ms is told of the ages of all six angles."""
    ages: list[int] = []
    for _ in range(READS):
        answer = await plc.ask(read_request(4, FIRST_SLOT, JOINTS * SLOT_REGISTERS))
        words = struct.unpack(f">{JOINTS * SLOT_REGISTERS}H", answer[9:])
        ages += words[AGE::SLOT_REGISTERS]
        await asyncio.sleep(0.002)
    return ages


async def silence_ms(plc: ModbusTcpClient, node: EncoderNode, sampled_s: list[float]) -> float:
    """From the last sample of a node that falls silent to the marker that a PLC reads in its angle's place."""
    node.deaf = True
    async with asyncio.timeout(LIMIT_S):
        while True:
            answer = await plc.ask(read_request(4, FIRST_SLOT + 3, 2))
            if struct.unpack(">i", answer[9:])[0] == -(2**31):
                break
            await asyncio.sleep(0.001)
    passed_ms = (time.monotonic() - sampled_s[-1]) * 1e3
    node.deaf = False
    return passed_ms


async def line_with(process: Process, text: str) -> str:
    assert process.stderr is not None
    async with asyncio.timeout(LIMIT_S):
        while True:
            line = (await process.stderr.readline()).decode()
            if text in line:
                return line
            assert line, "trueangled ended"


def resident_mib(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def cpu_s(pid: int) -> float:
    """User and system time of the process (proc(5), fields 14 and 15 of stat)."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def one_round(config: Path, node: EncoderNode, sampled_s: list[float]) -> dict[str, float]:
    """Seconds and MiB of one life; `node` falls silent in it, `sampled_s` are the times of its samples."""
    figures: dict[str, float] = {}
    begun_s = time.monotonic()
    process = await asyncio.create_subprocess_exec(
        *command("run", "--config", str(config)), env=environment(), stdin=DEVNULL, stdout=PIPE, stderr=PIPE
    )
    found = re.search(r"port=(\d+)", await line_with(process, "event=modbus_listening"))
    assert found is not None
    plc = await ModbusTcpClient.connect(int(found[1]))
    figures["listening s"] = time.monotonic() - begun_s
    figures["CPU until then s"] = cpu_s(process.pid)
    figures["six valid angles s"] = await answered(plc, ALL_VALID) - begun_s
    figures["resident MiB"] = resident_mib(process.pid)
    ages = sorted(await ages_ms(plc))
    figures["age of served angles, p50, ms"], figures["the same, at most, ms"] = ages[len(ages) // 2], ages[-1]
    process.send_signal(signal.SIGHUP)
    reloaded = re.search(r"took_s=([0-9.]+)", await line_with(process, "event=reloaded kept=6"))
    assert reloaded is not None
    figures["reload, nothing changed s"] = float(reloaded[1])
    figures["resident MiB after it"] = resident_mib(process.pid)
    figures["silent joint marked after ms"] = await silence_ms(plc, node, sampled_s)
    await plc.close()
    begun_s = time.monotonic()
    process.send_signal(signal.SIGTERM)
    await asyncio.wait_for(process.communicate(), LIMIT_S)
    figures["orderly stop s"] = time.monotonic() - begun_s
    return figures


async def measured(folder: Path) -> list[dict[str, float]]:
    models = write_models(folder)
    sampled_s = [0.0]

    def first_counts(_: int) -> int:
        sampled_s[:] = [time.monotonic()]
        return 1_234_567

    nodes = [EncoderNode(1, lambda _id, _data: None, counts=first_counts)]
    nodes += [EncoderNode(i, lambda _id, _data: None, counts=lambda _: 1_234_567) for i in range(2, JOINTS + 1)]
    config = folder / "arm.yaml"
    rounds: list[dict[str, float]] = []
    for _ in range(ROUNDS):
        for node in nodes:
            node.boot_up()
            node.objects |= {(0x6001, 0): (3_276_800, 4), (0x6002, 0): (3_276_800, 4), (0x6003, 0): (0, 4)}
            node.objects |= {(0x6501, 0): (65_536, 4)}
        async with SocketcandServer(*nodes) as bus:
            options = f"{{host: 127.0.0.1, port: {bus.port}}}"
            joints = [joint_yaml(i, f"joint {i}", model=model) for i, model in enumerate(models, start=1)]
            text = config_yaml(*joints, interface="socketcand", channel="can0", options=options)
            config.write_text(text.replace("stale_ms: 500", f"stale_ms: {STALE_MS}"), "utf-8")
            rounds.append(await one_round(config, nodes[0], sampled_s))
    return rounds


def main() -> None:
    """Print medians and extremes over rounds."""
    with tempfile.TemporaryDirectory() as folder:
        rounds = asyncio.run(measured(Path(folder)))
    for name in rounds[0]:
        values = [figures[name] for figures in rounds]
        spread = f"{min(values):.2f} to {max(values):.2f}"
        print(f"{name}: {statistics.median(values):.2f} (median of {ROUNDS}; {spread})")
    print(
        f"SYNC every {SYNC_MS} ms, stale_ms: {STALE_MS}; a silent joint is to be marked within {STALE_MS + 10} ms"
    )


if __name__ == "__main__":
    main()
