"""`python -m tests.fuzz [--share S] [--seed N]`: a million inputs, counted and timed; memory at 10 % and the end.

Exit status 1: a finding, or memory that rises beyond noise. Every input comes from the seed, so `--only KIND` with
the same seed meets the finding again; what it was goes into the corpus.
"""

import argparse
import asyncio
import logging
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.can_frames import PipelineFuzz
from tests.fuzz.memory import MemoryTrack
from tests.fuzz.modbus import ModbusFuzz
from tests.fuzz.node_frames import hear_frames
from tests.fuzz.texts import TextFuzz
from tests.fuzz.true_worlds import Worlds

COUNTS = {
    "modbus_tcp": 450_000,
    "modbus_rtu": 150_000,
    "can_pipeline": 330_000,
    "true_angles": 100_000,
    "can_master": 60_000,
    "configurations": 10_000,
    "presets": 10_000,
    "certificates": 20_000,
    "models": 2_000,
}
"""Streams, frames and configurations alone make 10^6."""
READINGS = 100


def run(kind: str, count: int, seed: int) -> MemoryTrack:
    """Feed at least `count` inputs; raises what the input raised."""
    track = MemoryTrack()
    if kind == "can_master":
        asyncio.run(hear_frames(random.Random(seed), count, track.read))
        return track
    with tempfile.TemporaryDirectory() as directory:
        one = _maker(kind, random.Random(seed), Path(directory) / "model.onnx")
        done, next_reading = 0, 0
        while done < count:
            done += one()
            if done >= next_reading:
                track.read(done / count)
                next_reading += max(1, count // READINGS)
    return track


def _maker(kind: str, rng: random.Random, model: Path) -> Callable[[], int]:
    if kind.startswith("modbus"):
        modbus = ModbusFuzz(rng)
        return _counted(modbus.one_tcp if kind == "modbus_tcp" else modbus.one_rtu)
    if kind == "can_pipeline":
        return PipelineFuzz(rng).some_frames
    if kind == "true_angles":
        return Worlds(rng).some_time
    texts = TextFuzz(rng)
    return _counted(
        {
            "configurations": texts.one_config,
            "presets": texts.one_preset_file,
            "certificates": texts.one_certificate,
            "models": lambda: texts.one_model(model),
        }[kind]
    )


def _counted(one: Callable[[], None]) -> Callable[[], int]:
    def call() -> int:
        one()
        return 1

    return call


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--share", type=float, default=1.0, help="of the full counts")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=COUNTS, action="append")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    total, begun_s, bad = 0, time.monotonic(), False
    print(f"{'inputs':<16}{'count':>9}{'seconds':>9}{'MiB at 10 %':>13}{'at the end':>12}{'rise MiB':>10}")
    for kind in options.only or COUNTS:
        count = max(1, round(COUNTS[kind] * options.share))
        kind_s = time.monotonic()
        try:
            track = run(kind, count, options.seed)
        except Exception:  # noqa: BLE001 - whatever it is, it is the finding
            traceback.print_exc()
            print(f"{kind}: a finding with --seed {options.seed}", file=sys.stderr)
            bad = True
            continue
        total += count
        warm = track.warm or track.readings
        figures = f"{warm[0][1]:>13.1f}{warm[-1][1]:>12.1f}{track.rise_mib:>10.2f}"
        print(f"{kind:<16}{count:>9}{time.monotonic() - kind_s:>9.1f}{figures}{'  RISES' if track.rises else ''}")
        sys.stdout.flush()
        bad = bad or track.rises
    print(f"{'all':<16}{total:>9}{time.monotonic() - begun_s:>9.1f}")
    return int(bad)


if __name__ == "__main__":
    sys.exit(main())
