"""Modbus TCP and RTU streams, with and without commands, held to a framer and an image of this file's own."""

import random
from dataclasses import dataclass

from tests.fakes.command_target import FakeJoints, FakeStore
from tests.fakes.register_values import joint_identity, joint_state
from tests.fuzz.mutation import Mutator, corpus_bytes

from trueangle.core.commands import CommandDesk, Peer
from trueangle.core.modbus_answer import ModbusTcpStream
from trueangle.core.modbus_pdu import Identification, PduResponder
from trueangle.core.modbus_rtu import ModbusRtuStream, crc16
from trueangle.core.registers import RegisterImage, RegisterMap

UNIT_ID = 17
MAX_PDU_BYTES, MAX_RTU_BYTES = 253, 256
COMMAND_BLOCK = 5000
MAS_PER_TURN = 1_296_000_000
KNOWN_EXCEPTIONS = frozenset({1, 2, 3, 4, 6, 11})
_MAP = RegisterMap([joint_identity(1), joint_identity(2)])
IMAGES: tuple[RegisterImage | None, ...] = (
    None,
    *(
        _MAP.image(cycle=n, heartbeat=n, service_status=0, states={1: joint_state(corrected_deg=3.0 * n)})
        for n in (1, 2)
    ),
)


@dataclass
class Served:
    """One connection's responder and what its commands act on."""

    commands: bool

    def __post_init__(self) -> None:
        self.joints, self.store = FakeJoints(), FakeStore()
        self.desk = CommandDesk(self.joints, self.store, presets=(), report=lambda _: None)
        # What `restore` did for joints without a preset is not the peer's doing.
        self.joints.zeros.clear()
        peer = Peer(address="fuzz", may_command=self.commands)
        self.responder = PduResponder(Identification(revision="1"), peer=peer, session=self.desk.session(peer))

    def check_effects(self) -> None:
        """Nothing is changed by a reader; by a commander nothing that is out of range."""
        if not self.commands:
            assert not self.joints.zeros
            assert not self.joints.cleared
            assert not self.joints.references
            assert not self.store.saved
            return
        assert set(self.joints.zeros) | set(self.joints.cleared) <= {1, 2}
        assert all(zero is None or 0 <= zero < MAS_PER_TURN for zero in self.joints.zeros.values())
        assert all(0.0 <= angle < 360.0 for _, angle, _ in self.joints.references)
        assert all(len(saved) <= 2 for saved in self.store.saved)


def check_pdu(request: bytes, answer: bytes, image: RegisterImage | None, *, commands: bool) -> None:
    """One answer against its request: of the right form, and registers only from this very image."""
    assert 2 <= len(answer) <= MAX_PDU_BYTES
    function = request[0]
    if answer[0] != function or function & 0x80:
        assert answer[0] == function | 0x80
        assert len(answer) == 2
        assert answer[1] in KNOWN_EXCEPTIONS, answer
        return
    assert commands or function in {1, 2, 3, 4, 0x2B}
    if function in {3, 4, 0x17}:
        address, count = int.from_bytes(request[1:3], "big"), int.from_bytes(request[3:5], "big")
        assert answer[1] == 2 * count == len(answer) - 2
        if address >= COMMAND_BLOCK:
            assert commands
        else:
            assert image is not None
            assert answer[2:] == image.read(address, count)
    elif function in {1, 2}:
        count = int.from_bytes(request[3:5], "big")
        assert answer[1] == (count + 7) // 8 == len(answer) - 2
        assert commands or image is not None
    elif function != 0x2B:
        assert request.startswith(answer)


def feed_tcp(data: bytes, cuts: list[int], images: list[int], *, commands: bool) -> None:
    """One stream in these pieces; before each piece another image may be published."""
    served = Served(commands)
    stream = ModbusTcpStream(UNIT_ID, served.responder)
    pending, at, now_ns = bytearray(), 0, 10**12
    ended = False
    for cut, which in zip((*cuts, len(data)), images, strict=True):
        while at < cut:
            space = stream.space
            assert len(space)
            taken = min(cut - at, len(space))
            space[:taken] = data[at : at + taken]
            pending += data[at : at + taken]
            at, now_ns = at + taken, now_ns + 60_000_000
            answers = memoryview(stream.answer(taken, IMAGES[which], now_ns))
            ended, answers = _check_tcp(pending, answers, IMAGES[which], ended=ended, commands=commands)
            assert not answers, "more answers than requests"
            assert ended == (stream.broken is not None)
    served.responder.close()
    served.check_effects()


def _check_tcp(
    pending: bytearray, answers: memoryview, image: RegisterImage | None, *, ended: bool, commands: bool
) -> tuple[bool, memoryview]:
    """Take the complete frames out of `pending`, each with its answer; what is left of the answers."""
    while not ended and len(pending) >= 7:
        length = int.from_bytes(pending[4:6], "big")
        if pending[2:4] != b"\0\0" or not 2 <= length <= 254:
            ended = True
        elif len(pending) < 6 + length:
            break
        else:
            size = int.from_bytes(answers[4:6], "big")
            header, pdu, answers = answers[:7], bytes(answers[7 : 6 + size]), answers[6 + size :]
            assert header == pending[:4] + (len(pdu) + 1).to_bytes(2, "big") + pending[6:7]
            request = bytes(pending[7 : 6 + length])
            if pending[6] in (0, 255, UNIT_ID):
                check_pdu(request, pdu, image, commands=commands)
            else:
                assert pdu == bytes((request[0] | 0x80, 0x0B))
            del pending[: 6 + length]
    return ended, answers


def feed_rtu(pieces: list[tuple[bytes, int]], which: int, *, commands: bool) -> None:
    """Bytes, each followed by so many ns without one; every silence is judged."""
    served = Served(commands)
    stream = ModbusRtuStream(UNIT_ID, served.responder, baudrate=19_200)
    now_ns, since_silence = 10**12, bytearray()
    for data, gap_ns in pieces:
        stream.receive(data, now_ns)
        since_silence += data
        now_ns += gap_ns
        answer = stream.silent(IMAGES[which], now_ns)
        if answer:
            assert gap_ns >= stream.silence_ns
            assert len(answer) <= MAX_RTU_BYTES
            assert answer[0] == UNIT_ID
            assert crc16(answer) == 0
            request = _last_request(bytes(since_silence), answer)
            check_pdu(request, answer[1:-2], IMAGES[which], commands=commands)
        if gap_ns >= stream.silence_ns:
            since_silence.clear()
    served.responder.close()
    served.check_effects()


def _last_request(line: bytes, answer: bytes) -> bytes:
    """The shortest good frame for this unit and function at the very end of what was received."""
    function = answer[1] & 0x7F
    for begin in range(len(line) - 4, -1, -1):
        frame = line[begin:]
        if (
            frame[0] == UNIT_ID
            and frame[1] & 0x7F == function
            and len(frame) <= MAX_RTU_BYTES
            and not crc16(frame)
        ):
            return frame[1:-2]
    raise AssertionError("an answer without a request at the end of the line")


class ModbusFuzz:
    """Makes and feeds streams; `one` is one stream."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._pdus = Mutator(rng, corpus_bytes("modbus.txt"))
        self._streams = Mutator(rng, [self._adu(pdu) for pdu in corpus_bytes("modbus.txt")])

    def one_tcp(self) -> None:
        """A mutated stream, or good headers around mutated PDUs: those reach deeper."""
        rng = self._rng
        if rng.random() < 0.4:
            data = self._streams.made()
        else:
            data = b"".join(self._adu(self._pdus.made(252) or b"\4") for _ in range(rng.randrange(1, 5)))
        cuts = sorted(rng.randrange(len(data) + 1) for _ in range(rng.choice((0, 0, 1, 2, 8))))
        images = [rng.randrange(3) for _ in range(len(cuts) + 1)]
        feed_tcp(data, cuts, images, commands=rng.random() < 0.5)

    def one_rtu(self) -> None:
        """Frames with good and bad checksums, gaps shorter and longer than the silence."""
        rng = self._rng
        pieces: list[tuple[bytes, int]] = []
        for _ in range(rng.randrange(1, 5)):
            frame = bytes((rng.choice((UNIT_ID, UNIT_ID, UNIT_ID, 0, 9)),)) + self._pdus.made(250)
            if rng.random() < 0.85:
                frame += crc16(frame).to_bytes(2, "little")
            if rng.random() < 0.2:
                frame = self._pdus.made(400)
            cut = rng.randrange(len(frame) + 1) if rng.random() < 0.3 else len(frame)
            gaps = (0, 500_000, 2_100_000, 40_000_000)
            pieces += [(part, rng.choice(gaps)) for part in (frame[:cut], frame[cut:]) if part]
        feed_rtu([*pieces, (b"", 3_000_000)], rng.randrange(3), commands=rng.random() < 0.5)

    def _adu(self, pdu: bytes) -> bytes:
        unit = self._rng.choice((0, 255, UNIT_ID, UNIT_ID, 9))
        return self._rng.randbytes(2) + b"\0\0" + (len(pdu) + 1).to_bytes(2, "big") + bytes((unit,)) + pdu
