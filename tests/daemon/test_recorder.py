"""Recording: readable by the laboratory, bounded, and no danger to the daemon whatever the disk does."""

import asyncio
import errno
import os
import threading
from pathlib import Path

import pytest
from tests.fakes.can_wire import CanWire
from tests.fakes.encoder_node import COUNTS_PER_REV, EncoderNode
from tests.fakes.register_values import joint_state
from tests.fakes.running_service import GOOD, LIMIT_S, config_yaml, images_of, joint_yaml, on_wire, started
from tests.fakes.served_images import image_of
from tests.fakes.trueangled_process import trueangled

from trueangle.config import parse_config
from trueangle.contract.calibration import read_campaign
from trueangle.contract.errors import ContractError
from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.recording import COLUMNS, RecordedJoint, RowMaker, recorded_number
from trueangle.core.register_reading import DetailReading, read_detail
from trueangle.edges.recorder import (
    QUEUE_IMAGES,
    RETRY_S,
    PatientRecorder,
    Recorder,
    RecordFiles,
    RecordLimits,
)

BASE, ELBOW = RecordedJoint(slot=1, name="base"), RecordedJoint(slot=2, name="el bow/../x")
STAMP, UTC = "20261122T200000Z", "2026-11-22T20:00:00.000Z"
LIMITS = RecordLimits(max_bytes=4000, rotate_bytes=1000, rotate_s=None)
LINE = "1.5," * (len(COLUMNS) - 1) + "x\n"


def detail(**changes: object) -> DetailReading:
    data = image_of({1: joint_state(**changes)}).read(1000, 70)
    assert data is not None
    return read_detail(data, 1)


def recorded(directory: Path) -> list[Path]:
    return sorted(directory.iterdir())


def fill(files: RecordFiles, lines: int, joint: RecordedJoint = BASE, now_s: float = 0.0) -> None:
    for _ in range(lines):
        files.append(joint, LINE, now_s=now_s, stamp=STAMP)


class Disk:
    """`os.write` of a disk with so many bytes left; it writes half a line before it says so."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.error = errno.ENOSPC

    def write(self, handle: int, data: bytes) -> int:
        if self.room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        written = os.write(handle, data[: self.room])
        self.room -= written
        return written


def test_a_recording_with_reference_angles_is_a_campaign(tmp_path: Path) -> None:
    files, maker = RecordFiles(tmp_path, LIMITS), RowMaker()
    for number, reference_deg in enumerate((None, 123.45, 359.9999)):
        raw = 0.0001 if number == 2 else 123.4512345
        row = maker.row(detail(raw_deg=raw), reference_deg=reference_deg, time_s=number, utc=UTC)
        files.append(BASE, row, now_s=number, stamp=STAMP)
    files.close_all()
    (path,) = recorded(tmp_path)
    campaign = read_campaign(path.read_bytes(), source=path.name)
    # raw - reference: 0.0012345 deg, and across the zero 0.0002 deg; the cells have 1e-4 arcsec.
    assert campaign.error_arcsec.tolist() == pytest.approx([4.4442, 0.72], abs=1e-4)
    assert campaign.run.tolist() == [1, 1]
    assert campaign.zero_group.tolist() == [campaign.zero_group[0]] * 2
    assert campaign.direction is not None
    assert campaign.direction.tolist() == [-1, -1]  # velocity -45.5 deg/s
    assert any("without angle or error" in note for note in campaign.notes)


def test_what_is_not_known_is_an_empty_cell_and_no_corrected_angle_stands_without_valid() -> None:
    bad = detail(status=StatusBit.STALE, temperature_c=None, velocity_deg_s=None, sequence=None)
    cells = dict(
        zip(
            COLUMNS,
            RowMaker().row(bad, reference_deg=None, time_s=1.0, utc=UTC).rstrip("\n").split(","),
            strict=True,
        )
    )
    empty = ("error_arcsec", "temperature_c", "direction", "velocity_deg_s", "corrected_deg", "reference_deg")
    assert [cells[name] for name in empty] == [""] * len(empty)
    assert (cells["status"], cells["angle_deg"]) == ("STALE", "123.451234500")


@pytest.mark.parametrize("end", [b"1.5,2.5", b"12.3", LINE.rstrip("\n").encode() + b"\0\0\0"])
def test_a_line_that_was_cut_off_is_left_out_and_only_in_a_recording(end: bytes) -> None:
    rows = b"1,2,20,1,0,1,0,0,,,,,,,VALID,x\n2,3,20,1,0,1,0,0,,,,,,,VALID,x\n"
    campaign = read_campaign(BASE.header.encode() + rows + end, source="x.csv")
    assert campaign.angle_deg.tolist() == [1.0, 2.0]
    assert "the last line of the recording is cut off and was left out" in campaign.notes
    with pytest.raises(ContractError, match="expected 2 cells"):
        read_campaign(b"angle_deg,error_arcsec\n1,2\n3", source="y.csv")


def test_files_rotate_with_their_header_and_the_oldest_go_first(tmp_path: Path) -> None:
    foreign = tmp_path / "trueangle-notes.csv"
    foreign.write_text("x" * 9000)
    files = RecordFiles(tmp_path, LIMITS)
    files.take_stock()
    sizes = []
    for _ in range(200):
        fill(files, 1)
        sizes.append(sum(path.stat().st_size for path in tmp_path.iterdir() if path != foreign))
    assert max(sizes) <= LIMITS.max_bytes
    files.close_all()
    mine = [path for path in recorded(tmp_path) if path != foreign]
    assert foreign.exists()
    assert len(mine) >= 3
    numbers = [recorded_number(path.name) for path in mine]
    assert numbers == list(range(numbers[0] or 0, (numbers[-1] or 0) + 1))
    assert (numbers[0] or 0) > 1
    for path in mine:
        assert path.read_text().startswith(BASE.header)
        assert path.stat().st_size <= LIMITS.rotate_bytes


def test_a_file_is_finished_by_time_as_well_and_names_stay_in_the_directory(tmp_path: Path) -> None:
    files = RecordFiles(tmp_path, RecordLimits(max_bytes=4000, rotate_bytes=2000, rotate_s=60))
    fill(files, 1, ELBOW, now_s=0.0)
    fill(files, 1, ELBOW, now_s=59.0)
    fill(files, 1, ELBOW, now_s=60.0)
    files.close_all()
    assert [path.name for path in recorded(tmp_path)] == [
        f"trueangle-0000000{number}-slot02-el_bow_.._x-{STAMP}.csv" for number in (1, 2)
    ]


def test_what_a_crash_left_is_finished_counted_and_never_written_over(tmp_path: Path) -> None:
    crashed = RecordFiles(tmp_path, LIMITS)
    fill(crashed, 3)
    (part,) = recorded(tmp_path)
    assert part.name.endswith(".csv.part")
    after = RecordFiles(tmp_path, LIMITS)
    after.take_stock()
    assert after.total_bytes == part.with_suffix("").stat().st_size
    fill(after, 1)
    after.close_all()
    assert [recorded_number(path.name) for path in recorded(tmp_path)] == [1, 2]


def test_a_full_disk_stops_the_recording_and_room_lets_it_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    disk = Disk(room=len(BASE.header) + 2 * len(LINE) + 7)
    free = [10]
    monkeypatch.setattr("trueangle.edges.recorder.room_bytes", lambda _: free[0])
    sink = PatientRecorder(RecordFiles(tmp_path, LIMITS, write=disk.write), tmp_path)

    def append(now_s: float) -> bool:
        sink.append(BASE, LINE, now_s=now_s, stamp=STAMP)
        return sink.stopped

    assert [append(second) for second in range(5)] == [False, False, True, True, True]
    (path,) = recorded(tmp_path)
    assert path.read_text() == BASE.header + 2 * LINE  # no half line stayed
    disk.room = 10**6
    assert append(3.0 + RETRY_S)  # the file system still says that it is full
    free[0] = 10**9
    assert append(3.1 + RETRY_S)  # not yet tried again
    assert not append(9.0 + 2 * RETRY_S)
    assert (sink.lines, sink.lines_lost) == (3, 5)
    assert [message.split()[0] for message in caplog.messages] == [
        "event=recorder_stopped",
        "event=recorder_resumed",
    ]
    assert "lines_lost=5" in caplog.messages[1]


@pytest.mark.parametrize("kind", ["gone", "a file"])
def test_a_directory_that_is_none_stops_the_recording_only(tmp_path: Path, kind: str) -> None:
    directory = tmp_path / "records"
    if kind == "a file":
        directory.write_text("")
    sink = PatientRecorder(RecordFiles(directory, LIMITS), directory)
    sink.append(BASE, LINE, now_s=0.0, stamp=STAMP)
    assert sink.stopped
    assert sink.reason


def test_the_recorder_never_waits_and_counts_what_it_could_not_take(tmp_path: Path) -> None:
    hold, entered = threading.Event(), threading.Event()

    def stuck(handle: int, data: bytes) -> int:
        entered.set()
        hold.wait(20)
        return os.write(handle, data)

    image = image_of({1: None})
    files = RecordFiles(tmp_path, RecordLimits(max_bytes=10**7, rotate_bytes=10**6, rotate_s=None), write=stuck)
    recorder = Recorder(tmp_path, [BASE], LIMITS, every_s=0.01, files=files)
    with recorder:
        recorder.offer(image, 0)
        assert entered.wait(20)
        for number in range(1, QUEUE_IMAGES + 11):
            recorder.offer(image, number * 10_000_000)
        assert recorder.images_dropped == 10
        hold.set()
    assert recorder.stopped


def test_images_are_taken_at_the_interval_and_at_once_with_a_reference_angle(tmp_path: Path) -> None:
    limits = RecordLimits(max_bytes=10**6, rotate_bytes=10**5, rotate_s=None)
    image = image_of({1: None, 2: None})
    with Recorder(tmp_path, [BASE], limits, every_s=0.1) as recorder:
        for millisecond in range(0, 250, 10):
            if millisecond == 150:
                recorder.note_reference(1, 123.45)
                recorder.note_reference(2, 99.0)  # not recorded: told to nobody
            recorder.offer(image, 5_000_000_000 + millisecond * 1_000_000)
    (path,) = recorded(tmp_path)
    rows = [line.split(",") for line in path.read_text().splitlines()[2:]]
    at, reference = COLUMNS.index("time_s"), COLUMNS.index("reference_deg")
    assert [row[at] for row in rows] == ["0.000", "0.100", "0.150", "0.200"]
    assert [row[reference] for row in rows] == ["", "", "123.450000000", ""]


def test_the_configuration_of_a_recording_is_checked() -> None:
    text = (
        "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: x}]\njoints:\n"
        "  - {slot: 1, name: base, bus: arm, node_id: 1, model: m.onnx, encoder: {counts_per_rev: 4096},\n"
        "     temperature: {index: 0x7130, subindex: 1, degc_per_unit: 0.01}}\n"
        "record: {directory: %s, joints: [%s], max_bytes: 200000, rotate_bytes: %d}\n"
    )
    good = parse_config(text % ("/var/lib/x", "base", 100_000), source="c")
    assert good.record is not None
    for values, expected in (
        (("records", "base", 100_000), "an absolute path"),
        (("/x", "wrist", 100_000), "one of the joints: base, found wrist"),
        (("/x", "base", 100_001), "at most half of max_bytes"),
    ):
        with pytest.raises(ContractError, match=expected):
            parse_config(text % values, source="c")


def test_the_command_without_directory_or_server_says_so(tmp_path: Path) -> None:
    done = trueangled("record", "--out", str(tmp_path / "none"), "--every-ms", "1")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 2
    done = trueangled("record", "--out", str(tmp_path), "--port", "1")
    assert (done.returncode, done.stdout) == (1, "")
    assert "cannot connect" in done.stderr


def test_the_running_daemon_records_what_it_serves_and_says_when_it_cannot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    directory = tmp_path / "records"
    config = config_yaml(joint_yaml(1, "base")) + f"record: {{directory: {directory}, every_ms: 10}}\n"
    monkeypatch.setattr("trueangle.edges.recorder.RETRY_S", 0.05)

    async def scenario() -> None:
        node = EncoderNode(1, lambda _id, _data: None, counts=lambda _: 1_234_567)
        async with on_wire(monkeypatch, CanWire(), node), started(config, caplog) as rig:
            async with asyncio.timeout(LIMIT_S):
                # The directory is not there yet: served all the same.
                await rig.until_status(1, StatusBit.VALID)
                while not await rig.service_status() & ServiceBit.RECORDER_STOPPED:
                    pass
                directory.mkdir()
                while await rig.service_status() & ServiceBit.RECORDER_STOPPED:
                    pass
            assert rig.service.recorder is not None
            rig.service.recorder.note_reference(1, 135.6)
            await rig.until_told(
                lambda: any(b",135.600000000," in path.read_bytes() for path in recorded(directory))
            )

    asyncio.run(scenario())
    (path,) = recorded(directory)
    campaign = read_campaign(path.read_bytes(), source=path.name)
    raw_deg = 1_234_567 * 360 / COUNTS_PER_REV
    assert campaign.angle_deg.tolist() == pytest.approx([raw_deg], abs=1e-9)
    assert campaign.error_arcsec.tolist() == pytest.approx([(raw_deg - 135.6) * 3600], abs=1e-4)


def test_a_disk_that_fills_in_service_stops_the_recording_and_no_joint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Stopped by a bit and a line, gone on by a line when there is room; no line of the file is half a line."""
    disk = Disk(6_000)
    monkeypatch.setattr(RecordFiles.__init__, "__kwdefaults__", {"write": disk.write})
    monkeypatch.setattr("trueangle.edges.recorder.room_bytes", lambda _: disk.room)
    monkeypatch.setattr("trueangle.edges.recorder.RETRY_S", 0.05)
    joints = (joint_yaml(1, "base"), joint_yaml(2, "elbow", model="twin.onnx"))
    config = config_yaml(*joints) + f"record: {{directory: {tmp_path}, every_ms: 10}}\n"
    images = images_of(monkeypatch)

    async def scenario() -> None:
        nodes = [EncoderNode(i, lambda _id, _data: None, counts=lambda _: 1_234_567) for i in (1, 2)]
        async with on_wire(monkeypatch, CanWire(), *nodes), started(config, caplog) as rig:
            for slot in (1, 2):
                await rig.until_status(slot, StatusBit.VALID)
            first = len(images)
            async with asyncio.timeout(LIMIT_S):
                while not await rig.service_status() & ServiceBit.RECORDER_STOPPED:
                    pass
                disk.room = 10**9
                while await rig.service_status() & ServiceBit.RECORDER_STOPPED:
                    pass
            words = {image.read(address, 2) for image in images[first:] for address in (10, 22)}
            assert words == {int(GOOD).to_bytes(4, "big")}

    asyncio.run(scenario())
    told = [message.split()[0] for message in caplog.messages if "event=recorder_" in message]
    assert told == ["event=recorder_stopped", "event=recorder_resumed"]
    for path in recorded(tmp_path):
        *lines, end = path.read_text().split("\n")
        assert end == ""
        assert {line.count(",") for line in lines[1:]} == {len(COLUMNS) - 1}
