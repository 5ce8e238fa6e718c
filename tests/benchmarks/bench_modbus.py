"""FC 04 x 40 registers on the loopback: libmodbus (C), trueangled's server plain and with TLS, stock pymodbus.

Run as `python -m tests.benchmarks modbus`; rounds are interleaved. The load is one separate process (C where gcc
is there, else a slower one in Python), bounded in requests and time; its own mutual TLS 1.3 counts as well, and
every ratio is to libmodbus without TLS. Each transport runs on asyncio, which trueangled uses, and on uvloop where
that is installed. What is missing is left out, and it says so. Ratios of one run mean something; absolute figures
belong to the machine.
"""

import argparse
import asyncio
import importlib
import importlib.util
import logging
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
LOOPS = ("asyncio", "uvloop")


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One round of one server."""

    requests_per_s: float
    p50_us: float
    p99_us: float
    server_cpu_us: float
    """User and system time of the server for one request."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Files:
    """Certificates of one plant, made for this run."""

    authority: str
    server: tuple[str, str]
    client: tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A running server and how it is loaded."""

    pid: int
    load: list[str]
    load_files: tuple[str, ...]
    port: int


def main() -> None:
    """Measure and print, or, with --serve or --load, be one of the processes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--requests", type=int, default=20_000, help="requests in each round")
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 8])
    parser.add_argument("--serve", choices=["trueangle", "pymodbus"], help=argparse.SUPPRESS)
    parser.add_argument("--loop", choices=LOOPS, default=LOOPS[0], help=argparse.SUPPRESS)
    parser.add_argument("--tls", nargs=3, default=[], help=argparse.SUPPRESS)
    parser.add_argument("--load", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve == "trueangle":
        with asyncio.Runner(loop_factory=loop_factory(options.loop)) as runner:
            runner.run(serve_trueangle(options.tls))
    elif options.serve:
        asyncio.run(serve_pymodbus())
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
        print("event loop of trueangled: asyncio, plain and TLS; uvloop is measured beside it")
        loops = [name for name in LOOPS if importlib.util.find_spec(name) is not None]
        if "uvloop" not in loops:
            print("uvloop is not installed: measured on asyncio alone")
        tls_load = compiled(build, "modbus_load.c", "-DWITH_TLS", "-lssl", "-lcrypto")
        files = None if tls_load is None else certificates(build)
        if files is None:
            print("no gcc, libssl (apt: libssl-dev) or openssl command: TLS is not measured")
        ours = [sys.executable, __file__, "--serve", "trueangle", "--loop"]
        servers: dict[str, Measured] = {}

        def run(name: str, command: list[str], load: list[str], *load_files: str) -> None:
            pid, port = stack.enter_context(running(command))
            servers[name] = Measured(pid=pid, port=port, load=load, load_files=load_files)

        if yardstick is not None:
            run(YARDSTICK, yardstick, load)
        for loop in loops:
            run(f"plain, {loop}", [*ours, loop], load)
        for loop in loops:
            if tls_load is not None and files is not None:
                command = [*ours, loop, "--tls", *files.server, files.authority]
                run(f"TLS 1.3, {loop}", command, tls_load, files.authority, *files.client)
        run("pymodbus stock", [sys.executable, __file__, "--serve", "pymodbus"], load)
        for clients in client_counts:
            results: dict[str, list[Round]] = defaultdict(list)
            for number in range(rounds + 1):
                for name, server in servers.items():
                    one = run_load(server, clients, requests)
                    # The first round warms caches and the interpreter.
                    if number:
                        results[name].append(one)
            print_results(clients, results)


def certificates(build: Path) -> Files | None:
    """An authority, a server and a client; None without the openssl command."""
    if shutil.which("openssl") is None:
        return None
    from tests.fakes.certificates import Authority

    authority = Authority(build, "plant")
    server, client = authority.issue("server", "subjectAltName=IP:127.0.0.1"), authority.issue("client")
    return Files(
        authority=str(authority.certificate),
        server=(str(server.certificate), str(server.key)),
        client=(str(client.certificate), str(client.key)),
    )


def loop_factory(name: str) -> Callable[[], asyncio.AbstractEventLoop]:
    """Makes the event loop of this name."""
    return importlib.import_module(name).new_event_loop


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


def run_load(server: Measured, clients: int, requests: int) -> Round:
    """One round; the server's processor time is taken around it."""
    before_s = cpu_s(server.pid)
    numbers = (server.port, clients, requests, TIME_LIMIT_S)
    command = [*server.load, *map(str, numbers), *server.load_files]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    done, seconds, p50_us, p99_us = int(printed[0]), float(printed[1]), float(printed[2]), float(printed[3])
    used_s = cpu_s(server.pid) - before_s
    return Round(requests_per_s=done / seconds, p50_us=p50_us, p99_us=p99_us, server_cpu_us=used_s / done * 1e6)


def cpu_s(pid: int) -> float:
    """User and system time of a process so far (proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def print_results(clients: int, results: dict[str, list[Round]]) -> None:
    """One line a server: medians, spread, the median of the ratios within each round, and the ratio of the p50.

    Each client waits for its answer, so rates go as one through the latency; the p50 shows less of what else runs
    on the machine.
    """
    print(f"\n{clients} client(s), FC 04 x {COUNT}, median of {len(next(iter(results.values())))} rounds")
    for name, rounds in results.items():
        rates = [one.requests_per_s for one in rounds]
        line = (
            f"  {name:16s} {statistics.median(rates):8.0f} requests/s ({min(rates):.0f}..{max(rates):.0f})"
            f"  p50 {statistics.median(one.p50_us for one in rounds):6.0f} us"
            f"  p99 {statistics.median(one.p99_us for one in rounds):6.0f} us"
            f"  server CPU {statistics.median(one.server_cpu_us for one in rounds):5.1f} us/request"
        )
        if YARDSTICK in results:
            ratios = [
                ours.requests_per_s / theirs.requests_per_s
                for ours, theirs in zip(rounds, results[YARDSTICK], strict=True)
            ]
            by_p50 = statistics.median(one.p50_us for one in results[YARDSTICK]) / statistics.median(
                one.p50_us for one in rounds
            )
            line += f"  ratio {statistics.median(ratios):.2f}, by p50 {by_p50:.2f}"
        print(line)


async def serve_until_stdin_closes(start: Callable[[], Awaitable[int]]) -> None:
    """Start, say the port, stay until the parent closes the pipe."""
    print(f"listening {await start()}", flush=True)
    await asyncio.to_thread(sys.stdin.read)


async def serve_trueangle(tls_files: list[str]) -> None:
    """The daemon's server with the image of six joints; with certificate, key and authority TLS alone."""
    from tests.benchmarks.bench_registers import joint_states, register_map

    from trueangle.config import TlsConfig
    from trueangle.edges.modbus_server import ModbusTcpServer, load_tls
    from trueangle.edges.modbus_server.server import Listener

    tls = None
    if tls_files:
        certificate, key, authority = tls_files
        config = TlsConfig(certificate=certificate, private_key=key, client_ca=authority)
        settings = load_tls(config, base=Path("/"), credentials=None, source="benchmark")
        tls = Listener(host="127.0.0.1", port=0, tls=settings)
    server = ModbusTcpServer("127.0.0.1", 0, 1, plain=tls is None, tls=tls)
    server.publish(
        register_map(6).image(cycle=1, heartbeat=1, service_status=1, states=joint_states(6)),
    )
    await serve_until_stdin_closes(server.start)
    await server.close()


async def serve_pymodbus() -> None:
    """pymodbus' own server and data store."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    # It logs its last frames as an error whenever a client leaves.
    logging.disable(logging.CRITICAL)
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
