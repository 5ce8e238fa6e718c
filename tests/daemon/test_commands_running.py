"""Presets on the running service: what a PLC writes is what it reads, after a restart too, on no other unit."""

import asyncio
import struct
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import EncoderNode
from tests.fakes.modbus_tcp_client import frame
from tests.fakes.running_service import (
    GOOD,
    MARKER,
    MODELS,
    Rig,
    config_yaml,
    correction_arcsec,
    joint_yaml,
    on_wire,
    raw_mas,
    same_angle,
    started,
)

from trueangle.config import parse_config
from trueangle.contract.errors import ContractError
from trueangle.core.commands import Command, Result
from trueangle.core.health import StatusBit
from trueangle.core.presets import presets_text, read_presets
from trueangle.service import Loaded, load_joints

COUNTS, CENTI_C = 700_000, 2500
WANTED_MAS = 36_000_000
MODEL_MAS = raw_mas(COUNTS) + correction_arcsec(COUNTS, CENTI_C) * 1e3
PRESET = GOOD | StatusBit.USER_PRESET

Scenario = Callable[[Rig], Coroutine[Any, Any, None]]
Go = Callable[..., None]


def config() -> str:
    text = config_yaml(joint_yaml(1, "base"))
    return text.replace("modbus: {port: 0}", "modbus: {port: 0, commands: true, insecure_commands: true}")


def node(**changes: Any) -> EncoderNode:
    return EncoderNode(
        node_id=1, send=lambda *_: None, counts=lambda _: COUNTS, temperature_centi_c=CENTI_C, **changes
    )


@pytest.fixture
def go(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path) -> Go:
    """Run a scenario on the service with these nodes and the state directory of the test."""

    def run(scenario: Scenario, *nodes: EncoderNode, text: str | None = None) -> None:
        async def within() -> None:
            async with (
                on_wire(monkeypatch, CanWire(), *nodes),
                started(text or config(), caplog, state_directory=tmp_path) as rig,
            ):
                await scenario(rig)

        asyncio.run(within())

    return run


async def command(rig: Rig, number: Command, angle_mas: int = WANTED_MAS, slot: int = 1) -> bytes:
    """Slot, angle and command in one write; the answer's PDU."""
    body = struct.pack(">BHHBHiH", 0x10, 5000, 4, 8, slot, angle_mas, number)
    return (await rig.plc.ask(frame(body)))[7:]


async def result(rig: Rig) -> Result:
    return Result(struct.unpack(">H", await rig.registers(5004, 1))[0])


async def arm(rig: Rig, number: Command) -> None:
    """Again while the joint's velocity is not known yet: after one sample nobody knows that it stands still."""
    while (await command(rig, number))[0] == 0x90:
        assert await result(rig) is Result.MOVING
    assert await result(rig) is Result.ARMED


async def confirm(rig: Rig) -> None:
    """As a PLC does: again until it is no longer too early, then until the disk has it."""
    while (await command(rig, Command.CONFIRM))[0] == 0x90:
        assert await result(rig) is Result.TOO_EARLY
    for _ in range(5000):
        if await result(rig) is not Result.PENDING:
            break
        await asyncio.sleep(0.002)
    assert await result(rig) is Result.DONE


async def preset(rig: Rig) -> None:
    await rig.until_status(1, GOOD)
    await arm(rig, Command.ARM_PRESET)
    await confirm(rig)


async def is_preset(rig: Rig) -> None:
    read = await rig.until_status(1, PRESET)
    assert same_angle(read.corrected_mas, WANTED_MAS, 1.0)
    assert read.raw_mas == raw_mas(COUNTS)


def test_a_preset_is_read_back_survives_a_restart_and_is_removed(go: Go, tmp_path: Path) -> None:
    async def first(rig: Rig) -> None:
        before = await rig.until_status(1, GOOD)
        assert same_angle(before.corrected_mas, MODEL_MAS, 1.0)
        assert await rig.service_status() & 1 << 6
        await preset(rig)
        await is_preset(rig)

    async def second(rig: Rig) -> None:
        await is_preset(rig)
        await arm(rig, Command.ARM_REMOVAL)
        await confirm(rig)
        read = await rig.until_status(1, GOOD)
        assert same_angle(read.corrected_mas, MODEL_MAS, 1.0)

    async def third(rig: Rig) -> None:
        read = await rig.until_status(1, GOOD)
        assert same_angle(read.corrected_mas, MODEL_MAS, 1.0)

    go(first, node())
    go(second, node())
    assert (tmp_path / "presets.json").exists()
    go(third, node())


def test_no_image_after_a_restart_serves_the_angle_without_its_preset(go: Go) -> None:
    """`Rig.until` looks at every answer; here also the first valid one must be the preset one."""

    async def first(rig: Rig) -> None:
        await preset(rig)

    async def second(rig: Rig) -> None:
        read = await rig.until(1, lambda read: StatusBit.VALID in read.status)
        assert read.status == PRESET
        assert same_angle(read.corrected_mas, WANTED_MAS, 1.0)

    go(first, node())
    go(second, node())


def test_another_unit_in_place_does_not_get_the_preset_and_is_not_referenced(
    go: Go, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def first(rig: Rig) -> None:
        await preset(rig)

    async def second(rig: Rig) -> None:
        read = await rig.until(1, lambda read: StatusBit.NOT_REFERENCED in read.status and read.raw_mas != MARKER)
        assert read.corrected_mas == MARKER
        assert (await command(rig, Command.ARM_PRESET))[:2] == b"\x90\x04"
        assert await result(rig) is Result.NOT_VALID
        # The way out: say that the old preset is void, then set it anew.
        await arm(rig, Command.ARM_REMOVAL)
        await confirm(rig)
        await preset(rig)
        await is_preset(rig)

    go(first, node())
    path = tmp_path / "presets.json"
    (stored,) = read_presets(path.read_text("utf-8"), source="p")
    assert stored.binding.serial_number == 4711
    other = replace(stored, binding=replace(stored.binding, serial_number=4712))
    path.write_text(presets_text([other]), "utf-8")
    go(second, node())
    assert any("what=preset_of_other_encoder" in message for message in caplog.messages)


def test_commands_are_logged_with_peer_and_role(go: Go, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(rig: Rig) -> None:
        await preset(rig)
        await command(rig, Command.REFERENCE_ANGLE, 3_600_000)

    go(scenario, node())
    told = [message for message in caplog.messages if "event=command " in message]
    assert any(
        "what=arm_preset slot=1 result=armed" in message and "peer=127.0.0.1" in message for message in told
    )
    assert any("what=preset_stored slot=1 result=done" in message for message in told)
    (reference,) = [message for message in caplog.messages if "event=reference_angle" in message]
    assert "reference_deg=1.000000000" in reference


def test_without_commands_the_same_writes_are_no_function_of_this_server(go: Go, tmp_path: Path) -> None:
    async def scenario(rig: Rig) -> None:
        await rig.until_status(1, GOOD)
        assert await command(rig, Command.ARM_PRESET) == b"\x90\x01"

    go(scenario, node(), text=config_yaml(joint_yaml(1, "base")))
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_file_of_presets_keeps_the_service_from_starting(go: Go, tmp_path: Path) -> None:
    (tmp_path / "presets.json").write_text("{", "utf-8")

    async def never(rig: Rig) -> None:
        raise AssertionError("started")

    with pytest.raises(ContractError, match=r"presets\.json"):
        go(never, node())


def test_commands_without_a_place_for_presets_are_refused_at_the_start(caplog: pytest.LogCaptureFixture) -> None:
    async def within() -> None:
        async with started(config(), caplog):
            raise AssertionError("started")

    with pytest.raises(ContractError, match="state_directory"):
        asyncio.run(within())


@pytest.mark.parametrize("stale_ms", [500, 600])
def test_a_preset_stays_through_a_reload_whether_its_joint_goes_on_or_begins_anew(
    stale_ms: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    def load_again() -> Loaded:
        changed = parse_config(config().replace("stale_ms: 500", f"stale_ms: {stale_ms}"), source="t")
        return Loaded(config=changed, joints=load_joints(changed, base=MODELS, source="t"))

    async def within() -> None:
        async with (
            on_wire(monkeypatch, CanWire(), node()),
            started(config(), caplog, load_again=load_again, state_directory=tmp_path) as rig,
        ):
            await preset(rig)
            await is_preset(rig)
            rig.service.reload()
            await rig.until_told(lambda: rig.service.reloads.succeeded == 1)
            # Not one valid answer without the preset, from the first one on.
            read = await rig.until(1, lambda read: StatusBit.VALID in read.status)
            assert StatusBit.USER_PRESET in read.status
            await is_preset(rig)

    asyncio.run(within())
