"""FC 04 x 40 registers on the loopback: libmodbus (C), trueangled's server, stock pymodbus; interleaved rounds.

Run as `python tests/benchmarks/bench_modbus.py`. The load is one separate process (C where gcc is there, else a
slower one in Python), bounded in requests and time. Without libmodbus's headers the yardstick is left out, and it
says so. Ratios of one run mean something; absolute figures belong to the machine.
"""

import argparse
import asyncio
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
FIRST_REGISTER = 1000
COUNT = 40
ANSWER_BYTES = 9 + 2 * COUNT
TIME_LIMIT_S = 10.0
YARDSTICK = "libmodbus (C)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One round of one server."""

    requests_per_s: float
    p50_us: float
    p99_us: float
    server_cpu_us: float
    """User and system time of the server for one request."""


def main() -> None:
    """Measure and print, or, with --serve or --load, be one of the processes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--requests", type=int, default=20_000, help="requests in each round")
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 8])
    parser.add_argument("--serve", choices=["trueangle", "pymodbus"], help=argparse.SUPPRESS)
    parser.add_argument("--load", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        asyncio.run({"trueangle": serve_trueangle, "pymodbus": serve_pymodbus}[options.serve]())
    elif options.load:
        port, clients, requests, limit_s = options.load
        load_in_python(int(port), int(clients), int(requests), float(limit_s))
    else:
        measure(options.rounds, options.requests, options.clients)


def measure(rounds: int, requests: int, client_counts: list[int]) -> None:
    """Run all servers at once, load one after the other, print the medians."""
    with ExitStack() as stack:
        build = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        load = compiled(build, "modbus_load.c") or [sys.executable, __file__, "--load"]
        if load[0] == sys.executable:
            print("no gcc: the load generator is Python and may be the slowest part")
        yardstick = compiled(build, "libmodbus_server.c", "-I/usr/include/modbus", "-lmodbus")
        if yardstick is None:
            print("no gcc or no libmodbus (apt: libmodbus-dev): measured without the yardstick")
        commands = {
            **({YARDSTICK: yardstick} if yardstick else {}),
            "trueangled": [sys.executable, __file__, "--serve", "trueangle"],
            "pymodbus stock": [sys.executable, __file__, "--serve", "pymodbus"],
        }
        servers = {name: stack.enter_context(running(command)) for name, command in commands.items()}
        for clients in client_counts:
            results: dict[str, list[Round]] = defaultdict(list)
            for number in range(rounds + 1):
                for name, (pid, port) in servers.items():
                    one = run_load(load, pid, port, clients, requests)
                    # The first round warms caches and the interpreter.
                    if number:
                        results[name].append(one)
            print_results(clients, results)


def compiled(build: Path, source: str, *options: str) -> list[str] | None:
    """The command of the compiled program; None where that is not possible."""
    if shutil.which("gcc") is None:
        return None
    program = build / source.removesuffix(".c")
    command = ["gcc", "-O2", "-Wall", "-Wextra", "-o", str(program), str(HERE / source), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return [str(program)] if done.returncode == 0 else None


@contextmanager
def running(command: list[str]) -> Iterator[tuple[int, int]]:
    """A server process; yields its process id and port. It ends when its standard input closes."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        word, port = process.stdout.readline().split()
        assert word == "listening"
        yield process.pid, int(port)
        process.stdin.close()


def run_load(load: list[str], pid: int, port: int, clients: int, requests: int) -> Round:
    """One round; the server's processor time is taken around it."""
    before_s = cpu_s(pid)
    command = [*load, str(port), str(clients), str(requests), str(TIME_LIMIT_S)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    done, seconds, p50_us, p99_us = int(printed[0]), float(printed[1]), float(printed[2]), float(printed[3])
    used_s = cpu_s(pid) - before_s
    return Round(requests_per_s=done / seconds, p50_us=p50_us, p99_us=p99_us, server_cpu_us=used_s / done * 1e6)


def cpu_s(pid: int) -> float:
    """User and system time of a process so far (proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def print_results(clients: int, results: dict[str, list[Round]]) -> None:
    """One line a server: medians, spread, and the median of the ratios within each round."""
    print(f"\n{clients} client(s), FC 04 x {COUNT}, median of {len(next(iter(results.values())))} rounds")
    for name, rounds in results.items():
        rates = [one.requests_per_s for one in rounds]
        line = (
            f"  {name:15s} {statistics.median(rates):8.0f} requests/s ({min(rates):.0f}..{max(rates):.0f})"
            f"  p50 {statistics.median(one.p50_us for one in rounds):6.0f} us"
            f"  p99 {statistics.median(one.p99_us for one in rounds):6.0f} us"
            f"  server CPU {statistics.median(one.server_cpu_us for one in rounds):5.1f} us/request"
        )
        if YARDSTICK in results:
            ratios = [
                ours.requests_per_s / theirs.requests_per_s
                for ours, theirs in zip(rounds, results[YARDSTICK], strict=True)
            ]
            line += f"  ratio {statistics.median(ratios):.2f}"
        print(line)


async def serve_until_stdin_closes(start: Callable[[], Awaitable[int]]) -> None:
    """Start, say the port, stay until the parent closes the pipe."""
    print(f"listening {await start()}", flush=True)
    await asyncio.to_thread(sys.stdin.read)


async def serve_trueangle() -> None:
    """The daemon's server with the image of six joints."""
    from bench_registers import joint_states, register_map

    from trueangle.edges.modbus_server import ModbusTcpServer

    server = ModbusTcpServer("127.0.0.1", 0, 1)
    server.publish(
        register_map(6).image(cycle=1, heartbeat=1, service_status=1, states=joint_states(6)),
    )
    await serve_until_stdin_closes(server.start)
    await server.close()


async def serve_pymodbus() -> None:
    """pymodbus' own server and data store."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    registers = SimData(address=FIRST_REGISTER, count=100, values=17, datatype=DataType.REGISTERS)
    server = ModbusTcpServer(SimDevice(id=0, simdata=[registers]), address=("127.0.0.1", port))

    async def start() -> int:
        await server.serve_forever(background=True)
        return port

    await serve_until_stdin_closes(start)
    await server.shutdown()


def load_in_python(port: int, clients: int, requests: int, limit_s: float) -> None:
    """The load of modbus_load.c where there is no compiler: one request at a time on each connection in turn."""
    request = bytes([0, 1, 0, 0, 0, 6, 1, 4, FIRST_REGISTER >> 8, FIRST_REGISTER & 0xFF, 0, COUNT])
    sockets = [socket.create_connection(("127.0.0.1", port), timeout=2.0) for _ in range(clients)]
    sent_s = [0.0] * clients
    latencies_us: list[float] = []
    start_s = time.perf_counter()
    for number, connection in enumerate(sockets):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sent_s[number] = time.perf_counter()
        connection.sendall(request)
    while len(latencies_us) < requests and time.perf_counter() - start_s < limit_s:
        for number, connection in enumerate(sockets):
            answer = connection.recv(ANSWER_BYTES, socket.MSG_WAITALL)
            assert len(answer) == ANSWER_BYTES
            assert answer[7] == 4
            now_s = time.perf_counter()
            latencies_us.append((now_s - sent_s[number]) * 1e6)
            sent_s[number] = now_s
            connection.sendall(request)
    seconds = time.perf_counter() - start_s
    latencies_us.sort()
    done = len(latencies_us)
    print(done, seconds, latencies_us[done // 2], latencies_us[done * 99 // 100])


if __name__ == "__main__":
    main()
