"""What a silent listener learns of a CANopen bus: who lives on it, what is sent how often, who else is master."""

from dataclasses import dataclass

NMT_STATES = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}
_PDO_BASES = (0x180, 0x280, 0x380, 0x480)
TEMPERATURE_CANDIDATES = (
    ((0x7130, 1), "CiA 404 input 1"),
    ((0x7130, 2), "CiA 404 input 2"),
    ((0x6401, 1), "CiA 401 analogue input 1"),
)
"""Objects that often hold a temperature; which one does is for the unit's manual to say."""


@dataclass(slots=True)
class HeardFrame:
    """One COB-ID and how often it came."""

    frames: int = 0
    length: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """None after a single frame."""
        elapsed_ns = self.last_ns - self.first_ns
        return (self.frames - 1) * 1e9 / elapsed_ns if self.frames > 1 and elapsed_ns > 0 else None


class BusSurvey:
    """Frames in, what they show out."""

    def __init__(self) -> None:
        self.frames = 0
        self.states: dict[int, str] = {}
        """Node-id to its last heartbeat."""
        self.boot_ups: dict[int, int] = {}
        self.emergencies: dict[int, str] = {}
        self.heard: dict[int, HeardFrame] = {}
        """Every COB-ID of process data, and SYNC."""
        self.other_master: str = ""
        """What another master was heard to say; empty: none was."""

    def take(self, cob_id: int, data: bytes, stamp_ns: int) -> None:
        """One frame of the bus, none of our own."""
        self.frames += 1
        node_id = cob_id & 0x7F
        if 0x701 <= cob_id <= 0x77F and len(data) == 1:
            state = data[0] & 0x7F
            self.states[node_id] = NMT_STATES.get(state, f"0x{state:02X}")
            self.boot_ups[node_id] = self.boot_ups.get(node_id, 0) + (state == 0)
        elif 0x081 <= cob_id <= 0x0FF:
            self.emergencies[node_id] = data.hex(" ")
        elif cob_id == 0x080 or 0x180 <= cob_id <= 0x57F:
            heard = self.heard.setdefault(cob_id, HeardFrame(first_ns=stamp_ns))
            heard.frames, heard.length, heard.last_ns = heard.frames + 1, len(data), stamp_ns
        elif 0x601 <= cob_id <= 0x67F:
            self.other_master = f"SDO requests to node {node_id}"
        elif cob_id == 0x7E5:
            self.other_master = "layer setting services"

    def nodes(self) -> set[int]:
        """Node-ids that were heard of, TPDOs of the pre-defined connection set included."""
        by_pdo = {cob_id & 0x7F for cob_id in self.heard if cob_id & 0x780 in _PDO_BASES}
        return (set(self.states) | set(self.emergencies) | by_pdo) - {0}

    def sent_by(self, node_id: int) -> dict[int, HeardFrame]:
        """Process data of this node, where it keeps to the pre-defined connection set."""
        return {base + node_id: self.heard[base + node_id] for base in _PDO_BASES if base + node_id in self.heard}
