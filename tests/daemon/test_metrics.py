"""Metrics: the text that Prometheus reads, the port that gives it, and that nobody can make it do more."""

import asyncio
import re
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.running_service import LIMIT_S, config_yaml, joint_yaml, on_wire, started

from trueangle.core.health import StatusBit
from trueangle.core.metrics import METRICS, Kind, MetricSample, render_metrics
from trueangle.edges.metrics import MAX_CONNECTIONS, MetricsServer

# One line of the format, as its description gives it (Prometheus docs, "Text-based format").
LINE = re.compile(
    r'([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{((?:[a-zA-Z_][a-zA-Z0-9_]*="(?:[^"\\\n]|\\["\\n])*",?)*)\})? (\S+)'
)

ESCAPED = {'\\"': '"', "\\\\": "\\", "\\n": "\n"}


def read(text: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """A reader of its own: each line after HELP and TYPE of its metric, each series once."""
    series: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {}
    declared = ""
    for line in text.splitlines():
        if line.startswith("# TYPE "):
            declared = line.split()[2]
        elif not line.startswith("# HELP "):
            match = LINE.fullmatch(line)
            assert match is not None, line
            assert match[1] == declared
            labels = tuple(
                (name, re.sub(r"\\.", lambda found: ESCAPED[found[0]], value))
                for name, value in re.findall(r'(\w+)="((?:[^"\\]|\\.)*)"', match[2] or "")
            )
            assert (match[1], labels) not in series
            series[match[1], labels] = float(match[3])
    return series


def test_names_carry_units_and_counters_their_ending() -> None:
    names = [metric.name for metric in METRICS]
    assert len(set(names)) == len(names)
    for metric in METRICS:
        assert re.fullmatch(r"trueangle(_[a-z0-9]+)+", metric.name)
        assert metric.name.endswith("_total") == (metric.kind is Kind.COUNTER)
        for unit in ("age", "lasted"):
            assert unit not in metric.name.split("_") or "seconds" in metric.name


@given(st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=20))
def test_any_label_comes_back_as_it_was(text: str) -> None:
    """A joint's name is checked, a model's path is not."""
    text = "".join(text.splitlines())  # a reader by lines; the line feed itself is in the example below
    sample = MetricSample(name="trueangle_bus_up", labels=(text,), value=1.0)
    assert read(render_metrics([sample])) == {("trueangle_bus_up", (("bus", text),)): 1.0}


def test_a_line_feed_in_a_label_ends_no_line() -> None:
    sample = MetricSample(name="trueangle_bus_up", labels=('a"\n\\b',), value=1.0)
    assert render_metrics([sample]).splitlines()[-1] == r'trueangle_bus_up{bus="a\"\n\\b"} 1'


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1e6, "1000000"), (0.25, "0.25"), (-3.0, "-3"), (1e300, "1e+300"), (float("nan"), "NaN")],
)
def test_numbers_are_written_as_prometheus_reads_them(value: float, text: str) -> None:
    sample = MetricSample(name="trueangle_cycles_total", labels=(), value=value)
    assert render_metrics([sample]).splitlines()[-1] == f"trueangle_cycles_total {text}"


@pytest.mark.parametrize("labels", [(), ("a", "b")])
def test_a_sample_without_its_labels_is_a_fault(labels: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="expected a metric of the table with its labels"):
        render_metrics([MetricSample(name="trueangle_bus_up", labels=labels, value=1.0)])


# The port


@asynccontextmanager
async def serving(render: Callable[[], str] = lambda: "x 1\n") -> AsyncIterator[MetricsServer]:
    server = MetricsServer("127.0.0.1", 0, render=render, content_type="text/plain; version=0.0.4")
    await server.open()
    try:
        yield server
    finally:
        await server.close()


async def ask(port: int, request: bytes) -> bytes:
    async with asyncio.timeout(LIMIT_S):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            writer.write(request)
            return await reader.read()
        except ConnectionResetError:
            return b""
        finally:
            writer.close()


def test_metrics_are_given_to_get_and_their_head_to_head() -> None:
    async def scenario() -> None:
        async with serving() as server:
            for path in (b"/metrics", b"/metrics?a=b"):
                head, body = (await ask(server.port, b"GET " + path + b" HTTP/1.1\r\nHost: x\r\n\r\n")).split(
                    b"\r\n\r\n"
                )
                assert head.split(b"\r\n")[:3] == [
                    b"HTTP/1.0 200 OK",
                    b"Content-Type: text/plain; version=0.0.4",
                    b"Content-Length: 4",
                ]
                assert body == b"x 1\n"
            assert (await ask(server.port, b"HEAD /metrics HTTP/1.0\r\n\r\n")).endswith(b"close\r\n\r\n")

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", b"404"),
        (b"GET /metrics/../etc HTTP/1.1\r\n\r\n", b"404"),
        (b"POST /metrics HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc", b"405"),
        (b"\r\n\r\n", b"400"),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\r\n\r\n", b"400"),
        (b"GET /metrics SPDY/9\r\n\r\n", b"400"),
        (b"GET " + b"a" * 20_000 + b" HTTP/1.1\r\n\r\n", b"400"),
    ],
)
def test_anything_else_is_refused_and_the_next_is_served(request_: bytes, status: bytes) -> None:
    async def scenario() -> None:
        async with serving() as server:
            answer = await ask(server.port, request_)
            # A request too long to be read whole may meet a reset instead of its answer.
            assert answer[9:12] == status or (answer == b"" and len(request_) > 8192)
            assert b"x 1" in await ask(server.port, b"GET /metrics HTTP/1.0\r\n\r\n")

    asyncio.run(scenario())


def test_connections_that_ask_nothing_are_few_and_end_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueangle.edges.metrics.TIMEOUT_S", 0.2)

    async def scenario() -> None:
        async with serving() as server:
            silent = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(MAX_CONNECTIONS)]
            async with asyncio.timeout(LIMIT_S):
                reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
                with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
                    await reader.readexactly(1)
                writer.close()
                assert server.refused == 1
                for held, held_writer in silent:
                    assert await held.read() == b""
                    held_writer.close()
            assert b"x 1" in await ask(server.port, b"GET /metrics HTTP/1.0\r\n\r\n")

    asyncio.run(scenario())


def test_a_port_that_is_taken_is_logged_and_nothing_else(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        with socket.create_server(("127.0.0.1", 0)) as holder:
            server = MetricsServer("127.0.0.1", holder.getsockname()[1], render=str, content_type="text/plain")
            await server.open()
            await server.close()
        assert "event=metrics_unavailable host=127.0.0.1" in caplog.text

    asyncio.run(scenario())


# The running service


def test_the_service_tells_of_joints_bus_and_modbus(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = (EncoderNode(i, lambda _id, _data: None, counts=lambda _: 1_234_567) for i in (1, 2))
    second.temperature_centi_c = 4500  # beyond its model
    config = config_yaml(joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx"))
    config = config.replace("schema_version: 1", "schema_version: 1\nmetrics: {port: 0}")

    async def scenario() -> None:
        async with on_wire(monkeypatch, CanWire(), first, second), started(config, caplog) as r:
            await r.until_status(1, StatusBit.VALID)
            await r.until(2, lambda read: StatusBit.TEMPERATURE_OUTSIDE_MODEL in read.status)
            found = re.search(r"event=metrics_listening host=127.0.0.1 port=(\d+)", caplog.text)
            assert found is not None
            answer = await ask(int(found[1]), b"GET /metrics HTTP/1.0\r\n\r\n")
            series = read(answer.decode().split("\r\n\r\n")[1])
            base, elbow = (("slot", "1"), ("joint", "base")), (("slot", "2"), ("joint", "elbow"))
            assert series["trueangle_joint_valid", base] == 1
            assert series["trueangle_joint_valid", elbow] == 0
            outside = (("bit", "temperature_outside_model"),)
            assert series["trueangle_joint_status_bit", base + outside] == 0
            assert series["trueangle_joint_status_bit", elbow + outside] == 1
            assert series["trueangle_temperature_celsius", elbow] == 45
            assert 0 <= series["trueangle_sample_age_seconds", base] < 0.5
            # Of a joint that is not corrected there is no correction to tell.
            assert ("trueangle_correction_arcseconds", base) in series
            assert ("trueangle_correction_arcseconds", elbow) not in series
            assert series["trueangle_bus_up", (("bus", "arm"),)] == 1
            assert series["trueangle_bus_frames_total", (("bus", "arm"),)] > 10
            assert series["trueangle_modbus_connections", ()] == 1
            assert series["trueangle_modbus_requests_total", ()] > 1
            told = {name for name, _ in series}
            unknown = {"trueangle_uncertainty_arcseconds"}  # these models state none
            assert told == {metric.name for metric in METRICS} - unknown

    asyncio.run(scenario())
