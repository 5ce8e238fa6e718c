"""A simulated CANopen encoder, protocol-true: CiA 301 slave, CiA 406 position, CiA 404 temperature.

The canopen library gives the SDO server and the NMT state; this file adds what that library's local node leaves
out: the boot-up message after a reset, the return to pre-operational, the rules of PDO mapping, SYNC-driven
TPDOs, and heartbeats without a python-can bus. All nodes of a process share one `NodeNetwork`.
"""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass

import canopen
from canopen.sdo.exceptions import SdoAbortedError

from trueangle.contract.encoder import EncoderSettings
from trueangle_training.simulator.encoder_dictionary import (
    MAPPABLE_BITS,
    MAX_MAPPED,
    OFFSET,
    POSITION,
    PRESET,
    SEQUENCE,
    TEMPERATURE,
    TPDO_COUNT,
    Address,
    encoder_dictionary,
)
from trueangle_training.simulator.trajectory import NodeSample

NMT_COB_ID, SYNC_COB_ID, SDO_REQUEST_BASE, HEARTBEAT_BASE = 0x000, 0x080, 0x600, 0x700
SDO_REPLY_BASE = 0x580
INVALID = 1 << 31
ABORT_UNMAPPABLE, ABORT_TOO_LONG = 0x06040041, 0x06040042
ABORT_VALUE, ABORT_STATE = 0x06090030, 0x08000022
ABORT_COMMAND = struct.pack("<B3xI", 0x80, 0x05040001)
"""Client command specifier not valid or unknown."""
NMT_STATE_NAMES = {0x01: "OPERATIONAL", 0x02: "STOPPED", 0x80: "PRE-OPERATIONAL"}
NMT_RESETS = (0x81, 0x82)


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSpec:
    """One simulated node."""

    node_id: int
    """1 .. 127"""
    settings: EncoderSettings
    """What the object dictionary says; fields left open get plain defaults."""
    sample: Callable[[int], NodeSample]
    """Pure function of the sample's sequence number 1, 2, ... (object 0x2100 carries its low 16 bits)."""
    name: str = "trueangle simulated encoder"


@dataclass(slots=True, kw_only=True)
class NodeFaults:
    """How a node misbehaves; all off at first."""

    silent: bool = False
    """Sends no TPDO."""
    frozen: bool = False
    """Samples nothing new: position, temperature and sequence stay as they are."""
    drop_every: int = 0
    """Leaves out every n-th TPDO; 0: none."""
    wrong_length: bool = False
    """Cuts the last byte off each TPDO."""
    ignores_mapping: bool = False
    """Confirms writes to 0x1A00 and 0x1A01 and keeps the old mapping."""
    no_heartbeat: bool = False


class NodeNetwork(canopen.Network):
    """The one dispatcher of all nodes: frames come in by `on_frame` and leave by `send`."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send
        self.encoders: dict[int, EncoderNode] = {}

    def add(self, spec: NodeSpec) -> "EncoderNode":
        """A node on this network, not yet powered."""
        node = EncoderNode(spec, self)
        self.encoders[spec.node_id] = node
        return node

    def close(self) -> None:
        """Switch all nodes off."""
        for node in self.encoders.values():
            node.power_off()

    def on_frame(self, can_id: int, data: bytes) -> None:
        """A frame from the bus; what no node can mean to understand is passed over."""
        if can_id == SYNC_COB_ID and len(data) <= 1:
            for node in self.encoders.values():
                node.on_sync()
        elif can_id == NMT_COB_ID and len(data) == 2:
            for node in self.encoders.values():
                if data[1] in (0, node.node_id):
                    node.on_nmt(data[0])
        elif len(data) == 8 and not self._stopped(can_id - SDO_REQUEST_BASE):
            try:
                self.notify(can_id, bytearray(data), 0.0)
            except struct.error:
                # The library's server cannot word an abort before its first transfer; the unit must answer.
                self._send(can_id - SDO_REQUEST_BASE + SDO_REPLY_BASE, ABORT_COMMAND)

    def _stopped(self, node_id: int) -> bool:
        """A stopped node answers no SDO (CiA 301, 7.3.2.2)."""
        node = self.encoders.get(node_id)
        return node is not None and node.stopped

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """A frame of a node."""
        self._send(can_id, bytes(data))

    def send_periodic(  # pyright: ignore[reportIncompatibleMethodOverride] - the library's own task needs a bus
        self, can_id: int, data: bytes, period: float, remote: bool = False
    ) -> "PeriodicFrame":
        """A node's heartbeat, kept by the event loop."""
        return PeriodicFrame(bytes(data), period, lambda content: self._beat(can_id, content))

    def _beat(self, can_id: int, data: bytes) -> None:
        node = self.encoders.get(can_id - HEARTBEAT_BASE)
        if node is None or not node.faults.no_heartbeat:
            self._send(can_id, data)


class PeriodicFrame:
    """A frame sent every `period_s`, first after one period, on an absolute schedule."""

    def __init__(self, data: bytes, period_s: float, send: Callable[[bytes], None]) -> None:
        self._data, self._period_s, self._send = data, period_s, send
        self._loop = asyncio.get_running_loop()
        self._due_s = self._loop.time() + period_s
        self._timer = self._loop.call_at(self._due_s, self._tick)

    def update(self, data: bytes) -> None:
        """Other content from the next time on."""
        self._data = bytes(data)

    def stop(self) -> None:
        """Send no more."""
        self._timer.cancel()

    def _tick(self) -> None:
        self._due_s = max(self._due_s + self._period_s, self._loop.time())
        self._timer = self._loop.call_at(self._due_s, self._tick)
        self._send(self._data)


class EncoderNode:
    """One encoder. `power_on` boots it; SYNC makes it sample and send while it is operational."""

    def __init__(self, spec: NodeSpec, network: NodeNetwork) -> None:
        self.node_id = spec.node_id
        self.faults = NodeFaults()
        self.sequence = 0
        """Samples taken since it was made; a reset does not put it back."""
        self._spec, self._network = spec, network
        self._device = _Device(spec, self)
        self._sample = spec.sample(0)
        self._preset_shift = 0
        self._preset = spec.settings.preset_value or 0
        self._maps: list[tuple[Address, ...]] = [()] * TPDO_COUNT
        self._sync_counts = [0] * TPDO_COUNT
        self._tpdos_due = 0

    @property
    def operational(self) -> bool:
        """Whether TPDOs are sent."""
        return self._device.nmt.state == "OPERATIONAL"

    @property
    def stopped(self) -> bool:
        """Whether nothing but NMT and heartbeats goes on."""
        return self._device.nmt.state == "STOPPED"

    def power_on(self) -> None:
        """Boot: objects as from the factory, boot-up message, pre-operational."""
        if not self._device.has_network():
            self._device.associate_network(self._network)
        self.reset()

    def power_off(self) -> None:
        """No more heartbeats, no answers."""
        if self._device.has_network():
            self._device.nmt.stop_heartbeat()
            self._device.remove_network()

    def reset(self) -> None:
        """What NMT reset node does; preset and offset survive, as in units that store them at once."""
        self._device.nmt.stop_heartbeat()
        self._device.data_store.clear()
        for n in range(TPDO_COUNT):
            self.remap(n)
        self._device.nmt.state = "RESET"  # sends the boot-up message
        self._device.nmt.state = "PRE-OPERATIONAL"

    def emergency(self, code: int, register: int = 0x01) -> None:
        """Send EMCY and enter it in error register and history; code 0 is the error's end."""
        self._device.data_store[0x1001] = {0: bytes((register if code else 0,))}
        self._device.data_store[0x1003] = {0: bytes((1 if code else 0,)), 1: code.to_bytes(4, "little")}
        self._device.emcy.send(code, register if code else 0)

    def on_nmt(self, command: int) -> None:
        """An NMT command that is for this node; unknown ones are passed over."""
        if not self._device.has_network():
            return
        if command in NMT_RESETS:
            self.reset()
        elif command in NMT_STATE_NAMES:
            self._device.nmt.state = NMT_STATE_NAMES[command]
            self._sync_counts = [0] * TPDO_COUNT

    def on_sync(self) -> None:
        """Sample, and send each TPDO whose turn it is (transmission type 1 .. 240: every that-many SYNC)."""
        if not self.operational or not self._device.has_network():
            return
        if not self.faults.frozen:
            self.sequence += 1
            self._sample = self._spec.sample(self.sequence)
        for n in range(TPDO_COUNT):
            cob_id, kind = self._number(0x1800 + n, 1), self._number(0x1800 + n, 2)
            if cob_id & INVALID or not 1 <= kind <= 240 or not self._maps[n]:
                continue
            self._sync_counts[n] += 1
            if self._sync_counts[n] >= kind:
                self._sync_counts[n] = 0
                self._send_tpdo(n, cob_id & 0x7FF)

    def live_value(self, address: Address) -> int | None:
        """The present value of an object that is measured, None for one that is stored."""
        if address == POSITION:
            return (self._sample.counts + self._preset_shift) % self._range_units
        if address == TEMPERATURE:
            return self._sample.temperature_centi_c
        if address == SEQUENCE:
            return self.sequence & 0xFFFF
        if address == PRESET:
            return self._preset
        if address == OFFSET:
            return ((self._spec.settings.offset_value or 0) + self._preset_shift) % 2**32
        return None

    def take_preset(self, value: int) -> None:
        """0x6003 written: the present position becomes `value`, and every later one moves with it."""
        self._preset = value
        self._preset_shift = (value - self._sample.counts) % self._range_units

    def remap(self, n: int) -> None:
        """Take over what 0x1A00 + n says now."""
        count = self._number(0x1A00 + n, 0)
        self._maps[n] = tuple(_mapped(self._number(0x1A00 + n, sub)) for sub in range(1, count + 1))

    def _send_tpdo(self, n: int, cob_id: int) -> None:
        self._tpdos_due += 1
        faults = self.faults
        if faults.silent or (faults.drop_every and self._tpdos_due % faults.drop_every == 0):
            return
        data = b"".join(self._process_value(address) for address in self._maps[n])
        self._network.send_message(cob_id, data[:-1] if faults.wrong_length else data)

    def _process_value(self, address: Address) -> bytes:
        value = self.live_value(address)
        if value is None:
            value = self._number(*address)
        return value.to_bytes(MAPPABLE_BITS[address] // 8, "little", signed=value < 0)

    @property
    def _range_units(self) -> int:
        return self._number(0x6002, 0) or 2**32

    def _number(self, index: int, subindex: int) -> int:
        return int.from_bytes(self._device.get_data(index, subindex), "little")


class _Device(canopen.LocalNode):
    """The library's local node with the rules of CiA 301 for what may be written when."""

    def __init__(self, spec: NodeSpec, owner: EncoderNode) -> None:
        super().__init__(spec.node_id, encoder_dictionary(spec.node_id, spec.settings, spec.name))
        self._owner = owner
        self.add_read_callback(lambda index, subindex, od: owner.live_value((index, subindex)))

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Store a value, or abort as a real unit does."""
        is_mapping = 0x1A00 <= index < 0x1A00 + TPDO_COUNT
        if is_mapping and self._owner.faults.ignores_mapping:
            return
        value = int.from_bytes(data, "little")
        if is_mapping:
            self._check_mapping(index, subindex, value)
        elif 0x1800 <= index < 0x1800 + TPDO_COUNT:
            self._check_communication(index, subindex, value)
        super().set_data(index, subindex, data, check_writable)
        if is_mapping and subindex == 0:
            self._owner.remap(index - 0x1A00)
        elif (index, subindex) == PRESET:
            self._owner.take_preset(value)

    def _check_communication(self, index: int, subindex: int, value: int) -> None:
        now_cob = self._stored(index, 1)
        if subindex == 1:
            if value & 0x3FFF_F800:
                raise SdoAbortedError(ABORT_VALUE)  # bits 11 .. 29: no extended identifiers here
            if not (now_cob | value) & INVALID and (now_cob ^ value) & 0x3FFF_FFFF:
                raise SdoAbortedError(ABORT_STATE)  # the identifier of a valid PDO does not change
        elif subindex == 2 and 241 <= value <= 253:
            raise SdoAbortedError(ABORT_VALUE)
        elif subindex == 3 and not now_cob & INVALID:
            raise SdoAbortedError(ABORT_STATE)

    def _check_mapping(self, index: int, subindex: int, value: int) -> None:
        if not self._stored(index - 0x200, 1) & INVALID:
            raise SdoAbortedError(ABORT_STATE)
        if subindex:
            if self._stored(index, 0):
                raise SdoAbortedError(ABORT_STATE)
            self._check_mappable(value)
        elif value > MAX_MAPPED:
            raise SdoAbortedError(ABORT_VALUE)
        else:
            entries = [self._stored(index, sub) for sub in range(1, value + 1)]
            for entry in entries:
                self._check_mappable(entry)
            if sum(entry & 0xFF for entry in entries) > 64:
                raise SdoAbortedError(ABORT_TOO_LONG)

    def _check_mappable(self, entry: int) -> None:
        if MAPPABLE_BITS.get(_mapped(entry)) != entry & 0xFF:
            raise SdoAbortedError(ABORT_UNMAPPABLE)

    def _stored(self, index: int, subindex: int) -> int:
        return int.from_bytes(self.get_data(index, subindex), "little")


def _mapped(entry: int) -> Address:
    return (entry >> 16, entry >> 8 & 0xFF)
