"""SDO transfers to one node, by the canopen library's client: the only place where that library is met."""

import asyncio
import queue
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from trueangle.core.node_setup import Address, SdoWrite, shown
from trueangle.errors import LinkError, NodeFault, NodeSilent

SDO_REPLY_BASE, SDO_REQUEST_BASE = 0x580, 0x600
ABSENT_CODES = frozenset({0x06010000, 0x06010001, 0x06020000, 0x06090011, 0x060A0023, 0x08000024})
"""SDO abort codes by which a unit says that it has no such object, or nothing in it (CiA 301, 7.2.4.3.17)."""
UNASKED_LIMIT = 2
"""So many answers that nobody asked for since the bring-up began are a second node; one may be late."""
SDO_ABORT, CLIENT_COMMAND, DOWNLOADS = 0x80, 0xE0, (0x00, 0x20)
"""Of the command byte: its upper three bits say what the client asks; 0 and 1 write (CiA 301, 7.2.4.3)."""
WITH_OBJECT = (0x20, 0x40, 0x60, SDO_ABORT)
"""Commands of either side, by those bits, whose bytes 1 to 3 name the object."""
FOREIGN_REQUESTS = 8
"""So many of another master's requests are remembered until they are answered."""
_INTERRUPTION = bytes((0x80, 0, 0, 0, 0, 0, 0, 0))
"""An SDO abort with code 0, which no node sends."""

T = TypeVar("T")


class FrameSender(Protocol):
    """What the master needs of a bus: to send from any thread, LinkError where it cannot."""

    def send(self, can_id: int, data: bytes) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterTiming:
    """How patient the master is."""

    sdo_timeout_s: float = 0.5
    sdo_attempts: int = 3
    heartbeat_periods: int = 3
    """So many heartbeats may fail to come before a node is lost."""
    backoff_first_s: float = 0.2
    backoff_limit_s: float = 2.0
    phase_check_s: float = 1.0
    """How often the objects that move the encoder's phase are read again in service."""
    other_master_quiet_s: float = 10.0
    """Another master that asked nothing for so long is gone."""
    stable_s: float = 10.0
    """A node that was in service so long starts again with the shortest pause."""


class SdoNetwork(canopen.Network):
    """The way out for canopen's SDO clients; nothing comes in by it and no thread is started."""

    def __init__(self, bus: FrameSender) -> None:
        super().__init__()
        self._sender = bus
        self.closed = False

        self.asked: dict[int, bytes] = {}
        """The last request on each COB-ID."""
        self.requests: dict[int, int] = {}
        """How many left on each COB-ID; written by the one worker thread that serves it."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send one frame, called in worker threads; LinkError where the bus is down or the master closes."""
        if self.closed:
            raise LinkError("the CANopen master is closing")
        request = bytes(data)
        if request[0] != SDO_ABORT:
            # Before the frame leaves: the answer may be here before `send` returns.
            self.asked[can_id] = request
            self.requests[can_id] = self.requests.get(can_id, 0) + 1
        self._sender.send(can_id, request)


class SdoPort:
    """SDO transfers to one node: canopen's blocking client in a worker thread, one transfer at a time.

    It counts answers against requests, because two nodes with one node-id both answer.
    """

    def __init__(
        self, node_id: int, network: "SdoNetwork", threads: ThreadPoolExecutor, timing: MasterTiming
    ) -> None:
        self._threads = threads
        self._network = network
        self._request_id = SDO_REQUEST_BASE + node_id
        client = SdoClient(SDO_REQUEST_BASE + node_id, SDO_REPLY_BASE + node_id, canopen.ObjectDictionary())
        client.network = self._network = network
        client.RESPONSE_TIMEOUT = timing.sdo_timeout_s
        # canopen counts the first attempt as a retry
        client.MAX_RETRIES = timing.sdo_attempts  # pyright: ignore[reportAttributeAccessIssue]
        self._client = client
        self._foreign_requests = self._answers = self._unasked = 0
        self._foreign_objects: deque[bytes] = deque(maxlen=FOREIGN_REQUESTS)
        """What another master asked for and was not answered yet."""

    def begin(self) -> None:
        """A bring-up begins: what was asked before is settled."""
        self._unasked = 0
        self._answers = self._asked()

    def on_reply(self, data: bytes) -> bool:
        """A frame on the node's SDO reply COB-ID; True where it shows that two nodes answer.

        Anything but 8 bytes is no SDO (CiA 301, 7.2.4.3). An answer that nobody asked for is not handed on.
        """
        if len(data) != 8:
            return False
        if self._answers >= self._asked():
            self._unasked += 1
            return self._unasked >= UNASKED_LIMIT
        self._answers += 1
        if not self._is_anothers(data):
            self._answer(data)
        return False

    def is_foreign(self, data: bytes) -> bool:
        """Whether another master sent this request; else it is our own, come back by an interface that echoes."""
        return len(data) == 8 and data != self._network.asked.get(self._request_id)

    def on_request(self, data: bytes) -> bool:
        """A request that another master sent to the node; True where it writes. Its answer is not ours."""
        if data[0] != SDO_ABORT:
            self._foreign_requests += 1
            if data[0] & CLIENT_COMMAND in WITH_OBJECT:
                self._foreign_objects.append(data[1:4])
        return data[0] & CLIENT_COMMAND in DOWNLOADS

    def _is_anothers(self, data: bytes) -> bool:
        """Whether another master asked for what this answers, and we did not."""
        if data[0] & CLIENT_COMMAND not in WITH_OBJECT or data[1:4] not in self._foreign_objects:
            return False
        self._foreign_objects.remove(data[1:4])
        return data[1:4] != self._network.asked.get(self._request_id, b"")[1:4]

    def _asked(self) -> int:
        return self._network.requests.get(self._request_id, 0) + self._foreign_requests

    def interrupt(self) -> None:
        """Fail the transfer in progress; the client empties its queue before the next one."""
        self._answer(_INTERRUPTION)

    def close(self) -> None:
        """Fail the transfer in progress and all later ones."""
        # In this order: a transfer that gets past the first finds the second when it waits.
        self._network.closed = True
        self.interrupt()

    def _answer(self, data: bytes) -> None:
        answers = cast("queue.Queue[bytes]", self._client.responses)  # pyright: ignore[reportUnknownMemberType]
        answers.put(data)

    async def read(self, address: Address) -> int | None:
        """Upload an unsigned value; None where the node says that it has no such object."""
        data = await self.upload(address)
        return None if data is None else int.from_bytes(data, "little")

    async def upload(self, address: Address) -> bytes | None:
        """The bytes of an object; None where the node says that it has no such object."""
        try:
            return await self._call(self._client.upload, *address)
        except SdoAbortedError as abort:
            if abort.code in ABSENT_CODES:
                return None
            raise NodeFault(f"the node does not tell {shown(address)}: {abort}") from abort
        except SdoCommunicationError as error:
            raise _no_answer(f"SDO read of {shown(address)}", error) from error

    async def write(self, write: SdoWrite) -> None:
        """Download one value."""
        data = write.value.to_bytes(write.size, "little")
        try:
            await self._call(self._client.download, *write.address, data)
        except SdoAbortedError as abort:
            raise NodeFault(f"the node refuses {write}: {abort}") from abort
        except SdoCommunicationError as error:
            raise _no_answer(f"SDO write of {write}", error) from error

    async def _call(self, transfer: Callable[..., T], *arguments: object) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, transfer, *arguments)


def _no_answer(what: str, error: SdoCommunicationError) -> LinkError:
    """Silence, or an answer out of order: the library tells them apart by this text alone."""
    silent = "No SDO response" in str(error)
    return (NodeSilent if silent else LinkError)(f"{what}: {error}")
