"""The simulated encoder against canopen's remote node (its SDO client) and against plain bytes."""

import asyncio
import struct

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from trueangle.contract.encoder import EncoderSettings
from trueangle_training.simulator.canopen_node import EncoderNode, NodeNetwork, NodeSample, NodeSpec

NODE_ID = 9
SETTINGS = EncoderSettings(
    vendor_id=0x1111,
    product_code=0x2222,
    revision_number=3,
    serial_number=4444,
    operating_parameters=4,
    units_per_revolution=1 << 20,
    total_range_units=1 << 20,
    preset_value=0,
    single_turn_resolution=1 << 20,
    distinguishable_revolutions=1,
    offset_value=17,
)


def sample(sequence: int) -> NodeSample:
    return NodeSample(counts=(1000 * sequence) % (1 << 20), temperature_centi_c=-1234 + sequence)


class MasterNetwork(canopen.Network):
    """The far side for canopen's remote node, in the same thread."""

    def __init__(self, bench: "Bench") -> None:
        super().__init__()
        self._bench = bench

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._bench.network.on_frame(can_id, bytes(data))


class Bench:
    """One powered node; `sent` is everything it has put on the bus."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes]] = []
        self.network = NodeNetwork(self._on_sent)
        self.master = MasterNetwork(self)
        self.remote = self.master.add_node(canopen.RemoteNode(NODE_ID, canopen.ObjectDictionary()))
        self.node: EncoderNode = self.network.add(NodeSpec(node_id=NODE_ID, settings=SETTINGS, sample=sample))
        self.node.power_on()

    def _on_sent(self, can_id: int, data: bytes) -> None:
        self.sent.append((can_id, data))
        self.master.notify(can_id, bytearray(data), 0.0)

    def read(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.remote.sdo.upload(index, subindex), "little")

    def write(self, index: int, subindex: int, value: int, size: int) -> None:
        self.remote.sdo.download(index, subindex, value.to_bytes(size, "little"))

    def nmt(self, command: int) -> None:
        self.network.on_frame(0x000, bytes((command, NODE_ID)))

    def sync(self, times: int = 1) -> list[tuple[int, bytes]]:
        """The frames that answer so many SYNC."""
        before = len(self.sent)
        for _ in range(times):
            self.network.on_frame(0x080, b"")
        return self.sent[before:]

    def map_tpdo(self, number: int, kind: int, *entries: int) -> None:
        n = number - 1
        self.write(0x1800 + n, 1, 0xC000_0180 + 0x100 * n + NODE_ID, 4)
        self.write(0x1A00 + n, 0, 0, 1)
        for position, entry in enumerate(entries, start=1):
            self.write(0x1A00 + n, position, entry, 4)
        self.write(0x1A00 + n, 0, len(entries), 1)
        self.write(0x1800 + n, 2, kind, 1)
        self.write(0x1800 + n, 1, 0x4000_0180 + 0x100 * n + NODE_ID, 4)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def abort_code(bench: Bench, index: int, subindex: int, value: int, size: int) -> int:
    with pytest.raises(SdoAbortedError) as caught:
        bench.write(index, subindex, value, size)
    return caught.value.code


def test_it_boots_with_a_message_and_factory_silence(bench: Bench) -> None:
    assert bench.sent == [(0x700 + NODE_ID, b"\x00")]
    bench.nmt(0x01)
    assert bench.sync(times=10) == []
    assert [bench.read(0x1800 + n, sub) for n in (0, 1) for sub in (2, 5)] == [255, 0, 255, 0]
    assert bench.read(0x1017) == 0


def test_identity_and_settings_read_back(bench: Bench) -> None:
    assert bench.read(0x1000) == 0x0001_0196
    assert [bench.read(0x1018, sub) for sub in range(5)] == [4, 0x1111, 0x2222, 3, 4444]
    indexes = (0x6000, 0x6001, 0x6002, 0x6003, 0x6501, 0x6502, 0x6509, 0x650B)
    assert [bench.read(i) for i in indexes] == [4, 1 << 20, 1 << 20, 0, 1 << 20, 1, 17, 4444]
    assert bench.read(0x6132, 1) == 2
    assert bench.remote.sdo.upload(0x1008, 0) == b"trueangle simulated encoder"  # segmented: longer than 4 bytes


def test_absent_objects_and_subindexes_are_told_apart(bench: Bench) -> None:
    for address, code in (((0x5000, 0), 0x06020000), ((0x1018, 9), 0x06090011)):
        with pytest.raises(SdoAbortedError) as caught:
            bench.remote.sdo.upload(*address)
        assert caught.value.code == code


def test_measured_objects_are_read_only(bench: Bench) -> None:
    assert abort_code(bench, 0x6004, 0, 5, 4) == 0x06010002


def test_sync_samples_and_sends_the_mapped_bytes(bench: Bench) -> None:
    bench.map_tpdo(1, 1, 0x6004_0020, 0x2100_0010)
    bench.map_tpdo(2, 3, 0x7130_0110, 0x6150_0108)
    bench.nmt(0x01)
    frames = bench.sync(times=7)
    positions = [data for can_id, data in frames if can_id == 0x189]
    assert positions == [struct.pack("<IH", 1000 * s, s) for s in range(1, 8)]
    temperatures = [data for can_id, data in frames if can_id == 0x289]
    assert temperatures == [struct.pack("<hB", -1234 + s, 0) for s in (3, 6)]
    assert bench.read(0x6004) == 7000
    assert bench.read(0x2100) == 7


def test_sequence_object_wraps_at_16_bits_while_the_samples_go_on(bench: Bench) -> None:
    bench.map_tpdo(1, 1, 0x6004_0020, 0x2100_0010)
    bench.nmt(0x01)
    bench.node.sequence = 0xFFFF
    assert bench.sync() == [(0x189, struct.pack("<IH", (1000 * 0x10000) % (1 << 20), 0))]


def test_mapping_changes_only_while_the_pdo_is_off_and_its_count_is_zero(bench: Bench) -> None:
    assert abort_code(bench, 0x1A00, 0, 0, 1) == 0x08000022
    bench.write(0x1800, 1, 0xC000_0189, 4)
    assert abort_code(bench, 0x1A00, 1, 0x6004_0020, 4) == 0x08000022
    bench.write(0x1A00, 0, 0, 1)
    bench.write(0x1A00, 1, 0x2100_0010, 4)
    assert bench.read(0x1A00, 1) == 0x2100_0010


@pytest.mark.parametrize("entry", [0x6001_0020, 0x6004_0010, 0x5000_0008, 0])
def test_unmappable_entry_is_refused(bench: Bench, entry: int) -> None:
    bench.write(0x1800, 1, 0xC000_0189, 4)
    bench.write(0x1A00, 0, 0, 1)
    assert abort_code(bench, 0x1A00, 1, entry, 4) == 0x06040041


def test_mapping_longer_than_a_frame_is_refused(bench: Bench) -> None:
    bench.write(0x1800, 1, 0xC000_0189, 4)
    bench.write(0x1A00, 0, 0, 1)
    for position in (1, 2, 3):
        bench.write(0x1A00, position, 0x6004_0020, 4)
    assert abort_code(bench, 0x1A00, 0, 3, 1) == 0x06040042
    bench.write(0x1A00, 0, 2, 1)


def test_identifier_of_a_valid_pdo_does_not_change(bench: Bench) -> None:
    assert abort_code(bench, 0x1800, 1, 0x4000_0199, 4) == 0x08000022
    assert abort_code(bench, 0x1800, 1, 0xE000_0199, 4) == 0x06090030


def test_preset_moves_the_position_and_shows_in_the_offset(bench: Bench) -> None:
    bench.map_tpdo(1, 1, 0x6004_0020)
    bench.nmt(0x01)
    bench.sync(times=3)
    bench.write(0x6003, 0, 50, 4)
    assert bench.read(0x6004) == 50
    assert bench.read(0x6003) == 50
    assert bench.read(0x6509) == 17 + (50 - 3000) % (1 << 20)
    assert bench.sync() == [(0x189, struct.pack("<I", 1050))]


def test_nmt_stops_and_resets_with_a_boot_up_message(bench: Bench) -> None:
    bench.map_tpdo(1, 1, 0x6004_0020)
    bench.nmt(0x01)
    assert len(bench.sync()) == 1
    bench.nmt(0x80)
    assert bench.sync() == []
    bench.nmt(0x01)
    bench.network.on_frame(0x000, bytes((0x02, NODE_ID + 1)))  # for another node
    assert len(bench.sync()) == 1
    bench.nmt(0x02)
    sent = len(bench.sent)
    bench.network.on_frame(0x600 + NODE_ID, bytes((0x40, 0, 0x10, 0, 0, 0, 0, 0)))
    assert len(bench.sent) == sent  # a stopped node answers no SDO
    bench.network.on_frame(0x000, bytes((0x81, 0)))  # to all
    assert bench.sent[-1] == (0x700 + NODE_ID, b"\x00")
    assert bench.read(0x1800, 2) == 255
    bench.nmt(0x01)
    assert bench.sync() == []


@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x600 + NODE_ID, 0x7FF])
@pytest.mark.parametrize("data", [b"", b"\x01", bytes(3), b"\xff" * 8])
def test_malformed_frames_leave_it_working(bench: Bench, can_id: int, data: bytes) -> None:
    bench.network.on_frame(can_id, data)
    assert bench.read(0x6001) == 1 << 20


def test_unknown_sdo_command_is_aborted_even_before_the_first_transfer(bench: Bench) -> None:
    bench.network.on_frame(0x600 + NODE_ID, b"\xff" * 8)
    assert bench.sent[-1] == (0x580 + NODE_ID, bytes.fromhex("8000000001000405"))


def test_heartbeat_carries_the_state() -> None:
    async def scenario() -> None:
        bench = Bench()
        beats: asyncio.Queue[bytes] = asyncio.Queue()
        bench.master.subscribe(0x700 + NODE_ID, lambda _, data, __: beats.put_nowait(bytes(data)))
        async with asyncio.timeout(10):
            bench.write(0x1017, 0, 5, 2)
            assert await beats.get() == b"\x7f"
            bench.nmt(0x01)
            while await beats.get() != b"\x05":
                pass
        bench.network.close()

    asyncio.run(scenario())


def test_emergency_is_sent_and_kept(bench: Bench) -> None:
    bench.node.emergency(0x5010)
    assert bench.sent[-1] == (0x080 + NODE_ID, struct.pack("<HB5x", 0x5010, 1))
    assert (bench.read(0x1001), bench.read(0x1003, 0), bench.read(0x1003, 1)) == (1, 1, 0x5010)
    bench.node.emergency(0)
    assert bench.read(0x1001) == 0


def test_fault_switches_do_what_they_say(bench: Bench) -> None:
    bench.map_tpdo(1, 1, 0x6004_0020, 0x2100_0010)
    bench.nmt(0x01)
    faults = bench.node.faults
    faults.silent = True
    assert bench.sync() == []
    faults.silent = False
    faults.frozen = True
    first, second = bench.sync(times=2)
    assert first == second
    faults.frozen = False
    faults.wrong_length = True
    assert len(bench.sync()[0][1]) == 5
    faults.wrong_length = False
    faults.drop_every = 3
    assert len(bench.sync(times=9)) == 6


def test_ignored_mapping_is_confirmed_and_not_taken(bench: Bench) -> None:
    bench.node.faults.ignores_mapping = True
    bench.map_tpdo(1, 1, 0x6004_0020, 0x2100_0010)
    assert bench.read(0x1A00, 0) == 1
    bench.nmt(0x01)
    assert bench.sync() == [(0x189, struct.pack("<I", 1000))]
