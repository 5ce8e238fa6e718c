"""Modbus/TCP Security and clients that stretch it: odd records and certificates, slow and repeated handshakes."""

import asyncio
import shutil
import ssl
import subprocess
from contextlib import suppress
from ipaddress import ip_network

import pytest
from tests.daemon.test_modbus_server import cycle_of, until
from tests.daemon.test_modbus_tls import CLEAR_FAULT, READ, ROLES, Plant, is_refused, serving
from tests.fakes.certificates import ROLE_OID
from tests.fakes.modbus_tcp_client import ModbusTcpClient, read_request, split_frames

from trueangle.edges.modbus_server import ModbusLimits

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="the openssl command is not installed")

LIMIT_S = 20.0


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    return Plant(tmp_path_factory.mktemp("plant"))


class MemoryClient:
    """TLS over memory, so that a test decides which bytes leave when."""

    def __init__(self, context: ssl.SSLContext, session: ssl.SSLSession | None = None) -> None:
        self.incoming, self.outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(self.incoming, self.outgoing, server_hostname="127.0.0.1", session=session)

    async def connect(self, port: int) -> None:
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", port)

    async def shake_hands(self, step: int = 65536) -> None:
        """In pieces of `step` bytes."""
        while True:
            try:
                self.tls.do_handshake()
            except ssl.SSLWantReadError:
                await self.send_in_pieces(step)
                await self.receive()
            else:
                await self.send_in_pieces(step)
                return

    async def send_in_pieces(self, step: int = 65536) -> None:
        data = self.outgoing.read()
        for at in range(0, len(data), step):
            self.writer.write(data[at : at + step])
            await self.writer.drain()
            await asyncio.sleep(0)

    async def read(self, count: int) -> bytes:
        data = b""
        async with asyncio.timeout(LIMIT_S):
            while len(data) < count:
                try:
                    data += self.tls.read(65536)
                except ssl.SSLWantReadError:
                    await self.receive()
        return data

    async def receive(self) -> None:
        """Once; the server's end is an error of TLS from then on."""
        received = await self.reader.read(65536)
        if received:
            self.incoming.write(received)
        else:
            self.incoming.write_eof()

    def close(self) -> None:
        self.writer.close()


@pytest.mark.parametrize("step", [1, 29, 4096, 65536])
def test_a_record_for_each_request_is_answered_however_the_records_are_cut(plant: Plant, step: int) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            client = MemoryClient(plant.client(plant.nobody))
            await client.connect(served.server.ports["modbus-tls"])
            await client.shake_hands(step)
            for number in range(60):
                client.tls.write(read_request(4, 2, 2, transaction=number, unit=0))
            await client.send_in_pieces(step)
            answers = split_frames(await client.read(60 * 13))
            assert [int.from_bytes(answer[:2], "big") for answer in answers] == list(range(60))
            client.close()

    asyncio.run(scenario())


def test_one_request_in_many_records_is_one_request(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            client = MemoryClient(plant.client(plant.nobody))
            await client.connect(served.server.ports["modbus-tls"])
            await client.shake_hands()
            for byte in READ:
                client.tls.write(bytes([byte]))
            await client.send_in_pieces()
            assert cycle_of(await client.read(13)) == 1
            assert served.server.counters.requests == 1
            client.close()

    asyncio.run(scenario())


def test_requests_that_come_with_the_end_of_the_handshake_are_answered(plant: Plant) -> None:
    """A TLS 1.3 client may send before it has heard that its certificate is good."""

    async def scenario() -> None:
        async with serving(plant) as served:
            client = MemoryClient(plant.client(plant.nobody))
            await client.connect(served.server.ports["modbus-tls"])
            with pytest.raises(ssl.SSLWantReadError):
                client.tls.do_handshake()
            await client.send_in_pieces()
            while True:
                await client.receive()
                with suppress(ssl.SSLWantReadError):
                    client.tls.do_handshake()
                    break
            client.tls.write(READ + READ)
            await client.send_in_pieces()
            assert len(split_frames(await client.read(26))) == 2
            client.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_a_resumed_session_has_the_rights_of_its_certificate_and_no_others(
    plant: Plant, version: ssl.TLSVersion
) -> None:
    async def scenario() -> None:
        async with serving(plant, ROLES) as served:
            for identity, answer in ((plant.setter, CLEAR_FAULT[7:]), (plant.viewer, b"\x85\x01")):
                context = plant.client(identity)
                context.minimum_version = context.maximum_version = version
                session: ssl.SSLSession | None = None
                for _ in range(2):
                    client = MemoryClient(context, session)
                    await client.connect(served.server.ports["modbus-tls"])
                    await client.shake_hands()
                    client.tls.write(CLEAR_FAULT)
                    await client.send_in_pieces()
                    assert (await client.read(7 + len(answer)))[7:] == answer
                    assert client.tls.session_reused == (session is not None)
                    session = client.tls.session
                    client.close()

    asyncio.run(scenario())


@pytest.mark.parametrize(
    "role",
    [
        f"{ROLE_OID}=ASN1:PRINTABLESTRING:setter",
        f"{ROLE_OID}=DER:0c0773657474657220",
        f"{ROLE_OID}=ASN1:UTF8String:SETTER",
        f"{ROLE_OID}=ASN1:UTF8String:",
        f"{ROLE_OID}=DER:0c06736574",
        f"{ROLE_OID}=DER:0c067365747465720c06736574746572",
        "1.3.6.1.4.1.50316.802.2=ASN1:UTF8String:setter",
    ],
)
def test_a_role_that_is_not_exactly_one_of_ours_has_no_rights(plant: Plant, role: str) -> None:
    async def scenario() -> None:
        async with serving(plant, ROLES) as served:
            client = await served.connect(plant.authority.issue("odd", role))
            assert (await client.ask(READ))[7:] == b"\x84\x01"
            assert (await client.ask(CLEAR_FAULT))[7:] == b"\x85\x01"
            assert served.joints.cleared == []
            await client.close()

    asyncio.run(scenario())


def test_a_certificate_for_another_purpose_is_refused(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            server_only = plant.authority.issue("server-only", "extendedKeyUsage=serverAuth")
            assert await is_refused(served.connect(server_only))
            await until(lambda: served.server.counters.tls_refused == 1)

    asyncio.run(scenario())


def test_a_handshake_in_single_bytes_gains_no_time_by_them(plant: Plant) -> None:
    async def scenario() -> None:
        limits = ModbusLimits(idle_timeout_s=3600.0, handshake_timeout_s=0.1)
        async with serving(plant, limits=limits) as served:
            client = MemoryClient(plant.client(plant.nobody))
            await client.connect(served.server.ports["modbus-tls"])
            with pytest.raises(ssl.SSLWantReadError):
                client.tls.do_handshake()
            hello = client.outgoing.read()
            # At 1 ms a byte the hello alone lasts longer than the whole handshake may.
            for byte in hello:
                if served.server.counters.tls_refused:
                    break
                with suppress(ConnectionError):
                    client.writer.write(bytes([byte]))
                await asyncio.sleep(0.001)
            assert served.server.counters.tls_refused == 1
            await until(lambda: served.server.counters.connections == 0)
            client.close()

    asyncio.run(scenario())


def test_limits_and_allowed_addresses_are_those_of_both_ports_together(plant: Plant) -> None:
    async def scenario() -> None:
        limits = ModbusLimits(
            idle_timeout_s=3600.0, connections_per_address=2, allow=(ip_network("127.0.0.1/32"),)
        )
        async with serving(plant, limits=limits) as served:
            plain = await ModbusTcpClient.connect(served.server.ports["modbus"], "127.0.0.1")
            secure = await served.connect(plant.nobody)
            for port in served.server.ports.values():
                third = await ModbusTcpClient.connect(port, "127.0.0.1")
                assert await third.at_end()
                await third.close()
                stranger = await ModbusTcpClient.connect(port, "127.0.0.9")
                assert await stranger.at_end()
                await stranger.close()
            assert cycle_of(await plain.ask(READ)) == cycle_of(await secure.ask(READ)) == 1
            assert (served.server.counters.refused, served.server.counters.not_allowed) == (2, 2)
            await plain.close()
            await secure.close()

    asyncio.run(scenario())


def test_a_client_that_negotiates_again_is_told_no(plant: Plant) -> None:
    """Only TLS 1.2 knows it; a line of R makes s_client ask for it."""
    command = ["openssl", "s_client", "-tls1_2", "-CAfile", str(plant.authority.certificate)]
    command += ["-cert", str(plant.nobody.certificate), "-key", str(plant.nobody.key), "-connect"]

    async def scenario() -> str:
        async with serving(plant) as served:
            bystander = await served.connect(plant.nobody)
            process = await asyncio.create_subprocess_exec(
                *command,
                f"127.0.0.1:{served.server.ports['modbus-tls']}",
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(b"R\n")
            await process.stdin.drain()
            async with asyncio.timeout(LIMIT_S):
                printed = b""
                while b"no renegotiation" not in printed:
                    more = await process.stdout.read(65536)
                    assert more, printed.decode()
                    printed += more
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
            assert cycle_of(await bystander.ask(READ)) == 1
            await bystander.close()
        return printed.decode()

    assert "RENEGOTIATING" in asyncio.run(scenario())
