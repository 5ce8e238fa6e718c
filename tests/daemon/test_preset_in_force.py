"""Which zero is taken off: the configuration's, or a preset made with this encoder, model and mechanics."""

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest
from tests.daemon.test_commands import Desk
from tests.daemon.test_commands_running import (
    COUNTS,
    MODEL_MAS,
    PRESET,
    Go,
    arm,
    config,
    confirm,
    go,
    is_preset,
    node,
    preset,
)
from tests.fakes.can_wire import CanWire
from tests.fakes.command_target import BINDING
from tests.fakes.encoder_node import COUNTS_PER_REV
from tests.fakes.running_service import (
    MARKER,
    MODELS,
    Rig,
    on_wire,
    raw_mas,
    same_angle,
    started,
)

from trueangle.config import parse_config
from trueangle.core.commands import Command, Result
from trueangle.core.health import StatusBit
from trueangle.core.presets import read_presets
from trueangle.service import Loaded, load_joints

__all__ = ["go"]

ZERO_MAS = 30 * 3_600_000


def with_zero() -> str:
    return config().replace("    stale_ms: 500\n", "    stale_ms: 500\n    zero_deg: 30\n")


def turned_round() -> str:
    return config().replace(
        f"encoder: {{counts_per_rev: {COUNTS_PER_REV}}}",
        f"encoder: {{counts_per_rev: {COUNTS_PER_REV}, direction: -1}}",
    )


def test_the_configured_zero_is_taken_off_where_presets_are_kept_but_none_was_made(go: Go) -> None:
    async def scenario(rig: Rig) -> None:
        read = await rig.until(1, lambda read: StatusBit.VALID in read.status)
        assert same_angle(read.corrected_mas, MODEL_MAS - ZERO_MAS, 1.0)
        assert read.status == PRESET

    go(scenario, node(), text=with_zero())


def test_a_preset_goes_before_the_configured_zero_which_is_back_when_it_is_removed(go: Go) -> None:
    async def scenario(rig: Rig) -> None:
        await rig.until_status(1, PRESET)
        await arm(rig, Command.ARM_PRESET)
        await confirm(rig)
        await is_preset(rig)
        await arm(rig, Command.ARM_REMOVAL)
        await confirm(rig)
        read = await rig.fast(1)
        assert same_angle(read.corrected_mas, MODEL_MAS - ZERO_MAS, 1.0)

    go(scenario, node(), text=with_zero())


def test_a_preset_is_not_applied_after_a_restart_with_another_direction(go: Go) -> None:
    async def second(rig: Rig) -> None:
        read = await rig.until(1, lambda read: read.status == StatusBit.NOT_REFERENCED | StatusBit.CONFIGURED)
        assert read.corrected_mas == MARKER

    go(preset, node())
    go(second, node(), text=turned_round())


def test_a_preset_is_bound_to_all_that_moves_the_phase_and_the_scale_of_the_position(
    go: Go, tmp_path: Path
) -> None:
    go(preset, node(objects={(0x6509, 0): (77, 4)}))
    (stored,) = read_presets((tmp_path / "presets.json").read_text("utf-8"), source="p")
    told = stored.binding
    assert (told.operating_parameters, told.preset_value, told.offset_value) == (4, 0, 77)
    assert told.units_per_revolution == told.total_range_units == COUNTS_PER_REV


def test_a_reload_that_turns_the_direction_round_takes_the_preset_out_of_force(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    def load_again() -> Loaded:
        changed = parse_config(turned_round(), source="t")
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
            read = await rig.until(1, lambda read: read.raw_mas != MARKER)
            assert same_angle(read.raw_mas, -raw_mas(COUNTS), 1.0)
            assert StatusBit.VALID not in read.status
            await rig.until_status(1, StatusBit.NOT_REFERENCED)

    asyncio.run(within())


def test_what_was_armed_on_one_encoder_is_not_confirmed_on_another() -> None:
    desk = Desk()
    assert desk.ask(Command.ARM_PRESET) is Result.ARMED
    desk.wait(200)
    desk.joints.change(1, binding=replace(BINDING, serial_number=4712))
    assert desk.ask(Command.CONFIRM) is Result.DIFFERS
    assert desk.store.saved == []
