"""The RTU server on a pseudo-terminal: a real descriptor with real silences, and one that is unplugged."""

import asyncio
import os
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.daemon.test_modbus_rtu import ANSWER, IMAGE, READ, UNIT_ID, framed
from tests.daemon.test_modbus_server import until

from trueangle.config import Parity, RtuConfig
from trueangle.core.modbus_pdu import Identification
from trueangle.edges.modbus_server import ModbusRtuServer
from trueangle.edges.modbus_server.rtu import open_serial
from trueangle.errors import LinkError

LIMIT_S = 20.0


class Master:
    """The other end of the line."""

    def __init__(self) -> None:
        self.descriptor, slave = os.openpty()
        tty.setraw(slave)
        self.device = os.ttyname(slave)
        self._slave = slave
        os.set_blocking(self.descriptor, False)

    def write(self, data: bytes) -> None:
        os.write(self.descriptor, data)

    async def read(self, count: int) -> bytes:
        heard = b""
        async with asyncio.timeout(LIMIT_S):
            while len(heard) < count:
                try:
                    heard += os.read(self.descriptor, 4096)
                except BlockingIOError:
                    await asyncio.sleep(0.002)
        return heard

    def close(self) -> None:
        os.close(self._slave)
        os.close(self.descriptor)


@asynccontextmanager
async def on_line(silence_ms: float = 30.0) -> AsyncIterator[tuple[Master, ModbusRtuServer]]:
    """A silence far above the pauses between writes of a test on a loaded machine."""
    master = Master()
    config = RtuConfig(device=master.device, unit_id=UNIT_ID, baudrate=115_200, silence_ms=silence_ms)
    server = ModbusRtuServer(config, lambda _: IMAGE, Identification(revision="1"))
    server.start()
    try:
        assert server.listening
        yield master, server
    finally:
        server.close()
        master.close()


def test_requests_are_answered_on_a_line() -> None:
    async def scenario() -> None:
        async with on_line() as (master, server):
            for _ in range(3):
                master.write(READ)
                assert await master.read(len(ANSWER)) == ANSWER
            for byte in READ:
                master.write(bytes([byte]))
                await asyncio.sleep(0)
            assert await master.read(len(ANSWER)) == ANSWER
            assert server.stream.requests == 4

    asyncio.run(scenario())


def test_garbage_and_foreign_units_leave_the_line_silent_and_usable() -> None:
    async def scenario() -> None:
        async with on_line() as (master, server):
            master.write(os.urandom(500) + b"\xff")
            await until(lambda: server.stream.damaged == 1)
            master.write(framed("04 0002 0002", 9))
            # Silence can only be waited for: three times what ends a frame.
            await asyncio.sleep(0.1)
            master.write(READ)
            # Had anything else been answered, it would come first.
            assert await master.read(len(ANSWER)) == ANSWER

    asyncio.run(scenario())


def test_a_line_that_is_unplugged_is_opened_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        first, link = Master(), tmp_path / "line"
        link.symlink_to(first.device)
        config = RtuConfig(device=str(link), unit_id=UNIT_ID, baudrate=115_200, silence_ms=30.0)
        server = ModbusRtuServer(config, lambda _: IMAGE, Identification(revision="1"))
        server.start()
        first.write(READ)
        assert await first.read(len(ANSWER)) == ANSWER
        link.unlink()
        first.close()
        await until(lambda: not server.listening)
        second = Master()
        link.symlink_to(second.device)
        await until(lambda: server.listening)
        second.write(READ)
        assert await second.read(len(ANSWER)) == ANSWER
        server.close()
        second.close()

    caplog.set_level("INFO")
    asyncio.run(scenario())
    assert sum("event=modbus_rtu_lost" in message for message in caplog.messages) == 1


def test_a_device_that_is_none_is_a_link_error_that_names_it(tmp_path: Path) -> None:
    plain = tmp_path / "file"
    plain.write_bytes(b"")
    for device in (plain, tmp_path / "nowhere"):
        with pytest.raises(LinkError, match=device.name):
            open_serial(RtuConfig(device=str(device)))


@pytest.mark.parametrize("parity", Parity)
@pytest.mark.parametrize("stop_bits", [1, 2])
def test_every_parity_and_speed_can_be_set(parity: Parity, stop_bits: int) -> None:
    master = Master()
    for baudrate in (1200, 19_200, 921_600):
        os.close(
            open_serial(RtuConfig(device=master.device, baudrate=baudrate, parity=parity, stop_bits=stop_bits))
        )
    master.close()
