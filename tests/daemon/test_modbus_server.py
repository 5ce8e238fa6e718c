"""The Modbus TCP server over real sockets on the loopback, with clients that behave and clients that do not."""

import asyncio
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from pymodbus.client import AsyncModbusTcpClient
from tests.fakes.modbus_tcp_client import ModbusTcpClient, frame, read_request
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.edges.modbus_server import ModbusLimits, ModbusTcpServer
from trueangle.errors import LinkError

UNIT_ID = 17
REGISTER_MAP = RegisterMap([joint_identity()])
FOREVER = ModbusLimits(idle_timeout_s=3600.0)


def image(cycle: int) -> RegisterImage:
    return REGISTER_MAP.image(cycle=cycle, heartbeat=0, service_status=1, states={1: joint_state()})


@asynccontextmanager
async def serving(limits: ModbusLimits = FOREVER) -> AsyncIterator[tuple[ModbusTcpServer, int]]:
    """A server with an image; nothing of it is left behind."""
    before = asyncio.all_tasks()
    server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, limits)
    server.publish(image(1))
    port = await server.start()
    try:
        yield server, port
    finally:
        await server.close()
    assert server.counters.connections == 0
    assert asyncio.all_tasks() == before


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop run until the condition holds; an error if it never does."""
    for _ in range(5000):
        if condition():
            return
        await asyncio.sleep(0.002)
    raise AssertionError("the condition never came to hold")


def cycle_of(answer: bytes) -> int:
    return struct.unpack(">I", answer[9:13])[0]


def test_a_request_that_waited_through_a_stall_is_answered_from_a_new_image() -> None:
    """The loop runs ready sockets before timers that are due: the image of before the stall is still the last."""

    async def scenario() -> None:
        made = [2]

        def refresh() -> None:
            if made:
                server.publish(image(made.pop()))

        limits = ModbusLimits(idle_timeout_s=3600.0, image_age_s=0.2)
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, limits, refresh)
        server.publish(image(1))
        client = await ModbusTcpClient.connect(await server.start())
        request = read_request(4, 2, 2, unit=UNIT_ID)
        time.sleep(0.25)  # noqa: ASYNC251 - the stall itself: nothing on the loop runs
        assert cycle_of(await client.ask(request)) == 2
        time.sleep(0.25)  # noqa: ASYNC251 - and now nobody can make a new one
        assert (await client.ask(request))[7:] == b"\x84\x06"
        await client.close()
        await server.close()

    asyncio.run(scenario())


def test_before_the_first_image_the_server_is_busy_and_then_answers_from_the_latest() -> None:
    async def scenario() -> None:
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID)
        client = await ModbusTcpClient.connect(await server.start())
        request = read_request(4, 2, 2, unit=UNIT_ID)
        assert await client.ask(request) == frame(b"\x84\x06", unit=UNIT_ID)
        for cycle in (5, 6):
            server.publish(image(cycle))
            assert cycle_of(await client.ask(request)) == cycle
        assert (server.counters.requests, server.counters.exceptions) == (3, 1)
        await client.close()
        await server.close()

    asyncio.run(scenario())


def test_pipelined_requests_are_all_answered_in_order() -> None:
    async def scenario() -> None:
        async with serving() as (server, port):
            client = await ModbusTcpClient.connect(port)
            await client.send(b"".join(read_request(4, 0, 84, transaction=n, unit=0) for n in range(1000)))
            answers = [await client.receive() for _ in range(1000)]
            assert [int.from_bytes(answer[:2], "big") for answer in answers] == list(range(1000))
            assert {answer[9:] for answer in answers} == {image(1).read(0, 84)}
            assert server.counters.requests == 1000
            await client.close()

    asyncio.run(scenario())


def test_a_request_that_arrives_byte_by_byte_is_answered() -> None:
    async def scenario() -> None:
        async with serving() as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            for byte in read_request(3, 2, 2, unit=255):
                writer.write(bytes([byte]))
                await writer.drain()
                await asyncio.sleep(0)
            assert cycle_of(await reader.readexactly(13)) == 1
            writer.close()
            await writer.wait_closed()

    asyncio.run(scenario())


def test_requests_before_a_half_close_are_answered() -> None:
    async def scenario() -> None:
        async with serving() as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(read_request(4, 0, 84, unit=0) * 50)
            writer.write_eof()
            assert len(await reader.read(-1)) == 50 * (9 + 168)
            writer.close()
            await writer.wait_closed()

    asyncio.run(scenario())


def test_a_bad_header_closes_only_its_own_connection(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with serving() as (server, port):
            bystander = await ModbusTcpClient.connect(port)
            for _ in range(3):
                client = await ModbusTcpClient.connect(port)
                await client.send(b"GET / HTTP/1.1\r\n\r\n")
                assert await client.at_end()
                await client.close()
            assert cycle_of(await bystander.ask(read_request(4, 2, 2, unit=0))) == 1
            assert server.counters.broken == 3
            await bystander.close()

    asyncio.run(scenario())
    # The same trouble again within a minute is counted, not logged again.
    assert sum("event=modbus_broken_stream" in record.getMessage() for record in caplog.records) == 1


def test_connections_beyond_the_limit_are_closed_at_once_and_a_freed_place_is_given_again() -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(connections=3, idle_timeout_s=3600.0)) as (server, port):
            request = read_request(4, 2, 2, unit=0)
            clients = [await ModbusTcpClient.connect(port) for _ in range(3)]
            for client in clients:
                assert cycle_of(await client.ask(request)) == 1
            fourth = await ModbusTcpClient.connect(port)
            assert await fourth.at_end()
            assert (server.counters.connections, server.counters.refused) == (3, 1)
            await clients.pop().close()
            await until(lambda: server.counters.connections == 2)
            late = await ModbusTcpClient.connect(port)
            assert cycle_of(await late.ask(request)) == 1
            for client in (*clients, fourth, late):
                await client.close()

    asyncio.run(scenario())


def test_one_address_cannot_take_all_connections() -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(connections_per_address=2, idle_timeout_s=3600.0)) as (server, port):
            request = read_request(4, 2, 2, unit=0)
            greedy = [await ModbusTcpClient.connect(port) for _ in range(2)]
            for client in greedy:
                assert cycle_of(await client.ask(request)) == 1
            third = await ModbusTcpClient.connect(port)
            assert await third.at_end()
            other = await ModbusTcpClient.connect(port, source_host="127.0.0.2")
            assert cycle_of(await other.ask(request)) == 1
            assert server.counters.refused == 1
            for client in (*greedy, third, other):
                await client.close()

    asyncio.run(scenario())


def test_a_silent_connection_is_closed_after_the_idle_time(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(idle_timeout_s=0.05)) as (server, port):
            client = await ModbusTcpClient.connect(port)
            assert await client.at_end()
            assert server.counters.idle_closed == 1
            await client.close()

    asyncio.run(scenario())
    assert "event=modbus_idle_closed peer=127.0.0.1 count=1 reason='no whole request'" in caplog.messages


def test_single_bytes_do_not_keep_a_connection_open() -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(idle_timeout_s=0.05)) as (server, port):
            client = await ModbusTcpClient.connect(port)
            endless = frame(bytes(253))
            sent = 0
            while server.counters.idle_closed == 0:
                # The request never ends; bytes at 1 ms each last five times the idle time.
                assert sent < len(endless) - 1
                await client.send(endless[sent : sent + 1])
                sent += 1
                await asyncio.sleep(0.001)
            assert server.counters.requests == 0
            await client.close()

    asyncio.run(scenario())


def deaf_client(port: int) -> socket.socket:
    """A client with small buffers that is not read from."""
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    client.connect(("127.0.0.1", port))
    client.setblocking(False)
    return client


async def send_until_stuck(client: socket.socket, requests: bytes) -> int:
    """Send without reading until nothing is taken over many turns of the loop or all is over; the bytes sent."""
    sent = idle_turns = 0
    while idle_turns < 2000 and sent < len(requests):
        try:
            sent += client.send(requests[sent : sent + 65536])
            idle_turns = 0
        except BlockingIOError:
            idle_turns += 1
        except ConnectionError:
            break
        await asyncio.sleep(0)
    return sent


ONE_REQUEST = read_request(4, 0, 84, unit=0)
ONE_ANSWER_BYTES = 9 + 168


def test_a_client_that_does_not_read_is_not_read_from_and_gets_every_answer_later() -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(idle_timeout_s=3600.0, unsent_bytes=8192)) as (server, port):
            client = deaf_client(port)
            requests = ONE_REQUEST * 500_000
            sent = await send_until_stuck(client, requests)
            assert sent < len(requests)
            bystander = await ModbusTcpClient.connect(port)
            assert cycle_of(await bystander.ask(read_request(4, 2, 2, unit=0))) == 1
            whole = sent // len(ONE_REQUEST)
            assert server.counters.requests - 1 < whole
            # The limit, and the answers to one full receive buffer: 21 requests.
            waiting = [connection.unsent_bytes for connection in server._open]
            assert 8192 < max(waiting) <= 8192 + 21 * ONE_ANSWER_BYTES
            loop = asyncio.get_running_loop()
            received = 0
            while received < whole * ONE_ANSWER_BYTES:
                received += len(await loop.sock_recv(client, 65536))
            assert received == whole * ONE_ANSWER_BYTES
            assert server.counters.requests - 1 == whole
            client.close()
            await bystander.close()

    asyncio.run(scenario())


def test_a_client_that_never_reads_is_ended_by_the_idle_time(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(idle_timeout_s=0.2, unsent_bytes=1024)) as (server, port):
            client = deaf_client(port)
            await send_until_stuck(client, ONE_REQUEST * 500_000)
            await until(lambda: server.counters.connections == 0)
            assert server.counters.idle_closed == 1
            client.close()

    asyncio.run(scenario())
    (line,) = [message for message in caplog.messages if "event=modbus_idle_closed" in message]
    assert "bytes of answers not taken" in line


def test_closing_does_not_wait_for_a_client_that_does_not_read() -> None:
    async def scenario() -> None:
        async with serving(ModbusLimits(idle_timeout_s=3600.0, unsent_bytes=1024)) as (server, port):
            client = deaf_client(port)
            await send_until_stuck(client, ONE_REQUEST * 500_000)
            await server.close()
            assert server.counters.connections == 0
            client.close()

    asyncio.run(scenario())


def test_closing_ends_open_connections_and_frees_the_port() -> None:
    async def scenario() -> None:
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, FOREVER)
        assert not server.listening
        port = await server.start()
        assert server.listening
        client = await ModbusTcpClient.connect(port)
        await client.ask(read_request(4, 0, 1, unit=0))
        await server.close()
        assert not server.listening
        assert await client.at_end()
        await client.close()
        again = ModbusTcpServer("127.0.0.1", port, UNIT_ID)
        assert await again.start() == port
        await again.close()

    asyncio.run(scenario())


def test_an_address_that_is_taken_is_a_link_error_that_names_it() -> None:
    async def scenario() -> None:
        async with serving() as (_, port):
            with pytest.raises(LinkError, match=rf"127\.0\.0\.1:{port}"):
                await ModbusTcpServer("127.0.0.1", port, UNIT_ID).start()

    asyncio.run(scenario())


def test_an_address_of_another_machine_is_a_link_error() -> None:
    # 192.0.2.0/24 is reserved for documentation (RFC 5737): no machine has it.
    with pytest.raises(LinkError, match=r"192\.0\.2\.1"):
        asyncio.run(ModbusTcpServer("192.0.2.1", 0, UNIT_ID).start())


@pytest.mark.parametrize("name", ["connections", "connections_per_address", "idle_timeout_s", "unsent_bytes"])
def test_a_limit_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        ModbusLimits(**{name: 0})  # pyright: ignore[reportArgumentType]


def test_the_client_of_pymodbus_reads_integers_and_floats_and_exceptions() -> None:
    async def scenario() -> None:
        async with serving() as (_, port):
            client = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0)
            assert await client.connect()
            integer = await client.read_input_registers(1006, count=2, device_id=UNIT_ID)
            double = await client.read_holding_registers(1008, count=4, device_id=UNIT_ID)
            outside = await client.read_input_registers(84, count=1, device_id=UNIT_ID)
            convert = client.convert_from_registers
            assert convert(integer.registers, client.DATATYPE.INT32) == 444_444_441
            assert convert(double.registers, client.DATATYPE.FLOAT64) == 123.4567891
            assert outside.isError()
            assert getattr(outside, "exception_code", None) == 2
            client.close()
            await asyncio.sleep(0)

    asyncio.run(scenario())
