"""The hub against python-can's client and raw sockets; at the end the daemon's CAN side against six nodes."""

import asyncio
import functools
import socket
import struct
import subprocess
import sys
from collections import defaultdict

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueangle.config import BusConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import MappedObject, NodePlan, Quantity, TpdoPlan
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.edges.can_bus import CanBus, Frame
from trueangle.edges.can_master import CanMaster
from trueangle_training.simulator.canopen_node import NodeSample, NodeSpec
from trueangle_training.simulator.node_process import nodes_on_hub
from trueangle_training.simulator.socketcand_hub import SocketcandHub, frame_line, parse_send

LIMIT_S = 20.0


def open_client(port: int) -> can.BusABC:
    return can.Bus(
        interface="socketcand", channel="can0", host="127.0.0.1", port=port, tcp_tune=True, ignore_config=True
    )


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_sent_frame_parses_back(can_id: int, data: bytes) -> None:
    """The client's form, as python-can writes it: bytes without leading zeros."""
    words = f"{can_id:03X} {len(data):X} {' '.join(f'{b:x}' for b in data)}".split()
    assert parse_send(words[0], words[1], words[2:]) == (can_id, data)


@pytest.mark.parametrize(
    "words",
    [
        ["12345678", "0"],
        ["800", "0"],
        ["123", "9", *["0"] * 9],
        ["123", "2", "1"],
        ["123", "1", "100"],
        ["x", "0"],
    ],
)
def test_broken_send_is_refused(words: list[str]) -> None:
    with pytest.raises(ValueError, match=r"identifier|length|invalid literal|range"):
        parse_send(words[0], words[1], words[2:])


def test_frame_line_has_three_digits_of_identifier_and_microseconds() -> None:
    assert frame_line(0x85, b"\x01\xff", 1_700_000_000_000_042_999) == b"< frame 085 1700000000.000042 01FF >"
    assert frame_line(0x80, b"", 0) == b"< frame 080 0.000000  >"


def test_clients_hear_nodes_and_each_other_but_not_themselves() -> None:
    async def scenario() -> None:
        async with SocketcandHub() as hub:
            heard: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()
            hub.attach(lambda can_id, data: heard.put_nowait((can_id, data)))
            one = await asyncio.to_thread(open_client, hub.port)
            two = await asyncio.to_thread(open_client, hub.port)
            with one, two:
                one.send(can.Message(arbitration_id=0x601, data=b"\x40\x00", is_extended_id=False))
                assert await heard.get() == (0x601, b"\x40\x00")
                hub.send(0x581, b"")
                first = await asyncio.to_thread(two.recv, LIMIT_S)
                second = await asyncio.to_thread(two.recv, LIMIT_S)
                only = await asyncio.to_thread(one.recv, LIMIT_S)
        assert first is not None
        assert second is not None
        assert only is not None
        assert (first.arbitration_id, bytes(first.data)) == (0x601, b"\x40\x00")
        assert (second.arbitration_id, bytes(second.data), second.is_extended_id) == (0x581, b"", False)
        assert only.arbitration_id == 0x581

    asyncio.run(asyncio.wait_for(scenario(), LIMIT_S))


async def talk(port: int, *lines: bytes) -> bytes:
    """Everything that the hub answers to these lines, sent one piece each."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    received = await reader.readuntil(b">")
    for line in lines:
        writer.write(line)
        received += await reader.readuntil(b">")
    writer.close()
    await writer.wait_closed()
    return received


def test_commands_out_of_order_or_unknown_are_answered_by_an_error() -> None:
    async def scenario() -> None:
        async with SocketcandHub() as hub:
            assert await talk(hub.port, b"< rawmode >") == b"< hi >< error unknown command rawmode >"
            assert b"error" in await talk(hub.port, b"< open can7 >")
            answers = await talk(hub.port, b"< open can0 >", b"< rawmode >", b"< send 123 3 1 >", b"< echo >")
            assert answers.startswith(b"< hi >< ok >< ok >< error length 3")
            assert answers.endswith(b"< echo >")

    asyncio.run(asyncio.wait_for(scenario(), LIMIT_S))


def test_command_without_end_is_hung_up_on() -> None:
    async def scenario() -> None:
        async with SocketcandHub() as hub:
            reader, writer = await asyncio.open_connection("127.0.0.1", hub.port)
            writer.write(b"x" * 5000)
            assert await reader.read() == b"< hi >"
            writer.close()

    asyncio.run(asyncio.wait_for(scenario(), LIMIT_S))


def test_client_that_does_not_read_loses_frames_and_they_are_counted() -> None:
    async def scenario() -> None:
        async with SocketcandHub() as hub:
            reader, writer = await asyncio.open_connection("127.0.0.1", hub.port, limit=64)
            for line in (b"< open can0 >", b"< rawmode >"):
                writer.write(line)
                await reader.readuntil(b">")
            async with asyncio.timeout(LIMIT_S):
                while not hub.frames_dropped:
                    for _ in range(5000):
                        hub.send(0x181, bytes(8))
                    await asyncio.sleep(0)
            writer.transport.abort()

    asyncio.run(scenario())


CHILD = """
from trueangle.contract.encoder import EncoderSettings
from trueangle_training.simulator.canopen_node import NodeSample, NodeSpec
from trueangle_training.simulator.node_process import run_nodes

def sample(sequence):
    return NodeSample(counts=sequence, temperature_centi_c=0)

run_nodes([NodeSpec(node_id=1, settings=EncoderSettings(), sample=sample)])
"""


def test_node_process_says_where_it_listens_and_ends_with_its_standard_input() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        words = child.stdout.readline().split()
        assert words[0] == "listening"
        host, port = words[1].split(":")
        with socket.create_connection((host, int(port)), timeout=LIMIT_S) as client:
            assert client.recv(64) == b"< hi >"
        child.stdin.close()
        assert child.wait(LIMIT_S) == 0


JOINTS, SYNC_HZ, WANTED = 6, 200, 300


def sample(joint: int, sequence: int) -> NodeSample:
    return NodeSample(
        counts=(joint * 10_000 + 37 * sequence) % (1 << 20), temperature_centi_c=2000 + sequence % 100
    )


def plan(slot: int) -> NodePlan:
    position = MappedObject(index=0x6004, subindex=0, bits=32, quantity=Quantity.POSITION)
    counter = MappedObject(index=0x2100, subindex=0, bits=16, quantity=Quantity.SEQUENCE)
    warmth = MappedObject(index=0x7130, subindex=1, bits=16, quantity=Quantity.TEMPERATURE, signed=True)
    return NodePlan(
        slot=slot,
        node_id=slot,
        heartbeat_ms=500,
        tpdos=(
            TpdoPlan(number=1, cob_id=0x180 + slot, transmission_type=1, mapping=(position, counter)),
            TpdoPlan(number=2, cob_id=0x280 + slot, transmission_type=20, mapping=(warmth,)),
        ),
    )


def test_six_nodes_at_200_hz_reach_the_daemon_without_a_gap() -> None:
    """Hub, nodes, transport and master on one loop: every SYNC answered, in order, with the right counts."""
    positions: dict[int, list[bytes]] = defaultdict(list)
    temperatures: dict[int, int] = defaultdict(int)

    async def scenario() -> None:
        running, enough = asyncio.Event(), asyncio.Event()
        states: dict[int, NodeState] = {}

        def on_node(slot: int, report: NodeReport) -> None:
            states[slot] = report.state
            if list(states.values()).count(NodeState.RUNNING) == JOINTS:
                running.set()

        def on_frames(frames: list[Frame]) -> None:
            for can_id, data, _ in frames:
                if can_id & 0x780 == 0x180:
                    positions[can_id & 0x7F].append(data)
                elif can_id & 0x780 == 0x280:
                    temperatures[can_id & 0x7F] += 1
                else:
                    master.notify(can_id, data)
            if min((len(p) for p in positions.values()), default=0) >= WANTED:
                enough.set()

        specs = [
            NodeSpec(node_id=j, settings=EncoderSettings(), sample=functools.partial(sample, j))
            for j in range(1, JOINTS + 1)
        ]
        async with SocketcandHub() as hub, nodes_on_hub(specs, hub):
            config = BusConfig(
                name="arm",
                interface="socketcand",
                channel="can0",
                options={"host": "127.0.0.1", "port": hub.port},
                sync_period_ms=1000 / SYNC_HZ,
            )
            bus = CanBus(config, on_frames=on_frames, on_bus_state=lambda u, r: master.on_bus_state(u, r))
            plans = [plan(slot) for slot in range(1, JOINTS + 1)]
            master = CanMaster(bus, plans, on_node=on_node, accept=lambda _slot, _settings: [])
            async with bus, master, asyncio.timeout(LIMIT_S):
                await running.wait()
                await enough.wait()
            assert hub.frames_dropped == 0
        assert bus.counters.frames_dropped == 0
        assert bus.counters.send_failures == 0

    asyncio.run(scenario())
    assert sorted(positions) == list(range(1, JOINTS + 1))
    for joint, frames in positions.items():
        for sequence, data in enumerate(frames, start=1):
            assert data == struct.pack("<IH", sample(joint, sequence).counts, sequence)
        # One temperature every 20 SYNC; the first may be up to 20 SYNC late and the run ends within a cycle.
        assert temperatures[joint] == pytest.approx(len(frames) / 20, abs=1)
