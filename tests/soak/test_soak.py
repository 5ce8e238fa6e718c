"""The short form of `make soak`."""

import asyncio
import random
from pathlib import Path

import pytest
from tests.soak.load import soak

SECONDS = 20.0
WARMING_MIB = 8.0
"""In twenty seconds the first reloads still fill caches; a leak for each request would be larger."""


@pytest.mark.timeout(180)
def test_twenty_seconds_of_everything_leave_memory_and_descriptors_as_they_were(tmp_path: Path) -> None:
    account = asyncio.run(soak(SECONDS, tmp_path, random.Random(1)))
    assert account.reads > 100
    assert account.valid > account.reads
    assert account.visits > 10
    assert account.reloads >= 1
    assert account.reboots >= 1
    assert account.memory.rise_mib < WARMING_MIB
    # One socket may be in the middle of being opened when the first count is taken.
    assert account.descriptors_end <= account.descriptors_begin + 1
