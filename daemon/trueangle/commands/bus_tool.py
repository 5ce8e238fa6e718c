"""One CAN bus for the time of a command: listening, SDO to any node, layer setting services. Nothing is retried
behind the user's back but a lost SDO answer, once."""

import argparse
import asyncio
import logging
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from trueangle.config import BusConfig, DaemonConfig, load_config
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.lss import MASTER_COB_ID, SLAVE_COB_ID, Answers, LssRequest
from trueangle.core.node_setup import Address, SdoWrite, shown
from trueangle.core.sdo_frames import (
    REPLY_BASE,
    REQUEST_BASE,
    SdoAnswer,
    abort_request,
    download_request,
    read_answer,
    refusal,
    upload_request,
)
from trueangle.edges.can_bus import CanBus, Frame, bus_faults
from trueangle.errors import LinkError, NodeFault

OPEN_S = 6.0
SDO_S = 0.5
LSS_S = 0.1
"""CiA 305 sets no limit; a unit that takes longer is told by `--lss-timeout`."""
GATHER_S = 0.02
"""After a first answer, for that of a second unit."""
LSS_LIMITS_S = (0.01, 10.0)

T = TypeVar("T")


class BusSession:
    """`async with` opens the bus; LinkError where it cannot be had."""

    def __init__(self, settings: BusConfig, *, lss_s: float = LSS_S) -> None:
        # A command produces no SYNC: what happens on the bus is what was asked for.
        self.settings = replace(settings, sync_period_ms=None)
        self._lss_s = lss_s
        self._bus = CanBus(self.settings, on_frames=self._on_frames, on_bus_state=self._on_state)
        self._up: asyncio.Future[None] | None = None
        self.listener: Callable[[int, bytes, int], None] | None = None
        """Given every frame."""
        self._waiting: dict[int, Callable[[bytes], None]] = {}
        self.doubled: set[int] = set()
        """Node-ids with an SDO answer that nobody had asked for: two nodes, or another master."""

    async def __aenter__(self) -> Self:
        # The transport logs what this class raises.
        logging.getLogger("trueangle").setLevel(logging.CRITICAL)
        self._up = asyncio.get_running_loop().create_future()
        await self._bus.__aenter__()
        try:
            async with asyncio.timeout(OPEN_S):
                await self._up
        except (TimeoutError, LinkError) as error:
            await self._bus.__aexit__(None, None, None)
            reason = str(error) or f"bus {self.settings.name}: did not open within {OPEN_S:g} s"
            raise LinkError(reason) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._bus.__aexit__(kind, error, trace)

    def send(self, cob_id: int, data: bytes) -> None:
        """One frame; LinkError where the bus is down."""
        self._bus.send(cob_id, data)

    async def upload(self, node_id: int, address: Address, *, timeout_s: float = SDO_S) -> SdoAnswer | None:
        """Read one object of up to 4 bytes; None where the node stays silent."""
        answer = await self._ask(node_id, upload_request(address), address, timeout_s, to_download=False)
        if answer is not None and answer.segmented:
            self.send(REQUEST_BASE + node_id, abort_request(address))
        return answer

    async def value(self, node_id: int, address: Address) -> int | None:
        """Read a number; None where the node has no such object. LinkError where it is silent, NodeFault where it
        refuses."""
        for _ in range(2):
            answer = await self.upload(node_id, address)
            if answer is not None:
                if answer.abort_code is not None and not answer.absent:
                    raise NodeFault(f"node {node_id} does not tell {refusal(address, answer)}")
                return answer.value
        raise LinkError(f"node {node_id} does not answer (SDO read of {shown(address)})")

    async def download(self, node_id: int, write: SdoWrite, *, timeout_s: float = SDO_S) -> None:
        """Write one object; LinkError where the node is silent, NodeFault where it refuses. Never sent twice."""
        answer = await self._ask(node_id, download_request(write), write.address, timeout_s, to_download=True)
        if answer is None:
            raise LinkError(f"node {node_id} does not answer (SDO write of {write}); read it back before going on")
        if answer.abort_code is not None:
            raise NodeFault(f"node {node_id} refuses {write}: {refusal(write.address, answer)}")

    async def lss(self, service: Generator[LssRequest, Answers, T]) -> T:
        """Carry out one layer setting service."""
        answers: list[bytes] = []
        first = asyncio.Event()

        def take(data: bytes) -> None:
            answers.append(data)
            first.set()

        self._waiting[SLAVE_COB_ID] = take
        try:
            request = next(service)
            while True:
                answers.clear()
                first.clear()
                self.send(MASTER_COB_ID, request.data)
                if request.answered:
                    try:
                        async with asyncio.timeout(self._lss_s):
                            await first.wait()
                        await asyncio.sleep(GATHER_S)
                    except TimeoutError:
                        pass
                request = service.send(tuple(answers))
        except StopIteration as end:
            return end.value
        finally:
            del self._waiting[SLAVE_COB_ID]

    async def _ask(
        self, node_id: int, request: bytes, address: Address, timeout_s: float, *, to_download: bool
    ) -> SdoAnswer | None:
        told: asyncio.Future[SdoAnswer] = asyncio.get_running_loop().create_future()

        def take(data: bytes) -> None:
            answer = read_answer(data, address, to_download=to_download)
            if told.done():
                self.doubled.add(node_id)
            elif answer is not None:
                told.set_result(answer)

        cob_id = REPLY_BASE + node_id
        self._waiting[cob_id] = take
        try:
            self.send(REQUEST_BASE + node_id, request)
            async with asyncio.timeout(timeout_s):
                return await told
        except TimeoutError:
            return None
        finally:
            del self._waiting[cob_id]

    def _on_frames(self, frames: list[Frame]) -> None:
        for cob_id, data, stamp_ns in frames:
            if self.listener is not None:
                self.listener(cob_id, data, stamp_ns)
            if cob_id in self._waiting:
                self._waiting[cob_id](data)
            elif REPLY_BASE < cob_id <= REPLY_BASE + 127:
                self.doubled.add(cob_id - REPLY_BASE)

    def _on_state(self, up: bool, reason: str) -> None:
        if self._up is not None and not self._up.done():
            if up:
                self._up.set_result(None)
            else:
                self._up.set_exception(LinkError(reason))


def add_bus(parser: argparse.ArgumentParser) -> None:
    """The options that name a bus."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="take the bus from it")
    parser.add_argument("--bus", metavar="NAME", help="which bus of the configuration, where it has several")
    parser.add_argument("--interface", help="python-can's name of the interface, without --config")
    parser.add_argument("--channel", help="such as can0")
    parser.add_argument("--bitrate", type=int, metavar="BIT/S", help="where the interface sets it")
    parser.add_argument(
        "--option", action="append", default=[], metavar="KEY=VALUE", help="further argument of the interface"
    )


def add_lss_timeout(parser: argparse.ArgumentParser) -> None:
    """The option that says how patient layer setting services are."""
    parser.add_argument("--lss-timeout", type=float, default=LSS_S, metavar="S", help="patience with LSS answers")


def lss_timeout_faults(options: argparse.Namespace) -> list[Fault]:
    """What is wrong with that option."""
    least, most = LSS_LIMITS_S
    if least <= options.lss_timeout <= most:
        return []
    found = f"{options.lss_timeout:g}"
    return [Fault(where="--lss-timeout", expected=f"{least:g} to {most:g}", found=found)]


def bus_of(options: argparse.Namespace) -> tuple[BusConfig, DaemonConfig | None]:
    """The bus that the options name, and the configuration where there is one; ContractError."""
    config = None if options.config is None else load_config(options.config)
    settings = _settings(options) if config is None else _configured(options, config)
    if faults := bus_faults(settings, where="the bus"):
        raise ContractError(faults)
    return settings, config


def _settings(options: argparse.Namespace) -> BusConfig:
    if not (options.interface and options.channel):
        expected = "a bus: --config FILE, or --interface and --channel"
        raise ContractError([Fault(where="command line", expected=expected, found="none")])
    further: dict[str, str | int | float | bool] = {}
    for text in options.option:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ContractError([Fault(where="--option", expected="KEY=VALUE", found=text)])
        further[key] = int(value) if value.isdigit() else value
    return BusConfig(
        name=options.channel,
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        options=further,
    )


def _configured(options: argparse.Namespace, config: DaemonConfig) -> BusConfig:
    if options.interface or options.channel or options.option:
        expected = "either --config or --interface, --channel and --option"
        raise ContractError([Fault(where="command line", expected=expected, found="both")])
    buses = {bus.name: bus for bus in config.buses}
    if options.bus is None and len(buses) > 1:
        raise ContractError([Fault(where="--bus", expected=f"one of {', '.join(buses)}", found="none")])
    name = next(iter(buses)) if options.bus is None else options.bus
    if name not in buses:
        raise ContractError([Fault(where="--bus", expected=f"one of {', '.join(buses)}", found=name)])
    return buses[name]
