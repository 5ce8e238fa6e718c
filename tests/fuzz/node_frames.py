"""What a node may say beside process data, against the master of a bus: garbage, and it brings the node back."""

import asyncio
import random
from collections.abc import Callable

from tests.fakes.master_bench import NODE_ID, Bench, bench, with_sequence_object
from tests.fuzz.mutation import Mutator, corpus_bytes

from trueangle.core.node_setup import NodeState

FRAMES_A_TURN = 25
FRAMES_A_REST = 250
"""After so many the node may come into service, so that garbage meets it in every phase of its life."""
SERVICES = (0x080, 0x580, 0x600, 0x700)
"""EMCY, SDO answer, SDO request of another master, heartbeat."""


async def hear_frames(
    rng: random.Random, count: int, progress: Callable[[float], None] = lambda share: None
) -> None:
    """Feed `count` frames while the node is brought up, serves and is lost; in each pause it must be served again.

    An error that nobody handled is a finding; so is a node that is not RUNNING after the garbage has ended.
    """
    unhandled: list[str] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: unhandled.append(str(context)))
    mutated = Mutator(rng, corpus_bytes("can.txt"))
    async with bench(device=with_sequence_object()) as heard:
        for number in range(count):
            data = mutated.made(14) + b"\0\0"
            cob_id = int.from_bytes(data[:2], "big") & 0x7FF
            if rng.random() < 0.7:
                cob_id = rng.choice(SERVICES) + NODE_ID
            heard.master.notify(cob_id, data[2:10])
            if number % FRAMES_A_REST == FRAMES_A_REST - 1:
                await _served_again(heard)
                progress(number / count)
            elif number % FRAMES_A_TURN == 0:
                await asyncio.sleep(0)
        await _served_again(heard)
    assert not unhandled, unhandled


async def _served_again(heard: Bench) -> None:
    """The node has rebooted and rests: it must come into service, however it was left."""
    while not heard.reports.empty():
        heard.reports.get_nowait()
    heard.seen.clear()
    heard.master.notify(0x700 + NODE_ID, b"\0")
    await heard.until(NodeState.RUNNING)
