"""Share of a core of the whole path at 1 kHz: CAN socket, six joints, Modbus server with 8 clients at 100 Hz.

Run as `python -m tests.benchmarks.bench_hot_path`. Frames come as 16-byte can_frames over a pair of datagram
sockets from this process; only the served process's CPU time counts. `empty` does the same waits and drops the
frames: what the loop alone costs, and the latency that it cannot go below. Kinds of rounds take turns, so that
their ratios mean something on a noisy machine. The next look at the socket comes 1 ms after the last batch was
dealt with, so at 1 kHz there are fewer images than cycles; a process that gets no processor in time gathers many
cycles into one image, and where `images a cycle` lies below one half the share of a core says little. On a busy
machine `chrt -f 5 python -m ...` keeps other processes out of the waits, though not out of the caches.
"""

import argparse
import asyncio
import json
import os
import socket
import statistics
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import can

from trueangle.config import BusConfig, parse_config
from trueangle.core.health import NodeCondition
from trueangle.core.pipeline import Frame, Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.edges.can_bus import CanBus
from trueangle.edges.modbus_server import ModbusTcpServer
from trueangle.edges.onnx_model import load_model
from trueangle.service import LoadedJoint, joint_channel, joint_identity

MODELS = Path(__file__).parents[1] / "data" / "models"
CAN_FRAME = struct.Struct("=IB3x8s")
KINDS = ("empty", "full", "foreign")
TEMPERATURE_EVERY = 50
CLIENTS, CLIENT_HZ, FOREIGN_A_CYCLE = 8, 100, 8
READ_FAST = bytes([0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 84])
JOINT = """
  - slot: {slot}
    name: joint {slot}
    bus: arm
    node_id: {slot}
    model: good.onnx
    encoder: {{counts_per_rev: 3276800}}
    temperature: {{index: 0x7130, subindex: 1, degc_per_unit: 0.01}}
    sequence: {{index: 0x2100, subindex: 0}}
"""


class _Near(can.BusABC):
    """Our end of the pair, in the place of python-can's SocketcanBus."""

    def __init__(self, end: socket.socket) -> None:
        self.socket = end
        super().__init__("pair")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("the daemon writes SocketCAN frames itself")


async def serve(kind: str, end: socket.socket, model: Path) -> dict[str, Any]:
    """The measured process; ends when the other end closes."""
    seen_ns: dict[int, int] = {}
    server = ModbusTcpServer("127.0.0.1", 0, 1)
    last = [0]

    def publish(image: RegisterImage) -> None:
        server.publish(image)
        seen_ns[last[0]] = time.monotonic_ns()

    text = "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: c}]\njoints:"
    text += "".join(JOINT.format(slot=slot) for slot in range(1, 7))
    # Six models, as six joints have: nothing is shared between their passes.
    joints = [
        LoadedJoint(config=joint, model=load_model(model)) for joint in parse_config(text, source="bench").joints
    ]
    pipeline = Pipeline(
        [joint_channel(joint) for joint in joints],
        RegisterMap([joint_identity(joint) for joint in joints]),
        publish=publish,
        on_status=lambda *_: None,
    )
    now_ns = time.monotonic_ns()
    pipeline.on_bus("arm", up=True, now_ns=now_ns)
    for slot in range(1, 7):
        pipeline.on_node(slot, NodeCondition.RUNNING, now_ns)
    closed = asyncio.Event()

    def on_frames(frames: list[Frame]) -> None:
        for cob_id, data, _ in reversed(frames):
            if 0x181 <= cob_id <= 0x186:
                last[0] = int.from_bytes(data[4:6], "little")
                break
        if kind == "empty":
            seen_ns[last[0]] = time.monotonic_ns()
        else:
            pipeline.on_frames("arm", frames, time.monotonic_ns())

    bus = CanBus(
        BusConfig(name="arm", interface="socketcan", channel="pair"),
        on_frames=on_frames,
        on_bus_state=lambda up, _: None if up else closed.set(),
        opener=lambda _: _Near(end),
    )
    bus.listen_to(pipeline.process_data("arm"))
    port = await server.start()
    async with bus:
        print(port, flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        started_s = time.process_time()
        await closed.wait()
        used_s = time.process_time() - started_s
    await server.close()
    lost = pipeline.counters.misfit_frames + sum(state.frames_lost for state in pipeline.states.values())
    valid = sum(int(state.status) & 1 for state in pipeline.states.values())
    return {
        "cpu_s": used_s,
        "seen_ns": seen_ns,
        "lost": lost,
        "valid": valid,
        "frames": bus.counters.frames,
        "images": pipeline.counters.images,
    }


def feed(kind: str, cycles: int, model: Path) -> dict[str, Any]:
    """One round: start the served process, send in real time, collect what it says."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    command = [sys.executable, "-m", "tests.benchmarks.bench_hot_path", "--model", str(model)]
    command += ["--serve", kind, str(near.fileno())]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=[near.fileno()]
    ) as child:
        near.close()
        assert child.stdin is not None
        assert child.stdout is not None
        port = int(child.stdout.readline())
        clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(CLIENTS)]
        sent_ns, late = send_all(kind, cycles, far, clients, child.stdin)
        far.close()
        told: dict[str, Any] = json.loads(child.stdout.readline())
    seen = {int(number): at_ns for number, at_ns in told["seen_ns"].items()}
    delays = sorted(delays_ms(sent_ns, seen))
    wall_s = cycles * 1e-3 + late
    return {
        "core": told["cpu_s"] / wall_s,
        "cycle_us": told["cpu_s"] / cycles * 1e6,
        "p50_ms": delays[len(delays) // 2],
        "p99_ms": delays[len(delays) * 99 // 100],
        "lost": told["lost"] + (7 + 6 / TEMPERATURE_EVERY) * cycles + 6 - told["frames"],
        "valid": told["valid"],
        "rate_hz": cycles / wall_s,
        "images": told["images"] / cycles,
    }


def delays_ms(sent_ns: dict[int, int], seen_ns: dict[int, int]) -> list[float]:
    """From each cycle's last frame to the first time its sample, or a newer one, could be read."""
    delays: list[float] = []
    readable_ns: int | None = None
    for number in sorted(sent_ns, reverse=True):
        readable_ns = seen_ns.get(number, readable_ns)
        if readable_ns is not None:
            delays.append((readable_ns - sent_ns[number]) / 1e6)
    return delays


def send_all(
    kind: str, cycles: int, far: socket.socket, clients: list[socket.socket], begin: Any
) -> tuple[dict[int, int], float]:
    """The times at which the last frame of each cycle left, and by how many seconds the whole came late."""
    for slot in range(1, 7):
        far.send(CAN_FRAME.pack(0x280 + slot, 2, struct.pack("<h", 2000)))
    begin.write("go\n")
    begin.flush()
    sent_ns: dict[int, int] = {}
    every, asked = 1000 // CLIENT_HZ, set[socket.socket]()
    start_s = time.monotonic()
    for cycle in range(1, cycles + 1):
        pause_s = start_s + cycle * 1e-3 - time.monotonic()
        if pause_s > 0:
            time.sleep(pause_s)
        far.send(CAN_FRAME.pack(0x080, 0, b""))
        if kind == "foreign":
            for number in range(FOREIGN_A_CYCLE):
                far.send(CAN_FRAME.pack(0x400 + number, 8, bytes(8)))
        data = struct.pack("<IH", cycle * 977 % 3_276_800, cycle & 0xFFFF)
        for slot in range(1, 7):
            far.send(CAN_FRAME.pack(0x180 + slot, 6, data))
        sent_ns[cycle & 0xFFFF] = time.monotonic_ns()
        if cycle % TEMPERATURE_EVERY == 0:
            for slot in range(1, 7):
                far.send(CAN_FRAME.pack(0x280 + slot, 2, struct.pack("<h", 2000)))
        if cycle % every < CLIENTS:
            client = clients[cycle % every]
            if client in asked:
                client.recv(9 + 2 * 84)
            client.send(READ_FAST)
            asked.add(client)
    late_s = max(0.0, time.monotonic() - start_s - cycles * 1e-3)
    time.sleep(0.05)
    return sent_ns, late_s


def main() -> None:
    """Print medians over rounds, or be the measured process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=3000)
    parser.add_argument("--model", type=Path, default=MODELS / "good.onnx", help="what every joint runs")
    parser.add_argument("--serve", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        kind, handle = options.serve
        print(json.dumps(asyncio.run(serve(kind, socket.socket(fileno=int(handle)), options.model))), flush=True)
        return
    results: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    for _ in range(options.rounds):
        for kind in KINDS:
            results[kind].append(feed(kind, options.cycles, options.model))
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    print(
        f"{os.cpu_count()} cores, load {load}, {options.model.name}; "
        f"medians of {options.rounds} rounds of {options.cycles} cycles at 1 kHz"
    )
    for kind, rounds in results.items():
        middle = {name: statistics.median(one[name] for one in rounds) for name in rounds[0]}
        print(
            f"  {kind:8s} {middle['core'] * 100:5.1f} % of a core ({middle['cycle_us']:.0f} us a cycle)"
            f"  latency p50 {middle['p50_ms']:.2f} ms, p99 {middle['p99_ms']:.2f} ms"
            f"  lost {sum(one['lost'] for one in rounds)}  valid {middle['valid']:.0f} of 6"
            f"  reached {middle['rate_hz']:.0f} Hz  images a cycle {middle['images']:.2f}"
        )
    against = {
        kind: {
            name: statistics.median(r[name] / e[name] for r, e in zip(rounds, results["empty"], strict=True))
            for name in ("core", "p99_ms")
        }
        for kind, rounds in results.items()
    }
    for kind in KINDS[1:]:
        print(f"  {kind} against empty: CPU {against[kind]['core']:.2f}, p99 {against[kind]['p99_ms']:.2f}")


if __name__ == "__main__":
    main()
