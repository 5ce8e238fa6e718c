"""The short form of `make fuzz`: the same inputs, some thousands of them, and those that once were findings."""

import asyncio
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fuzz.can_frames import PipelineFuzz
from tests.fuzz.memory import MemoryTrack
from tests.fuzz.modbus import UNIT_ID, ModbusFuzz, feed_tcp
from tests.fuzz.mutation import corpus_bytes
from tests.fuzz.node_frames import hear_frames
from tests.fuzz.texts import TOKENS, TextFuzz, try_config

SEED = 20_26


def test_modbus_streams_are_answered_from_the_image_and_do_no_more_than_the_peer_may() -> None:
    fuzz = ModbusFuzz(random.Random(SEED))
    for _ in range(6_000):
        fuzz.one_tcp()
    for _ in range(2_000):
        fuzz.one_rtu()


pdus = st.one_of(st.sampled_from(corpus_bytes("modbus.txt")), st.binary(min_size=1, max_size=253))


@settings(max_examples=100, deadline=None)
@given(st.lists(pdus, max_size=6), st.binary(max_size=20), st.data(), st.booleans())
def test_a_modbus_stream_that_is_answered_wrong_is_shown_at_its_shortest(
    requests: list[bytes], garbage: bytes, data: st.DataObject, commands: bool
) -> None:
    stream = b"".join(
        n.to_bytes(2, "big") + b"\0\0" + (len(pdu) + 1).to_bytes(2, "big") + bytes((UNIT_ID,)) + pdu
        for n, pdu in enumerate(requests)
    )
    stream += garbage
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=4)))
    images = data.draw(st.lists(st.integers(0, 2), min_size=len(cuts) + 1, max_size=len(cuts) + 1))
    feed_tcp(stream, cuts, images, commands=commands)


def test_no_image_shows_an_angle_that_the_frames_do_not_license() -> None:
    fuzz = PipelineFuzz(random.Random(SEED))
    for _ in range(4_000):
        fuzz.some_frames()
    # Every way of serving was reached, or the assertions were about nothing.
    assert min(fuzz.served.values()) > 50, fuzz.served


def test_a_master_that_hears_garbage_brings_its_node_back() -> None:
    asyncio.run(hear_frames(random.Random(SEED), 1_000))


def test_configurations_are_taken_or_refused_by_name() -> None:
    fuzz = TextFuzz(random.Random(SEED))
    for _ in range(300):
        fuzz.one_config()
    assert 10 < fuzz.taken < 200  # mutations that reach beyond the parser, and such that do not


@pytest.mark.parametrize("token", TOKENS)
def test_every_odd_value_in_every_kind_of_field_is_taken_or_refused_by_name(token: str) -> None:
    for key in ("schema_version", "modbus", "buses"):
        try_config(f"schema_version: 1\n{key}: {token}\n")
    try_config(f"modbus: {{port: 1, host: {token}, idle_timeout_s: {token}, commands: {token}}}\n")
    try_config(f"joints:\n- slot: {token}\n  name: {token}\n  stale_ms: {token}\n  supervision: {token}\n")


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(
            "\n".join(f"schema_versio{i}: 1" for i in range(8_000)), id="thousands of names almost right"
        ),
        pytest.param("a" * 190_000 + ": 1", id="one long name"),
        pytest.param("[" * 5_000, id="lists in lists"),
        pytest.param("a: " + "[" * 200 + "]" * 200, id="lists that close"),
        pytest.param("a: &a [*a, *a]", id="a list in itself"),
        pytest.param("a: &a {b: *a}", id="a mapping in itself"),
        pytest.param('"' * 190_000, id="quotes"),
        pytest.param("? " * 90_000, id="question marks"),
        pytest.param("a: b: " * 30_000, id="colons"),
        pytest.param("&a " * 50_000, id="anchors"),
        pytest.param("# " * 90_000, id="comment"),
        pytest.param("%TAG ! !\n" * 20_000, id="directives"),
    ],
)
def test_a_configuration_that_is_a_bomb_is_refused_in_bounded_time(text: str) -> None:
    assert try_config(text) is None


def test_presets_certificates_and_models_are_taken_or_refused_by_name(tmp_path: Path) -> None:
    fuzz = TextFuzz(random.Random(SEED))
    for _ in range(1_000):
        fuzz.one_preset_file()
        fuzz.one_certificate()
    for _ in range(50):
        fuzz.one_model(tmp_path / "model.onnx")


def test_a_rise_of_memory_is_told_from_its_noise() -> None:
    flat, rising = MemoryTrack(), MemoryTrack()
    for step in range(100):
        noise_mib = 0.5 * (step % 3)
        flat.readings.append((step / 100, 40.0 + noise_mib))
        rising.readings.append((step / 100, 40.0 + noise_mib + step * 0.06))
    assert not flat.rises
    assert rising.rises
    assert rising.rise_mib == pytest.approx(0.9 * 6.0, abs=0.2)  # 6 MiB over the run, of which nine tenths count
