"""Modbus/TCP Security over real sockets: without a good certificate nothing, with one what its role may."""

import asyncio
import shutil
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from tests.daemon.test_modbus_server import cycle_of, deaf_client, image, send_until_stuck, until
from tests.fakes.certificates import Authority, Identity, openssl
from tests.fakes.command_target import FakeJoints, FakeStore
from tests.fakes.modbus_tcp_client import ModbusTcpClient, frame, read_request

from trueangle.config import Right, TlsConfig
from trueangle.contract.errors import ContractError
from trueangle.core.commands import CommandDesk, CommandReport
from trueangle.edges.modbus_server import ModbusLimits, ModbusTcpServer, load_tls
from trueangle.edges.modbus_server.server import Listener

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="the openssl command is not installed")

UNIT_ID = 17
READ = read_request(4, 2, 2, unit=UNIT_ID)
CLEAR_FAULT = frame(bytes.fromhex("05 07d0 ff00"), unit=UNIT_ID)
LIMITS = ModbusLimits(idle_timeout_s=3600.0, handshake_timeout_s=20.0)


class Plant:
    """The certificates of one plant, made once."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.authority = Authority(directory, "plant")
        self.server = self.authority.issue("server", "subjectAltName=IP:127.0.0.1")
        self.setter = self.authority.with_role("setter", "setter")
        self.viewer = self.authority.with_role("viewer", "viewer")
        self.nobody = self.authority.issue("nobody")
        self.expired = self.authority.issue("expired", days=-1)
        self.stranger = Authority(directory, "elsewhere").with_role("stranger", "setter")

    def config(self, roles: dict[str, Right] | None = None) -> TlsConfig:
        return TlsConfig(
            certificate=self.server.certificate.name,
            private_key=self.server.key.name,
            client_ca=self.authority.certificate.name,
            roles=roles or {},
        )

    def client(self, identity: Identity | None) -> ssl.SSLContext:
        context = ssl.create_default_context(cafile=str(self.authority.certificate))
        if identity is not None:
            context.load_cert_chain(identity.certificate, identity.key)
        return context


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    return Plant(tmp_path_factory.mktemp("plant"))


ROLES = {"setter": Right.COMMAND, "viewer": Right.READ}


class Served:
    """A server with a plain and a TLS port."""

    def __init__(self, plant: Plant, roles: dict[str, Right] | None, limits: ModbusLimits) -> None:
        self.joints = FakeJoints()
        self.reports: list[CommandReport] = []
        desk = CommandDesk(self.joints, FakeStore(), presets=(), report=self.reports.append)
        settings = load_tls(plant.config(roles), base=plant.directory, credentials=None, source="t")
        tls = Listener(host="127.0.0.1", port=0, tls=settings)
        self.server = ModbusTcpServer("127.0.0.1", 0, UNIT_ID, limits, tls=tls, desk=desk)
        self.server.publish(image(1))
        self._plant = plant

    async def connect(
        self, identity: Identity | None, change: Callable[[ssl.SSLContext], None] = lambda _: None
    ) -> ModbusTcpClient:
        context = self._plant.client(identity)
        change(context)
        port = self.server.ports["modbus-tls"]
        return ModbusTcpClient(*await asyncio.open_connection("127.0.0.1", port, ssl=context))


@asynccontextmanager
async def serving(
    plant: Plant, roles: dict[str, Right] | None = None, limits: ModbusLimits = LIMITS
) -> AsyncIterator[Served]:
    served = Served(plant, roles, limits)
    await served.server.start()
    try:
        yield served
    finally:
        await served.server.close()
    assert served.server.counters.connections == 0


async def is_refused(connect: Awaitable[ModbusTcpClient]) -> bool:
    """With TLS 1.3 a client believes in its handshake until it reads."""
    try:
        client = await connect
    except (ssl.SSLError, ConnectionError):
        return True
    try:
        answer = await client.ask(READ)
    except (ssl.SSLError, ConnectionError, asyncio.IncompleteReadError):
        return True
    finally:
        with suppress(ssl.SSLError):
            await client.close()
    raise AssertionError(f"answered {answer.hex()}")


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_a_client_with_a_certificate_of_the_plant_reads(plant: Plant, version: ssl.TLSVersion) -> None:
    def only(context: ssl.SSLContext) -> None:
        context.minimum_version = context.maximum_version = version

    async def scenario() -> None:
        async with serving(plant) as served:
            client = await served.connect(plant.nobody, only)
            assert cycle_of(await client.ask(READ)) == 1
            # Plain and secure at once, from one image.
            plain = await ModbusTcpClient.connect(served.server.ports["modbus"])
            served.server.publish(image(2))
            assert cycle_of(await plain.ask(READ)) == cycle_of(await client.ask(READ)) == 2
            assert served.server.counters.requests == 3
            await plain.close()
            await client.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("who", ["missing", "stranger", "expired"])
@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_a_missing_foreign_or_expired_certificate_is_refused_and_logged_once(
    plant: Plant, who: str, version: ssl.TLSVersion, caplog: pytest.LogCaptureFixture
) -> None:
    def only(context: ssl.SSLContext) -> None:
        context.minimum_version = context.maximum_version = version

    async def scenario() -> None:
        async with serving(plant) as served:
            identity = {"missing": None, "stranger": plant.stranger, "expired": plant.expired}[who]
            for _ in range(3):
                assert await is_refused(served.connect(identity, only))
            await until(lambda: served.server.counters.connections == 0)
            assert served.server.counters.tls_refused == 3
            assert served.server.counters.requests == 0
            good = await served.connect(plant.nobody)
            assert cycle_of(await good.ask(READ)) == 1
            await good.close()

    asyncio.run(scenario())
    told = [message for message in caplog.messages if "event=modbus_tls_refused" in message]
    assert len(told) == 1
    words = {
        "missing": "did not return a certificate",
        "stranger": "unable to get local issuer",
        "expired": "expired",
    }
    assert words[who] in told[0]


@pytest.mark.filterwarnings("ignore:ssl.TLSVersion.TLSv1_1:DeprecationWarning")
def test_tls_1_1_is_refused(plant: Plant) -> None:
    def old(context: ssl.SSLContext) -> None:
        context.set_ciphers("ALL:@SECLEVEL=0")
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1

    async def scenario() -> None:
        async with serving(plant) as served:
            assert await is_refused(served.connect(plant.nobody, old))
            await until(lambda: served.server.counters.tls_refused == 1)

    asyncio.run(scenario())


def test_rights_follow_the_role_in_the_certificate(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant, ROLES) as served:
            setter = await served.connect(plant.setter)
            viewer = await served.connect(plant.viewer)
            nobody = await served.connect(plant.nobody)
            plain = await ModbusTcpClient.connect(served.server.ports["modbus"])
            assert cycle_of(await setter.ask(READ)) == cycle_of(await viewer.ask(READ)) == 1
            assert (await nobody.ask(READ))[7:] == b"\x84\x01"
            for client in (viewer, nobody, plain):
                assert (await client.ask(CLEAR_FAULT))[7:] == b"\x85\x01"
            assert served.joints.cleared == []
            assert await setter.ask(CLEAR_FAULT) == CLEAR_FAULT
            assert served.joints.cleared == [1]
            report = served.reports[-1]
            assert (report.event, report.peer.address, report.peer.role) == ("clear_fault", "127.0.0.1", "setter")
            for client in (setter, viewer, nobody, plain):
                await client.close()

    asyncio.run(scenario())


def test_without_roles_every_accepted_certificate_reads_and_none_commands(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            client = await served.connect(plant.setter)
            assert cycle_of(await client.ask(READ)) == 1
            assert (await client.ask(CLEAR_FAULT))[7:] == b"\x85\x01"
            await client.close()

    asyncio.run(scenario())


def test_a_handshake_that_does_not_go_on_is_ended_and_counts_as_a_connection_until_then(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        limits = ModbusLimits(idle_timeout_s=3600.0, handshake_timeout_s=0.1, connections=2)
        async with serving(plant, limits=limits) as served:
            port = served.server.ports["modbus-tls"]
            silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
            # The first bytes of a handshake, and no more.
            silent[0][1].write(bytes.fromhex("16 03 01 02 00 01 00"))
            await until(lambda: served.server.counters.connections == 2)
            third, writer = await asyncio.open_connection("127.0.0.1", port)
            with suppress(ConnectionResetError):
                assert await third.read(1) == b""
            writer.close()
            for reader, _ in silent:
                assert await reader.read(100) == b""
            assert served.server.counters.tls_refused == 2
            for _, writer in silent:
                writer.close()

    asyncio.run(scenario())
    assert any("no handshake within" in message for message in caplog.messages)


@pytest.mark.parametrize(
    "garbage", [b"GET / HTTP/1.1\r\n\r\n", READ, bytes(5000), b"\x16\x03\x01\xff\xff" + bytes(3000)]
)
def test_garbage_instead_of_a_handshake_ends_only_its_own_connection(plant: Plant, garbage: bytes) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            good = await served.connect(plant.nobody)
            client = await ModbusTcpClient.connect(served.server.ports["modbus-tls"])
            await client.send(garbage)
            # An alert may come first; a whole answer never.
            while not await client.at_end():
                pass
            await client.close()
            assert cycle_of(await good.ask(READ)) == 1
            assert served.server.counters.tls_refused == 1
            await good.close()

    asyncio.run(scenario())


def test_pipelined_and_byte_by_byte_requests_are_answered_in_order(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            client = await served.connect(plant.nobody)
            await client.send(b"".join(read_request(4, 0, 84, transaction=n, unit=0) for n in range(1000)))
            answers = [await client.receive() for _ in range(1000)]
            assert [int.from_bytes(answer[:2], "big") for answer in answers] == list(range(1000))
            for byte in READ:
                await client.send(bytes([byte]))
            assert cycle_of(await client.receive()) == 1
            await client.close()

    asyncio.run(scenario())


def test_a_bad_header_inside_tls_closes_the_connection(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            client = await served.connect(plant.nobody)
            await client.send(b"GET / HTTP/1.1\r\n\r\n")
            assert await client.at_end()
            assert served.server.counters.broken == 1
            await client.close()

    asyncio.run(scenario())


def test_a_client_that_does_not_read_is_not_decrypted_further(plant: Plant) -> None:
    """One record holds 1365 requests: all answered at once they would be 240 KB that nobody takes."""

    async def scenario() -> None:
        async with serving(plant, limits=ModbusLimits(idle_timeout_s=3600.0, unsent_bytes=8192)) as served:
            raw = deaf_client(served.server.ports["modbus-tls"])
            incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
            tls = plant.client(plant.nobody).wrap_bio(incoming, outgoing, server_hostname="127.0.0.1")
            loop = asyncio.get_running_loop()
            while True:
                try:
                    tls.do_handshake()
                    break
                except ssl.SSLWantReadError:
                    await loop.sock_sendall(raw, outgoing.read())
                    incoming.write(await loop.sock_recv(raw, 65536))
            for _ in range(300):
                tls.write(read_request(4, 0, 84, unit=0) * 1300)
            await send_until_stuck(raw, outgoing.read())
            waiting = [connection.unsent_bytes for connection in served.server._open]
            # The limit, one receive buffer's answers, and what TLS adds to a record.
            assert 8192 < max(waiting) <= 8192 + 21 * (9 + 168) + 64
            bystander = await served.connect(plant.nobody)
            assert cycle_of(await bystander.ask(READ)) == 1
            # Read again: every whole record that arrived is answered.
            before = served.server.counters.requests
            async with asyncio.timeout(20.0):
                while served.server.counters.requests < before + 1000:
                    assert await loop.sock_recv(raw, 65536)
            raw.close()
            await bystander.close()

    asyncio.run(scenario())


def test_new_certificates_and_roles_are_for_new_connections(plant: Plant) -> None:
    async def scenario() -> None:
        async with serving(plant) as served:
            old = await served.connect(plant.nobody)
            config = plant.config(ROLES)
            served.server.renew_tls(load_tls(config, base=plant.directory, credentials=None, source="t"))
            new = await served.connect(plant.nobody)
            assert cycle_of(await old.ask(READ)) == 1
            assert (await new.ask(READ))[7:] == b"\x84\x01"
            await old.close()
            await new.close()

    asyncio.run(scenario())


def test_keys_come_from_systemd_credentials_as_well(plant: Plant) -> None:
    config = TlsConfig(
        certificate=f"credential:{plant.server.certificate.name}",
        private_key=f"credential:{plant.server.key.name}",
        client_ca=plant.authority.certificate.name,
    )
    load_tls(config, base=plant.directory, credentials=plant.directory, source="t")
    with pytest.raises(ContractError, match="LoadCredential"):
        load_tls(config, base=plant.directory, credentials=None, source="t")


def test_files_that_cannot_be_used_are_named_together(plant: Plant, tmp_path: Path) -> None:
    config = TlsConfig(certificate="no.pem", private_key="no.key", client_ca=str(plant.authority.certificate))
    with pytest.raises(ContractError) as caught:
        load_tls(config, base=tmp_path, credentials=None, source="t.yaml")
    assert [fault.where for fault in caught.value.faults] == [
        "t.yaml, modbus.tls.certificate",
        "t.yaml, modbus.tls.private_key",
    ]
    (tmp_path / "text.pem").write_text("no certificate")
    wrong = TlsConfig(
        certificate=str(plant.server.certificate), private_key=str(plant.nobody.key), client_ca="text.pem"
    )
    with pytest.raises(ContractError) as caught:
        load_tls(wrong, base=tmp_path, credentials=None, source="t.yaml")
    assert len(caught.value.faults) == 2
    assert "key values mismatch" in str(caught.value)


def test_a_key_with_a_password_is_refused_and_no_terminal_is_asked(plant: Plant, tmp_path: Path) -> None:
    locked = tmp_path / "locked.key"
    openssl("ec", "-in", str(plant.server.key), "-aes128", "-passout", "pass:word", "-out", str(locked))
    config = TlsConfig(
        certificate=str(plant.server.certificate),
        private_key=str(locked),
        client_ca=str(plant.authority.certificate),
    )
    with pytest.raises(ContractError, match="not encrypted"):
        load_tls(config, base=tmp_path, credentials=None, source="t")
