"""mbpoll (Debian, on libmodbus) reads the registers: a client that this project did not write."""

import asyncio
import re
import shutil
import subprocess

import pytest
from tests.fakes.register_values import joint_identity, joint_state

from trueangle.core.registers import RegisterMap
from trueangle.edges.modbus_server import ModbusTcpServer

pytestmark = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt: mbpoll)")


def mbpoll(*options: str) -> str:
    """What `mbpoll` prints for one poll of unit 1 with 0-based addresses, most significant word first."""

    async def scenario() -> str:
        server = ModbusTcpServer("127.0.0.1", 0, 1)
        server.publish(
            RegisterMap([joint_identity()]).image(
                cycle=1, heartbeat=1, service_status=1, states={1: joint_state()}
            )
        )
        port = await server.start()
        command = ["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-1", "-B", *options, "127.0.0.1"]
        done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=30)
        await server.close()
        return done.stdout + done.stderr

    return asyncio.run(scenario())


def test_the_corrected_angle_as_a_32_bit_integer() -> None:
    assert re.search(r"^\[13\]:\s+444444441$", mbpoll("-t", "3:int", "-r", "13", "-c", "1"), re.MULTILINE)


def test_the_corrected_angle_as_a_float_from_holding_registers() -> None:
    # mbpoll prints six significant digits.
    assert re.search(r"^\[1012\]:\s+123\.457$", mbpoll("-t", "4:float", "-r", "1012", "-c", "1"), re.MULTILINE)


def test_a_register_outside_is_an_illegal_data_address() -> None:
    assert "Illegal data address" in mbpoll("-t", "3", "-r", "84", "-c", "1")
