"""Presets on the disk: the same again after a restart, and nothing damaged taken for "none"."""

import asyncio
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.command_target import BINDING

from trueangle.contract.errors import ContractError
from trueangle.core.presets import Preset, PresetBinding, presets_text, read_presets
from trueangle.edges.preset_store import PresetFile, load_presets, write_presets

PRESETS = (
    Preset(slot=1, user_zero_mas=1_295_999_999, binding=BINDING),
    Preset(slot=32, user_zero_mas=0, binding=BINDING),
)

_NUMBERS = st.none() | st.integers(0, 0xFFFF_FFFF)
_BINDINGS = st.builds(
    PresetBinding,
    model_sha256=st.text("0123456789abcdef", min_size=64, max_size=64),
    vendor_id=_NUMBERS,
    product_code=_NUMBERS,
    serial_number=_NUMBERS,
    preset_value=_NUMBERS,
    offset_value=_NUMBERS,
)


@given(
    presets=st.lists(
        st.builds(Preset, slot=st.integers(1, 32), user_zero_mas=st.integers(0, 1_295_999_999), binding=_BINDINGS),
        unique_by=lambda preset: preset.slot,
    )
)
def test_what_is_written_is_read_again(presets: list[Preset]) -> None:
    assert read_presets(presets_text(presets), source="p") == tuple(sorted(presets, key=lambda one: one.slot))


def test_no_file_is_no_preset(tmp_path: Path) -> None:
    assert load_presets(tmp_path) == ()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "{}",
        presets_text(PRESETS)[:-20],
        presets_text(PRESETS).replace('"schema_version": 1', '"schema_version": 2'),
        presets_text(PRESETS).replace("1295999999", "1296000000"),
        presets_text(PRESETS).replace("1295999999", "1e3"),
        presets_text(PRESETS).replace('"slot": 32', '"slot": 1'),
        presets_text(PRESETS).replace('"serial_number"', '"serial"'),
        "[" * 100_000,
        "\x00\ufffd",
    ],
)
def test_a_damaged_file_is_refused_and_never_taken_for_no_presets(text: str, tmp_path: Path) -> None:
    (tmp_path / "presets.json").write_text(text, encoding="utf-8")
    with pytest.raises(ContractError, match=r"presets\.json"):
        load_presets(tmp_path)


def test_a_file_that_is_too_large_or_not_text_is_refused(tmp_path: Path) -> None:
    for data in (b" " * 100_001, b"\xff\xfe\x00"):
        (tmp_path / "presets.json").write_bytes(data)
        with pytest.raises(ContractError):
            load_presets(tmp_path)


def test_presets_survive_and_replace_what_was_there(tmp_path: Path) -> None:
    async def scenario() -> None:
        store = PresetFile(tmp_path)
        told: list[bool] = []
        store.save(PRESETS, told.append)
        # Not on the loop's own turn: the disk may take its time.
        assert told == []
        await store.close()
        assert told == [True]
        assert load_presets(tmp_path) == PRESETS
        store.save(PRESETS[:1], told.append)
        await store.close()
        assert load_presets(tmp_path) == PRESETS[:1]

    asyncio.run(scenario())
    assert [path.name for path in tmp_path.iterdir()] == ["presets.json"]


def test_a_disk_that_refuses_keeps_the_old_presets_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_presets(tmp_path, presets_text(PRESETS))

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    async def scenario() -> None:
        store = PresetFile(tmp_path)
        told: list[bool] = []
        monkeypatch.setattr("os.fsync", full)
        store.save(PRESETS[:1], told.append)
        await store.close()
        assert told == [False]

    asyncio.run(scenario())
    assert load_presets(tmp_path) == PRESETS


def test_the_new_content_is_on_the_disk_before_it_has_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power failure between the two must leave the old file, not an empty one."""
    write_presets(tmp_path, presets_text(PRESETS))
    seen: list[int] = []

    def look(descriptor: int) -> None:
        seen.append(len(load_presets(tmp_path)))

    monkeypatch.setattr("os.fsync", look)
    write_presets(tmp_path, presets_text(PRESETS[:1]))
    # The file is synced while the old one has the name, the directory after.
    assert seen == [2, 1]


def test_the_file_is_plain_json(tmp_path: Path) -> None:
    write_presets(tmp_path, presets_text(PRESETS))
    value = json.loads((tmp_path / "presets.json").read_text("utf-8"))
    assert value["presets"][0]["binding"]["serial_number"] == 4711


def test_a_directory_that_cannot_be_synced_leaves_the_presets_that_are_in_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was told as not stored must not come into force at the next start."""
    write_presets(tmp_path, presets_text(PRESETS))
    calls: list[int] = []

    def second_fails(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) > 1:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr("os.fsync", second_fails)
    with pytest.raises(OSError, match="Input/output"):
        write_presets(tmp_path, presets_text(PRESETS[:1]))
    assert load_presets(tmp_path) == PRESETS


@given(place=st.integers(0, 10_000), flipped=st.sampled_from([1, 2, 4, 8, 16, 64]))
def test_no_flipped_bit_makes_another_preset_of_a_file(place: int, flipped: int) -> None:
    text = presets_text(PRESETS)
    damaged = bytearray(text.encode())
    damaged[place % len(damaged)] ^= flipped
    try:
        read = read_presets(damaged.decode("utf-8", errors="replace"), source="p")
    except ContractError:
        return
    assert read == PRESETS
