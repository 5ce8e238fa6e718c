"""The pipeline of joints that a configuration names, fed frame by frame; time is an argument, nothing waits."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from trueangle.config import JointConfig, parse_config
from trueangle.core.health import NodeCondition, ServiceBit, StatusBit
from trueangle.core.pipeline import Frame, Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.process_data import node_plans
from trueangle.service import joint_channel, joint_identity, load_joints

MODELS = Path(__file__).parents[1] / "data" / "models"
MS = 1_000_000
GOOD = StatusBit.CONFIGURED | StatusBit.VALID
REST = 1_234_567
SERVICE_STATUS = 7


def joint(slot: int, *, temperature: str = "", more: str = "") -> str:
    """Joint 1 has good.onnx, joint 2 its twin."""
    model = "good.onnx" if slot == 1 else "twin.onnx"
    return (
        f"  - {{slot: {slot}, name: j{slot}, bus: arm, node_id: {slot}, model: {model}, {more}\n"
        f"     encoder: {{counts_per_rev: 3276800}},\n"
        f"     temperature: {{index: 0x7130, subindex: {slot}, degc_per_unit: 0.01, stale_s: 2, "
        f"{temperature}}}}}\n"
    )


@dataclass
class Line:
    """The pipeline of these joints; buses up, nodes in service, SYNC seen, positions at rest on bus arm."""

    text: str
    buses: tuple[str, ...] = ("arm",)
    now_ns: int = 10**12
    images: list[RegisterImage] = field(default_factory=list[RegisterImage])
    asked: list[tuple[str, int, str]] = field(default_factory=list[tuple[str, int, str]])
    """Bus, node-id and reason of each wish to identify a node anew."""

    def __post_init__(self) -> None:
        buses = ", ".join(f"{{name: {name}, interface: virtual, channel: {name}}}" for name in self.buses)
        head = f"schema_version: 1\nbuses: [{buses}]\njoints:\n"
        config = parse_config(head + self.text, source="t.yaml")
        loaded = load_joints(config, base=MODELS, source="t.yaml")
        self.joints: dict[int, JointConfig] = {j.slot: j for j in config.joints}
        plans = [(bus, plan) for bus in self.buses for plan in node_plans(config.joints, bus)]
        self.pipeline = Pipeline(
            [joint_channel(entry) for entry in loaded],
            RegisterMap([joint_identity(entry) for entry in loaded]),
            publish=self.images.append,
            on_status=lambda slot, before, after: None,
            sensors=plans,
            on_clash=lambda bus, node_id, reason: self.asked.append((bus, node_id, reason)),
        )
        for bus in self.buses:
            self.pipeline.on_bus(bus, up=True, now_ns=self.now_ns)
        for bus, plan in plans:
            if plan.slot is not None:
                self.pipeline.on_node(plan.slot, NodeCondition.RUNNING, self.now_ns, head=plan.head)
            self.pipeline.on_sensor(bus, plan.node_id, NodeCondition.RUNNING, self.now_ns)

    def feed(self, *frames: tuple[int, bytes], bus: str = "arm") -> None:
        batch: list[Frame] = [(cob_id, data, self.now_ns) for cob_id, data in frames]
        self.pipeline.on_frames(bus, batch, self.now_ns)

    def cycle(self, *slots: int, counts: int = REST, sync: bool = True) -> None:
        """5 ms: SYNC, 1 ms later positions of these slots."""
        if sync:
            self.pipeline.on_sync("arm", self.now_ns)
        self.now_ns += MS
        self.feed(*(position(slot, counts) for slot in slots))
        self.now_ns += 4 * MS

    def run(self, seconds: float, *slots: int, sync: bool = True, also: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds * 200)):
            self.cycle(*slots, sync=sync)
            if also is not None:
                also()

    def status(self, slot: int) -> StatusBit:
        self.pipeline.tick(self.now_ns)
        data = self.images[-1].read(10 + 12 * (slot - 1), 2)
        assert data is not None
        return StatusBit(int.from_bytes(data, "big"))

    def service(self) -> ServiceBit:
        self.pipeline.tick(self.now_ns)
        data = self.images[-1].read(SERVICE_STATUS, 1)
        assert data is not None
        return ServiceBit(int.from_bytes(data, "big"))


def position(slot: int, counts: int = REST) -> tuple[int, bytes]:
    return (0x180 + slot, struct.pack("<I", counts))
