"""`trueangled commission` on nodes made of bytes: nothing without a yes, nothing without a way back."""

import asyncio
import json
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.lss_bus import LssEncoder
from tests.fakes.lss_unit import LssUnit
from tests.fakes.pseudo_terminal import PseudoTerminal
from tests.fakes.running_service import MODELS, config_yaml, joint_yaml
from tests.fakes.socketcand_server import SocketcandServer
from tests.fakes.trueangled_process import command, environment

from trueangle.contract.errors import ContractError
from trueangle.core.commissioning import OldObject, UndoRecord, undo_from_json, undo_to_json, undo_writes

STORE = {(0x1010, 1): (1, 4)}
PHASE = range(0x6000, 0x6004)


def encoder(**more: object) -> EncoderNode:
    node = EncoderNode(1, lambda _id, _data: None, **more)  # pyright: ignore[reportArgumentType]
    node.objects |= STORE
    return node


@pytest.fixture
def site(tmp_path: Path) -> Path:
    shutil.copy(MODELS / "good.onnx", tmp_path)
    return tmp_path


def configured(site: Path, port: int) -> list[str]:
    options = f"{{host: 127.0.0.1, port: {port}}}"
    text = config_yaml(joint_yaml(1, "base"), interface="socketcand", channel="can0", options=options)
    (site / "c.yaml").write_text(text, "utf-8")
    return ["commission", "--config", str(site / "c.yaml"), "--undo-file", str(site / "undo.json")]


def bare(port: int, site: Path) -> list[str]:
    where = ["--interface", "socketcand", "--channel", "can0", "--bitrate", "125000"]
    options = ["--option", "host=127.0.0.1", "--option", f"port={port}"]
    return ["commission", *where, *options, "--undo-file", str(site / "undo.json")]


async def done(arguments: list[str], chatter: SocketcandServer | None = None) -> tuple[int, str, str]:
    process = await asyncio.create_subprocess_exec(
        *command(*arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=environment(),
    )

    async def talk() -> None:
        while chatter is not None:
            chatter.send(0x601, bytes(8))
            await asyncio.sleep(0.02)

    talking = asyncio.create_task(talk())
    out, err = await process.communicate()
    talking.cancel()
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()


def test_without_a_terminal_nothing_is_written_that_was_not_named(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        async with SocketcandServer(node) as server:
            code, out, _ = await done(configured(site, server.port))
        assert code == 1
        assert "setup: not done (no terminal; --yes setup does it)" in out
        assert "counts_per_rev: 3276800" in out
        assert (node.writes, node.nmt) == ([], [])
        assert not (site / "undo.json").exists()

    asyncio.run(scenario())


def test_what_was_set_up_reads_back_and_the_undo_file_puts_it_back(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        before = dict(node.objects)
        async with SocketcandServer(node) as server:
            code, out, err = await done([*configured(site, server.port), "--yes", "setup"])
            assert (code, "set and read back" in out, "store: not done" in out) == (1, True, True), err
            assert node.objects[0x1A00, 1] == (0x6004_0020, 4)
            assert node.objects[0x1017, 0] == (500, 2)
            assert not any(index in PHASE or index == 0x1010 for index, _, _ in node.writes)
            # A second look finds nothing to do, and the undo file is never written over.
            code, out, _ = await done(configured(site, server.port))
            assert (code, "are set as configured" in out) == (0, True)
            arguments = [*configured(site, server.port), "--undo", str(site / "undo.json"), "--yes", "undo"]
            code, out, err = await done(arguments)
            assert "put back and read back" in out, err
        used = {a: v for a, v in before.items() if not (a[0] in (0x1A00, 0x1A01) and a[1] > before[a[0], 0][0])}
        assert {address: node.objects[address] for address in used} == used

    asyncio.run(scenario())


def test_a_person_is_asked_for_each_step_and_only_the_word_yes_counts(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        async with (
            SocketcandServer(node) as server,
            PseudoTerminal(*configured(site, server.port), columns=200) as terminal,
        ):
            await terminal.until("Type yes to do it:")
            assert node.writes == []
            assert not (site / "undo.json").exists()
            terminal.keys("yes\n")
            await terminal.until("Store all parameters")
            assert (site / "undo.json").exists()
            terminal.keys("y\n")
            assert await terminal.ended() == 1
            await terminal.until("store: not done")
        assert all(index != 0x1010 for index, _, _ in node.writes)

    asyncio.run(scenario())


def test_ctrl_c_at_a_question_ends_it_at_once_and_nothing_was_written(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        async with (
            SocketcandServer(node) as server,
            PseudoTerminal(*configured(site, server.port), columns=200) as terminal,
        ):
            await terminal.until("Type yes to do it:")
            terminal.interrupt()
            assert await terminal.ended() == 130
            assert "Traceback" not in terminal.screen
        assert node.writes == []
        assert not (site / "undo.json").exists()

    asyncio.run(scenario())


def test_the_undo_file_is_whole_before_the_first_write(site: Path) -> None:
    class Watching(EncoderNode):
        def handle(self, can_id: int, data: bytes) -> None:
            if can_id == 0x601 and data[0] & 0xE0 == 0x20 and not self.writes:
                record = undo_from_json((site / "undo.json").read_text(), source="undo")
                seen.append(len(record.nodes[0].objects))
            super().handle(can_id, data)

    seen: list[int] = []

    async def scenario() -> None:
        node = Watching(1, lambda _id, _data: None)
        async with SocketcandServer(node) as server:
            await done([*configured(site, server.port), "--yes", "setup"])

    asyncio.run(scenario())
    # Heartbeat; COB-ID, type, count and two places of each of two TPDOs.
    assert seen == [1 + 2 * 5]


def test_an_undo_file_that_exists_stops_everything(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        (site / "undo.json").write_text("precious")
        async with SocketcandServer(node) as server:
            code, _, err = await done([*configured(site, server.port), "--yes", "setup"])
        assert code == 2
        assert "keep it: it may be the only way back" in err
        assert node.writes == []
        assert (site / "undo.json").read_text() == "precious"

    asyncio.run(scenario())


def test_a_node_that_keeps_its_old_mapping_is_found_out_and_nothing_is_stored(site: Path) -> None:
    async def scenario() -> None:
        node = encoder(ignores_mapping=True)
        async with SocketcandServer(node) as server:
            code, _, err = await done([*configured(site, server.port), "--yes", "setup", "--yes", "store"])
        assert code == 1
        assert "did not take its set-up" in err
        assert all(index != 0x1010 for index, _, _ in node.writes)

    asyncio.run(scenario())


def test_undo_never_touches_another_unit(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        async with SocketcandServer(node) as server:
            await done([*configured(site, server.port), "--yes", "setup"])
            node.objects[0x650B, 0] = (4712, 4)
            node.writes.clear()
            undo = ["--undo", str(site / "undo.json"), "--yes", "undo"]
            code, _, err = await done([*configured(site, server.port), *undo])
        assert (code, node.writes) == (1, [])
        assert "nothing was written" in err

    asyncio.run(scenario())


def test_beside_another_master_nothing_is_done(site: Path) -> None:
    async def scenario() -> None:
        node = encoder()
        async with SocketcandServer(node) as server:
            code, _, err = await done([*configured(site, server.port), "--yes", "setup"], chatter=server)
        assert code == 1
        assert "another master speaks here" in err
        assert (node.reads, node.writes) == ([], [])

    asyncio.run(scenario())


def test_one_of_two_factory_units_gets_its_node_id_and_the_file_gives_it_back(site: Path) -> None:
    def unit(serial: int) -> LssEncoder:
        return LssEncoder(32, lambda _id, _data: None, lss=LssUnit((1, 2, 3, serial), node_id=32))

    async def scenario() -> None:
        one, two = unit(10), unit(11)
        async with SocketcandServer(one, two) as server:
            base = bare(server.port, site)
            code, _, err = await done([*base, "--new-node-id", "5", "--yes", "node-id"])
            assert (code, "2 answered" in err) == (1, True)
            assert not one.lss.configuring
            assert not two.lss.configuring
            wanted = ["--new-node-id", "5", "--new-bitrate", "500000", "--identity", "1:2:3:0xB"]
            agreed = ["--yes", "node-id", "--yes", "bitrate", "--yes", "lss-store"]
            code, out, err = await done([*base, *wanted, *agreed])
            assert code == 0, err
            assert "node-id 5: set and read back" in out
            assert (one.lss.stored, two.lss.stored) == (None, (5, 2))
            assert not two.lss.configuring
            code, _, err = await done([*base, "--undo", str(site / "undo.json"), "--yes", "undo"])
            assert (two.lss.node_id, two.lss.bit_timing) == (32, 4), err

    asyncio.run(scenario())


def test_a_node_id_that_another_node_has_is_not_given(site: Path) -> None:
    async def scenario() -> None:
        fresh = LssEncoder(32, lambda _id, _data: None)
        async with SocketcandServer(fresh, EncoderNode(5, lambda _id, _data: None)) as server:
            code, _, err = await done([*bare(server.port, site), "--new-node-id", "5", "--yes", "node-id"])
        assert (code, fresh.lss.node_id) == (1, 255)
        assert "node-id 5 is taken" in err

    asyncio.run(scenario())


@given(
    st.lists(
        st.builds(
            OldObject,
            index=st.sampled_from([0x1017, 0x1800, 0x1A00, 0x1A01]),
            subindex=st.integers(0, 3),
            size=st.just(4),
            value=st.integers(0, 2**32 - 1),
        ),
        unique_by=lambda old: old.address,
    )
)
def test_undo_ends_with_the_old_value_of_every_object_it_writes(objects: list[OldObject]) -> None:
    last = {write.address: write.value for write in undo_writes(objects)}
    assert last.items() <= {old.address: old.value for old in objects}.items()


def test_an_undo_file_reads_back_and_one_that_would_move_the_phase_is_refused() -> None:
    assert undo_from_json(undo_to_json(UndoRecord(made="x")), source="u") == UndoRecord(made="x")
    moved = {"node_id": 1, "identity": {}, "objects": [{"index": 0x6003, "subindex": 0, "size": 4, "value": 1}]}
    text = json.dumps({"schema_version": 1, "nodes": [moved]})
    with pytest.raises(ContractError, match="0x1000 to 0x1FFF"):
        undo_from_json(text, source="u")
    with pytest.raises(ContractError, match="an undo file in JSON"):
        undo_from_json("{", source="u")
