"""What clients may take of the TCP server: addresses, crowds, sockets from systemd, streams without sense."""

import asyncio
import ipaddress
import random
import socket
from contextlib import suppress

import pytest
from tests.daemon.test_modbus_server import UNIT_ID, cycle_of, image, serving, until
from tests.fakes.command_target import FakeJoints, FakeStore
from tests.fakes.modbus_tcp_client import ModbusTcpClient, frame, read_request

from trueangle.core.commands import CommandDesk
from trueangle.core.modbus_pdu import Identification
from trueangle.edges.modbus_server import ModbusLimits, ModbusTcpServer
from trueangle.edges.modbus_server.limits import TroubleLog, host_address
from trueangle.edges.modbus_server.server import Listener

READ = read_request(4, 2, 2, unit=UNIT_ID)


def limits(*networks: str, connections: int = 32, each: int = 8) -> ModbusLimits:
    allow = tuple(ipaddress.ip_network(network) for network in networks)
    return ModbusLimits(allow=allow, connections=connections, connections_per_address=each, idle_timeout_s=3600.0)


@pytest.mark.parametrize(
    ("networks", "address", "allowed"),
    [
        ((), "203.0.113.9", True),
        (("192.0.2.0/24",), "192.0.2.255", True),
        (("192.0.2.0/24",), "192.0.3.0", False),
        (("192.0.2.0/24", "203.0.113.9"), "203.0.113.9", True),
        (("192.0.2.0/24",), "2001:db8::1", False),
        (("2001:db8::/32",), "2001:db8::1", True),
        (("0.0.0.0/0",), "unknown", False),
    ],
)
def test_an_address_is_let_in_if_a_network_holds_it(
    networks: tuple[str, ...], address: str, allowed: bool
) -> None:
    assert limits(*networks).allows(address) is allowed


@pytest.mark.parametrize(
    ("peername", "address"),
    [
        (("192.0.2.7", 40000), "192.0.2.7"),
        (("::ffff:192.0.2.7", 40000, 0, 0), "192.0.2.7"),
        (("fe80::1%eth0", 40000, 0, 2), "fe80::1"),
        (("somewhere", 1), "somewhere"),
        (None, "unknown"),
        ("", "unknown"),
    ],
)
def test_one_host_has_one_address_whatever_socket_it_comes_by(peername: object, address: str) -> None:
    """An IPv4 client of an IPv6 socket would otherwise be outside every IPv4 network, and counted twice."""
    assert host_address(peername) == address


def test_a_client_from_elsewhere_is_closed_at_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with serving(limits("127.0.0.2")) as (server, port):
            for _ in range(3):
                client = await ModbusTcpClient.connect(port, "127.0.0.1")
                assert await client.at_end()
                await client.close()
            neighbour = await ModbusTcpClient.connect(port, "127.0.0.2")
            assert cycle_of(await neighbour.ask(READ)) == 1
            assert server.counters.not_allowed == 3
            await neighbour.close()

    asyncio.run(scenario())
    assert sum("event=modbus_not_allowed" in message for message in caplog.messages) == 1


def test_trouble_has_a_line_at_its_begin_one_a_minute_and_one_when_it_is_over(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = TroubleLog()
    with caplog.at_level("INFO", logger="trueangle"):
        for now_s in (0.0, 1.0, 59.9, 60.0, 61.0):
            log.report("modbus_refused", "192.0.2.7", f"at {now_s:g}", now_s)
        log.report("modbus_broken_stream", "192.0.2.8", "garbage", 100.0)
        assert log.end_what_is_over(120.9)
        assert log.end_what_is_over(121.0)
        assert not log.end_what_is_over(160.0)
        log.report("modbus_refused", "192.0.2.7", "again", 170.0)
    assert caplog.messages == [
        "event=modbus_refused peer=192.0.2.7 count=1 reason='at 0'",
        "event=modbus_refused peer=192.0.2.7 count=3 reason='at 60'",
        "event=modbus_broken_stream peer=192.0.2.8 count=1 reason='garbage'",
        "event=modbus_refused_over lasted_s=61.0 count=5",
        "event=modbus_broken_stream_over lasted_s=0.0 count=1",
        "event=modbus_refused peer=192.0.2.7 count=1 reason='again'",
    ]


def test_the_end_of_trouble_is_logged_though_no_client_comes_any_more(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        async with serving(limits("127.0.0.2")) as (server, port):
            server._trouble.interval_s = 0.02
            client = await ModbusTcpClient.connect(port, "127.0.0.1")
            assert await client.at_end()
            await client.close()
            await until(lambda: any("event=modbus_not_allowed_over" in message for message in caplog.messages))

    with caplog.at_level("INFO", logger="trueangle"):
        asyncio.run(scenario())


def test_three_hundred_connections_are_held_to_the_limit_and_the_first_are_served() -> None:
    async def scenario() -> None:
        async with serving(limits(connections=32, each=100)) as (server, port):
            clients = [await ModbusTcpClient.connect(port) for _ in range(300)]
            await until(lambda: server.counters.accepted + server.counters.refused == 300)
            assert (server.counters.connections, server.counters.refused) == (32, 268)
            for client in clients[:32]:
                assert cycle_of(await client.ask(READ)) == 1
            for client in clients[32:]:
                assert await client.at_end()
            for client in clients:
                await client.close()

    asyncio.run(scenario())


def test_three_hundred_connections_are_all_served_where_they_are_allowed() -> None:
    async def scenario() -> None:
        async with serving(limits(connections=300, each=300)) as (server, port):
            clients = [await ModbusTcpClient.connect(port) for _ in range(300)]
            answers = await asyncio.gather(*(client.ask(READ) for client in clients))
            assert {cycle_of(answer) for answer in answers} == {1}
            assert server.counters.requests == 300
            for client in clients:
                await client.close()

    asyncio.run(scenario())


def test_a_client_that_resets_or_leaves_half_a_request_frees_its_place() -> None:
    async def scenario() -> None:
        async with serving(limits(connections=2)) as (server, port):
            for number in range(20):
                client = socket.create_connection(("127.0.0.1", port))
                client.sendall(READ[: number % len(READ)])
                if number % 2:
                    # Linger of 0 s: the kernel sends RST in place of FIN.
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                await until(lambda: server.counters.connections == 1)
                client.close()
                await until(lambda: server.counters.connections == 0)
            assert server.counters.refused == 0

    asyncio.run(scenario())


def test_thirty_pipelined_requests_of_all_kinds_are_answered_in_order() -> None:
    async def scenario() -> None:
        async with serving() as (_, port):
            client = await ModbusTcpClient.connect(port)
            bodies = ["04 0002 0002", "65", "03 0000 0000", "02 0000 0050", "2b 0e 01 00", "06 1388 0001"]
            sent = [frame(bytes.fromhex(bodies[n % 6]), transaction=n, unit=0) for n in range(30)]
            await client.send(b"".join(sent))
            answers = [await client.receive() for _ in range(30)]
            assert [int.from_bytes(answer[:2], "big") for answer in answers] == list(range(30))
            assert [answer[7] for answer in answers[:6]] == [4, 0xE5, 0x83, 2, 0x2B, 0x86]
            await client.close()

    asyncio.run(scenario())


def test_random_streams_of_many_clients_leave_the_server_as_it_was() -> None:
    """Seeded, so that a failure comes again; what the bytes mean is judged in test_modbus_answer."""

    async def scenario() -> None:
        draw = random.Random(20_26)  # noqa: S311 - noise, no secret
        async with serving(limits(connections=300, each=300)) as (server, port):
            bystander = await ModbusTcpClient.connect(port)
            for _ in range(60):
                client = await ModbusTcpClient.connect(port)
                data = b"".join(
                    draw.choice(
                        (draw.randbytes(draw.randrange(40)), READ, frame(draw.randbytes(draw.randrange(1, 253))))
                    )
                    for _ in range(10)
                )
                with suppress(ConnectionError):
                    await client.send(data)
                await client.close()
                assert cycle_of(await bystander.ask(READ)) == 1
            await until(lambda: server.counters.connections == 1)
            await bystander.close()

    asyncio.run(scenario())


def test_commands_over_plain_tcp_only_where_the_configuration_calls_them_insecure() -> None:
    async def scenario(insecure: bool) -> tuple[bytes, list[int]]:
        joints = FakeJoints()
        desk = CommandDesk(joints, FakeStore(), presets=(), report=lambda _: None)
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, desk=desk, plain_commands=insecure)
        server.publish(image(1))
        client = await ModbusTcpClient.connect(await server.start())
        answer = await client.ask(frame(bytes.fromhex("05 07d0 ff00"), unit=UNIT_ID))
        await client.close()
        await server.close()
        return answer[7:], joints.cleared

    assert asyncio.run(scenario(insecure=False)) == (b"\x85\x01", [])
    assert asyncio.run(scenario(insecure=True)) == (bytes.fromhex("05 07d0 ff00"), [1])


def test_what_a_connection_armed_is_gone_with_it() -> None:
    async def scenario() -> None:
        joints = FakeJoints()
        desk = CommandDesk(joints, FakeStore(), presets=(), report=lambda _: None)
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, desk=desk, plain_commands=True)
        server.publish(image(1))
        port = await server.start()
        arm = frame(bytes.fromhex("10 1388 0004 08 0001 0000 0000 0001"), unit=UNIT_ID)
        confirm = frame(bytes.fromhex("10 1388 0004 08 0001 0000 0000 0002"), unit=UNIT_ID)
        first = await ModbusTcpClient.connect(port)
        assert (await first.ask(arm))[7] == 0x10
        second = await ModbusTcpClient.connect(port)
        assert (await second.ask(confirm))[7:] == b"\x90\x04"
        await first.close()
        await until(lambda: server.counters.connections == 1)
        assert (await second.ask(confirm))[7:] == b"\x90\x04"
        assert joints.zeros == {1: 0, 2: 0}
        await second.close()
        await server.close()

    asyncio.run(scenario())


def test_a_socket_that_was_handed_over_is_served_in_place_of_host_and_port() -> None:
    async def scenario() -> None:
        handed_over = socket.socket()
        handed_over.bind(("127.0.0.1", 0))
        handed_over.listen()
        port = handed_over.getsockname()[1]
        # Whoever is in the queue before the service starts is served as well.
        early = socket.create_connection(("127.0.0.1", port))
        early.sendall(READ)
        early.setblocking(False)
        # Port 1 cannot be had without a capability; it is never asked for.
        server = ModbusTcpServer("127.0.0.1", 1, UNIT_ID, sockets={"modbus": handed_over, "other": handed_over})
        server.publish(image(1))
        assert await server.start() == port
        assert cycle_of(await asyncio.get_running_loop().sock_recv(early, 100)) == 1
        early.close()
        await server.close()
        assert handed_over.fileno() == -1

    asyncio.run(scenario())


def test_identification_names_the_revision_of_the_daemon() -> None:
    async def scenario() -> None:
        about = Identification(revision="7.8.9")
        server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, identification=about)
        client = await ModbusTcpClient.connect(await server.start())
        # Before the first image: what the device is does not depend on it.
        assert (await client.ask(frame(bytes.fromhex("2b 0e 04 02"), unit=0))).endswith(b"\x02\x057.8.9")
        await client.close()
        await server.close()

    asyncio.run(scenario())


def test_a_port_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="port"):
        Listener(host="127.0.0.1", port=65536)
