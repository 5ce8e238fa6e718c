"""Policies and reading heads in the real service: nodes that speak CANopen, registers read over Modbus."""

import asyncio

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.running_service import (
    MARKER,
    MODELS,
    Rig,
    config_yaml,
    correction_arcsec,
    joint_yaml,
    on_wire,
    raw_mas,
    started,
)

from trueangle.config import parse_config
from trueangle.core.health import StatusBit
from trueangle.service import Loaded, load_joints

COUNTS = 400_000
HALF_TURN = COUNTS_PER_REV // 2
APART = 8
"""Counts by which the second head reads more: half of it is left in the mean of the two."""


class HoldingRig(Rig):
    @staticmethod
    def check(read: object) -> None:
        """A held angle is licensed too; the pipeline's own tests hold every image against the rule."""


def test_a_silent_node_leaves_its_last_angle_for_as_long_as_is_configured_and_a_reboot_takes_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    device = EncoderNode(1, lambda *_: None, counts=lambda _: COUNTS)
    config = config_yaml(joint_yaml(1, "base", more="    when_not_valid: {policy: hold, hold_ms: 60000}\n"))

    async def scenario() -> None:
        wire = CanWire()
        async with on_wire(monkeypatch, wire, device), started(config, caplog) as started_rig:
            r = HoldingRig(started_rig.service, started_rig.task, started_rig.port, started_rig.plc)
            good = await r.until_status(1, StatusBit.VALID)
            device.deaf = True
            held = await r.until(1, lambda read: StatusBit.NODE_NOT_READY in read.status)
            assert StatusBit.HELD in held.status
            assert held.corrected_mas == good.corrected_mas
            device.deaf, device.answers_sdo = False, False
            device.reboot()
            gone = await r.until(1, lambda read: StatusBit.HELD not in read.status)
            assert gone.corrected_mas == MARKER

    asyncio.run(scenario())


def test_two_reading_heads_are_set_up_fused_and_outlive_each_other(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    first = EncoderNode(1, lambda *_: None, counts=lambda _: COUNTS)
    second = EncoderNode(2, lambda *_: None, counts=lambda _: COUNTS + HALF_TURN + APART)
    head = f"{{node_id: 2, mounting_deg: 180, encoder: {{counts_per_rev: {COUNTS_PER_REV}}}}}"
    config = config_yaml(joint_yaml(1, "base", more=f"    further_heads: [{head}]\n"))

    async def scenario() -> None:
        wire = CanWire()
        async with on_wire(monkeypatch, wire, first, second), started(config, caplog) as r:
            fused = await r.until_status(1, StatusBit.VALID)
            mean = COUNTS + APART // 2
            assert fused.raw_mas == raw_mas(mean)
            expected_mas = raw_mas(mean) + correction_arcsec(mean, 2500) * 1000
            assert fused.corrected_mas == pytest.approx(expected_mas, abs=1)
            second.deaf = True
            alone = await r.until_status(1, StatusBit.VALID | StatusBit.HEAD_LOST)
            assert alone.raw_mas == pytest.approx(fused.raw_mas, abs=1)

    asyncio.run(scenario())


def test_a_further_head_whose_own_zero_is_moved_in_service_is_no_longer_fused(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """By less than heads may differ: only its objects tell, and of them the configuration says nothing."""
    moved = [0]
    first = EncoderNode(1, lambda *_: None, counts=lambda _: COUNTS)
    second = EncoderNode(2, lambda *_: None, counts=lambda _: COUNTS + HALF_TURN + moved[0])
    head = f"{{node_id: 2, mounting_deg: 180, encoder: {{counts_per_rev: {COUNTS_PER_REV}}}}}"
    config = config_yaml(joint_yaml(1, "base", more=f"    further_heads: [{head}]\n"))

    async def scenario() -> None:
        async with on_wire(monkeypatch, CanWire(), first, second), started(config, caplog) as r:
            await r.until_status(1, StatusBit.VALID)
            second.objects[0x6509, 0] = (1000, 4)
            moved[0] = 1000
            await r.until_told(lambda: "offset_value expected 5 found 1000 since the start" in caplog.text)
            for _ in range(50):
                assert StatusBit.HEAD_LOST in (await r.fast(1)).status

    asyncio.run(scenario())


def test_no_reload_accepts_an_encoder_whose_own_zero_was_moved_in_service(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    device = EncoderNode(1, lambda *_: None, counts=lambda _: COUNTS)

    def load_again() -> Loaded:
        changed = parse_config(
            config_yaml(joint_yaml(1, "base")).replace("stale_ms: 500", "stale_ms: 600"), source="t"
        )
        return Loaded(config=changed, joints=load_joints(changed, base=MODELS, source="t"))

    async def scenario() -> None:
        async with (
            on_wire(monkeypatch, CanWire(), device),
            started(config_yaml(joint_yaml(1, "base")), caplog, load_again=load_again) as r,
        ):
            await r.until_status(1, StatusBit.VALID)
            device.objects[0x6509, 0] = (1000, 4)
            await r.until(1, lambda read: StatusBit.ENCODER_DIFFERS in read.status)
            r.service.reload()
            await r.until_told(lambda: r.service.reloads.succeeded == 1)
            await r.until(1, lambda read: StatusBit.ENCODER_DIFFERS not in read.status)
            read = await r.until(1, lambda read: read.raw_mas == raw_mas(COUNTS))
            assert StatusBit.ENCODER_DIFFERS in read.status
            assert read.corrected_mas == MARKER

    asyncio.run(scenario())
