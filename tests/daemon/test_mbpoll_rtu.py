"""mbpoll (Debian, on libmodbus) as master of the serial line and as reader of bits: a client of other people."""

import asyncio
import os
import re
import shutil
import subprocess

import pytest
from tests.daemon.test_mbpoll import mbpoll
from tests.daemon.test_modbus_rtu import IMAGE, UNIT_ID
from tests.daemon.test_modbus_rtu_line import Master

from trueangle.config import Parity, RtuConfig
from trueangle.core.modbus_pdu import Identification
from trueangle.edges.modbus_server import ModbusRtuServer

pytestmark = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt: mbpoll)")


def over_rtu(unit: int, *options: str) -> str:
    """What mbpoll prints for one poll over two pseudo-terminals with a wire between them."""

    def wire(here: Master, there: Master) -> None:
        there.write(os.read(here.descriptor, 4096))

    async def scenario() -> str:
        ours, theirs = Master(), Master()
        loop = asyncio.get_running_loop()
        loop.add_reader(ours.descriptor, wire, ours, theirs)
        loop.add_reader(theirs.descriptor, wire, theirs, ours)
        config = RtuConfig(
            device=ours.device, baudrate=115_200, parity=Parity.NONE, unit_id=UNIT_ID, silence_ms=10.0
        )
        server = ModbusRtuServer(config, lambda _: IMAGE, Identification(revision="1"))
        server.start()
        line = ("-m", "rtu", "-b", "115200", "-P", "none", "-a", str(unit), "-0", "-1", "-B", "-o", "2")
        command = ["mbpoll", *line, *options, theirs.device]
        done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=30)
        server.close()
        for end in (ours, theirs):
            loop.remove_reader(end.descriptor)
            end.close()
        return done.stdout + done.stderr

    return asyncio.run(scenario())


def test_the_corrected_angle_over_a_serial_line() -> None:
    assert re.search(
        r"^\[13\]:\s+444444441$", over_rtu(UNIT_ID, "-t", "3:int", "-r", "13", "-c", "1"), re.MULTILINE
    )


def test_an_exception_over_a_serial_line() -> None:
    assert "Illegal data address" in over_rtu(UNIT_ID, "-t", "3", "-r", "84", "-c", "1")


def test_another_unit_is_not_answered() -> None:
    assert "timed out" in over_rtu(9, "-t", "3", "-r", "13", "-c", "1")


def test_bits_as_discrete_inputs_and_as_coils() -> None:
    for kind in ("1", "0"):
        told = mbpoll("-t", kind, "-r", "0", "-c", "2")
        assert re.findall(r"^\[(\d+)\]:\s+(\d)$", told, re.MULTILINE) == [("0", "1"), ("1", "0")]
