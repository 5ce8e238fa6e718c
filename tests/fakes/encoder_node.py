"""A CANopen encoder that also samples: at each SYNC it sends what its own mapping says, in that order.

The daemon's idea of the mapping is never asked, so a node that fell back to its factory mapping sends other bytes
on the same COB-ID, as a real one does. It keeps no clock: heartbeats too are paced by SYNC.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.fakes.canopen_device import Address, FakeDevice

SYNC, SDO_REQUEST, SDO_UPLOAD = 0x080, 0x600, 0x40
OPERATIONAL, COB_INVALID = 0x05, 1 << 31
POSITION, SEQUENCE, TEMPERATURE = (0x6004, 0), (0x2100, 0), (0x7130, 1)
COUNTS_PER_REV = 3_276_800
AS_CALIBRATED: dict[Address, tuple[int, int]] = {
    (0x6001, 0): (COUNTS_PER_REV, 4),
    (0x6002, 0): (COUNTS_PER_REV, 4),
    (0x6003, 0): (0, 4),
    (0x6501, 0): (65_536, 4),
}
"""How the encoder of tests/data/models was set at calibration; its serial number is the FakeDevice's, 4711."""


@dataclass
class EncoderNode(FakeDevice):
    """One node with process data; `counts` gives the position of a sample by its number."""

    counts: Callable[[int], int] = lambda _: 0
    temperature_centi_c: int = 2500
    temperatures: Callable[[int], int] | None = None
    """Gives the temperature of a sample by its number, in its place."""
    sends_temperature: bool = True
    extra_bytes: int = 0
    """Process data are so much longer than mapped; negative: shorter."""
    answers_sdo: bool = True
    syncs_per_heartbeat: int = 50
    """The 500 ms of the tests' configuration at a SYNC every 10 ms; more often would be two nodes."""
    syncs: int = 0
    sampled: int = 0
    """Number of the last sample."""
    frozen: bool = False
    """Its process data stand still, the frames go on."""
    sends_position: bool = True
    sends_heartbeat: bool = True
    reads: list[Address] = field(default_factory=list[Address])
    """Objects uploaded by SDO, in order."""

    def __post_init__(self) -> None:
        self.objects = AS_CALIBRATED | self.objects
        super().__post_init__()

    def handle(self, can_id: int, data: bytes) -> None:
        if can_id == SYNC and not self.deaf:
            self.sample()
        elif can_id == SDO_REQUEST + self.node_id and not self.deaf:
            if not self.answers_sdo:
                return
            if data[0] == SDO_UPLOAD:
                self.reads.append((int.from_bytes(data[1:3], "little"), data[3]))
        super().handle(can_id, data)

    def sample(self) -> None:
        """What SYNC makes the node do."""
        self.syncs += 1
        if self.state == OPERATIONAL:
            for number in range(2):
                kind = self.objects[0x1800 + number, 2][0]
                if 1 <= kind <= 240 and self.syncs % kind == 0:
                    self._send_process_data(number)
        if self.sends_heartbeat and self.objects[0x1017, 0][0] and self.syncs % self.syncs_per_heartbeat == 0:
            self.heartbeat()

    def elapse(self) -> None:
        """What its event timers make the node do when they have run out."""
        self.syncs += 1
        if self.state == OPERATIONAL:
            for number in range(2):
                timer_ms, _ = self.objects.get((0x1800 + number, 5), (0, 0))
                if self.objects[0x1800 + number, 2][0] >= 254 and timer_ms:
                    self._send_process_data(number)

    def _send_process_data(self, number: int) -> None:
        cob = self.objects[0x1800 + number, 1][0]
        entries = [
            self.objects[0x1A00 + number, place][0] for place in range(1, self.objects[0x1A00 + number, 0][0] + 1)
        ]
        mapped = [((entry >> 16, entry >> 8 & 0xFF), entry & 0xFF) for entry in entries]
        warm = any(address == TEMPERATURE for address, _ in mapped)
        if cob & COB_INVALID or not (self.sends_temperature if warm else self.sends_position):
            return
        if not self.frozen:
            self.sampled = self.syncs & 0xFFFF
        told = self.temperatures
        values = {
            POSITION: self.counts(self.sampled),
            SEQUENCE: self.sampled,
            TEMPERATURE: self.temperature_centi_c if told is None else told(self.sampled),
        }
        data = b"".join(
            (values[address] & (1 << bits) - 1).to_bytes(bits // 8, "little") for address, bits in mapped
        )
        self.send(cob & 0x7FF, (data + bytes(8))[: len(data) + self.extra_bytes])

    def reboot(self, changed: dict[Address, tuple[int, int]] | None = None) -> None:
        """Supply lost and back: the factory's process data, the encoder's own settings kept, but for `changed`."""
        self.boot_up(AS_CALIBRATED | (changed or {}))
