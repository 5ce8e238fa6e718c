"""`trueangled scan` against nodes made of bytes behind a socketcand: what it finds, and that it only reads."""

import asyncio
import json

from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.lss_bus import LssEncoder
from tests.fakes.lss_unit import LssUnit
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment, trueangled

from trueangle.core.bus_survey import BusSurvey
from trueangle.core.node_setup import SdoWrite
from trueangle.core.sdo_frames import SdoAnswer, download_request, read_answer, upload_request


def encoder(node_id: int) -> EncoderNode:
    node = EncoderNode(node_id, lambda _id, _data: None)
    node.objects |= {(0x7130, 1): (0xFFF6, 2), (0x1018, 4): (1000 + node_id, 4)}
    return node


async def scanned(
    *nodes: EncoderNode, chatter: bytes = b"", arguments: tuple[str, ...] = ()
) -> tuple[int, str, str]:
    async with SocketcandServer(*nodes) as server:
        process = await asyncio.create_subprocess_exec(
            *command("scan", "--interface", "socketcand", "--channel", "can0", "--listen-s", "0.4"),
            *("--option", "host=127.0.0.1", "--option", f"port={server.port}", *arguments),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=environment(),
        )

        async def talk() -> None:
            while True:
                for node in nodes:
                    node.heartbeat()
                if chatter:
                    server.send(0x601, chatter)
                await asyncio.sleep(0.02)

        talking = asyncio.create_task(talk())
        out, err = await process.communicate()
        talking.cancel()
        assert process.returncode is not None
        return process.returncode, out.decode(), err.decode()


def test_scan_lists_nodes_with_identity_state_and_temperature_and_writes_nothing() -> None:
    one, two = encoder(3), encoder(127)
    code, out, _ = asyncio.run(scanned(one, two))
    assert code == 0
    rows = {line.split()[0]: line for line in out.splitlines() if line[:1].isdigit()}
    assert f"pre-operational  CiA 406 encoder  0x1234  0x5678   1003    {COUNTS_PER_REV}" in rows["3"]
    assert "0x7130:1 = -10" in rows["127"]
    assert (one.writes, two.writes, one.nmt) == ([], [], [])


def test_scan_in_json_says_the_same() -> None:
    code, out, _ = asyncio.run(scanned(encoder(3), arguments=("--json",)))
    (node,) = json.loads(out)["nodes"]
    assert (code, node["node_id"], node["settings"]["serial_number"]) == (0, 3, 1003)
    assert node["counts_per_rev"] == COUNTS_PER_REV


def test_scan_asks_nobody_while_another_master_does() -> None:
    node = encoder(1)
    code, out, _ = asyncio.run(scanned(node, chatter=upload_request((0x6004, 0))))
    assert code == 0
    assert "another master speaks here: SDO requests to node 1; nodes were not asked" in out
    assert node.reads == []


def test_an_empty_bus_and_an_absent_one_are_told_apart() -> None:
    code, out, _ = asyncio.run(scanned())
    assert code == 1
    assert "no node was heard and none answers" in out
    done = trueangled(
        "scan",
        "--interface",
        "socketcand",
        "--channel",
        "can0",
        "--option",
        "host=127.0.0.1",
        "--option",
        "port=1",
    )
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert "cannot open socketcand" in line


def test_units_that_share_a_node_id_are_listed_by_their_identities() -> None:
    """As `commission --identity` takes them; nothing of the units changes."""

    def unit(serial: int) -> LssEncoder:
        return LssEncoder(32, lambda _id, _data: None, lss=LssUnit((1, 2, 3, serial), node_id=32))

    units = (unit(10), unit(11))
    code, out, err = asyncio.run(scanned(*units, arguments=("--lss", "1:2", "--lss-timeout", "0.05")))
    assert code == 0, err
    assert [line for line in out.splitlines() if line.startswith("unit ")] == [
        "unit 0x1:0x2:0x3:0xA",
        "unit 0x1:0x2:0x3:0xB",
    ]
    assert not any(unit.lss.configuring or unit.writes for unit in units)


def test_units_are_listed_in_json_and_none_is_an_answer_too() -> None:
    code, out, _ = asyncio.run(scanned(encoder(3), arguments=("--json", "--lss", "1:2")))
    assert (code, json.loads(out)["lss_units"]) == (0, [])


def test_bad_input_is_exit_2() -> None:
    for arguments in (
        ["--interface", "virtual", "--channel", "x", "--lss", "1"],
        ["--interface", "virtual", "--channel", "x", "--lss", "1:0x1FFFFFFFF"],
        ["--interface", "virtual", "--channel", "x", "--lss", "1:2", "--lss-timeout", "0"],
        [],
        ["--interface", "nonesuch", "--channel", "x"],
        ["--interface", "virtual", "--channel", "x", "--option", "y"],
    ):
        done = trueangled("scan", *arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert len(done.stderr.splitlines()) == 1


def test_a_listener_tells_rates_and_nodes_by_their_frames() -> None:
    survey = BusSurvey()
    for number in range(11):
        survey.take(0x185, bytes(6), number * 10_000_000)
    survey.take(0x707, b"\x00", 0)
    survey.take(0x707, b"\x85", 1)  # toggle bit of node guarding
    assert survey.nodes() == {5, 7}
    assert survey.sent_by(5)[0x185].rate_hz == 100.0
    assert (survey.states[7], survey.boot_ups[7], survey.other_master) == ("operational", 1, "")


def test_sdo_frames_are_those_of_the_standard_and_strange_answers_are_none() -> None:
    assert upload_request((0x1018, 4)).hex(" ") == "40 18 10 04 00 00 00 00"
    assert download_request(SdoWrite(address=(0x1017, 0), value=200, size=2)).hex(" ") == "2b 17 10 00 c8 00 00 00"
    address = (0x6004, 0)
    assert read_answer(bytes.fromhex("4f046000ff000000"), address) == SdoAnswer(value=255, size=1)
    assert read_answer(bytes.fromhex("4104600010000000"), address) == SdoAnswer(segmented=True)
    absent = read_answer(bytes.fromhex("8004600000000206"), address)
    assert absent is not None
    assert absent.absent
    for strange in ("4f056000ff000000", "4f0460", "60046000 00000000", "43046001 01020304"):
        assert read_answer(bytes.fromhex(strange), address) is None
