"""Simulated nodes on a bus of their own: a socketcand hub on this machine, or a SocketCAN interface."""

import asyncio
import contextlib
import os
import signal
import sys
import threading
from collections.abc import AsyncIterator, Iterator, Sequence

import can

from trueangle_training.simulator.canopen_node import NodeNetwork, NodeSpec
from trueangle_training.simulator.socketcand_hub import SocketcandHub

RECEIVE_SLICE_S = 0.1
STDIN = 0


@contextlib.asynccontextmanager
async def nodes_on_hub(specs: Sequence[NodeSpec], hub: SocketcandHub) -> AsyncIterator[NodeNetwork]:
    """Powered nodes on a hub that is listening."""
    network = NodeNetwork(hub.send)
    hub.attach(network.on_frame)
    with _powered(specs, network):
        yield network


@contextlib.asynccontextmanager
async def nodes_on_socketcan(specs: Sequence[NodeSpec], channel: str) -> AsyncIterator[NodeNetwork]:
    """Powered nodes on a SocketCAN interface such as vcan0; OSError where there is none.

    While the interface is down they lose their frames, as real nodes do, and go on when it is up again.
    """
    loop = asyncio.get_running_loop()
    closing = threading.Event()
    with can.Bus(interface="socketcan", channel=channel, ignore_config=True) as bus:

        def send(can_id: int, data: bytes) -> None:
            with contextlib.suppress(can.CanError):
                bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))

        network = NodeNetwork(send)

        def read() -> None:
            while not closing.is_set():
                try:
                    message = bus.recv(RECEIVE_SLICE_S)
                except can.CanError:
                    closing.wait(RECEIVE_SLICE_S)
                    continue
                if message is not None and _is_data_frame(message):
                    loop.call_soon_threadsafe(network.on_frame, message.arbitration_id, bytes(message.data))

        reader = threading.Thread(target=read, name="simulated-nodes", daemon=True)
        reader.start()
        try:
            with _powered(specs, network):
                yield network
        finally:
            closing.set()
            reader.join()


def run_nodes(specs: Sequence[NodeSpec], *, can_channel: str | None = None, port: int = 0) -> None:
    """Run nodes in this process until SIGTERM, SIGINT or the end of standard input: they die with their parent.

    On the hub one line `listening 127.0.0.1:PORT` is written to standard output once clients may connect;
    on a SocketCAN interface `listening INTERFACE`.
    """
    asyncio.run(_run_until_told(specs, can_channel, port))


async def _run_until_told(specs: Sequence[NodeSpec], can_channel: str | None, port: int) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    threading.Thread(target=_wait_for_end_of_stdin, args=(loop, stop), daemon=True).start()
    async with contextlib.AsyncExitStack() as stack:
        if can_channel is None:
            hub = await stack.enter_async_context(SocketcandHub(port=port))
            await stack.enter_async_context(nodes_on_hub(specs, hub))
            _announce(f"127.0.0.1:{hub.port}")
        else:
            await stack.enter_async_context(nodes_on_socketcan(specs, can_channel))
            _announce(can_channel)
        await stop.wait()


def _wait_for_end_of_stdin(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    # os.read and not sys.stdin: a daemon thread inside a buffered reader aborts the interpreter at its exit.
    with contextlib.suppress(OSError):
        while os.read(STDIN, 4096):
            pass
    with contextlib.suppress(RuntimeError):  # the loop is closed already
        loop.call_soon_threadsafe(stop.set)


def _announce(where: str) -> None:
    sys.stdout.write(f"listening {where}\n")
    sys.stdout.flush()


@contextlib.contextmanager
def _powered(specs: Sequence[NodeSpec], network: NodeNetwork) -> Iterator[None]:
    try:
        for spec in specs:
            network.add(spec).power_on()
        yield
    finally:
        network.close()


def _is_data_frame(message: can.Message) -> bool:
    return not (message.is_error_frame or message.is_remote_frame or message.is_extended_id)
