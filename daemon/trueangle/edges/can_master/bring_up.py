"""What is asked and told of one node by SDO: identity, health, set-up, read-back, values.

Rules of this file: every step asks the node itself; nothing counts as set because it was written, nor as fixed
because an EDS says so. A node that is taken as found is never written to.
"""

from collections.abc import Awaitable, Callable

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.frames import NodePlan, PolledObject, TpdoPlan, number_in
from trueangle.core.node_setup import (
    ALARMS,
    COB_INVALID,
    ENCODER_OBJECTS,
    ERROR_REGISTER,
    HEARTBEAT_PRODUCER,
    PHASE_OBJECTS,
    PROFILE_SERIAL,
    STANDARD_TPDOS,
    Address,
    SdoWrite,
    cob_address,
    event_timer_addresses,
    readback_differences,
    settings_from,
    shown,
    tpdo_readback,
    tpdo_writes,
)
from trueangle.errors import NodeFault

Upload = Callable[[Address], Awaitable[bytes | None]]
"""The bytes of an object, None where the node has none; LinkError and NodeFault as they come."""
Write = Callable[[SdoWrite], Awaitable[None]]
IDENTITY: tuple[Address, ...] = ((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4))
"""What every node has; 0x6000 and above mean something else on a node that is no encoder."""

SERIAL: tuple[Address, ...] = ((0x1018, 4), PROFILE_SERIAL)


class BringUp:
    """The steps of one node's set-up, in the order in which they are taken."""

    def __init__(self, plan: NodePlan, upload: Upload, write: Write) -> None:
        self._plan, self._upload, self._write = plan, upload, write
        self._serial: dict[Address, int | None] = {}
        """As read at the last identification."""
        self._verified: dict[Address, int] = {}
        """What read back as it must at the last set-up."""
        self._turn = 0
        self.heartbeat_ms: int | None = None
        """What the node's heartbeat is set to; None where it has none and is asked for life."""

    async def identify(self) -> EncoderSettings:
        """Every object that tells which encoder this is and how it is set."""
        encoder = self._plan.slot is not None
        asked = (*ENCODER_OBJECTS.values(), PROFILE_SERIAL) if encoder else IDENTITY
        told = {address: await self._read(address) for address in asked}
        self._serial = {address: told[address] for address in SERIAL if told.get(address) is not None}
        settings = settings_from(told)
        for wanted in self._plan.expected:
            address = (wanted.index, wanted.subindex)
            value = await self._read(address)
            if value is not None and value != wanted.value:
                raise NodeFault(f"{wanted.meaning} {shown(address)} expected {wanted.value} found {value}")
        return settings

    async def check_health(self) -> None:
        """NodeFault where the node itself says that something is wrong."""
        alarms = ((ALARMS, "encoder alarms"),) if self._plan.slot is not None else ()
        for address, meaning in ((ERROR_REGISTER, "error register"), *alarms):
            value = await self._read(address)
            if value:
                raise NodeFault(f"{meaning} {shown(address)} expected 0 found 0x{value:X}")

    async def configure(self) -> None:
        """Set the node up as planned, unless it is taken as found."""
        if self._plan.as_found:
            return
        for tpdo in self._plan.tpdos:
            await self._configure(tpdo)
        await self._silence_other_tpdos()
        if not self._plan.polled:
            await self._write(SdoWrite(address=HEARTBEAT_PRODUCER, value=self._plan.heartbeat_ms, size=2))

    async def verify(self) -> None:
        """Read back everything that the decoding of frames and the supervision rest on."""
        expected: dict[Address, int] = {}
        for tpdo in self._plan.tpdos:
            expected |= tpdo_readback(tpdo)
            if tpdo.event_timer_ms is not None:
                address, _ = await self._event_timer(tpdo)
                expected[address] = tpdo.event_timer_ms
        found = {address: await self._read(address) for address in expected}
        heartbeat_ms = await self._read(HEARTBEAT_PRODUCER)
        differences = readback_differences(expected, found)
        if self._plan.as_found:
            differences += await self._strangers()
            self.heartbeat_ms = heartbeat_ms or None
        elif self._plan.polled:
            self.heartbeat_ms = None
        else:
            wanted = {HEARTBEAT_PRODUCER: self._plan.heartbeat_ms}
            differences += readback_differences(wanted, {HEARTBEAT_PRODUCER: heartbeat_ms})
            self.heartbeat_ms = self._plan.heartbeat_ms
        if differences:
            what = "is not set up as expected" if self._plan.as_found else "did not take its set-up"
            raise NodeFault(f"the node {what}: {'; '.join(differences)}")
        found |= self._serial
        self._verified = {address: value for address, value in found.items() if value is not None}

    async def check_unchanged(self, settings: EncoderSettings) -> None:
        """Another tool may preset, rescale or map anew while the node runs; no frame would tell.

        What moves the phase is asked each time, of the rest one object in turn.
        """
        for name in PHASE_OBJECTS if self._plan.slot is not None else ():
            before, now = getattr(settings, name), await self._read(ENCODER_OBJECTS[name])
            if now != before:
                raise NodeFault(f"{name} was changed in service from {before} to {now}")
        addresses = list(self._verified)
        if addresses:
            self._turn = (self._turn + 1) % len(addresses)
            address = addresses[self._turn]
            before, now = self._verified[address], await self._read(address)
            if now != before:
                shown_now = "nothing" if now is None else f"0x{now:X}"
                raise NodeFault(f"{shown(address)} was changed in service from 0x{before:X} to {shown_now}")

    async def poll(self, polled: PolledObject) -> int:
        """The value of an object that is not mapped; NodeFault where it is not there or of another length."""
        value = polled.value
        address = (value.index, value.subindex)
        data = await self._upload(address)
        if data is None:
            raise NodeFault(f"the node has no {value.quantity.value} {shown(address)}")
        number = number_in(value, data)
        if number is None:
            raise NodeFault(f"{shown(address)} expected {value.bits} bits found {8 * len(data)}")
        return number

    async def _configure(self, tpdo: TpdoPlan) -> None:
        cob = await self._read(cob_address(tpdo.number))
        if cob is None:
            raise NodeFault(f"the node has no TPDO {tpdo.number} ({shown(cob_address(tpdo.number))} is absent)")
        timer = None if tpdo.event_timer_ms is None else await self._event_timer(tpdo)
        for write in tpdo_writes(tpdo, cob, timer):
            await self._write(write)

    async def _event_timer(self, tpdo: TpdoPlan) -> tuple[Address, int]:
        """The object that holds this TPDO's event timer, and its size in bytes."""
        addresses = event_timer_addresses(tpdo)
        for address in addresses:
            data = await self._upload(address)
            if data:
                return address, len(data)
        wanted = " or ".join(shown(address) for address in addresses)
        raise NodeFault(f"the node has no event timer for TPDO {tpdo.number} ({wanted} is absent): use SYNC")

    async def _silence_other_tpdos(self) -> None:
        """A TPDO that is not planned may sit on a planned COB-ID: two senders, one of them decoded wrongly."""
        planned = {tpdo.number for tpdo in self._plan.tpdos}
        for number in STANDARD_TPDOS:
            address = cob_address(number)
            cob = None if number in planned else await self._read(address)
            if cob is not None and not cob & COB_INVALID:
                await self._write(SdoWrite(address=address, value=cob | COB_INVALID, size=4))
                if not (await self._read(address) or 0) & COB_INVALID:
                    raise NodeFault(f"unplanned TPDO {number} cannot be switched off ({shown(address)})")

    async def _strangers(self) -> list[str]:
        """TPDOs of a node taken as found that use the COB-ID of a planned one."""
        planned = {tpdo.number: tpdo.cob_id for tpdo in self._plan.tpdos}
        found: list[str] = []
        for number in STANDARD_TPDOS:
            cob = None if number in planned else await self._read(cob_address(number))
            if cob is not None and not cob & COB_INVALID and cob & 0x7FF in planned.values():
                found.append(f"TPDO {number} sends on the planned COB-ID 0x{cob & 0x7FF:03X} too")
        return found

    async def _read(self, address: Address) -> int | None:
        data = await self._upload(address)
        return None if data is None else int.from_bytes(data, "little")
